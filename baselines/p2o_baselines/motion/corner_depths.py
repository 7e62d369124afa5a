"""Refine the extrinsic by the motion of image corners with LiDAR depth: all steps in one least squares.

Corners are tracked once. The extrinsic X determines the distance of each corner, from the points of the sweep around
it, and its motion X B X^-1 for the motion B of the LiDAR. The moved corner should lie on its observed ray. The
derivatives include the change of the distance with X. Alternating between tracked LiDAR points and hand-eye equations
(`hand_eye`) can instead converge to a consistent X that is wrong by half a metre.

LiDAR odometry may have the same error in every step (2 cm for the car's poses of KITTI), which a translation of the
camera explains nearly as well. For the covariance alone, this error per step is therefore a further unknown of six
parameters with zero mean. If the corners indicate a larger one, its size is used and the covariance includes the
resulting change of the extrinsic. The method and all constants are ours.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import p2o
from p2o import Float, Int

from p2o_baselines.motion.lidar_tracks import across

_NEIGHBOURS = 6
_REACH_PX = 12.0  # points of the sweep farther from a corner do not determine its distance
_STEP = 0.12  # neighbours whose distances differ by a larger share belong to different objects
_SOFT_PX = 3.0
_RIDGE_PX = 1.5  # neighbours closer together than this do not determine a slope
_USUAL_PX = 0.5
_CHANGE = 1e-4
_DRIFT = np.repeat([np.radians(0.01), 0.005], 3)
"""Standard deviation (rad, m) of an error common to all steps of LiDAR odometry, unless corners indicate more."""
_DRIFT_TURNS = 3
_FLOOR = np.repeat([1 / 1.0**2, 1 / 30.0**2], 3)  # prior information of the extrinsic (rad, m)
_FEWEST = 40  # sights that the least squares takes at least


@dataclass(frozen=True, eq=False)
class Followed:
    """One image's sweep (N, 3), corners px and rays (M, ...), rays in later images, NaN if lost, and LiDAR motions."""

    camera: p2o.Camera
    xyz: Float
    uv: Float
    rays: Float
    later: Float
    lidar: Float


@dataclass(frozen=True, eq=False)
class Joint:
    """The extrinsic (4, 4), its covariance (6, 6) (rad, m), corners, residual, and drift (6,) of each LiDAR step."""

    camera_from_lidar: Float
    covariance: Float
    corners: int
    off_px: float
    settled: bool
    drift: Float


def refined(groups: Sequence[Followed], camera_from_lidar: Float, *, iterations: int = 25) -> Joint | None:
    """Return the extrinsic that fits all corners, from an approximate one (4, 4); None if too few have depth."""
    pose, settled, width_px = np.array(camera_from_lidar, np.float64), False, 6.0 * _USUAL_PX
    seen = [_Seen.of(group) for group in groups]
    for number in range(iterations):
        terms = [_terms(group, pose, width_px) for group in seen]
        if sum(term.count for term in terms) < _FEWEST:
            return None
        normal, gradient = (np.sum([getattr(term, part) for term in terms], axis=0) for part in ("normal", "gradient"))
        update = _limited(np.asarray(-np.linalg.solve(normal + np.diag(_FLOOR), gradient), np.float64))
        pose = p2o.se3.exp(update) @ pose
        small = np.linalg.norm(update[:3]) < 1e-4 and np.linalg.norm(update[3:]) < 2e-3
        if small and number > 3:
            settled = True
            break
        # Wide first, for the start may be off by many pixels.
        width_px = max(0.75 * width_px, 3.0 * _USUAL_PX)
    return _with_drift(seen, pose, width_px, settled)


