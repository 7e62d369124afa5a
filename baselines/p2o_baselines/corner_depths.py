"""The extrinsic at which corners that the sweeps give a depth move as the LiDAR says: all steps in one least squares.

Corners are followed from picture to picture once. The extrinsic X gives each its distance, from the points of the sweep
around it, and how it moves: X B X^-1 for the LiDAR's motion B. It should then lie on the ray on which it is seen. That
the distance changes with X is in the derivatives: with LiDAR points that are followed by an X that is wrong, and
hand-eye equations in turn (`hand_eye`), an X half a metre off can agree with itself. Ours, as are all constants.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import p2o
from p2o.arrays import Float, Int

from p2o_baselines.lidar_tracks import across

_NEIGHBOURS = 6
_REACH_PX = 12.0
"""Points of the sweep farther from a corner say nothing of its distance."""
_STEP = 0.12
"""Neighbours whose distances differ by a larger share lie on different things."""
_SOFT_PX = 3.0
_RIDGE_PX = 1.5
"""Neighbours closer together than this tell no slope."""
_USUAL_PX = 0.5
_CHANGE = 1e-4
_DRIFT_RAD, _DRIFT_M = np.radians(0.01), 0.005
"""How wrong LiDAR odometry may be in every step alike, an axis."""
_FLOOR_RAD, _FLOOR_M = 1.0, 30.0


@dataclass(frozen=True, eq=False)
class Followed:
    """Corners of one picture, and where they are seen in later ones.

    `xyz` (N, 3) is the sweep that belongs to the picture, `uv` (M, 2) px and `rays` (M, 3) are its corners, `there`
    (K, M, 3) their rays in later pictures, NaN where they are lost, and `lidar` (K, 4, 4) how points of the LiDAR frame
    move until then.
    """

    camera: p2o.Camera
    xyz: Float
    uv: Float
    rays: Float
    there: Float
    lidar: Float


@dataclass(frozen=True, eq=False)
class Joint:
    """The extrinsic (4, 4), the covariance (6, 6) of a left update (rad, m), how many corners count, and by how much
    they are off, root mean square; `settled` tells whether it was reached.
    """

    camera_from_lidar: Float
    covariance: Float
    corners: int
    off_px: float
    settled: bool


def refined(groups: Sequence[Followed], camera_from_lidar: Float, *, iterations: int = 25) -> Joint | None:
    """Return the extrinsic that all corners agree on, from one (4, 4) that is about right; None where too few count."""
    pose, settled, width_px = np.array(camera_from_lidar, np.float64), False, 6.0 * _USUAL_PX
    floor = np.diag(np.repeat([1 / _FLOOR_RAD**2, 1 / _FLOOR_M**2], 3))
    for number in range(iterations):
        terms = [_terms(group, pose, width_px) for group in groups]
        normal = sum((term.normal for term in terms), np.zeros((6, 6)))
        gradient = sum((term.gradient for term in terms), np.zeros(6))
        if sum(term.count for term in terms) < 40:
            return None
        update = -np.linalg.solve(normal + floor, gradient)
        size = np.abs(update)
        update *= min(1.0, 0.05 / max(float(size[:3].max()), 1e-12), 0.3 / max(float(size[3:].max()), 1e-12))
        pose = p2o.se3.exp(update) @ pose
        small = np.linalg.norm(update[:3]) < 1e-4 and np.linalg.norm(update[3:]) < 2e-3
        if small and number > 3:
            settled = True
            break
        # Wide first, for the start may be off by many pixels.
        width_px = max(0.75 * width_px, 3.0 * _USUAL_PX)
    terms = [_terms(group, pose, width_px) for group in groups]
    count = sum(term.count for term in terms)
    if count < 40:
        return None
    normal = sum((term.normal for term in terms), np.zeros((6, 6)))
    square = sum(term.square for term in terms)
    total = sum(term.weight for term in terms)
    inverse = np.linalg.inv(normal + floor)
    # What corners of one picture have in common counts once a picture.
    parts = np.array([term.gradient for term in terms if term.count])
    spread = parts.T @ parts * len(parts) / max(len(parts) - 6, 1)
    longer = count / max(sum(term.corners for term in terms), 1)
    covariance = inverse @ spread @ inverse + inverse * max(square / max(2 * total, 1e-9), 1e-4) * longer
    # LiDAR odometry that is wrong by the same in every step, which no residual shows.
    swayed = inverse @ sum((_by_lidar(group, pose, width_px) for group in groups), np.zeros((6, 6)))
    covariance += swayed @ np.diag(np.repeat([_DRIFT_RAD**2, _DRIFT_M**2], 3)) @ swayed.T
    # What nothing tells is open, however well it fits.
    covariance += np.linalg.inv(normal / max(square / max(2 * total, 1e-9), 1e-4) + floor)
    return Joint(pose, 0.5 * (covariance + covariance.T), count, float(np.sqrt(square / max(total, 1e-9))), settled)


@dataclass(frozen=True, eq=False)
class _Terms:
    """Sums over the corners of one picture: `square` of residuals in px^2 and `weight`, both damped."""

    normal: Float
    gradient: Float
    square: float
    weight: float
    count: int
    corners: int


def _terms(group: Followed, pose: Float, width_px: float) -> _Terms:
    rows, neighbours = _neighbours(group, pose)
    if not len(rows):
        return _Terms(np.zeros((6, 6)), np.zeros(6), 0.0, 0.0, 0, 0)
    off = _off_px(group, rows, neighbours, pose)
    known = np.isfinite(off).all(axis=2)
    jacobian = np.zeros((*off.shape, 6))
    for axis in range(6):
        change = np.zeros(6)
        change[axis] = _CHANGE
        both = [_off_px(group, rows, neighbours, p2o.se3.exp(sign * change) @ pose, centre=pose) for sign in (1, -1)]
        jacobian[..., axis] = (both[0] - both[1]) / (2 * _CHANGE)
    known &= np.isfinite(jacobian).all(axis=(2, 3))
    off, jacobian = off[known], jacobian[known]
    square = (off**2).sum(axis=1)
    weight = 1.0 / (1.0 + square / width_px**2)
    return _Terms(
        np.einsum("n,nji,njk->ik", weight, jacobian, jacobian),
        np.einsum("n,nji,nj->i", weight, jacobian, off),
        float((weight * square).sum()),
        float(weight.sum()),
        len(off),
        int(known.any(axis=0).sum()),
    )


def _by_lidar(group: Followed, pose: Float, width_px: float) -> Float:
    """Return how the gradient (6,) changes with a left update (6,) of the LiDAR's step from frame to frame."""
    longer = np.arange(1, len(group.lidar) + 1)[:, None]
    out = np.zeros((6, 6))
    for axis in range(6):
        change = np.zeros(6)
        change[axis] = _CHANGE
        both = [
            _terms(replace(group, lidar=p2o.se3.exp(sign * change * longer) @ group.lidar), pose, width_px).gradient
            for sign in (1, -1)
        ]
        out[:, axis] = (both[0] - both[1]) / (2 * _CHANGE)
    return out


