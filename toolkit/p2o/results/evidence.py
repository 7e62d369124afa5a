"""Predicted error, and evidence for or against an estimated pose: agreement, the next best pose, costs, the prior."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from p2o.results.json_types import Count, Number, Pose


@dataclass(frozen=True)
class Accuracy:
    """The predicted error of a calibration, estimated without ground truth.

    The rotation error is below `rotation_deg` for 67 % of calibrations with such numbers and below `rotation_deg_95`
    for 95 %; the same holds for the translation error and `translation_m`, `translation_m_95`. Errors are those of
    `p2o.geometry.pose_error.pose_error`. `roll_deg` to `z_m` are the 67 % bounds by camera axis (roll about z, pitch
    about x, yaw about y), None where they are unknown: a direction that the scene does not determine widens its own
    axis only.
    """

    rotation_deg: Number
    translation_m: Number
    rotation_deg_95: Number
    translation_m_95: Number
    roll_deg: Number | None = None
    pitch_deg: Number | None = None
    yaw_deg: Number | None = None
    x_m: Number | None = None
    y_m: Number | None = None
    z_m: Number | None = None

    def reaches(self, rotation_deg: float, translation_m: float) -> bool:
        """Return whether the predicted errors (67 %) are at most these."""
        return self.rotation_deg <= rotation_deg and self.translation_m <= translation_m


@dataclass(frozen=True)
class Agreement:
    """Agreement of LiDAR edges with image edges of the same direction at a pose (`p2o.problems.agreement`).

    `near` is the share of LiDAR edges in the image with a reliable image edge of their direction near by, `chance` the
    share expected under random alignment within the same image rows, `points` the number of LiDAR edges. `places` is
    the number of independent cells (64 px, by direction) in which edges agree. `least_odds` is the smallest odds ratio
    of one direction, and `least_side` its letter (L, R, U, B); None and "" where no direction has enough edges.
    """

    near: Number
    chance: Number
    points: Count
    places: Count = 0
    least_odds: Number | None = None
    least_side: str = ""

    @property
    def strength(self) -> float:
        """The evidence: log odds ratio times the square root of `places`; 0 for random alignment, NaN without points.

        The log odds ratio that random alignment and a search among poses can reach falls with the square root of the
        number of independent cells. This value therefore compares between sensors, which the odds ratio does not.
        """
        return float(np.log(self.odds_ratio) * np.sqrt(self.places)) if self.points else float("nan")

    @property
    def odds_ratio(self) -> float:
        """Odds of agreement over the odds under random alignment: 1 for random alignment, NaN without points."""
        return odds_ratio(self.near, self.chance) if self.points else float("nan")


def odds_ratio(near: float, chance: float) -> float:
    """Return the odds of a share `near` over those of a share `chance`; both are clipped to within 1e-6 of 0 and 1."""
    near, chance = np.clip([near, chance], 1e-6, 1 - 1e-6).tolist()
    return near / (1 - near) / (chance / (1 - chance))


@dataclass(frozen=True)
class Rival:
    """The next best pose that differs from the estimate: its distance and by how much its cost is higher.

    `lead` is the difference of the costs in `unit`: for directed edges, the number of edges fewer that agree.
    """

    lead: Number
    unit: str
    rotation_deg: Number
    translation_m: Number


@dataclass(frozen=True, eq=False)
class StartWeight:
    """The effect of an initial guess with standard deviations `sigma_deg` and `sigma_m` per axis, used as a prior.

    `camera_from_lidar` (4, 4) is the pose estimated from edges alone and `accuracy` its predicted error. The estimate
    is the mean of this pose and the initial guess, weighted by their information; `step_deg` and `step_m` are its
    distance from the pose of the edges.
    """

    sigma_deg: Number
    sigma_m: Number
    camera_from_lidar: Pose
    accuracy: Accuracy
    step_deg: Number
    step_m: Number


@dataclass(frozen=True)
class Judged:
    """The costs of the initial guess and of the estimate on the same points, by the judge of the method, in `unit`."""

    judge: str
    unit: str
    start: Number
    estimate: Number
    excess_truth: Number | None = None  # cost of the truth minus that of the estimate, where the truth is known