def _with_drift(seen: Sequence[_Seen], pose: Float, width_px: float, settled: bool) -> Joint | None:
    """Return an extrinsic (4, 4) with its covariance, including an error common to all LiDAR steps."""
    drift, sigma, other = np.zeros(6), _DRIFT, pose
    here = sums = _sums(seen, pose, width_px, drift)
    for _ in range(_DRIFT_TURNS):
        if here.count < _FEWEST or sums.count < _FEWEST:
            return None
        update = np.asarray(-np.linalg.solve(sums.information(sigma), sums.pull(drift, sigma)))
        other = p2o.se3.exp(_limited(update[:6])) @ other
        most = np.repeat([0.005, 0.03], 3)
        drift = drift + np.clip(update[6:], -most, most)
        sigma = np.maximum(_DRIFT, np.abs(drift))
        sums = _sums(seen, other, width_px, drift)
    inverse = np.linalg.inv(here.information(sigma))
    # What corners of one image have in common counts once an image.
    spread = here.parts.T @ here.parts * len(here.parts) / max(len(here.parts) - 6, 1)
    covariance = (inverse @ spread @ inverse + inverse)[:6, :6]
    # An unobservable parameter has an infinite uncertainty, however small the residuals are.
    alone = here.normal[:6, :6] * here.longer + np.diag(_FLOOR)
    change = p2o.se3.log(other @ p2o.se3.inverse(pose))
    covariance += np.linalg.inv(alone) + np.outer(change, change)
    return Joint(pose, 0.5 * (covariance + covariance.T), here.count, here.off_px, settled, drift)


@dataclass(frozen=True, eq=False)
class _Sums:
    """Sums over all images in standard deviations; `longer` is the number of correlated observations of a corner."""

    normal: Float
    gradient: Float
    parts: Float
    longer: float
    count: int
    off_px: float

    def information(self, sigma: Float) -> Float:
        """Return the information (12, 12) with drifts of deviations (6,)."""
        return np.asarray(self.normal + np.diag(np.concatenate([_FLOOR, 1 / sigma**2])))

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


def _limited(update: Float) -> Float:
    """Return an update (6,) limited to the trust region of one iteration."""
    size = np.abs(update)
    return np.asarray(update * min(1.0, 0.05 / max(float(size[:3].max()), 1e-12), 0.3 / max(size[3:].max(), 1e-12)))


@dataclass(frozen=True, eq=False)
class _Seen:
    """Corners of one image as unit rays (M, 3), later (K, M, 3), with bases (..., 2, 3) across them."""

    group: Followed
    rays: Float
    basis: Float
    later: Float
    later_basis: Float

    @classmethod
    def of(cls, group: Followed) -> _Seen:
        """Return what stays of followed corners."""
        rays = group.rays / np.linalg.norm(group.rays, axis=1)[:, None]
        later = group.later / np.linalg.norm(group.later, axis=2)[:, :, None]
        known = np.where(np.isfinite(later), later, [0.0, 0.0, 1.0])
        return cls(group, rays, across(rays), later, across(known.reshape(-1, 3)).reshape(*later.shape[:2], 2, 3))


@dataclass(frozen=True, eq=False)
class _Terms:
    """Robust sums over the corners of one image; unknowns are the extrinsic (6) and, if requested, the drift (6)."""

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
    lidar = seen.group.lidar
    steps = _drifting(lidar, np.zeros(6) if drift is None else drift)
    off = _off_px(seen, rows, here, pose, steps)
    jacobian = np.zeros((*off.shape, size))
    for axis, change in enumerate(_CHANGE * np.eye(6)):
        moved = [p2o.se3.exp(sign * change) @ pose for sign in (1, -1)]
        ahead, behind = (_off_px(seen, rows, places.points(each), each, steps) for each in moved)
        jacobian[..., axis] = (ahead - behind) / (2 * _CHANGE)
        if drift is not None:
            drifted = [_drifting(lidar, drift + sign * change) for sign in (1, -1)]
            ahead, behind = (_off_px(seen, rows, here, pose, each) for each in drifted)
            jacobian[..., 6 + axis] = (ahead - behind) / (2 * _CHANGE)
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
    """Return the motions (K, 4, 4) of a LiDAR whose steps all have the error of a left update (6,)."""
    longer = np.arange(1, len(lidar) + 1)
    return np.array([p2o.se3.exp(drift * times) @ step for times, step in zip(longer, lidar, strict=True)])


