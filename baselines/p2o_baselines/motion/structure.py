"""Estimate the extrinsic that aligns a sparse visual map with the surfaces of the LiDAR's map and both motions.

A stretch of a drive has a visual map, up to scale (`visual_map`), the LiDAR's poses, and its map as small planes
(`surface_map`). With the extrinsic X, a landmark y in the camera frame of time k and the scale s_k there, the point W_k
X^-1 s_k y of the LiDAR's world should lie on the nearest plane, and the steps A of the camera should be those B of the
LiDAR: A(s) X = X B.

Both kinds of equations make one least squares over X and the scales (`solved`). Each landmark counts once; outlier
landmarks and steps are damped (Cauchy); the scatter of both kinds scales their weights. Scales of neighbouring times
are similar: a visual map of 30 m drifts by a percent. The global search (`searched`) minimises the damped cost over X
and one scale in a box around an initial guess. All constants are ours.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import p2o
from p2o import Bool, Float, Int
from scipy.spatial import cKDTree

from p2o_baselines.motion.hand_eye_equations import adjoint

_LEAST_POINTS = 12  # points of a plane
_THICK_M = 0.05
_WIDE_M = 0.05
_FLATTER = 2.5  # least ratio of width to thickness of a plane


@dataclass(frozen=True, eq=False)
class SurfaceMap:
    """Cubes of the world, found by `tree`: centre (N, 3) m of the points, normal, thickness, and which are `flat`."""

    centre: Float
    normal: Float
    thickness_m: Float
    flat: Bool
    tree: cKDTree

    def near(self, xyz: Float, reach_m: float) -> tuple[Bool, Int]:
        """Return which points (N, 3) have a plane next to them within `reach_m`, and its cube (N,)."""
        away, cube = self.tree.query(xyz, distance_upper_bound=reach_m)
        has_plane = np.isfinite(away)
        cube = np.where(has_plane, cube, 0)
        return has_plane & self.flat[cube], cube


def surface_map(
    sweeps: Sequence[Float], world_from_lidar: Float, *, cube_m: float = 0.5, near_m: float = 2.5, far_m: float = 60.0
) -> SurfaceMap | None:
    """Return the map of sweeps (N, 3) at poses (K, 4, 4) from points `near_m` to `far_m` away; None if empty."""
    parts = []
    for xyz, pose in zip(sweeps, world_from_lidar, strict=True):
        distance = np.linalg.norm(xyz, axis=1)
        parts.append(p2o.se3.apply(pose, xyz[(distance > near_m) & (distance < far_m)]))
    points = np.concatenate(parts)
    if not len(points):
        return None
    cell = np.floor(points / cube_m).astype(np.int64)
    key = (cell - cell.min(axis=0)) @ np.array([1 << 40, 1 << 20, 1])
    _, cube, count = np.unique(key, return_inverse=True, return_counts=True)
    centre = np.stack([np.bincount(cube, points[:, axis]) / count for axis in range(3)], axis=1)
    off = points - centre[cube]
    spread = np.zeros((len(count), 3, 3))
    for one in range(3):
        for two in range(one, 3):
            spread[:, one, two] = spread[:, two, one] = np.bincount(cube, off[:, one] * off[:, two]) / count
    enough = count >= _LEAST_POINTS
    if not enough.any():
        return None
    values, axes = np.linalg.eigh(spread[enough])
    sizes = np.sqrt(np.maximum(values, 0.0))
    flat = (sizes[:, 0] < _THICK_M) & (sizes[:, 1] > _WIDE_M) & (sizes[:, 1] > _FLATTER * sizes[:, 0])
    return SurfaceMap(centre[enough], axes[:, :, 0], sizes[:, 0], flat, cKDTree(centre[enough]))


_REACH_M = 0.3
_SURFACE_M = 0.02  # standard deviation of a plane in addition to its thickness
_FAR_M = 40.0
_VAGUE_M = 0.5  # landmarks with a larger standard deviation are left out
_WIDTHS_M = (0.5, 0.5, 0.5, 0.3, 0.3, 0.3, 0.15, 0.15, 0.15)
"""Additional tolerance of landmarks in the first iterations, for the error of the extrinsic."""
_CAUCHY, _STEP_CAUCHY = 1.0, 2.0
_STEP_RAD, _STEP_SHARE, _STEP_M = np.radians(0.02), 0.005, 0.003
"""Deviations of a step: its turn, its translation by the images (a share of it) and by the sweeps."""
_WALK = 0.01  # deviation of the logarithm of the scale from moment to moment
_DRIFT_RAD, _DRIFT_M = np.radians(0.01), 0.005
"""Standard deviation per axis of an error common to all steps of LiDAR odometry."""
_FLOOR = np.repeat([1 / 1.0**2, 1 / 30.0**2], 3)  # prior information of the extrinsic (rad, m)
_LEAST = 1e-3  # limit of the factor by which residuals may be smaller than expected
_SMALL_RAD, _SMALL_M = 5e-5, 5e-4  # updates smaller than this are caused by landmarks that change planes
_DELAY_S, _DELAY_TURNS = 0.01, 8
_SEARCHED = 500  # landmarks of each stretch that the search evaluates
_SEARCH_M = 0.3


@dataclass(frozen=True, eq=False)
class Stretch:
    """A stretch of a drive: landmarks `xyz` (N, 3) in the camera frame of time `moment` (N,), up to scale.

    `landmark` (N,) numbers them, `covariance` (N, 3, 3) is theirs. `camera_step` (K-1, 4, 4) is the motion of the
    camera from each time to the next, up to scale, `world_from_lidar` (K, 4, 4) the LiDAR's poses, `velocity` (K, 6)
    its velocity (rad/s, m/s, in its own frame), and `surfaces` its map.
    """

    xyz: Float
    covariance: Float
    landmark: Int
    moment: Int
    camera_step: Float
    world_from_lidar: Float
    velocity: Float
    surfaces: SurfaceMap

    def __len__(self) -> int:
        return len(self.xyz)

    @property
    def lidar_step(self) -> Float:
        """Motions (K-1, 4, 4) of points in the LiDAR frame from each moment to the next."""
        return np.asarray(p2o.se3.inverse(self.world_from_lidar[1:]) @ self.world_from_lidar[:-1])

    def later(self, delay_s: float) -> Stretch:
        """Return the same with the LiDAR poses at a later time and the same map."""
        ahead = np.array([p2o.se3.exp(twist * delay_s) for twist in self.velocity])
        return replace(self, world_from_lidar=self.world_from_lidar @ ahead)

    def nearer(self, scale: float) -> Stretch:
        """Return the same without far or uncertain landmarks, if the map has about `scale` m per unit."""
        sigma = np.sqrt(np.trace(self.covariance, axis1=1, axis2=2)) * scale
        kept = (self.xyz[:, 2] * scale < _FAR_M) & (sigma < _VAGUE_M)
        return self._select(kept)

    def once(self, most: int) -> Stretch:
        """Return each landmark at the time of its smallest uncertainty, at most `most`, distributed over the drive."""
        order = np.lexsort((np.trace(self.covariance, axis1=1, axis2=2), self.xyz[:, 2], self.landmark))
        first = order[np.concatenate([[True], np.diff(self.landmark[order]) > 0])] if len(order) else order
        return self._select(np.sort(first[:: max(len(first) // most, 1)]))

    def _select(self, kept: Bool | Int) -> Stretch:
        names = ("xyz", "covariance", "landmark", "moment")
        return replace(self, **{name: getattr(self, name)[kept] for name in names})


@dataclass(frozen=True, eq=False)
class Consistency:
    """The extrinsic at which both maps agree.

    `covariance` (6, 6) is that of a left update (rad, m), `scales` (K,) m per unit of each stretch. `landmarks` lie
    next to a plane; `off_m` is their median distance. Steps differ by
    `off_deg` and `off_step_m`, root mean squares of the inliers. `delay_s` is the delay of the camera relative to its
    sweeps, with its standard deviation, infinite if it is not observable.
    """

    camera_from_lidar: Float
    covariance: Float
    scales: tuple[Float, ...]
    landmarks: int
    off_m: float
    off_deg: float
    off_step_m: float
    delay_s: float
    delay_sigma_s: float
    settled: bool


@dataclass(frozen=True, eq=False)
class _Sums:
    """Sums over one stretch, its landmarks and steps; unknowns are the extrinsic (6) and logarithms of scales."""

    normal: Float
    gradient: Float
    parts: Float
    by_drift: Float
    off: Float
    near: Bool
    weight: Float
    step_off: Float
    step_sigma: Float
    step_weight: Float
    rows: Float


def searched(
    stretches: Sequence[Stretch],
    camera_from_lidar: Float,
    log_scales: Sequence[float],
    axes: Float,
    half: Float,
    *,
    seed: int,
    rounds: int,
) -> tuple[Float, float]:
    """Return the extrinsic with the least damped cost in a box, and the common logarithmic change of the scales.

    The box is around an extrinsic (4, 4): rotations about its `axes` (3, 3, rows, camera frame), translations of the
    camera along its own axes and one factor for all scales, each up to `half` (7,) rad, m, logarithm. Differential
    evolution with a fixed seed; the initial guess is in its first generation.
    """
    from scipy.optimize import differential_evolution

    few = [stretch.once(_SEARCHED) for stretch in stretches]
    back, turn = camera_from_lidar[:3, :3].T, camera_from_lidar[:3, :3]
    place = -back @ camera_from_lidar[:3, 3]

    def pose(x: Float) -> Float:
        rotation = p2o.se3.exp(np.concatenate([x[:3] @ axes, np.zeros(3)]))[:3, :3] @ turn
        return p2o.se3.make(rotation, -rotation @ (place + back @ x[3:6]))

    def cost(x: Float) -> float:
        pairs = zip(few, log_scales, strict=True)
        scales = ((stretch, np.full(len(stretch.world_from_lidar), log_scale + x[6])) for stretch, log_scale in pairs)
        camera = pose(x)
        return sum(_damped(stretch, camera, scale) for stretch, scale in scales)

    optimum = differential_evolution(
        cost,
        np.stack([-half, half], axis=1).tolist(),
        x0=np.zeros(7),
        popsize=6,
        maxiter=rounds,
        tol=1e-4,
        polish=False,
        rng=np.random.default_rng(seed),
    )
    return pose(optimum.x), float(optimum.x[6])


def _damped(stretch: Stretch, camera_from_lidar: Float, log_scale: Float) -> float:
    """Return the truncated cost of landmarks and steps, each kind per piece."""
    off, sigma, near, _, _, _ = _distances(stretch, camera_from_lidar, log_scale, _SEARCH_M)
    parts = np.where(near, np.minimum((off / sigma) ** 2, 4.0), 4.0)
    step_off, step_sigma, _, _ = _steps(stretch, camera_from_lidar, log_scale)
    # Ten times wider: a box of degrees has to slope everywhere.
    steps = ((step_off / (10 * step_sigma)) ** 2).mean(axis=1)
    return float(parts.mean() + np.minimum(steps, 4.0).mean())


def solved(
    stretches: Sequence[Stretch], camera_from_lidar: Float, log_scales: Sequence[float], *, iterations: int = 40
) -> Consistency | None:
    """Return the least-squares extrinsic of all stretches from initial values; None without landmarks near planes."""
    pose = np.array(camera_from_lidar, np.float64)
    scales = [np.full(len(each.world_from_lidar), value) for each, value in zip(stretches, log_scales, strict=True)]
    settled = False
    for number in range(iterations):
        wide = _WIDTHS_M[number] if number < len(_WIDTHS_M) else 0.0
        parts = [_sums(each, pose, scale, wide) for each, scale in zip(stretches, scales, strict=True)]
        if not any(part.near.any() for part in parts):
            return None
        newton = _newton(parts, scales)
        size = np.abs(newton.update)
        limit = min(1.0, 0.05 / max(float(size[:3].max()), 1e-12), 0.2 / max(float(size[3:].max()), 1e-12))
        update = newton.update * limit
        pose = p2o.se3.exp(update) @ pose
        scales = [scale + np.clip(change, -0.1, 0.1) for scale, change in zip(scales, newton.changes, strict=True)]
        small = np.linalg.norm(update[:3]) < _SMALL_RAD and np.linalg.norm(update[3:]) < _SMALL_M
        if small and number >= len(_WIDTHS_M):
            settled = True
            break
    return _with_covariance(stretches, pose, scales, settled)


def _with_covariance(
    stretches: Sequence[Stretch], pose: Float, scales: Sequence[Float], settled: bool
) -> Consistency | None:
    parts = [_sums(each, pose, scale, 0.0) for each, scale in zip(stretches, scales, strict=True)]
    if not any(part.near.any() for part in parts):
        return None
    newton = _newton(parts, scales)
    inverse, swayed = newton.inverse, newton.inverse @ newton.drift
    # What landmarks of one moment have in common counts once a moment.
    spread = newton.parts.T @ newton.parts * len(newton.parts) / max(len(newton.parts) - 6, 1)
    covariance = inverse + inverse @ spread @ inverse
    covariance += swayed @ np.diag(np.repeat([_DRIFT_RAD**2, _DRIFT_M**2], 3)) @ swayed.T
    off = np.concatenate([np.abs(part.off[part.near]) for part in parts])
    steps = np.concatenate([part.step_off for part in parts])
    weight = np.concatenate([part.step_weight for part in parts])
    square = (weight[:, None] * steps**2).sum(axis=0) / max(float(weight.sum()), 1e-12)
    near = sum(len(np.unique(each.landmark[part.near])) for each, part in zip(stretches, parts, strict=True))
    off_deg, off_step_m = float(np.degrees(np.sqrt(square[:3].sum()))), float(np.sqrt(square[3:].sum()))
    of_maps, off_m = tuple(np.exp(scale) for scale in scales), float(np.median(off))
    delay = _delay(stretches, pose, scales)
    covariance = 0.5 * (covariance + covariance.T)
    return Consistency(pose, covariance, of_maps, near, off_m, off_deg, off_step_m, *delay, settled)


@dataclass(frozen=True, eq=False)
class _Newton:
    """One step: update (6,), that of scales, inverse (6, 6), gradients (M, 6) and drift (6, 6) when scales follow."""

    update: Float
    changes: list[Float]
    inverse: Float
    parts: Float
    drift: Float


def _newton(sums: Sequence[_Sums], scales: Sequence[Float]) -> _Newton:
    normal = np.diag(_FLOOR)
    gradient, drift, kept, parts = np.zeros(6), np.zeros((6, 6)), [], []
    for each, scale in zip(sums, scales, strict=True):
        walk = np.diff(np.eye(len(scale)), axis=0) / _WALK
        own = each.normal[6:, 6:] + walk.T @ walk + 1e-9 * np.eye(len(scale))
        own_gradient = each.gradient[6:] + walk.T @ (walk @ scale)
        cross = each.normal[6:, :6]
        gain = np.linalg.solve(own, cross)
        normal = normal + each.normal[:6, :6] - cross.T @ gain
        gradient = gradient + each.gradient[:6] - gain.T @ own_gradient
        parts.append(each.parts[:, :6] - each.parts[:, 6:] @ gain)
        drift = drift + each.by_drift[:6] - gain.T @ each.by_drift[6:]
        kept.append((own, own_gradient, cross))
    inverse = np.asarray(np.linalg.inv(normal))
    update = -inverse @ gradient
    changes = [np.asarray(-np.linalg.solve(own, right + cross @ update), np.float64) for own, right, cross in kept]
    return _Newton(update, changes, inverse, np.concatenate(parts), drift)


def _sums(stretch: Stretch, pose: Float, log_scale: Float, wide_m: float) -> _Sums:
    """Return the sums of one stretch at an extrinsic and scales (K,)."""
    count = len(stretch.world_from_lidar)
    off, sigma, near, slope, by_scale, _ = _distances(stretch, pose, log_scale, wide_m)
    # The residuals of a landmark are correlated, so that an outlier counts once for all its observations.
    sights = np.bincount(stretch.landmark[near], minlength=int(stretch.landmark.max(initial=0)) + 1)
    ratio = np.abs(off) / sigma
    scale = max(float(np.median(ratio[near])) / 0.6745, _LEAST) if near.any() else 1.0
    if wide_m > 0:
        scale = max(scale, 1.0)
    damped = 1.0 / (1.0 + (ratio / (scale * _CAUCHY)) ** 2)
    weight = np.where(near, damped / np.maximum(sights[stretch.landmark], 1), 0.0)
    full = weight / (scale * sigma) ** 2
    normal, gradient = np.zeros((6 + count, 6 + count)), np.zeros(6 + count)
    normal[:6, :6] = (full[:, None] * slope).T @ slope
    gradient[:6] = slope.T @ (full * off)
    diagonal = np.bincount(stretch.moment, full * by_scale**2, minlength=count)
    normal[range(6, 6 + count), range(6, 6 + count)] = diagonal
    gradient[6:] = np.bincount(stretch.moment, full * by_scale * off, minlength=count)
    cross = np.zeros((count, 6))
    np.add.at(cross, stretch.moment, (full * by_scale)[:, None] * slope)
    normal[6:, :6], normal[:6, 6:] = cross, cross.T
    step_off, step_sigma, step_slope, stretching = _steps(stretch, pose, log_scale)
    ratios = (step_off / step_sigma) ** 2
    sizes = np.array([np.median(ratios[:, :3].sum(axis=1)), np.median(ratios[:, 3:].sum(axis=1))]) / 2.366
    sizes = np.maximum(sizes, 1.0 if wide_m > 0 else _LEAST**2)
    step_sigma = step_sigma * np.sqrt(np.repeat(sizes, 3))
    square = ((step_off / step_sigma) ** 2).sum(axis=1) / 6.0
    step_weight = 1.0 / (1.0 + square / _STEP_CAUCHY**2)
    rows = np.zeros((len(step_off), 6, 6 + count))
    rows[:, :, :6] = step_slope
    number = np.arange(len(step_off))
    rows[number, 3:, 6 + number] = rows[number, 3:, 7 + number] = 0.5 * stretching
    rows /= step_sigma[:, :, None]
    normal += np.einsum("n,nij,nik->jk", step_weight, rows, rows)
    gradient += np.einsum("n,nij,ni->j", step_weight, rows, step_off / step_sigma)
    moved = p2o.se3.inverse(stretch.lidar_step) @ p2o.se3.inverse(pose)
    camera_step = stretch.camera_step.copy()
    camera_step[:, :3, 3] = stretching
    by_step = -adjoint(camera_step @ pose @ moved @ pose) / step_sigma[:, :, None]
    by_drift = np.einsum("n,nij,nik->jk", step_weight, rows, by_step)
    parts = np.zeros((count, 6 + count))
    np.add.at(parts[:, :6], stretch.moment, (full * off)[:, None] * slope)
    parts[range(count), range(6, 6 + count)] = np.bincount(stretch.moment, full * by_scale * off, minlength=count)
    parts[:-1] += np.einsum("n,nij,ni->nj", step_weight, rows, step_off / step_sigma)
    return _Sums(normal, gradient, parts, by_drift, off, near, full, step_off, step_sigma, step_weight, rows)


def _distances(
    stretch: Stretch, pose: Float, log_scale: Float, wide_m: float
) -> tuple[Float, Float, Bool, Float, Float, Int]:
    """Return distances (N,) m from the nearest planes, deviations, which have one, changes by update, scale, index."""
    turn, shift = pose[:3, :3], pose[:3, 3]
    scale = np.exp(log_scale)[stretch.moment]
    camera = stretch.xyz * scale[:, None]
    world = stretch.world_from_lidar[stretch.moment]
    at = np.einsum("nij,nj->ni", world[:, :3, :3], (camera - shift) @ turn) + world[:, :3, 3]
    near, cube = stretch.surfaces.near(at, _REACH_M + wide_m)
    normal = stretch.surfaces.normal[cube]
    off = ((at - stretch.surfaces.centre[cube]) * normal).sum(axis=1)
    # The plane's normal in the camera frame.
    across = np.einsum("ni,nij->nj", normal, world[:, :3, :3]) @ turn.T
    slope = np.concatenate([np.cross(across, camera), -across], axis=1)
    own = scale**2 * np.einsum("ni,nij,nj->n", across, stretch.covariance, across)
    sigma = np.sqrt(stretch.surfaces.thickness_m[cube] ** 2 + _SURFACE_M**2 + own + wide_m**2)
    return off, sigma, near, slope, (across * camera).sum(axis=1), cube


def _small(transforms: Float) -> Float:
    """Return the tangents (N, 6) of transforms (N, 4, 4) that turn little; to the second order of their turns."""
    turn, move = p2o.se3.rotation_vector(transforms[:, :3, :3]), transforms[:, :3, 3]
    once = np.cross(turn, move)
    return np.concatenate([turn, move - 0.5 * once + np.cross(turn, once) / 12.0], axis=1)


def _steps(stretch: Stretch, pose: Float, log_scale: Float) -> tuple[Float, Float, Float, Float]:
    """Return the differences of both sensors' steps (K-1, 6) rad and m, deviations, and changes by update and scale."""
    camera = stretch.camera_step.copy()
    camera[:, :3, 3] *= np.exp(0.5 * (log_scale[1:] + log_scale[:-1]))[:, None]
    moved = camera @ pose @ p2o.se3.inverse(stretch.lidar_step) @ p2o.se3.inverse(pose)
    off = _small(moved)
    translation = camera[:, :3, 3]
    sigma = np.empty_like(off)
    sigma[:, :3] = _STEP_RAD
    sigma[:, 3:] = np.hypot(_STEP_SHARE * np.linalg.norm(translation, axis=1), _STEP_M)[:, None]
    return off, sigma, adjoint(camera) - adjoint(moved), translation


