"""Least-squares adjustment of the pose together with nuisance parameters: camera errors, sweep motions, time offset."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from scipy.linalg import block_diag

from p2o.arrays import Float, Int
from p2o.errors import InputError
from p2o.features.side import Side
from p2o.geometry import se3
from p2o.geometry.camera import Camera
from p2o.geometry.motion import EgoMotion, MotionPrior
from p2o.geometry.radial_error import LARGEST, RadialError, RadialFit, is_correctable, slopes
from p2o.problems.point_to_line import OUTLINE_CELL_PX, PointToLine

_ITERATIONS = 30
_CONVERGED = 1e-7
_CAMERA_SIGMA = np.array([0.01, 0.02])
TIME_SIGMA_S = 0.05
"""Standard deviation of the prior on the offset: images and sweeps are paired within a camera period."""
_MAX_OFFSET_S = 0.5
_PAIRS_PER_OUTLINE = 10.0
"""Pairs along one outline have correlated errors: this many count as one measurement. Chosen on KITTI's `train`."""
_MIN_VARIANCE_PX2 = 0.25
_SIGMA_INFLATION = 2.5
"""Errors of single-frame motions are 2.2 to 2.5 times the deviation from the pairs (KITTI's `train`, synthetic)."""
_OUTWARD = {Side.LEFT: (-1.0, 0.0), Side.RIGHT: (1.0, 0.0), Side.UPPER: (0.0, -1.0), Side.BOTTOM: (0.0, 1.0)}


@dataclass(frozen=True, eq=False)
class MotionFit:
    """The estimated motion of one sweep, with its covariance (2, 2) of speed in m/s and turning rate in rad/s."""

    motion: EgoMotion
    covariance: Float


@dataclass(frozen=True)
class TimeFit:
    """The estimated delay of the images against their timestamps, with its standard deviation."""

    offset_s: float = 0.0
    sigma_s: float = TIME_SIGMA_S


@dataclass(frozen=True, eq=False)
class Adjustment:
    """The pose (4, 4) that fits the pairs best, and the nuisance parameters fitted with it.

    `covariance` (6, 6) is that of a left update in rad and m, with all nuisance parameters unknown as well; None where
    the pairs come from too few independent image cells (`places`). `cameras` has an entry for every fitted camera,
    `motions` one for every frame, or none; `time` is the offset between images and sweeps where it is fitted.
    `step_px` is the root mean square change of the residuals by the fit.
    """

    camera_from_lidar: Float
    covariance: Float | None
    cameras: tuple[RadialFit, ...]
    motions: tuple[MotionFit, ...]
    step_px: float
    places: int
    time: TimeFit | None = None


