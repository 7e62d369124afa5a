"""Estimate errors of camera intrinsics together with the pose, by the directed distance of all edges.

An error of the focal length is absorbed to a large part by a shift along the optical axis, and one of the principal
point by a rotation. Pairs that were matched at such a pose confirm it; the distance maps of the image edges do not.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from p2o.arrays import Float, Int
from p2o.features.view import View
from p2o.geometry import se3
from p2o.geometry.camera import Camera
from p2o.geometry.radial_error import RadialError, is_correctable, slopes
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
_ITERATIONS, _COARSE_ITERATIONS, _MAX_HALVINGS = 30, 12, 8
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
class IntrinsicFit:
    """The error of the intrinsics of one camera, estimated jointly with the pose.

    `covariance` (4, 4) is that of focal, radial, x and y (in focal lengths), with the systematic part. `evidence` is
    the decrease of the directed distance by the corrected cameras in standard deviations over image cells.
    """

    camera: Camera
    error: RadialError
    covariance: Float
    evidence: float

    @property
    def values(self) -> Float:
        """The error (4,): focal, radial, x and y in focal lengths."""
        return _numbers(self.error, self.camera)

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
    which the edges do not reveal, and insignificant estimates as far as their scatter does not explain them.
    """

    fits: tuple[IntrinsicFit, ...]
    camera_from_lidar: Float
    covariance: Float


