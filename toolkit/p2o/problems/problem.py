"""What a matcher makes of the views at one pose: a cost over poses, and for least squares its residuals as well."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar, Protocol, runtime_checkable

import numpy as np

from p2o.arrays import Float, Int
from p2o.geometry import se3

_CHUNK = 1 << 18  # residuals evaluated at once for many poses: about what a core's cache holds
_STEP = 1e-5  # radians and metres: errors of central differences and of rounding are alike at this size


@runtime_checkable
class Problem(Protocol):
    """Anything with a cost: `cost` takes camera_from_lidar (B, 4, 4) and returns (B,), lower is better."""

    def cost(self, poses: Float, /) -> Float: ...


@dataclass(frozen=True, eq=False)
class Objective:
    """A scalar cost: `cost` takes camera_from_lidar (B, 4, 4) and returns (B,), lower is better.

    Optional, for one pose (4, 4): `gradient`, the derivatives (6,) of the cost by a left update in radians and metres
    in the camera frame, where solvers would take differences; and `covariance`, the (6, 6) of such an update where the
    pose is the optimum, or None where it cannot be told, which solvers hand on with their solution. `lasting` says that
    the cost does not depend on the reach that it was posed with: a round that leaves the pose where it is is the last.
    """

    cost: Callable[[Float], Float]
    gradient: Callable[[Float], Float] | None = None
    covariance: Callable[[Float], Float | None] | None = None
    lasting: bool = False


class LeastSquares:
    """Base of problems that are a robust sum of squares: any number K of residuals r_k, weights and a Huber kernel.

    The cost is sum_k weight_k rho(r_k), rho(r) = r^2 / 2 up to `huber` and linear beyond. A subclass has `weight` (K,)
    >= 0, `frame` (K,) the number of the view that each residual belongs to, `huber` and `far` in the `unit` of its
    residuals, and `residuals`; derivatives are taken by differences unless it gives them. `far` is what an unseen
    measurement (NaN) is charged with, and the most that any is.
    """

    unit: ClassVar[str] = "px"
    weight: Float
    frame: Int

    @property
    def huber(self) -> float:
        """Residual from which a measurement counts linearly and no longer squared."""
        raise TypeError(f"{type(self).__name__} has no Huber width: define huber")

    @property
    def far(self) -> float:
        """The largest residual that counts, and that of what is unseen."""
        return 1e3 * self.huber

    def __len__(self) -> int:
        return len(self.weight)

    def residuals(self, camera_from_lidar: Float) -> Float:
        """Return signed residuals, (K,) for one pose (4, 4) or (B, K) for (B, 4, 4); NaN where unseen."""
        raise TypeError(f"{type(self).__name__} does not say its residuals: define residuals")

    def residuals_with_jacobian(self, camera_from_lidar: Float) -> tuple[Float, Float]:
        """Return residuals (K,) and derivatives (K, 6) for a left update exp(delta) @ camera_from_lidar.

        The tangent vector is (rotation in rad, translation in m), in the camera frame; here by central differences.
        """
        pose = np.asarray(camera_from_lidar, dtype=np.float64)
        steps = se3.exp(np.concatenate([_STEP * np.eye(6), -_STEP * np.eye(6)])) @ pose
        around = self.residuals(steps)
        return self.residuals(pose), (around[:6] - around[6:]).T / (2 * _STEP)

    def depth_m(self, camera_from_lidar: Float) -> float:
        """Return the mean distance of what is measured from the camera, which scales turns against shifts."""
        return 30.0

    def robust_weight(self, residuals: Float) -> Float:
        """Return the factors (K,) of a reweighted sum: `weight`, less where a residual exceeds the kernel."""
        return np.asarray(self.weight * self.huber / np.maximum(np.abs(residuals), self.huber))

    def loss(self, residuals: Float) -> Float:
        """Return the robust sum (...) of residuals (..., K); unseen ones (NaN) count as `far`, as do larger ones."""
        size = np.abs(residuals)
        np.fmin(size, self.far, out=size)  # fmin passes over NaN
        inner = np.minimum(size, self.huber)
        size -= 0.5 * inner
        size *= inner
        return np.asarray(size @ self.weight)

    def cost(self, poses: Float) -> Float:
        """Return the robust sum (B,) of poses (B, 4, 4): what makes residuals an `Objective` too.

        A measurement that a pose puts out of sight costs as much as one that is `far` off.
        """
        poses = np.asarray(poses, dtype=np.float64)
        size = max(1, _CHUNK // max(len(self), 1))
        parts = [self.loss(self.residuals(poses[i : i + size])) for i in range(0, len(poses), size)]
        return np.concatenate(parts) if parts else np.zeros(0)

    def as_objective(self) -> Objective:
        """Return the robust sum for solvers that want a scalar cost."""
        return Objective(self.cost)