def fit_with_nuisances(
    problem: PointToLine,
    camera_from_lidar: Float,
    *,
    fits_cameras: bool = True,
    known: Mapping[Camera, RadialError] | None = None,
    prior: MotionPrior | None = None,
    motions: Sequence[EgoMotion] = (),
    twists: Float | None = None,
    time: TimeFit | None = None,
    weights: Float | None = None,
    scenes: Int | None = None,
) -> Adjustment:
    """Fit pose, radial errors of cameras, motions of sweeps and a time offset to pairs by least squares.

    The cameras of `problem` are uncorrected; `known` are their initial errors, fixed with `fits_cameras` False. Motions
    are fitted if there is a `prior`; the points are compensated for `motions`, one a frame (none: raw points). A time
    offset is fitted from the initial value `time`; `twists` (F, 6) are the known velocities of the LiDAR, zero where
    unknown. The robust sum is that of the problem (Huber; Eq. 1 of the paper). With cameras, the widths of outlines are
    fitted, too: systematic edge bias must not be absorbed by the focal length. Gaussian priors: errors of cameras 1 %
    and 0.02, the time offset 50 ms, motions as `prior`. The prior of a motion counts with the weight of its frame, as
    its pairs do (`weights` (F,), with a mean of 1). Covariances are cluster robust: pairs of one direction within 64 px
    are one measurement (Liang and Zeger, 1986), in all frames of one of the `scenes` (F,). Cameras without a radial
    coefficient are not fitted. Raises InputError for a problem without pairs, and where motions or twists are not one
    a frame.
    """
    if not len(problem):
        raise InputError("there are no pairs to fit", expected="at least one pair", got="none")
    if motions and len(motions) != len(problem.cameras):
        raise InputError("the motions are not one a frame", expected=len(problem.cameras), got=len(motions))
    if time is not None and (twists is None or len(twists) != len(problem.cameras)):
        got = "none" if twists is None else len(twists)
        raise InputError("the velocities are not one a frame", expected=len(problem.cameras), got=got)
    model = _Model.of(problem, camera_from_lidar, fits_cameras, known or {}, prior, motions, twists, time, weights)
    pose, state = np.asarray(camera_from_lidar, np.float64), model.start
    rows, own, residuals = model.linearised(pose, state)
    began = residuals
    for _ in range(_ITERATIONS):
        weight = problem.weight * problem.huber_px / np.maximum(np.abs(residuals), problem.huber_px)
        precision = model.precision(weight, residuals)
        hessian = _normal(rows, own, weight) + precision
        pull = weight * residuals
        gradient = np.concatenate([rows.T @ pull, np.asarray(own.T @ pull)])
        gradient[6:] += precision[6:, 6:] @ (state - model.expected)
        step = -np.asarray(np.linalg.lstsq(hessian, gradient, rcond=None)[0], np.float64)
        pose, state = se3.exp(step[:6]) @ pose, model.within(state + step[6:])
        rows, own, residuals = model.linearised(pose, state)
        if np.abs(step).max() < _CONVERGED:
            break
    inverse = np.asarray(np.linalg.pinv(hessian))
    clustered, places = _clustered(problem, rows, own, residuals, scenes)
    covariance = inverse @ clustered @ inverse
    expected = model.prior_score(precision)
    surely = inverse @ (_SIGMA_INFLATION**2 * clustered + expected) @ inverse
    variance = surely.diagonal()
    if time is not None:
        by_frame = _by_frame(problem, rows, own, residuals, weight, inverse)
        variance = np.maximum(variance, (inverse @ (by_frame + expected) @ inverse).diagonal())
    # With six places the fit has no residual for any pose: with few places, residuals underestimate the error.
    spare = places / (places - 6) if places > 6 else None
    pose_covariance: Float | None = None
    if spare is not None:
        pose_covariance = (inverse @ (spare * clustered + expected) @ inverse)[:6, :6]
        # What the pose owes to the motions has their larger errors.
        at = 6 + model.shared
        by_motion = np.linalg.pinv(hessian[:6, :6]) @ hessian[:6, at:]
        more = (_SIGMA_INFLATION**2 - 1) * covariance[at:, at:]
        pose_covariance = pose_covariance + by_motion @ more @ by_motion.T
        pose_covariance = np.asarray(0.5 * (pose_covariance + pose_covariance.T))
    return Adjustment(
        pose,
        pose_covariance,
        model.camera_fits(state, covariance),
        model.motion_fits(state, surely),
        float(np.sqrt(np.mean((residuals - began) ** 2))),
        places,
        model.time_fit(state, variance),
    )


