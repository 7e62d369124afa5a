"""Estimate errors of camera intrinsics together with the pose, by the directed distance of all edges.

An error of the focal length is absorbed to a large part by a shift along the optical axis, and one of the principal
point by a rotation. Pairs that were matched at such a pose confirm it; the distance maps of the image edges do not.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from scipy.linalg import block_diag

from p2o.arrays import Float, Int, Int8
from p2o.features.view import View
from p2o.geometry import se3
from p2o.geometry.camera import Camera
from p2o.geometry.motion import EgoMotion, MotionPrior
from p2o.geometry.radial_error import RadialError, RadialFit, is_correctable, slopes
from p2o.problems.directed_cost import DirectedCost
from p2o.problems.point_to_line import OUTLINE_CELL_PX

_MAX_POINTS = 6000
_MAX_VIEWS = 32
_MARGIN_PX = 30.0
_FINE, _COARSE = (5.0, 1), (15.0, 2)
"""Truncation in px and scale of the maps of the final fit, and of the search for it, where farther edges attract."""
_COARSE_STARTS = np.array([[f, 0, 0, 0] for f in (0.03, -0.03, 0.12, -0.12)] + [[0, 0.1, 0, 0], [0, -0.1, 0, 0]])
"""Errors of focal length and radial distortion from which the fit on coarse maps starts, too."""
_MIN_DISTANCE_PX = 0.5
"""Smaller distances count as this in the weights of the iterations (least absolute distances)."""
_ITERATIONS, _COARSE_ITERATIONS, _POSE_ITERATIONS, _MAX_HALVINGS = 30, 12, 4, 8
_MOST_FITTED = 2
"""Fits on coarse maps: the initial values of lowest cost once the pose is fitted to them."""
_CONVERGED_PX = 2e-5
_PRIOR = np.array([0.03, 0.06, 0.02, 0.02])
"""Standard deviations of the errors that are expected: focal length (relative), radial distortion, centre (of f)."""
_SIGMA_INFLATION = 2.5
"""Errors are larger than the scatter between image cells predicts, by this factor (simulated streets)."""
_SYSTEMATIC = np.array([0.003, 0.006, 0.003, 0.004])
"""Errors found for correct cameras of real rigs with many frames: biases of the extractors, in units of `_PRIOR`."""
SIGNIFICANT, SIGMAS = 3.0, 2.5
"""Smallest evidence, and smallest ratio of an error to its standard deviation, for which a camera is in doubt."""
_FIXED = 1e9
"""Precision of the prior of a parameter that is not fitted."""
_LEAD = 2.0
"""Smallest evidence for which a fit from another initial value replaces the one from the given cameras."""
_CALIBRATED = np.array([0.0015, 0.002, 0.0003, 0.0003])
"""Standard deviations of the errors of a usual calibration, in units of `_PRIOR`: part of the predicted error."""
_UNEXPECTED = np.array([9.0, 9.0, 9.0, 2.0])
"""The part of the square of an estimated error beyond this multiple of its variance belongs to the predicted error.

