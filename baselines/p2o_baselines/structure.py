"""The extrinsic at which a sparse map from pictures lies on the surfaces that a LiDAR saw, and both move alike.

For a stretch of a drive there are a visual map, up to scale (`visual_map`), the LiDAR's poses, and its map as small
planes (`surface_map`). With the extrinsic X, a landmark y in the camera frame of moment k and the scale s_k there, the
point W_k X^-1 s_k y of the LiDAR's world should lie on the plane next to it, and the camera's steps A from moment to
moment should be those of the LiDAR: A(s) X = X B.

Both kinds of equations make one least squares over X and the scales (`solved`). Landmarks count once however often they
are seen; wrong ones and wrong steps are damped (Cauchy); how far both kinds are off scales their weights. Scales of
neighbouring moments differ little: a visual map of 30 m drifts by a percent. The global search (`searched`) looks for
the least damped cost over X and one scale in a box around a first guess. All constants are ours.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import p2o
from p2o.arrays import Bool, Float, Int

from p2o_baselines.hand_eye_equations import adjoint
from p2o_baselines.surface_map import SurfaceMap

_REACH_M = 0.3
_SURFACE_M = 0.02
"""Deviation of a plane besides its thickness."""
_FAR_M = 40.0
_VAGUE_M = 0.5
"""Landmarks that are known no better than this are left out."""
_WIDTHS_M = (0.5, 0.5, 0.5, 0.3, 0.3, 0.3, 0.15, 0.15, 0.15)
"""Landmarks may be off by so much more at first, for the extrinsic may be."""
_CAUCHY, _STEP_CAUCHY = 1.0, 2.0
_STEP_RAD, _STEP_SHARE, _STEP_M = np.radians(0.02), 0.005, 0.003
"""Deviations of a step: its turn, its translation by the pictures (a share of it) and by the sweeps."""
_WALK = 0.01
"""Deviation of the logarithm of the scale from moment to moment."""
_DRIFT_RAD, _DRIFT_M = np.radians(0.01), 0.005
"""How wrong LiDAR odometry may be in every step alike, an axis."""
_FLOOR_RAD, _FLOOR_M = 1.0, 30.0
_LEAST = 1e-3
"""Nothing is better than expected by more than this factor."""
_SMALL_RAD, _SMALL_M = 5e-5, 5e-4
"""Smaller updates come from landmarks that change planes."""
_DELAY_S, _DELAY_TURNS = 0.01, 8
_SEARCHED = 500
"""Landmarks of each stretch that the search looks at."""
_SEARCH_M = 0.3


@dataclass(frozen=True, eq=False)
class Stretch:
    """A stretch of a drive: landmarks `xyz` (N, 3) as seen, in the camera frame of moment `moment` (N,), up to scale.

    `landmark` (N,) numbers them, `covariance` (N, 3, 3) is theirs. `camera_step` (K-1, 4, 4) is the camera's motion
    from each moment to the next, up to scale, `world_from_lidar` (K, 4, 4) the LiDAR's poses, `velocity` (K, 6) how it
    moves at them (rad/s, m/s, in its own frame), and `surfaces` its map.
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
        """Return the same with the LiDAR where it is so much later, its map staying."""
        ahead = np.array([p2o.se3.exp(twist * delay_s) for twist in self.velocity])
        return replace(self, world_from_lidar=self.world_from_lidar @ ahead)

    def nearer(self, scale: float) -> Stretch:
        """Return the same without what is far, or vague, where the map is about `scale` m a unit."""
        sigma = np.sqrt(np.trace(self.covariance, axis1=1, axis2=2)) * scale
        kept = (self.xyz[:, 2] * scale < _FAR_M) & (sigma < _VAGUE_M)
        return self._select(kept)

    def once(self, most: int) -> Stretch:
        """Return each landmark as seen from where it is best known, at most so many, evenly spread over the drive."""
        order = np.lexsort((np.trace(self.covariance, axis1=1, axis2=2), self.xyz[:, 2], self.landmark))
        first = order[np.concatenate([[True], np.diff(self.landmark[order]) > 0])] if len(order) else order
        return self._select(np.sort(first[:: max(len(first) // most, 1)]))

    def _select(self, kept: Bool | Int) -> Stretch:
        return replace(
            self,
            xyz=self.xyz[kept],
            covariance=self.covariance[kept],
            landmark=self.landmark[kept],
            moment=self.moment[kept],
        )


@dataclass(frozen=True, eq=False)
class Consistency:
    """The extrinsic at which both maps agree.

    `covariance` (6, 6) is of a left update (rad, m), `scales` (K,) m a unit of each stretch. `landmarks` lie next to a
    plane, `share` of those that are near enough to be asked; they are off by `off_m`, in the median. Steps differ by
    `off_deg` and `off_step_m`, root mean squares of those that count. `delay_s` is how much later than its sweeps the
    camera is, with its deviation, infinite where nothing tells.
    """

    camera_from_lidar: Float
    covariance: Float
    scales: tuple[Float, ...]
    landmarks: int
    share: float
    off_m: float
    off_deg: float
    off_step_m: float
    delay_s: float
    delay_sigma_s: float
    settled: bool


@dataclass(frozen=True, eq=False)
class _Sums:
    """Sums over one stretch; the first six unknowns are the extrinsic's, the others its logarithms of scales.

    `parts` (K, 6 + K) are what the landmarks of each moment, and the step after it, add to the gradient, and `by_drift`
    (6 + K, 6) is how that changes with a left update of each step of the LiDAR alike.
    """

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
    """Return the extrinsic with the least damped cost in a box, and by how much scales are larger there.

    The box is around an extrinsic (4, 4): turns about its `axes` (3, 3, rows, camera frame), the camera's way along
    its own axes and one factor for all scales, each as far as `half` (7,) rad, m, logarithm. Differential evolution,
    which always draws the same; the first guess is among its first generation.
    """
    from scipy.optimize import differential_evolution

    few = [stretch.once(_SEARCHED) for stretch in stretches]
    back, turn = camera_from_lidar[:3, :3].T, camera_from_lidar[:3, :3]
    place = -back @ camera_from_lidar[:3, 3]

    def pose(x: Float) -> Float:
        rotation = p2o.se3.exp(np.concatenate([x[:3] @ axes, np.zeros(3)]))[:3, :3] @ turn
        return p2o.se3.make(rotation, -rotation @ (place + back @ x[3:6]))

    def cost(x: Float) -> float:
        camera = pose(x)
        return sum(
            _damped(stretch, camera, np.full(len(stretch.world_from_lidar), log_scale + x[6]))
            for stretch, log_scale in zip(few, log_scales, strict=True)
        )

    found = differential_evolution(
        cost,
        list(zip((-half).tolist(), half.tolist(), strict=True)),
        x0=np.zeros(7),
        popsize=6,
        maxiter=rounds,
        tol=1e-4,
        polish=False,
        rng=np.random.default_rng(seed),
    )
    return pose(found.x), float(found.x[6])


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
    """Return the extrinsic that the least squares of all stretches has, from a first one; None with no landmark near.

    `log_scales` are first ones, one a stretch.
    """
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
        update = newton.update * min(
            1.0, 0.05 / max(float(size[:3].max()), 1e-12), 0.2 / max(float(size[3:].max()), 1e-12)
        )
        pose = p2o.se3.exp(update) @ pose
        scales = [scale + np.clip(change, -0.1, 0.1) for scale, change in zip(scales, newton.changes, strict=True)]
        small = np.linalg.norm(update[:3]) < _SMALL_RAD and np.linalg.norm(update[3:]) < _SMALL_M
        if small and number >= len(_WIDTHS_M):
            settled = True
            break
    return _told(stretches, pose, scales, settled)


def _told(stretches: Sequence[Stretch], pose: Float, scales: Sequence[Float], settled: bool) -> Consistency | None:
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
    asked = sum(len(np.unique(each.landmark)) for each in stretches)
    delay_s, delay_sigma_s = _delay(stretches, pose, scales)
    return Consistency(
        pose,
        0.5 * (covariance + covariance.T),
        tuple(np.exp(scale) for scale in scales),
        near,
        near / max(asked, 1),
        float(np.median(off)),
        float(np.degrees(np.sqrt(square[:3].sum()))),
        float(np.sqrt(square[3:].sum())),
        delay_s,
        delay_sigma_s,
        settled,
    )


@dataclass(frozen=True, eq=False)
class _Newton:
    """One step: the `update` (6,), that of the scales, and the `inverse` (6, 6) once scales follow.

    `parts` (M, 6) are the gradients of moments and `drift` (6, 6) how the gradient changes with the LiDAR's steps, both
    once scales follow.
    """

    update: Float
    changes: list[Float]
    inverse: Float
    parts: Float
    drift: Float


def _newton(sums: Sequence[_Sums], scales: Sequence[Float]) -> _Newton:
    normal = np.diag(np.repeat([1 / _FLOOR_RAD**2, 1 / _FLOOR_M**2], 3))
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
    # However often it is seen, a landmark is wrong once.
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
    """Return how far landmarks (N,) are from the planes next to them, m, the deviations, which have one, how the
    distance changes with a left update of the extrinsic (N, 6) and with the logarithm of the scale, and which plane.
    """
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
    from scipy.spatial.transform import Rotation

    turn, move = Rotation.from_matrix(transforms[:, :3, :3]).as_rotvec(), transforms[:, :3, 3]
    once = np.cross(turn, move)
    return np.concatenate([turn, move - 0.5 * once + np.cross(turn, once) / 12.0], axis=1)


def _steps(stretch: Stretch, pose: Float, log_scale: Float) -> tuple[Float, Float, Float, Float]:
    """Return by how much camera steps differ from those of the LiDAR (K-1, 6) rad and m, the deviations (K-1, 6), how
    that changes with a left update (K-1, 6, 6), and with the logarithm of the scale (K-1, 3), for translations.
    """
    camera = stretch.camera_step.copy()
    camera[:, :3, 3] *= np.exp(0.5 * (log_scale[1:] + log_scale[:-1]))[:, None]
    moved = camera @ pose @ p2o.se3.inverse(stretch.lidar_step) @ p2o.se3.inverse(pose)
    off = _small(moved)
    way = camera[:, :3, 3]
    sigma = np.empty_like(off)
    sigma[:, :3] = _STEP_RAD
    sigma[:, 3:] = np.hypot(_STEP_SHARE * np.linalg.norm(way, axis=1), _STEP_M)[:, None]
    return off, sigma, adjoint(camera) - adjoint(moved), way


def _delay(stretches: Sequence[Stretch], pose: Float, scales: Sequence[Float]) -> tuple[float, float]:
    """Return how much later the camera is than its sweeps, and the deviation: all unknowns with the delay."""
    delay_s, sigma_s = 0.0, np.inf
    for _ in range(_DELAY_TURNS):
        shifted = [stretch.later(delay_s) for stretch in stretches]
        sums = [_sums(each, pose, scale, 0.0) for each, scale in zip(shifted, scales, strict=True)]
        update, sigma_s = _with_delay(shifted, pose, scales, sums)
        pose = p2o.se3.exp(update[:6]) @ pose
        delay_s += float(np.clip(update[6], -0.05, 0.05))
        ends = np.cumsum([7, *map(len, scales)])
        scales = [
            scale + np.clip(update[begin : begin + len(scale)], -0.1, 0.1)
            for scale, begin in zip(scales, ends, strict=False)
        ]
        if abs(update[6]) < 0.1 * sigma_s:
            break
    return delay_s, sigma_s


def _with_delay(
    stretches: Sequence[Stretch], pose: Float, scales: Sequence[Float], sums: Sequence[_Sums]
) -> tuple[Float, float]:
    """Return the update of the extrinsic, the delay, and all scales (7 + K,), and the deviation of the delay.

    How distances and steps change with the delay is by differences.
    """
    size, begin = 7 + sum(map(len, scales)), 7
    normal, gradient = np.zeros((size, size)), np.zeros(size)
    normal[range(7), range(7)] += np.array([1 / _FLOOR_RAD**2] * 3 + [1 / _FLOOR_M**2] * 3 + [1.0])
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