@dataclass(frozen=True, eq=False)
class _Model:
    """What residuals depend on beside the pose.

    The state (N,) is focal and radial of every camera in `asked`, the widths of outlines, the time offset if there is
    a `time`, then speed and turn of every frame. `by_shared` are derivatives by the first two, computed once. `motions`
    (F, 2) are those that the points are corrected for, none without a `prior`; `by_time` (K, 3) is their velocity.
    `weights` (F,) are those of the frames.
    """

    problem: PointToLine
    errors: Mapping[Camera, RadialError]
    asked: tuple[Camera, ...]
    by_shared: Float
    prior: MotionPrior | None
    motions: Float
    time: TimeFit | None
    by_time: Float
    weights: Float

    @classmethod
    def of(
        cls,
        problem: PointToLine,
        pose: Float,
        fits_cameras: bool,
        known: Mapping[Camera, RadialError],
        prior: MotionPrior | None,
        motions: Sequence[EgoMotion],
        twists: Float | None,
        time: TimeFit | None,
        weights: Float | None,
    ) -> _Model:
        correctable = [camera for camera in dict.fromkeys(problem.cameras) if is_correctable(camera)]
        errors = {camera: known.get(camera, RadialError()) for camera in correctable}
        by_shared = np.zeros((len(problem), 0))
        if fits_cameras:
            by_shared = np.hstack([_by_error(problem, pose, errors), _outward(problem)])
        if prior is not None and not motions:
            motions = [EgoMotion()] * len(problem.cameras)
        numbers = [[motion.speed_m_s, motion.turn_rad_s] for motion in motions] if prior is not None else []
        by_time = np.zeros((len(problem), 3))
        if time is not None and twists is not None:
            velocity = np.asarray(twists, np.float64)[problem.frame]
            by_time = -(np.cross(velocity[:, :3], problem.xyz) + velocity[:, 3:])
        asked = tuple(correctable) if fits_cameras else ()
        weights = np.ones(len(problem.cameras)) if weights is None else weights
        return cls(problem, errors, asked, by_shared, prior, np.reshape(numbers, (-1, 2)), time, by_time, weights)

    @property
    def shared(self) -> int:
        """How many numbers of the state are of all frames; the motions follow them."""
        return int(self.by_shared.shape[1]) + (self.time is not None)

    @property
    def start(self) -> Float:
        """The state (N,) of the problem as it is."""
        errors = [[self.errors[camera].focal, self.errors[camera].radial] for camera in self.asked]
        widths = np.zeros(self.by_shared.shape[1] - 2 * len(self.asked))
        offset = [] if self.time is None else [self.time.offset_s]
        return np.concatenate([np.ravel(errors), widths, offset, self.motions.ravel()])

    @property
    def expected(self) -> Float:
        """The state (N,) that is known beforehand."""
        out = np.zeros(self.shared + self.motions.size)
        if self.prior is not None:
            motion = self.prior.expected
            out[self.shared :] = np.tile([motion.speed_m_s, motion.turn_rad_s], len(self.motions))
        return out

    def linearised(self, pose: Float, state: Float) -> tuple[Float, Any, Float]:
        """Return derivatives by pose and shared state (K, 6 + S), by motions (K, 2 F) and residuals (K,).

        All are zero where a point is unseen.
        """
        problem, shared = self.problem, self.shared
        errors = dict(self.errors) | {
            camera: self._error(camera, state[2 * i : 2 * i + 2]) for i, camera in enumerate(self.asked)
        }
        cameras = tuple(errors[c].corrected(c) if c in errors else c for c in problem.cameras)
        # What a motion changes is small: its first order is enough.
        by_speed, by_turn = self._displacements()
        xyz = problem.xyz
        if self.prior is not None:
            change = (state[shared:].reshape(-1, 2) - self.motions)[problem.frame]
            xyz = xyz + change[:, :1] * by_speed + change[:, 1:] * by_turn
        if self.time is not None:
            xyz = xyz + (state[shared - 1] - self.time.offset_s) * self.by_time
        residuals, by_pose = replace(problem, cameras=cameras, xyz=xyz).residuals_with_jacobian(pose)
        by_xyz = by_pose[:, 3:] @ pose[:3, :3]
        by_time = (by_xyz * self.by_time).sum(axis=1, keepdims=True)[:, : self.time is not None]
        rows = np.hstack([by_pose, self.by_shared, by_time])
        own = np.column_stack([(by_xyz * by_speed).sum(axis=1), (by_xyz * by_turn).sum(axis=1)])
        unseen = ~(np.isfinite(residuals) & np.isfinite(rows).all(axis=1))
        # The sum of products with widths comes last: unseen rows hold NaN.
        rows, own = np.where(unseen[:, None], 0.0, rows), np.where(unseen[:, None], 0.0, own)
        widths = slice(2 * len(self.asked), self.by_shared.shape[1])
        residuals = np.where(unseen, 0.0, residuals + self.by_shared[:, widths] @ state[widths])
        return rows, self._spread(own), residuals

    def _displacements(self) -> tuple[Float, Float]:
        """Return how points (K, 3) move in m by 1 m/s and by 1 rad/s of their sweeps' motions."""
        if self.prior is None:
            return np.zeros((len(self.problem), 3)), np.zeros((len(self.problem), 3))
        motion, time_s = self.prior.expected, self.problem.time_s[:, None]
        return time_s * motion.by_speed[3:], time_s * np.cross(motion.by_turn[:3], self.problem.xyz)

    def _spread(self, own: Float) -> Any:
        """Return derivatives by the own motion (K, 2) as a matrix (K, 2 F) of all, sparse where there are several."""
        count = len(own)
        if self.prior is None:
            return np.zeros((count, 0))
        if len(self.motions) == 1:
            return own
        from scipy import sparse

        columns = 2 * self.problem.frame[:, None] + np.array([0, 1])
        at = (own.ravel(), columns.ravel(), np.arange(0, 2 * count + 1, 2))
        return sparse.csr_array(at, shape=(count, self.motions.size))

    def precision(self, weight: Float, residuals: Float) -> Float:
        """Return what is known beforehand of pose and state, as a Hessian (6 + N, 6 + N)."""
        first = np.zeros(6 + self.shared)
        first[6 : 6 + 2 * len(self.asked)] = np.tile(1 / _CAMERA_SIGMA**2, len(self.asked))
        variance = float(weight @ residuals**2) / max(float(weight.sum()), np.finfo(float).tiny)
        outline_variance = _PAIRS_PER_OUTLINE * max(variance, _MIN_VARIANCE_PX2)
        if self.time is not None:
            first[-1] = outline_variance / TIME_SIGMA_S**2
        of_motions = outline_variance * self.motion_information
        root = np.sqrt(np.repeat(self.weights, 2))
        return block_diag(np.diag(first), root[:, None] * of_motions * root if of_motions.size else of_motions)

    def prior_score(self, precision: Float) -> Float:
        """Return the covariance (6 + N, 6 + N) of the gradient because expected motions and times are not the true."""
        at, out = 6 + self.shared, np.zeros_like(precision)
        if self.time is not None:
            out[at - 1, at - 1] = (precision[at - 1, at - 1] * TIME_SIGMA_S) ** 2
        if self.prior is not None:
            of_motions = precision[at:, at:]
            out[at:, at:] = of_motions @ self.prior.covariance_of(len(self.motions)) @ of_motions
        return out

    @cached_property
    def motion_information(self) -> Float:
        """The inverse (2 F, 2 F) of the covariance of the motions before any pair is evaluated."""
        if self.prior is None:
            return np.zeros((0, 0))
        return np.asarray(np.linalg.inv(self.prior.covariance_of(len(self.motions))))

    def within(self, state: Float) -> Float:
        """Return the state (N,) with errors of cameras and the offset in time kept within bounds."""
        count, out = 2 * len(self.asked), np.array(state)
        out[:count] = np.clip(out[:count], -0.5 * LARGEST, 0.5 * LARGEST)
        if self.time is not None:
            out[self.shared - 1] = np.clip(out[self.shared - 1], -_MAX_OFFSET_S, _MAX_OFFSET_S)
        return out

    def time_fit(self, state: Float, variance: Float) -> TimeFit | None:
        """Read the time offset from the state (N,); `variance` (6 + N,) is that of pose and state."""
        if self.time is None:
            return None
        at = self.shared - 1
        return TimeFit(float(state[at]), float(np.sqrt(variance[6 + at])))

    def camera_fits(self, state: Float, covariance: Float) -> tuple[RadialFit, ...]:
        """Read the corrections of the cameras from the state (N,); `covariance` is that of pose and state."""
        places = [(camera, 2 * i, 6 + 2 * i) for i, camera in enumerate(self.asked)]
        return tuple(
            RadialFit(camera, self._error(camera, state[at : at + 2]), covariance[row : row + 2, row : row + 2])
            for camera, at, row in places
        )

    def _error(self, camera: Camera, values: Float) -> RadialError:
        """Return the error of a camera with values (2,) of focal and radial; its principal point is not fitted."""
        return replace(self.errors[camera], focal=float(values[0]), radial=float(values[1]))

    def motion_fits(self, state: Float, covariance: Float) -> tuple[MotionFit, ...]:
        """Read the motions from the state (N,); `covariance` is that of pose and state."""
        fits = []
        for at in range(self.shared, len(state), 2):
            assert self.prior is not None
            motion = replace(self.prior.expected, speed_m_s=float(state[at]), turn_rad_s=float(state[at + 1]))
            fits.append(MotionFit(motion, covariance[6 + at : 8 + at, 6 + at : 8 + at]))
        return tuple(fits)