Less for the vertical principal point, of which a rotation absorbs more than the edges of a low image reveal.
"""


@dataclass(frozen=True, eq=False)
class IntrinsicFit(RadialFit):
    """The error of the intrinsics of one camera, estimated jointly with the pose.

    `covariance` (4, 4) is that of focal, radial, x and y (in focal lengths), with the systematic part. `evidence` is
    the decrease of the directed distance by the corrected cameras in standard deviations over image cells.
    """

    evidence: float

    @property
    def values(self) -> Float:
        """The error (4,): focal, radial, x and y in focal lengths."""
        error, focal_px = self.error, self.camera.focal_px
        return np.array([error.focal, error.radial, error.x_px / focal_px, error.y_px / focal_px])

    @property
    def significant(self) -> tuple[bool, ...]:
        """Whether focal, radial, x and y are in doubt."""
        if self.evidence < SIGNIFICANT:
            return (False,) * 4
        return tuple((np.abs(self.values) > SIGMAS * np.sqrt(np.diag(self.covariance))).tolist())


@dataclass(frozen=True, eq=False)
class IntrinsicsEstimate:
    """The fits of all cameras, the pose (4, 4) with their errors corrected, and what they mean for the pose.

    `covariance` (6, 6) is that of a left update in rad and m by the errors of the cameras: those of usual calibrations,
    which the edges do not reveal, and insignificant estimates as far as their scatter does not explain them. `absorbed`
    (6, 6) is that by significant errors, which the pose has absorbed: the square of the step to the corrected pose.
    """

    fits: tuple[IntrinsicFit, ...]
    camera_from_lidar: Float
    covariance: Float
    absorbed: Float = field(default_factory=lambda: np.zeros((6, 6)))


def estimate_intrinsics(
    views: Sequence[View],
    camera_from_lidar: Float,
    parameters: Sequence[bool] = (True,) * 4,
    prior: MotionPrior | None = None,
    motions: Sequence[EgoMotion] = (),
) -> IntrinsicsEstimate | None:
    """Estimate the errors of the cameras of views at a pose (4, 4); None where there are no edges or no such cameras.

    Focal length, first radial coefficient and principal point of every camera are fitted together with the pose, by
    Gauss-Newton steps on the distance maps with weights of least absolute deviations; Gaussian priors are scaled by
    the scatter of the gradient over image cells. The fit starts from the given cameras, and from the best of fits on
    coarse maps, which start from those of several focal lengths and radial distortions that cost least with a pose
    fitted to them: its result is used where it is significantly better. `parameters` (4,) are those that are fitted:
    focal length, radial coefficient, principal point x and y.

    With a `prior`, the motions of all sweeps are fitted, too: in raw sweeps a forward motion displaces edges much as an
    error of the principal point in x does. The views are compensated for `motions`, one a view.
    """
    cameras = tuple(camera for camera in dict.fromkeys(view.camera for view in views) if is_correctable(camera))
    if not cameras:
        return None
    fine = _Field.of(views, camera_from_lidar, cameras, prior, motions, _MAX_POINTS, *_FINE)
    if fine is None:
        return None
    coarse = _Field.of(views, camera_from_lidar, cameras, prior, motions, _MAX_POINTS // 3, *_COARSE)
    given = _State(camera_from_lidar, np.zeros(fine.moving), np.zeros((len(cameras), 4)))
    given = fine.fit(given, count=6)
    noise = fine.noise(given)
    precision = fine.precision(noise, np.where(parameters, noise / _PRIOR**2, _FIXED))
    fixed = fine.fit(given, precision, count=6 + fine.moving) if fine.moving else given
    best = fine.fit(fixed, precision)
    cells = fine.cells(best.pose)
    if coarse is not None:
        errors = _COARSE_STARTS[np.any(_COARSE_STARTS[:, np.asarray(parameters, np.bool_)], axis=1)]
        starts = [replace(fixed, errors=fixed.errors + error) for error in (np.zeros(4), *errors)]
        starts = [coarse.fit(start, precision, count=6 + fine.moving, iterations=_POSE_ITERATIONS) for start in starts]
        starts = sorted(starts, key=lambda start: start.cost)[:_MOST_FITTED]
        ends = [coarse.fit(start, precision, iterations=_COARSE_ITERATIONS) for start in starts]
        other = fine.fit(min(ends, key=lambda end: end.cost), precision)
        if fine.evidence(best, other, cells) > _LEAD:
            best = other
    return fine.estimate(camera_from_lidar, fixed, best, precision, cells)


@dataclass(frozen=True, eq=False)
class _State:
    """A pose (4, 4), changes (2 P,) of the motions of the parts, speed and turning, and errors (C, 4) of the cameras.

    `distances` (K,) are those of all points, and `cost` is that after a fit.
    """

    pose: Float
    motions: Float
    errors: Float
    distances: Float | None = None
    cost: float = np.inf

    def moved(self, step: Float) -> _State:
        """Return the state after a step (N,) of its first N parameters."""
        step = np.concatenate([step, np.zeros(6 + self.motions.size + self.errors.size - len(step))])
        errors = np.clip(self.errors + step[6 + self.motions.size :].reshape(-1, 4), -5 * _PRIOR, 5 * _PRIOR)
        motions = self.motions + step[6 : 6 + self.motions.size]
        return _State(se3.exp(step[:6]) @ self.pose, motions, errors.clip(-0.19, 0.19))


class _Seen(NamedTuple):
    """All points (K, 3) in the frame of the camera, their pixels (K, 2), and the corrected cameras."""

    xyz: Float
    uv: Float
    cameras: list[Camera]


@dataclass(frozen=True, eq=False)
class _Field:
    """The distances of all points to the image edges of their direction, as a function of pose, motions and cameras.

    `by_motion` (2, K, 3) are the derivatives of the points, as `xyz`, by speed and turning of their sweeps; `expected`
    (2 P,) are the changes of the motions before any edge is seen, and `spread` (2 P, 2 P) is their covariance. P is
    the number of parts, 0 where motions are not fitted. `side` (K,) are the directions.
    """

    cost: DirectedCost
    cameras: tuple[Camera, ...]
    side: Int8
    by_motion: Float
    expected: Float
    spread: Float

    @classmethod
    def of(
        cls,
        views: Sequence[View],
        pose: Float,
        cameras: tuple[Camera, ...],
        prior: MotionPrior | None,
        motions: Sequence[EgoMotion],
        points: int,
        truncate_px: float,
        scale: int,
    ) -> _Field | None:
        """Return the field of the points that are visible from near a pose (4, 4); None without any."""
        cost = DirectedCost.of(
            views, pose, truncate_px, scale=scale, margin_px=_MARGIN_PX, max_points=points, max_views=_MAX_VIEWS
        )
        order = [view.camera for view in views]
        parts = tuple(sorted(cost.parts, key=lambda part: order.index(part.camera)))
        if not cost.edges > 0:
            return None
        cost = replace(cost, parts=parts)
        seen = [views[part.view].cloud_edges.select(part.rows) for part in parts]
        side = np.concatenate([edges.side for edges in seen])
        if prior is None:
            return cls(cost, cameras, side, np.zeros((2, 0, 3)), np.zeros(0), np.zeros((0, 0)))
        by_motion, expected = [], []
        by_speed, by_turn = prior.expected.by_speed[3:], prior.expected.by_turn[:3]
        for part, edges in zip(parts, seen, strict=True):
            motion = motions[part.view]
            shift = edges.time_s[:, None] * np.stack([np.tile(by_speed, (len(edges), 1)), np.cross(by_turn, edges.xyz)])
            by_motion.append(shift @ pose[:3, :3].T)
            change = (prior.expected.speed_m_s - motion.speed_m_s, prior.expected.turn_rad_s - motion.turn_rad_s)
            expected.append(change)
        spread = prior.covariance_of(len(parts))
        return cls(cost, cameras, side, np.concatenate(by_motion, axis=1), np.ravel(expected), spread)

    @property
    def moving(self) -> int:
        """The number of parameters of motions."""
        return len(self.expected)

    @cached_property
    def part_of(self) -> Int:
        """The part (K,) of every point."""
        return np.repeat(np.arange(len(self.rows)), [rows.stop - rows.start for rows in self.rows])

    def precision(self, noise: float, of_errors: Float) -> Float:
        """Return the precision (N, N) in px of the priors of pose, motions and errors (4,) of every camera."""
        motions = noise * np.linalg.inv(self.spread)
        return np.asarray(block_diag(np.zeros((6, 6)), motions, np.diag(np.tile(of_errors, len(self.cameras)))))

    @cached_property
    def weight(self) -> Float:
        """The weights (K,) of the points; their sum is 1."""
        weight = np.concatenate([part.weight for part in self.cost.parts])
        return np.asarray(weight / weight.sum())

    @cached_property
    def xyz(self) -> Float:
        """The points (K, 3), in the frame of the camera at the pose that the cost was made at."""
        return np.concatenate([part.xyz for part in self.cost.parts])

    @cached_property
    def rows(self) -> tuple[slice, ...]:
        """The points of each part."""
        ends = np.cumsum([0, *(len(part.xyz) for part in self.cost.parts)]).tolist()
        return tuple(slice(first, end) for first, end in pairwise(ends))

    @cached_property
    def rows_of_cameras(self) -> tuple[tuple[Camera, int | None, slice], ...]:
        """The cameras of the parts, their numbers, None for those that stay as given, and their points."""
        rows_of: dict[Camera, slice] = {}  # the parts of a camera follow one another
        for part, rows in zip(self.cost.parts, self.rows, strict=True):
            rows_of[part.camera] = slice(rows_of.get(part.camera, rows).start, rows.stop)
        numbers = {camera: number for number, camera in enumerate(self.cameras)}
        return tuple((camera, numbers.get(camera), rows) for camera, rows in rows_of.items())

    def seen(self, state: _State) -> _Seen:
        """Return what the cameras see in a state."""
        errors, xyz = state.errors, self.xyz
        if self.moving:
            change = state.motions.reshape(-1, 2)[self.part_of]
            xyz = xyz + change[:, :1] * self.by_motion[0] + change[:, 1:] * self.by_motion[1]
        xyz = se3.apply(state.pose @ self.cost.lidar_from_around, xyz)
        uv, cameras = np.empty((len(xyz), 2)), []
        for given, number, rows in self.rows_of_cameras:
            camera = given if number is None else _error(errors[number], given).corrected(given)
            uv[rows] = camera.project(xyz[rows])
            cameras.append(camera)
        return _Seen(xyz, uv, cameras)

    def distances(self, seen: _Seen) -> Float:
        """Return the truncated distances (K,) in px."""
        return np.concatenate([self.cost.sampled(number, seen.uv[rows]) for number, rows in enumerate(self.rows)])

    def linearised(self, seen: _Seen, state: _State) -> Float:
        """Return the derivatives (N, K) of the distances by a left update of the pose, by motions and by errors."""
        first, errors = 6 + self.moving, state.errors
        out = np.zeros((first + 4 * len(self.cameras), len(seen.xyz)))
        slope = np.hstack([self.cost.slopes(number, seen.uv[rows]) for number, rows in enumerate(self.rows)])
        for (given, number, rows), camera in zip(self.rows_of_cameras, seen.cameras, strict=True):
            xyz, uv, by_u, by_v = seen.xyz[rows], seen.uv[rows], *slope[:, rows]
            _, by_xyz = camera.project_with_jacobian(xyz)
            out[3:6, rows] = by_u * by_xyz[:, 0].T + by_v * by_xyz[:, 1].T
            if number is not None:
                by_error = slopes(given, _error(errors[number], given), xyz, uv)
                at = first + 4 * number
                out[at : at + 2, rows] = by_u * by_error[:, 0].T + by_v * by_error[:, 1].T
                out[at + 2 : at + 4, rows] = given.focal_px * slope[:, rows]
        np.copyto(out, 0.0, where=np.isnan(out))
        (x, y, z), (by_x, by_y, by_z) = seen.xyz.T, out[3:6]
        out[:3] = y * by_z - z * by_y, z * by_x - x * by_z, x * by_y - y * by_x
        if self.moving:
            rotation = (state.pose @ self.cost.lidar_from_around)[:3, :3]
            by_motion = np.einsum("mkj,jk->mk", self.by_motion @ rotation.T, out[3:6])
            for part, rows in enumerate(self.rows):
                out[6 + 2 * part : 8 + 2 * part, rows] = by_motion[:, rows]
        return out

    def fit(
        self, start: _State, precision: Float | None = None, *, count: int | None = None, iterations: int = _ITERATIONS
    ) -> _State:
        """Return the state of the smallest mean distance near another one.

        `count` is the number of parameters that are fitted, from the first one: 6 for the pose only, by default all.
        `precision` (N, N) is that of the priors in px.
        """
        if precision is None:
            precision = self.precision(0.0, np.zeros(4))
        count = len(precision) if count is None else count
        precision, damping = precision[:count, :count], 1e-3
        state, expected = start, np.concatenate([np.zeros(6), self.expected, np.zeros(start.errors.size)])[:count]
        seen = self.seen(state)
        distances = self.distances(seen)
        cost, away = self._cost(distances, state, expected, precision)
        for _ in range(iterations):
            by = self.linearised(seen, state)[:count]
            weight = self.weight / np.maximum(distances, _MIN_DISTANCE_PX)
            hessian, gradient = (by * weight) @ by.T + precision, by @ (weight * distances) + precision @ away
            for _ in range(_MAX_HALVINGS):
                damped = hessian.copy()
                # A parameter without influence keeps its value.
                damped.flat[:: count + 1] += damping * hessian.diagonal() + np.finfo(float).tiny
                next_state = state.moved(-np.asarray(np.linalg.solve(damped, gradient), np.float64))
                next_seen = self.seen(next_state)
                next_distances = self.distances(next_seen)
                next_cost, next_away = self._cost(next_distances, next_state, expected, precision)
                if next_cost < cost:
                    break
                damping *= 5
            else:
                break
            gain, state, distances, cost, away = cost - next_cost, next_state, next_distances, next_cost, next_away
            seen = next_seen
            damping /= 5
            if gain < _CONVERGED_PX:
                break
        return replace(state, distances=distances, cost=cost)

    def cells(self, pose: Float) -> tuple[Int, Int]:
        """Return the number (K,) of the cell that each point belongs to, twice: of its view, and of all views.

        A cell is one of a direction and a part of the image. Errors in one cell of several views are not independent
        where a drive straight on, or a rig at rest, shows the same outlines there again.
        """
        xyz, keys = se3.apply(pose @ self.cost.lidar_from_around, self.xyz), []
        for number, (camera, _, rows) in enumerate(self.rows_of_cameras):
            cell = np.floor(np.nan_to_num(camera.project(xyz[rows]), nan=-1.0) / OUTLINE_CELL_PX).astype(np.int64)
            keys.append(np.column_stack([self.part_of[rows], np.full(len(cell), number), self.side[rows], cell]))
        key = np.concatenate(keys)
        own, common = (np.unique(k, axis=0, return_inverse=True)[1].reshape(-1) for k in (key, key[:, 1:]))
        return own, common

    def evidence(self, before: _State, after: _State, cells: tuple[Int, Int]) -> float:
        """Return by how many standard deviations over image cells the mean distance is smaller after than before.

        The cells are those with the larger deviation.
        """
        assert before.distances is not None
        assert after.distances is not None
        gain = self.weight * (before.distances - after.distances)
        deviation = max(float(np.linalg.norm(np.bincount(cell, gain))) for cell in cells)
        return float(gain.sum() / max(deviation, np.finfo(float).tiny))

    def noise(self, state: _State) -> float:
        """Return the scatter of the gradient over image cells per curvature, in px: the mean over the pose."""
        hessian, score = self._information(state, self.cells(state.pose)[0])
        return float(np.trace(np.linalg.pinv(hessian[:6, :6]) @ score[:6, :6]) / 6)

    def estimate(
        self, given: Float, fixed: _State, best: _State, precision: Float, cells: tuple[Int, Int]
    ) -> IntrinsicsEstimate:
        """Return the estimate at a fitted state; `fixed` is the one with the cameras as given.

        `given` (4, 4) is the pose of the result, which is estimated with the cameras as given.
        """
        first, scatters = 6 + self.moving, []
        for numbers in cells:
            hessian, score = self._information(best, numbers)
            hessian += precision
            score *= _SIGMA_INFLATION**2
            # Expected motions are not the true ones.
            score[6:first, 6:first] += precision[6:first, 6:first] @ self.spread @ precision[6:first, 6:first]
            inverse = np.linalg.pinv(hessian)
            scatters.append(inverse @ score @ inverse)
        own, common = scatters
        wider = np.sqrt(np.maximum(1.0, np.diag(own) / np.maximum(np.diag(common), np.finfo(float).tiny)))
        scatter = wider[:, None] * common * wider
        evidence = self.evidence(fixed, best, cells)
        prior = np.diag(precision)[first:].reshape(-1, 4)
        fits, errors = [], np.where(prior < _FIXED, best.errors, 0.0)
        for index, camera in enumerate(self.cameras):
            rows = slice(first + 4 * index, first + 4 * (index + 1))
            covariance = scatter[rows, rows] + np.diag(_SYSTEMATIC**2)
            fits.append(IntrinsicFit(camera, _error(errors[index], camera), covariance, evidence))
        # The pose follows unnoticed errors of the cameras: those of a usual calibration, as far as edges allow them,
        # and estimated ones that exceed their scatter but are too small to be significant.
        by_errors = np.linalg.pinv(hessian[:6, :6]) @ hessian[:6, first:]
        usual = 1 / (np.tile(1 / _CALIBRATED**2, len(self.cameras)) + 1 / np.diag(scatter)[first:])
        expected = np.concatenate([np.diag(fit.covariance) for fit in fits])
        unexpected = np.maximum(errors.ravel() ** 2 - np.tile(_UNEXPECTED, len(self.cameras)) * expected, 0.0)
        significant = np.concatenate([fit.significant for fit in fits])
        unexpected[significant] = 0.0
        step = se3.log(best.pose @ se3.inverse(given)) if significant.any() else np.zeros(6)
        covariance = (by_errors * (usual + unexpected)) @ by_errors.T
        return IntrinsicsEstimate(tuple(fits), best.pose, covariance, np.outer(step, step))

    def _information(self, state: _State, cells: Int) -> tuple[Float, Float]:
        """Return the curvature of the mean distance and the covariance of its gradient over cells, each (N, N)."""
        assert state.distances is not None
        by = self.linearised(self.seen(state), state)
        weight = self.weight / np.maximum(state.distances, _MIN_DISTANCE_PX)
        gradient = np.array([np.bincount(cells, row) for row in by * (weight * state.distances)])
        return (by * weight) @ by.T, gradient @ gradient.T

    def _cost(self, distances: Float, state: _State, expected: Float, precision: Float) -> tuple[float, Float]:
        """Return the cost of a state, and by how much its first parameters differ from the expected ones."""
        away = np.concatenate([np.zeros(6), state.motions, state.errors.ravel()])[: len(expected)] - expected
        return float(self.weight @ distances + 0.5 * away @ precision @ away), away


def _error(values: Float, camera: Camera) -> RadialError:
    """Return the error of numbers (4,): focal, radial, x and y in focal lengths."""
    focal, radial, x, y = values.tolist()
    return RadialError(focal, radial, x * camera.focal_px, y * camera.focal_px)
