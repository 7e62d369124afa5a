"""The extrinsic at which corners that the sweeps give a depth move as the LiDAR says: all steps in one least squares.

Corners are followed from picture to picture once. The extrinsic X gives each its distance, from the points of the sweep
around it, and how it moves: X B X^-1 for the LiDAR's motion B. It should then lie on the ray on which it is seen. That
the distance changes with X is in the derivatives: with LiDAR points that are followed by an X that is wrong, and
hand-eye equations in turn (`hand_eye`), an X half a metre off can agree with itself.

LiDAR odometry may be wrong by the same in every step (a car's poses are by 2 cm on KITTI), which a shift of the camera
explains nearly as well. So at last, for the covariance alone, the step's error is unknown, too: six numbers that are
about zero. Where corners say that they are larger, odometry is taken to be off by so much, and the covariance holds the
way that the extrinsic then goes. Ours, as are all constants.
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
"""How wrong LiDAR odometry may be in every step alike, an axis, where corners do not say more."""
_DRIFT_TURNS = 3
_FLOOR_RAD, _FLOOR_M = 1.0, 30.0
_FEWEST = 40
"""Sights that the least squares takes at least."""


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

    `drift` (6,) is the left update (rad, m) by which the LiDAR's steps from frame to frame seem to be wrong alike.
    """

    camera_from_lidar: Float
    covariance: Float
    corners: int
    off_px: float
    settled: bool
    drift: Float


def refined(groups: Sequence[Followed], camera_from_lidar: Float, *, iterations: int = 25) -> Joint | None:
    """Return the extrinsic that all corners agree on, from one (4, 4) that is about right; None where too few count."""
    pose, settled, width_px = np.array(camera_from_lidar, np.float64), False, 6.0 * _USUAL_PX
    seen = [_Seen.of(group) for group in groups]
    floor = np.repeat([1 / _FLOOR_RAD**2, 1 / _FLOOR_M**2], 3)
    for number in range(iterations):
        terms = [_terms(group, pose, width_px) for group in seen]
        if sum(term.count for term in terms) < _FEWEST:
            return None
        normal, gradient = (np.sum([getattr(term, part) for term in terms], axis=0) for part in ("normal", "gradient"))
        update = _held(np.asarray(-np.linalg.solve(normal + np.diag(floor), gradient), np.float64))
        pose = p2o.se3.exp(update) @ pose
        small = np.linalg.norm(update[:3]) < 1e-4 and np.linalg.norm(update[3:]) < 2e-3
        if small and number > 3:
            settled = True
            break
        # Wide first, for the start may be off by many pixels.
        width_px = max(0.75 * width_px, 3.0 * _USUAL_PX)
    return _with_drift(seen, pose, width_px, settled)


def _with_drift(seen: Sequence[_Seen], pose: Float, width_px: float, settled: bool) -> Joint | None:
    """Return an extrinsic (4, 4) that was found with what is likely if the LiDAR's steps are all wrong alike."""
    usual = np.repeat([_DRIFT_RAD, _DRIFT_M], 3)
    drift, sigma, other = np.zeros(6), usual, pose
    here = sums = _sums(seen, pose, width_px, drift)
    for _ in range(_DRIFT_TURNS):
        if here.count < _FEWEST or sums.count < _FEWEST:
            return None
        update = -np.linalg.solve(sums.information(sigma), sums.pull(drift, sigma))
        other = p2o.se3.exp(_held(update[:6])) @ other
        most = np.repeat([0.005, 0.03], 3)
        drift = drift + np.clip(update[6:], -most, most)
        sigma = np.maximum(usual, np.abs(drift))
        sums = _sums(seen, other, width_px, drift)
    inverse = np.linalg.inv(here.information(sigma))
    # What corners of one picture have in common counts once a picture.
    spread = here.parts.T @ here.parts * len(here.parts) / max(len(here.parts) - 6, 1)
    covariance = (inverse @ spread @ inverse + inverse)[:6, :6]
    # What nothing tells is open, however well it fits.
    alone = here.normal[:6, :6] * here.longer + np.diag(np.repeat([1 / _FLOOR_RAD**2, 1 / _FLOOR_M**2], 3))
    way = p2o.se3.log(other @ p2o.se3.inverse(pose))
    covariance += np.linalg.inv(alone) + np.outer(way, way)
    return Joint(pose, 0.5 * (covariance + covariance.T), here.count, here.off_px, settled, drift)


