"""What was found beside a pose that speaks for or against it: agreement of edges, the rival pose, costs."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from p2o.arrays import Float
from p2o.results.accuracy import Accuracy


@dataclass(frozen=True)
class Agreement:
    """How LiDAR edges and image edges of their direction meet at a pose (`p2o.calibration.agreement`).

    `near` is the share of LiDAR edges in the image that have a sure image edge of their direction close by, `chance`
    the share that points scattered over the same rows of the image would have, `points` how many there are. `places`
    is how many places of the pictures (64 px, by direction) they meet in.
    """

    near: float
    chance: float
    points: int
    places: int = 0

    @property
    def strength(self) -> float:
        """The logarithm of the odds ratio times the root of the places: 0 is chance, NaN without points.

        The logarithm that chance and a search among poses can reach falls with the root of how many places there are to
        fit, so this compares between sensors, which the odds ratio does not.
        """
        return float(np.log(self.odds_ratio) * np.sqrt(self.places)) if self.points else float("nan")

    @property
    def odds_ratio(self) -> float:
        """Odds of a meeting over its odds by chance: 1 is chance, NaN without points."""
        near, chance = (np.clip(p, 1e-6, 1 - 1e-6) for p in (self.near, self.chance))
        return float(near / (1 - near) / (chance / (1 - chance))) if self.points else float("nan")


@dataclass(frozen=True)
class Rival:
    """The next best pose that is another one: how far away, and by how much it is worse.

    `lead` is the difference of the costs in `unit`: for directed edges, by how many edges fewer it is met.
    """

    lead: float
    unit: str
    rotation_deg: float
    translation_m: float


@dataclass(frozen=True, eq=False)
class StartWeight:
    """What a start that is good to `sigma_deg` and `sigma_m` an axis (one deviation) was worth for the estimate.

    `camera_from_lidar` (4, 4) is the pose of the edges alone and `accuracy` how wrong that one is likely to be. The
    estimate is the mean of it and the start, each weighed by what it leaves open, `step_deg` and `step_m` from it.
    """

    sigma_deg: float
    sigma_m: float
    camera_from_lidar: Float
    accuracy: Accuracy
    step_deg: float
    step_m: float


@dataclass(frozen=True)
class Judged:
    """The costs of the start and of the estimate on one set of points, by the judge of the method, in `unit`."""

    judge: str
    unit: str
    start: float
    estimate: float