def _normal(rows: Float, own: Any, weight: Float) -> Float:
    """Return A^T W A (N, N) of A = [rows, own], the second part sparse where it is of several frames."""
    heavy = rows * weight[:, None]
    mixed = np.asarray((own.T @ heavy).T)
    return np.block([[heavy.T @ rows, mixed], [mixed.T, _dense(own.T @ (own * weight[:, None]))]])


def _dense(matrix: Any) -> Float:
    return np.asarray(matrix.toarray() if hasattr(matrix, "toarray") else matrix)


def _by_error(problem: PointToLine, pose: Float, errors: Mapping[Camera, RadialError]) -> Float:
    """Return derivatives (K, 2 C) of the residuals by focal and radial of every camera."""
    rows = np.zeros((len(problem), 2 * len(errors)))
    xyz = se3.apply(pose, problem.xyz)
    for i, (camera, error) in enumerate(errors.items()):
        of_camera = np.array([other == camera for other in problem.cameras])
        mine = np.flatnonzero(of_camera[problem.frame])
        slope = slopes(camera, error, xyz[mine])
        rows[mine, 2 * i : 2 * i + 2] = np.einsum("ka,kap->kp", problem.normal[mine], slope)
    return rows


def _outward(problem: PointToLine) -> Float:
    """Return how residuals grow (K, W) where outlines are wider and where they are higher; W is 0 without sides."""
    table = np.array([_OUTWARD.get(Side(s), (0.0, 0.0)) for s in range(len(_OUTWARD))])
    known = problem.side >= 0
    if not known.any():
        return np.zeros((len(problem), 0))
    out = np.where(known, (table[np.where(known, problem.side, 0)] * problem.normal).sum(axis=1), 0.0)
    upright = np.isin(problem.side, [Side.LEFT, Side.RIGHT])
    return np.column_stack([out * upright, out * ~upright])


