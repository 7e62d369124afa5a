"""The judge of poses of a LiDAR on a body, by the edges of several cameras."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from p2o.arrays import Float
from p2o.calibration.judge import DirectedJudge, IntervalJudge
from p2o.features.view import View
from p2o.geometry import se3
from p2o.geometry.motion import adjoint_matrix
from p2o.problems.interval_likelihood import IntervalLikelihood


@dataclass(frozen=True, eq=False)
class RigJudge:
    """Judges poses body_from_lidar by the edges of all cameras.

    `places` are camera_from_body (4, 4), `counts` the numbers of views of the cameras; all `judges` are of one kind.
    """

    places: tuple[Float, ...]
    judges: tuple[DirectedJudge | IntervalJudge, ...]
    counts: tuple[int, ...]

    @property
    def name(self) -> str:
        """The name of the cost."""
        return self.judges[0].name

    @property
    def unit(self) -> str:
        """The unit of the cost."""
        return self.judges[0].unit

    def costs(self, poses: Sequence[Float]) -> list[float]:
        """Return the cost of each pose: the mean distance over all edges in px, or the sum of nats."""
        rows, weights = [], []
        for place, judge in zip(self.places, self.judges, strict=True):
            row = np.array(judge.costs([place @ pose for pose in poses]))
            if np.isfinite(row).all():
                rows.append(row)
                weights.append(judge.cost.edges if isinstance(judge, DirectedJudge) else 1.0)
        if not rows:
            return [float("inf")] * len(poses)
        total = np.array(weights) @ np.array(rows)
        costs: list[float] = (total / (sum(weights) if isinstance(self.judges[0], DirectedJudge) else 1.0)).tolist()
        return costs

    def lead(self, best: float, other: float) -> tuple[float, str]:
        """Return how many matched edges the other pose loses."""
        first = self.judges[0]
        if isinstance(first, IntervalJudge):
            return first.lead(best, other)
        edges = sum(judge.cost.edges for judge in self.judges if isinstance(judge, DirectedJudge))
        return (other - best) * edges / first.cost.truncate_px, "edges"

    def on(self, views: Sequence[View]) -> RigJudge:
        """Return the judge of the same edges in other `views`, those of all cameras one after the other."""
        ends = np.cumsum([0, *self.counts])
        judges = [judge.on(views[a:b]) for judge, a, b in zip(self.judges, ends[:-1], ends[1:], strict=True)]
        return replace(self, judges=tuple(judges))


_STEPS = np.array([*np.radians([0.1, 0.1, 0.1]), 0.02, 0.02, 0.02])
"""Units of the unknowns of the maximisation: 0.1 deg and 2 cm."""


def most_likely_near(parts: Sequence[tuple[Float, IntervalLikelihood]], body_from_lidar: Float) -> Float:
    """Return the pose (4, 4) of the local maximum of a sum of interval likelihoods near a pose, by BFGS.

    `parts` are camera_from_body (4, 4) and the likelihood of each camera.
    """
    from scipy.optimize import minimize

    def cost_and_gradient(x: Float) -> tuple[float, Float]:
        pose, total, gradient = se3.exp(x * _STEPS) @ body_from_lidar, 0.0, np.zeros(6)
        for place, likelihood in parts:
            value, by_camera = likelihood.with_gradient(place @ pose)
            total, gradient = total - value, gradient - by_camera @ adjoint_matrix(place)
        return total, gradient * _STEPS

    best = minimize(cost_and_gradient, np.zeros(6), jac=True, method="BFGS", options={"maxiter": 30, "gtol": 0.2})
    return np.asarray(se3.exp(best.x * _STEPS) @ body_from_lidar)