@dataclass(frozen=True, eq=False)
class _Sums:
    """Sums over all pictures, in deviations: `normal` (12, 12), `gradient` (12,), and that of each picture, `parts`.

    `longer` is how many sights of each corner count, which are wrong together.
    """

    normal: Float
    gradient: Float
    parts: Float
    longer: float
    count: int
    off_px: float

    def information(self, sigma: Float) -> Float:
        """Return the information (12, 12) with drifts of deviations (6,)."""
        floor = np.repeat([1 / _FLOOR_RAD**2, 1 / _FLOOR_M**2], 3)
        return np.asarray(self.normal + np.diag(np.concatenate([floor, 1 / sigma**2])))

    def pull(self, drift: Float, sigma: Float) -> Float:
        """Return the gradient (12,) with drifts of deviations (6,)."""
        return np.asarray(self.gradient + np.concatenate([np.zeros(6), drift / sigma**2]))


def _sums(seen: Sequence[_Seen], pose: Float, width_px: float, drift: Float) -> _Sums:
    terms = [_terms(group, pose, width_px, drift) for group in seen]
    count = sum(term.count for term in terms)
    square, weight = sum(term.square for term in terms), max(sum(term.weight for term in terms), 1e-9)
    longer = count / max(sum(term.corners for term in terms), 1)
    noise = max(square / (2 * weight), 1e-4) * longer
    parts = np.array([term.gradient for term in terms if term.count]).reshape(-1, 12) / noise
    normal = np.sum([term.normal for term in terms], axis=0) / noise
    return _Sums(normal, parts.sum(axis=0), parts, longer, count, float(np.sqrt(square / weight)))


def _held(update: Float) -> Float:
    """Return an update (6,) made shorter where it is more than an iteration may be trusted with."""
    size = np.abs(update)
    return np.asarray(update * min(1.0, 0.05 / max(float(size[:3].max()), 1e-12), 0.3 / max(size[3:].max(), 1e-12)))


@dataclass(frozen=True, eq=False)
class _Seen:
    """Corners of one picture with what stays as the extrinsic changes.

    `rays` (M, 3) and `there` (K, M, 3) have length 1; `basis` (M, 2, 3) and `there_basis` (K, M, 2, 3) are across them.
    """

    group: Followed
    rays: Float
    basis: Float
    there: Float
    there_basis: Float

    @classmethod
    def of(cls, group: Followed) -> _Seen:
        """Return what stays of followed corners."""
        rays = group.rays / np.linalg.norm(group.rays, axis=1)[:, None]
        there = group.there / np.linalg.norm(group.there, axis=2)[:, :, None]
        known = np.where(np.isfinite(there), there, [0.0, 0.0, 1.0])
        there_basis = across(known.reshape(-1, 3)).reshape(*there.shape[:2], 2, 3)
        return cls(group, rays, across(rays), there, there_basis)


@dataclass(frozen=True, eq=False)
class _Terms:
    """Sums over the corners of one picture: `square` of residuals in px^2 and `weight`, both damped.

    The first six unknowns are the extrinsic's; six more are the LiDAR's drift, where that is asked.
    """

    normal: Float
    gradient: Float
    square: float
    weight: float
    count: int
    corners: int


