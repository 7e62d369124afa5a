"""Local minimum of the directed distance near a pose, by Gauss-Newton steps on the distance maps."""

from __future__ import annotations

import numpy as np

from p2o.arrays import Float
from p2o.geometry import se3
from p2o.problems.directed_cost import DirectedCost

_MAX_POINTS = 4000
_MIN_DISTANCE_PX = 0.5
"""Smaller distances count as this in the weights of the iterations (least absolute distances)."""
_ITERATIONS, _MAX_HALVINGS = 12, 6
_CONVERGED_PX = 1e-4


def nearest_minimum(cost: DirectedCost, pose: Float) -> Float:
    """Return the pose (4, 4) of the smallest mean distance near a pose; of many points, an even subset counts.

    Rounds of matching end at one of several poses near by, which depends on where they began; the local minimum of the
    distance does not.
    """
    if not cost.points:
        return pose
    cost = cost.thinned(_MAX_POINTS)
    best, damping = cost.at(pose), 1e-3
    for _ in range(_ITERATIONS):
        hessian, gradient = _normal_equations(cost, pose)
        before = best
        for _ in range(_MAX_HALVINGS):
            damped = hessian + np.diag(damping * hessian.diagonal() + np.finfo(float).tiny)
            step_of_pose = np.asarray(np.linalg.lstsq(damped, gradient, rcond=None)[0], np.float64)
            after = se3.exp(-step_of_pose) @ pose
            value = cost.at(after)
            if value < best:
                pose, best = after, value
                damping /= 5
                break
            damping *= 5
        if before - best < _CONVERGED_PX:
            break
    return pose


def _normal_equations(cost: DirectedCost, pose: Float) -> tuple[Float, Float]:
    """Return Hessian (6, 6) and gradient (6,) of the mean distance by a left update of a pose (4, 4)."""
    hessian, gradient = np.zeros((6, 6)), np.zeros(6)
    for number, part in enumerate(cost.parts):
        xyz = se3.apply(pose @ cost.lidar_from_around, part.xyz)
        with np.errstate(divide="ignore", invalid="ignore"):
            uv, by_xyz = part.camera.project_with_jacobian(xyz)
        distance = cost.sampled(number, uv)
        slope_u, slope_v = cost.slopes(number, uv)
        by_point = slope_u[:, None] * by_xyz[:, 0] + slope_v[:, None] * by_xyz[:, 1]
        by_pose = np.hstack([np.cross(xyz, by_point), by_point])
        np.copyto(by_pose, 0.0, where=~np.isfinite(by_pose))
        weight = part.weight / np.maximum(distance, _MIN_DISTANCE_PX)
        hessian += (by_pose * weight[:, None]).T @ by_pose
        gradient += by_pose.T @ (weight * distance)
    return hessian / cost.edges, gradient / cost.edges
