"""Problems that matchers pose to solvers: a cost over poses, and for least squares the residuals as well."""

from __future__ import annotations

import copy
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar, Protocol, Self, runtime_checkable

import numpy as np

from p2o.arrays import Float, Int
from p2o.geometry import se3

_CHUNK = 1 << 18  # residuals evaluated at once for many poses: about what a core's cache holds
_STEP = 1e-5  # rad and m: truncation and rounding errors of central differences are of equal size at this step


@runtime_checkable
class Problem(Protocol):
    """Any object with a cost: `cost` takes camera_from_lidar (B, 4, 4) and returns (B,), lower is better, no NaN."""

    def cost(self, poses: Float, /) -> Float: ...


@dataclass(frozen=True, eq=False)
class Objective:
    """A scalar cost: `cost` takes camera_from_lidar (B, 4, 4) and returns (B,), lower is better.

    Optional functions of one pose (4, 4): `gradient` returns the derivatives (6,) of the cost with respect to a left
    update exp(delta) @ pose (rotation in rad, translation in m, camera frame); solvers use differences without it.
    `covariance` returns the (6, 6) of such an update if the pose is the optimum, or None if it cannot be estimated;
    solvers copy it to their solution. Set `reach_independent` if the cost does not depend on the matching distance:
    the pipeline then stops when a round does not change the pose.
    """

    cost: Callable[[Float], Float]
    gradient: Callable[[Float], Float] | None = None
    covariance: Callable[[Float], Float | None] | None = None
    reach_independent: bool = False


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

    @cached_property
    def huber(self) -> float:
        """Residual from which a measurement counts linearly and no longer squared; set it or define it."""
        raise TypeError(f"{type(self).__name__} has no Huber width: define huber")

    @cached_property
    def far(self) -> float:
        """Largest residual that counts, and the residual of measurements that are not visible; 1000 times `huber`."""
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

    def weighted(self, weights: Float) -> Self:
        """Return the problem with the residuals of each view weighted by `weights` (F,); the sum stays as it is."""
        if not len(self) or len(set(weights.tolist())) < 2:
            return self
        weight = self.weight * weights[self.frame]
        total = float(weight.sum())
        weight = weight * (float(self.weight.sum()) / total) if total > 0 else weight
        out, kind = copy.copy(self), type(self)
        if isinstance(getattr(kind, "weight", None), property):  # no attribute of the object can replace it
            object.__setattr__(out, "__class__", type(kind.__name__, (kind,), {"weight": weight}))
        else:
            object.__setattr__(out, "weight", weight)
        return out

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


def pose_from_chart(start: Float, delta: Float) -> Float:
    """Return the poses (..., 4, 4) at delta (..., 6): `start` (4, 4) turned, then shifted, in the camera frame.

    delta holds a rotation vector in radians and a shift in metres; zero is the start itself.
    """
    delta = np.asarray(delta, dtype=np.float64)
    turn = delta.copy()
    turn[..., 3:] = 0.0
    pose = se3.exp(turn) @ start
    pose[..., :3, 3] += delta[..., 3:]
    return pose


def left_from_chart(delta: Float) -> Float:
    """Return the matrix (6, 6) that turns a small change of delta (6,) into the left update of the pose it makes.

    Derivatives by left updates (K, 6), times this matrix, are derivatives by delta.
    """
    # The translational part of the exponential is V times its argument, with V the left Jacobian of the rotation.
    unit = np.concatenate([np.tile(delta[:3], (3, 1)), np.eye(3)], axis=1)
    rotation = se3.exp(unit)[:, :3, 3].T
    out = np.eye(6)
    out[:3, :3] = rotation
    out[3:, :3] = se3.skew(delta[3:]) @ rotation
    return out


def swarmed(
    cost: Callable[[Float], Float],
    low: Float,
    high: Float,
    rng: np.random.Generator,
    *,
    first: Float,
    particles: int,
    moves: int,
    inertia: float = 0.7298,
    attraction: float = 1.49618,
    narrow: float = 0.0,
) -> tuple[Float, float, int]:
    """Return the best place (D,) found in the box from `low` to `high` (D,), its cost, and the moves that were made.

    `cost` takes places (B, D) and returns (B,), all of a move at once. One particle begins at `first`, so that nothing
    worse is returned; the others all over the box. Each keeps the share `inertia` of its velocity and is drawn by up to
    `attraction` to its own best place and to that of all (Kennedy and Eberhart 1995; the usual figures are those of
    Clerc and Kennedy 2002, with which a swarm comes to rest); it stops at a wall. A swarm whose best places lie within
    `narrow` of one another in every unknown has done its work.
    """
    place = rng.uniform(low, high, (particles, len(low)))
    place[0] = first
    velocity = rng.uniform(-0.5, 0.5, place.shape) * (high - low)
    own, own_cost, moved = place, cost(place), 0
    while moved < moves and not np.ptp(own, axis=0).max() < narrow:
        leader = own[np.argmin(own_cost)]
        to_own, to_leader = rng.uniform(0, attraction, (2, *place.shape))
        velocity = inertia * velocity + to_own * (own - place) + to_leader * (leader - place)
        place = place + velocity
        outside = (place < low) | (place > high)
        velocity = np.where(outside, 0.0, velocity)
        place = np.clip(place, low, high)
        costs = cost(place)
        better = costs < own_cost
        own, own_cost = np.where(better[:, None], place, own), np.where(better, costs, own_cost)
        moved += 1
    best = int(np.argmin(own_cost))
    return own[best], float(own_cost[best]), moved