def _neighbours(group: Followed, pose: Float) -> tuple[Int, Int]:
    """Return the rows of corners (R,) whose distance the sweep tells at a pose, and the points around them (R, 6)."""
    from scipy.spatial import cKDTree

    points = p2o.se3.apply(pose, group.xyz)
    uv = group.camera.project(points)
    seen = np.flatnonzero(group.camera.in_image(uv, _REACH_PX) & (points[:, 2] > 0.1))
    if len(seen) < _NEIGHBOURS:
        return np.zeros(0, np.int64), np.zeros((0, _NEIGHBOURS), np.int64)
    away, near = cKDTree(uv[seen]).query(group.uv, k=_NEIGHBOURS, distance_upper_bound=_REACH_PX)
    full = np.isfinite(away).all(axis=1)
    near = seen[np.where(full[:, None], near, 0)]
    distance = np.linalg.norm(points[near], axis=2)
    smooth = distance.max(axis=1) / np.maximum(distance.min(axis=1), 1e-6) < 1 + _STEP
    rows = np.flatnonzero(full & smooth)
    return rows, near[rows]


def _off_px(group: Followed, rows: Int, neighbours: Int, pose: Float, *, centre: Float | None = None) -> Float:
    """Return how far corners (R,) lie from their rays in each later picture, (K, R, 2) px.

    Neighbours weigh by how near they are at the pose `centre`.
    """
    rays = group.rays[rows] / np.linalg.norm(group.rays[rows], axis=1)[:, None]
    basis = across(rays)
    focal_px = group.camera.focal_px

    def ways(camera_from_lidar: Float) -> tuple[Float, Float]:
        points = p2o.se3.apply(camera_from_lidar, group.xyz[neighbours].reshape(-1, 3)).reshape(*neighbours.shape, 3)
        distance = np.linalg.norm(points, axis=2)
        return np.einsum("rij,rkj->rki", basis, points / distance[..., None]) * focal_px, 1.0 / distance

    aside, inverse = ways(pose)
    near = aside if centre is None else ways(centre)[0]
    weight = 1.0 / ((near**2).sum(axis=2) + _SOFT_PX**2)
    # On a plane the inverse distance is linear over the picture: its value at the corner, where aside is zero.
    design = np.concatenate([np.ones((*aside.shape[:2], 1)), aside], axis=2)
    normal = np.einsum("rk,rki,rkj->rij", weight, design, design)
    ridge = weight.sum(axis=1)[:, None] * np.array([0.0, _RIDGE_PX**2, _RIDGE_PX**2])
    normal += ridge[:, :, None] * np.eye(3)
    here = np.linalg.solve(normal, np.einsum("rk,rki,rk->ri", weight, design, inverse)[..., None])[:, 0, 0]
    points = rays / np.maximum(here, 1e-4)[:, None]
    back = p2o.se3.inverse(pose)
    out = np.full((len(group.there), len(rows), 2), np.nan)
    for number, (there, lidar) in enumerate(zip(group.there, group.lidar, strict=True)):
        moved = p2o.se3.apply(pose @ lidar @ back, points)
        known = np.isfinite(there[rows]).all(axis=1) & (moved[:, 2] > 0.1)
        seen = there[rows][known]
        seen = seen / np.linalg.norm(seen, axis=1)[:, None]
        way = moved[known] / np.linalg.norm(moved[known], axis=1)[:, None]
        out[number, known] = np.einsum("nij,nj->ni", across(seen), way) * focal_px
    return out