def _delay(stretches: Sequence[Stretch], pose: Float, scales: Sequence[Float]) -> tuple[float, float]:
    """Return how much later the camera is than its sweeps, and the deviation: all unknowns with the delay."""
    delay_s, sigma_s = 0.0, np.inf
    for _ in range(_DELAY_TURNS):
        shifted = [stretch.later(delay_s) for stretch in stretches]
        sums = [_sums(each, pose, scale, 0.0) for each, scale in zip(shifted, scales, strict=True)]
        update, sigma_s = _with_delay(shifted, pose, scales, sums)
        pose = p2o.se3.exp(update[:6]) @ pose
        delay_s += float(np.clip(update[6], -0.05, 0.05))
        ends = np.cumsum([7, *map(len, scales)])[:-1]
        changes = (update[begin : begin + len(scale)] for scale, begin in zip(scales, ends, strict=True))
        scales = [scale + np.clip(change, -0.1, 0.1) for scale, change in zip(scales, changes, strict=True)]
        if abs(update[6]) < 0.1 * sigma_s:
            break
    return delay_s, sigma_s


def _with_delay(
    stretches: Sequence[Stretch], pose: Float, scales: Sequence[Float], sums: Sequence[_Sums]
) -> tuple[Float, float]:
    """Return the update of extrinsic, delay (by differences) and scales (7 + K,), and the deviation of the delay."""
    size, begin = 7 + sum(map(len, scales)), 7
    normal, gradient = np.zeros((size, size)), np.zeros(size)
    normal[range(7), range(7)] += np.array([*_FLOOR, 1.0])
    for stretch, scale, part in zip(stretches, scales, sums, strict=True):
        count = len(scale)
        ahead, behind = (_distances(stretch.later(sign * _DELAY_S), pose, scale, 0.0) for sign in (1, -1))
        here = _distances(stretch, pose, scale, 0.0)
        same = part.near & (ahead[5] == here[5]) & (behind[5] == here[5]) & ahead[2] & behind[2]
        by_delay = np.where(same, ahead[0] - behind[0], 0.0) / (2 * _DELAY_S)
        steps = [_steps(stretch.later(sign * _DELAY_S), pose, scale)[0] for sign in (1, -1)]
        step_by_delay = (steps[0] - steps[1]) / (2 * _DELAY_S) / part.step_sigma
        column = np.zeros(6 + count)
        column[:6] = here[3].T @ (part.weight * by_delay)
        column[6:] = np.bincount(stretch.moment, part.weight * here[4] * by_delay, minlength=count)
        column += np.einsum("nij,ni->j", part.rows, step_by_delay * part.step_weight[:, None])
        index = np.concatenate([np.arange(6), begin + np.arange(count)])
        own = np.arange(begin, begin + count)
        walk = np.diff(np.eye(count), axis=0) / _WALK
        normal[np.ix_(index, index)] += part.normal
        normal[np.ix_(own, own)] += walk.T @ walk + 1e-9 * np.eye(count)
        gradient[index] += part.gradient
        gradient[own] += walk.T @ (walk @ scale)
        normal[index, 6] += column
        normal[6, index] += column
        normal[6, 6] += (part.weight * by_delay**2).sum() + (part.step_weight[:, None] * step_by_delay**2).sum()
        gradient[6] += (part.weight * by_delay * part.off).sum()
        gradient[6] += (part.step_weight[:, None] * step_by_delay * part.step_off / part.step_sigma).sum()
        begin += count
    inverse = np.linalg.inv(normal)
    return -inverse @ gradient, float(np.sqrt(max(inverse[6, 6], 0.0)))