def _neighbours(group: Followed, pose: Float) -> tuple[Int, Int]:
    """Return the rows of corners (R,) with a depth from the sweep at a pose, and the points around them (R, 6)."""
    from scipy.spatial import cKDTree

    points = p2o.se3.apply(pose, group.xyz)
    uv = group.camera.project(points)
    seen = np.flatnonzero(group.camera.in_image(uv, _REACH_PX) & (points[:, 2] > 0.1))
    if len(seen) < _NEIGHBOURS:
        return np.zeros(0, np.int64), np.zeros((0, _NEIGHBOURS), np.int64)
    away, near = cKDTree(uv[seen]).query(group.uv, k=_NEIGHBOURS, distance_upper_bound=_REACH_PX)
    full = np.asarray(np.isfinite(away).all(axis=1))
    near = seen[np.where(full[:, None], near, 0)]
    distance = np.linalg.norm(points[near], axis=2)
    smooth = distance.max(axis=1) / np.maximum(distance.min(axis=1), 1e-6) < 1 + _STEP
    rows = np.flatnonzero(full & smooth)
    return rows, near[rows]


@dataclass(frozen=True, eq=False)
class _Places:
    """Corners (R,) with the points of the sweep around them, weighted by their distance at one extrinsic."""

    seen: _Seen
    rows: Int
    xyz: Float
    weight: Float

    @classmethod
    def of(cls, seen: _Seen, rows: Int, neighbours: Int, pose: Float) -> _Places:
        """Return them with the weights of an extrinsic."""
        alone = cls(seen, rows, seen.group.xyz[neighbours], np.zeros(0))
        aside, _ = alone._offsets(pose)
        return replace(alone, weight=1.0 / ((aside**2).sum(axis=2) + _SOFT_PX**2))

    def points(self, pose: Float) -> Float:
        """Return the corners (R, 3) in the camera frame: inverse distance is linear in the image of a plane."""
        aside, inverse = self._offsets(pose)
        design = np.concatenate([np.ones((*aside.shape[:2], 1)), aside], axis=2)
        weighted = self.weight[..., None] * design
        ridge = self.weight.sum(axis=1)[:, None] * np.array([0.0, _RIDGE_PX**2, _RIDGE_PX**2])
        normal = np.swapaxes(weighted, 1, 2) @ design + ridge[:, :, None] * np.eye(3)
        here = np.linalg.solve(normal, np.swapaxes(weighted, 1, 2) @ inverse[..., None])[:, 0, 0]
        return np.asarray(self.seen.rays[self.rows] / np.maximum(here, 1e-4)[:, None])

    def _offsets(self, pose: Float) -> tuple[Float, Float]:
        points = p2o.se3.apply(pose, self.xyz.reshape(-1, 3)).reshape(self.xyz.shape)
        distance = np.linalg.norm(points, axis=2)
        aside = (points / distance[..., None]) @ np.swapaxes(self.seen.basis[self.rows], 1, 2)
        return aside * self.seen.group.camera.focal_px, 1.0 / distance


def _off_px(seen: _Seen, rows: Int, points: Float, pose: Float, lidar: Float) -> Float:
    """Return the distances (K, R, 2) px of points (R, 3) of the camera frame from their rays in each later image."""
    back = p2o.se3.inverse(pose)
    out = np.full((len(lidar), len(rows), 2), np.nan)
    for number, step in enumerate(lidar):
        moved = p2o.se3.apply(pose @ step @ back, points)
        known = np.isfinite(seen.later[number, rows]).all(axis=1) & (moved[:, 2] > 0.1)
        direction = moved[known] / np.linalg.norm(moved[known], axis=1)[:, None]
        basis = seen.later_basis[number, rows[known]]
        out[number, known] = (basis @ direction[..., None])[..., 0] * seen.group.camera.focal_px
    return out
