"""The least-squares problem of several cameras over one pose: the unknown is body_from_lidar.

A left update exp(d) of body_from_lidar is the left update exp(Ad(camera_from_body) d) of camera_from_lidar (Barfoot,
State Estimation for Robotics, 2017, section 7.1).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from p2o.arrays import Float
from p2o.geometry.motion import adjoint_matrix
from p2o.problems.problem import LeastSquares


@dataclass(frozen=True, eq=False)
class RigResiduals(LeastSquares):
    """The residuals of several cameras over body_from_lidar (4, 4): `parts` are camera_from_body (4, 4) and problem."""

    parts: tuple[tuple[Float, LeastSquares], ...]

    @cached_property
    def weight(self) -> Float:  # type: ignore[override]
        """Weights (K,) of all residuals."""
        return np.concatenate([np.zeros(0), *(problem.weight for _, problem in self.parts)])

    @cached_property
    def frame(self) -> Float:  # type: ignore[override]
        """Numbers (K,) of the views, counted over all cameras."""
        first = np.cumsum([0, *(int(problem.frame.max(initial=-1)) + 1 for _, problem in self.parts)])
        frames = [problem.frame + at for (_, problem), at in zip(self.parts, first, strict=False)]
        return np.concatenate([np.zeros(0, np.int64), *frames])

    @cached_property
    def huber(self) -> float:
        """Width of the Huber kernel, the same for all cameras."""
        return max((problem.huber for _, problem in self.parts), default=1.0)

    @cached_property
    def far(self) -> float:
        """Largest residual that counts."""
        return max((problem.far for _, problem in self.parts), default=1e3)

    def residuals(self, body_from_lidar: Float) -> Float:
        """Return signed residuals, (K,) for one pose (4, 4) or (B, K) for (B, 4, 4); NaN where unseen."""
        pose = np.asarray(body_from_lidar, np.float64)
        none = np.zeros((*pose.shape[:-2], 0))
        return np.concatenate([none, *(problem.residuals(place @ pose) for place, problem in self.parts)], axis=-1)

    def residuals_with_jacobian(self, body_from_lidar: Float) -> tuple[Float, Float]:
        """Return residuals (K,) and derivatives (K, 6) by a left update of body_from_lidar, in rad and m."""
        residuals, rows = [np.zeros(0)], [np.zeros((0, 6))]
        for place, problem in self.parts:
            its, by_camera = problem.residuals_with_jacobian(place @ body_from_lidar)
            residuals.append(its)
            rows.append(by_camera @ adjoint_matrix(place))
        return np.concatenate(residuals), np.concatenate(rows)

    def depth_m(self, body_from_lidar: Float) -> float:
        """Return the mean distance of what the cameras measure."""
        return float(np.mean([problem.depth_m(place @ body_from_lidar) for place, problem in self.parts]))