def _clustered(problem: PointToLine, rows: Float, own: Any, residuals: Float, scenes: Int | None) -> tuple[Float, int]:
    """Return the covariance (N, N) of the gradient, with pairs of one scene, side and cell as one, and their count."""
    cell = np.floor(problem.centre / OUTLINE_CELL_PX).astype(np.int64)
    scene = problem.frame if scenes is None else scenes[problem.frame]
    _, place = np.unique(np.column_stack([scene, problem.side, cell]), axis=0, return_inverse=True)
    score = _summed(problem, rows, own, residuals, place.reshape(-1))
    return np.asarray(score.T @ score), len(score)


def _by_frame(problem: PointToLine, rows: Float, own: Any, residuals: Float, weight: Float, inverse: Float) -> Float:
    """Return the covariance (N, N) of the gradient if all pairs of a frame have a common error, as of its pose.

    CR3 for few frames (Cameron and Miller, 2015); `inverse` is that of the Hessian.
    """
    _, frame = np.unique(problem.frame, return_inverse=True)
    score = _summed(problem, rows, own, residuals, frame.reshape(-1))
    out = np.zeros_like(inverse)
    for number, gradient in enumerate(score):
        mine = np.flatnonzero(frame.reshape(-1) == number)
        share = _normal(rows[mine], own[mine], weight[mine]) @ inverse
        freed = np.linalg.lstsq(np.eye(len(share)) - share, gradient, rcond=None)[0]
        out += np.outer(freed, freed)
    return out * (1 - 1 / len(score))


def _summed(problem: PointToLine, rows: Float, own: Any, residuals: Float, group: Int) -> Float:
    """Return the gradient (G, N) of the robust sum by group of pairs; `group` (K,) holds their numbers."""
    psi = problem.weight * np.clip(residuals, -problem.huber_px, problem.huber_px)
    count, groups = len(problem), int(group.max()) + 1
    from scipy import sparse

    members = sparse.csr_array((psi, (group, np.arange(count))), shape=(groups, count))
    return np.hstack([np.asarray(members @ rows), _dense(members @ own)])