def _terms(seen: _Seen, pose: Float, width_px: float, drift: Float | None = None) -> _Terms:
    size = 6 if drift is None else 12
    rows, neighbours = _neighbours(seen.group, pose)
    if not len(rows):
        return _Terms(np.zeros((size, size)), np.zeros(size), 0.0, 0.0, 0, 0)
    places = _Places.of(seen, rows, neighbours, pose)
    here = places.points(pose)
    steps = _drifting(seen.group.lidar, np.zeros(6) if drift is None else drift)
    off = _off_px(seen, rows, here, pose, steps)
    jacobian = np.zeros((*off.shape, size))
    for axis in range(6):
        change = np.zeros(6)
        change[axis] = _CHANGE
        moved = [p2o.se3.exp(sign * change) @ pose for sign in (1, -1)]
        both = [_off_px(seen, rows, places.points(each), each, steps) for each in moved]
        jacobian[..., axis] = (both[0] - both[1]) / (2 * _CHANGE)
        if drift is not None:
            both = [
                _off_px(seen, rows, here, pose, _drifting(seen.group.lidar, drift + sign * change)) for sign in (1, -1)
            ]
            jacobian[..., 6 + axis] = (both[0] - both[1]) / (2 * _CHANGE)
    known = np.isfinite(off).all(axis=2) & np.isfinite(jacobian).all(axis=(2, 3))
    off, jacobian = off[known], jacobian[known]
    square = (off**2).sum(axis=1)
    weight = 1.0 / (1.0 + square / width_px**2)
    flat, double = jacobian.reshape(-1, size), np.repeat(weight, 2)
    return _Terms(
        (double[:, None] * flat).T @ flat,
        flat.T @ (double * off.ravel()),
        float((weight * square).sum()),
        float(weight.sum()),
        len(off),
        int(known.any(axis=0).sum()),
    )


def _drifting(lidar: Float, drift: Float) -> Float:
    """Return the motions (K, 4, 4) of a LiDAR whose steps from frame to frame are wrong by a left update (6,) each."""
    longer = np.arange(1, len(lidar) + 1)
    return np.array([p2o.se3.exp(drift * times) @ step for times, step in zip(longer, lidar, strict=True)])


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


@dataclass(frozen=True, eq=False)
class _Places:
    """Corners (R,) with the points of the sweep around them, which weigh by how near they are at one extrinsic."""

    seen: _Seen
    rows: Int
    xyz: Float
    weight: Float

    @classmethod
    def of(cls, seen: _Seen, rows: Int, neighbours: Int, pose: Float) -> _Places:
        """Return them as weighed at an extrinsic."""
        alone = cls(seen, rows, seen.group.xyz[neighbours], np.zeros(0))
        aside, _ = alone._ways(pose)
        return replace(alone, weight=1.0 / ((aside**2).sum(axis=2) + _SOFT_PX**2))

    def points(self, pose: Float) -> Float:
        """Return where the corners are (R, 3) in the camera frame.

        On a plane the inverse distance is linear over the picture: its value at the corner, where aside is zero.
        """
        aside, inverse = self._ways(pose)
        design = np.concatenate([np.ones((*aside.shape[:2], 1)), aside], axis=2)
        weighed = self.weight[..., None] * design
        normal = np.swapaxes(weighed, 1, 2) @ design
        ridge = self.weight.sum(axis=1)[:, None] * np.array([0.0, _RIDGE_PX**2, _RIDGE_PX**2])
        normal += ridge[:, :, None] * np.eye(3)
        here = np.linalg.solve(normal, np.swapaxes(weighed, 1, 2) @ inverse[..., None])[:, 0, 0]
        return np.asarray(self.seen.rays[self.rows] / np.maximum(here, 1e-4)[:, None])

    def _ways(self, pose: Float) -> tuple[Float, Float]:
        points = p2o.se3.apply(pose, self.xyz.reshape(-1, 3)).reshape(self.xyz.shape)
        distance = np.linalg.norm(points, axis=2)
        aside = (points / distance[..., None]) @ np.swapaxes(self.seen.basis[self.rows], 1, 2)
        return aside * self.seen.group.camera.focal_px, 1.0 / distance


def _off_px(seen: _Seen, rows: Int, points: Float, pose: Float, lidar: Float) -> Float:
    """Return how far points (R, 3) of the camera frame lie from their rays in each later picture, (K, R, 2) px."""
    back = p2o.se3.inverse(pose)
    out = np.full((len(lidar), len(rows), 2), np.nan)
    for number, step in enumerate(lidar):
        moved = p2o.se3.apply(pose @ step @ back, points)
        known = np.isfinite(seen.there[number, rows]).all(axis=1) & (moved[:, 2] > 0.1)
        way = moved[known] / np.linalg.norm(moved[known], axis=1)[:, None]
        basis = seen.there_basis[number, rows[known]]
        out[number, known] = (basis @ way[..., None])[..., 0] * seen.group.camera.focal_px
    return out