def estimate_intrinsics(
    views: Sequence[View], camera_from_lidar: Float, parameters: Sequence[bool] = (True,) * 4
) -> IntrinsicsEstimate | None:
    """Estimate the errors of the cameras of views at a pose (4, 4); None where there are no edges or no such cameras.

    Focal length, first radial coefficient and principal point of every camera are fitted together with the pose, by
    Gauss-Newton steps on the distance maps with weights of least absolute deviations; Gaussian priors are scaled by
    the scatter of the gradient over image cells. The fit starts from the given cameras, and from the best of fits on
    coarse maps that start from other focal lengths and radial distortions: its result is used where it is significantly
    better. `parameters` (4,) are those that are fitted: focal length, radial coefficient, principal point x and y.
    """
    cameras = tuple(camera for camera in dict.fromkeys(view.camera for view in views) if is_correctable(camera))
    if not cameras:
        return None
    fine = _Field.of(views, camera_from_lidar, cameras, _MAX_POINTS, *_FINE)
    if fine is None:
        return None
    coarse = _Field.of(views, camera_from_lidar, cameras, _MAX_POINTS // 3, *_COARSE)
    fixed = fine.fit(_State(camera_from_lidar, np.zeros((len(cameras), 4))), free=False)
    prior = np.where(parameters, fine.noise(fixed) / _PRIOR**2, _FIXED)
    best = fine.fit(fixed, prior=prior)
    cells = fine.cells(best.pose)
    if coarse is not None:
        starts = [fixed]
        for error in _COARSE_STARTS[np.any(_COARSE_STARTS[:, np.asarray(parameters, np.bool_)], axis=1)]:
            start = replace(fixed, errors=fixed.errors + error)
            starts.append(coarse.fit(start, free=False, iterations=_COARSE_ITERATIONS))
        ends = [coarse.fit(start, prior=prior, iterations=_COARSE_ITERATIONS) for start in starts]
        other = fine.fit(min(ends, key=lambda end: end.cost), prior=prior)
        if fine.evidence(best, other, cells) > _LEAD:
            best = other
    return fine.estimate(fixed, best, prior, cells)


@dataclass(frozen=True, eq=False)
class _State:
    """A pose (4, 4) with the errors (C, 4) of the cameras; distances (K,) of all points, and the cost after a fit."""

    pose: Float
    errors: Float
    distances: Float | None = None
    cost: float = np.inf


class _Seen(NamedTuple):
    """All points (K, 3) in the frame of the camera, their pixels (K, 2), and the corrected cameras."""

    xyz: Float
    uv: Float
    cameras: list[Camera]


@dataclass(frozen=True, eq=False)
class _Field:
    """The distances of all points to the image edges of their direction, as a function of pose and cameras."""

    cost: DirectedCost
    cameras: tuple[Camera, ...]

    @classmethod
    def of(
        cls,
        views: Sequence[View],
        pose: Float,
        cameras: tuple[Camera, ...],
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
        return cls(replace(cost, parts=parts), cameras) if cost.edges > 0 else None

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
        its: dict[Camera, slice] = {}  # the parts of a camera follow one another
        for part, rows in zip(self.cost.parts, self.rows, strict=True):
            its[part.camera] = slice(its.get(part.camera, rows).start, rows.stop)
        numbers = {camera: number for number, camera in enumerate(self.cameras)}
        return tuple((camera, numbers.get(camera), rows) for camera, rows in its.items())

    def seen(self, pose: Float, errors: Float) -> _Seen:
        """Return what cameras with errors (C, 4) see at a pose (4, 4)."""
        xyz = se3.apply(pose @ self.cost.lidar_from_around, self.xyz)
        uv, cameras = np.empty((len(xyz), 2)), []
        for given, number, rows in self.rows_of_cameras:
            camera = given if number is None else _error(errors[number], given).corrected(given)
            uv[rows] = camera.project(xyz[rows])
            cameras.append(camera)
        return _Seen(xyz, uv, cameras)

    def distances(self, seen: _Seen) -> Float:
        """Return the truncated distances (K,) in px."""
        return np.concatenate([self.cost.sampled(number, seen.uv[rows]) for number, rows in enumerate(self.rows)])

    def linearised(self, seen: _Seen, errors: Float) -> Float:
        """Return the derivatives (6 + 4 C, K) of the distances by a left update of the pose and by the errors."""
        out = np.zeros((6 + 4 * len(self.cameras), len(seen.xyz)))
        slope = np.hstack([self.cost.slopes(number, seen.uv[rows]) for number, rows in enumerate(self.rows)])
        for (given, number, rows), camera in zip(self.rows_of_cameras, seen.cameras, strict=True):
            xyz, uv, by_u, by_v = seen.xyz[rows], seen.uv[rows], *slope[:, rows]
            _, by_xyz = camera.project_with_jacobian(xyz)
            out[3:6, rows] = by_u * by_xyz[:, 0].T + by_v * by_xyz[:, 1].T
            if number is not None:
                by_error = slopes(given, _error(errors[number], given), xyz, uv)
                at = 6 + 4 * number
                out[at : at + 2, rows] = by_u * by_error[:, 0].T + by_v * by_error[:, 1].T
                out[at + 2 : at + 4, rows] = given.focal_px * slope[:, rows]
        np.copyto(out, 0.0, where=np.isnan(out))
        (x, y, z), (by_x, by_y, by_z) = seen.xyz.T, out[3:6]
        out[:3] = y * by_z - z * by_y, z * by_x - x * by_z, x * by_y - y * by_x
        return out

    def fit(
        self, start: _State, *, free: bool = True, prior: Float | None = None, iterations: int = _ITERATIONS
    ) -> _State:
        """Return the state of the smallest mean distance near another one; without `free` the cameras stay fixed.

        `prior` (4,) are the precisions of errors of cameras around zero, in px.
        """
        count = 6 + (4 * len(self.cameras) if free else 0)
        precision = np.tile(np.zeros(4) if prior is None else prior, len(self.cameras))
        pose, errors, damping = start.pose, start.errors, 1e-3
        seen = self.seen(pose, errors)
        distances = self.distances(seen)
        cost = self._cost(distances, errors, precision)
        for _ in range(iterations):
            by = self.linearised(seen, errors)[:count]
            weight = self.weight / np.maximum(distances, _MIN_DISTANCE_PX)
            hessian, gradient = (by * weight) @ by.T, by @ (weight * distances)
            if free:
                hessian[6:, 6:] += np.diag(precision)
                gradient[6:] += precision * errors.ravel()
            for _ in range(_MAX_HALVINGS):
                damped = hessian.copy()
                # A parameter without influence keeps its value.
                damped.flat[:: count + 1] += damping * hessian.diagonal() + np.finfo(float).tiny
                step = np.zeros(6 + errors.size)
                step[:count] = -np.linalg.solve(damped, gradient)
                next_pose, next_errors = se3.exp(step[:6]) @ pose, _bounded(errors + step[6:].reshape(-1, 4))
                next_seen = self.seen(next_pose, next_errors)
                next_distances = self.distances(next_seen)
                next_cost = self._cost(next_distances, next_errors, precision)
                if next_cost < cost:
                    break
                damping *= 5
            else:
                break
            gain, pose, errors, distances, cost = cost - next_cost, next_pose, next_errors, next_distances, next_cost
            seen = next_seen
            damping /= 5
            if gain < _CONVERGED_PX:
                break
        return _State(pose, errors, distances, cost)

    def cells(self, pose: Float) -> Int:
        """Return the number (K,) of the scene, direction and cell of the image that each point belongs to."""
        keys = []
        for part in self.cost.parts:
            uv = np.nan_to_num(part.camera.project(se3.apply(pose @ self.cost.lidar_from_around, part.xyz)), nan=-1.0)
            cell = np.floor(uv / OUTLINE_CELL_PX).astype(np.int64)
            scene = np.full(len(cell), self.cost.scenes[part.view])
            keys.append(np.column_stack([scene, part.side_index, cell]))
        return np.asarray(np.unique(np.concatenate(keys), axis=0, return_inverse=True)[1].reshape(-1))

    def evidence(self, before: _State, after: _State, cells: Int) -> float:
        """Return by how many standard deviations over image cells the mean distance is smaller after than before."""
        assert before.distances is not None
        assert after.distances is not None
        gain = np.bincount(cells, self.weight * (before.distances - after.distances))
        return float(gain.sum() / max(np.sqrt(gain @ gain), np.finfo(float).tiny))

    def noise(self, state: _State) -> float:
        """Return the scatter of the gradient over image cells per curvature, in px: the mean over the pose."""
        hessian, score = self._information(state, self.cells(state.pose))
        return float(np.trace(np.linalg.pinv(hessian[:6, :6]) @ score[:6, :6]) / 6)

    def estimate(self, fixed: _State, best: _State, prior: Float, cells: Int) -> IntrinsicsEstimate:
        """Return the estimate at a fitted state; `fixed` is the one with the cameras as given."""
        hessian, score = self._information(best, cells)
        precision = np.concatenate([np.zeros(6), np.tile(prior, len(self.cameras))])
        inverse = np.linalg.pinv(hessian + np.diag(precision))
        scatter = _SIGMA_INFLATION**2 * inverse @ score @ inverse
        evidence = self.evidence(fixed, best, cells)
        fits, errors = [], np.where(prior < _FIXED, best.errors, 0.0)
        for index, camera in enumerate(self.cameras):
            its = slice(6 + 4 * index, 10 + 4 * index)
            covariance = scatter[its, its] + np.diag(_SYSTEMATIC**2)
            fits.append(IntrinsicFit(camera, _error(errors[index], camera), covariance, evidence))
        # The pose follows unnoticed errors of the cameras: those of a usual calibration, as far as edges allow them,
        # and estimated ones that exceed their scatter but are too small to be significant.
        by_errors = np.linalg.pinv(hessian[:6, :6]) @ hessian[:6, 6:]
        usual = 1 / (np.tile(1 / _CALIBRATED**2, len(self.cameras)) + 1 / np.diag(scatter)[6:])
        expected = np.concatenate([np.diag(fit.covariance) for fit in fits])
        unexpected = np.maximum(errors.ravel() ** 2 - np.tile(_UNEXPECTED, len(self.cameras)) * expected, 0.0)
        unexpected[np.concatenate([fit.significant for fit in fits])] = 0.0  # these make the camera doubtful
        return IntrinsicsEstimate(tuple(fits), best.pose, (by_errors * (usual + unexpected)) @ by_errors.T)

    def _information(self, state: _State, cells: Int) -> tuple[Float, Float]:
        """Return the curvature of the cost and the covariance of its gradient over cells, each (6 + 4 C, 6 + 4 C)."""
        assert state.distances is not None
        by = self.linearised(self.seen(state.pose, state.errors), state.errors)
        weight = self.weight / np.maximum(state.distances, _MIN_DISTANCE_PX)
        gradient = np.array([np.bincount(cells, row) for row in by * (weight * state.distances)])
        return (by * weight) @ by.T, gradient @ gradient.T

    def _cost(self, distances: Float, errors: Float, precision: Float) -> float:
        return float(self.weight @ distances + 0.5 * precision @ errors.ravel() ** 2)


def _error(values: Float, camera: Camera) -> RadialError:
    """Return the error of numbers (4,): focal, radial, x and y in focal lengths."""
    focal, radial, x, y = values.tolist()
    return RadialError(focal, radial, x * camera.focal_px, y * camera.focal_px)


def _numbers(error: RadialError, camera: Camera) -> Float:
    return np.array([error.focal, error.radial, error.x_px / camera.focal_px, error.y_px / camera.focal_px])


def _bounded(errors: Float) -> Float:
    return np.clip(errors, -5 * _PRIOR, 5 * _PRIOR).clip(-0.19, 0.19)
