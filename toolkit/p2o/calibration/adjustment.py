"""Least-squares adjustment of the pose together with nuisance parameters: camera errors, sweep motions, time offset."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
from scipy import sparse
from scipy.linalg import block_diag

from p2o.arrays import Float, Int
from p2o.calibration.block_system import BlockSystem
from p2o.calibration.intrinsics import IntrinsicsEstimate, estimate_intrinsics
from p2o.features.side import Side
from p2o.features.view import View
from p2o.geometry import se3
from p2o.geometry.camera import Camera
from p2o.geometry.motion import EgoMotion, MotionPrior, pose_at
from p2o.geometry.radial_error import LARGEST, RadialError, RadialFit, is_correctable, slopes
from p2o.problems.distinct_views import scenes_of, view_weights
from p2o.problems.point_to_line import OUTLINE_CELL_PX, PointToLine
from p2o.results.result import SweepMotion, TimeOffset

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
    time: TimeOffset | None = None


@dataclass(frozen=True)
class Nuisance:
    """Values of the nuisance parameters: errors of cameras, motions (one a view, or none) and an offset in time.

    `twists` (F, 6) are the velocities that make the offset observable, None where it is not. `weights` (F,) and
    `scenes` (F,) are those of the views (`p2o.problems.distinct_views`), None where every view counts once.
    """

    prior: MotionPrior | None = None
    errors: Mapping[Camera, RadialError] = field(default_factory=dict)
    motions: tuple[MotionFit, ...] = ()
    twists: Float | None = None
    time: TimeOffset | None = None
    weights: Float | None = None
    scenes: Int | None = None

    @classmethod
    def expected(cls, views: Sequence[View], prior: MotionPrior | None, twists: Float | None = None) -> Nuisance:
        """Return the values that are expected before any pair is evaluated, with the weights and scenes of views."""
        motions = () if prior is None else (MotionFit(prior.expected, prior.covariance),) * len(views)
        return cls(prior, motions=motions, twists=twists, weights=view_weights(views), scenes=scenes_of(views))

    def error_of(self, camera: Camera) -> RadialError:
        """Return the error of a camera; zero where none is known."""
        return self.errors.get(camera, RadialError())

    def timed(self) -> Nuisance:
        """Return the same values with an offset in time to be estimated."""
        return replace(self, time=TimeOffset(0.0, TIME_SIGMA_S, used=True))

    def fit(self, problem: PointToLine, cameras: tuple[Camera, ...], pose: Float, *, fits_cameras: bool) -> Adjustment:
        """Fit pose and nuisance parameters to pairs, starting from these values; `cameras` are uncorrected."""
        return fit_with_nuisances(replace(problem, cameras=cameras), pose, self, fits_cameras=fits_cameras)

    def after(self, fit: Adjustment) -> Nuisance:
        """Return the values after a fit."""
        errors = dict(self.errors) | {c.camera: c.error for c in fit.cameras}
        return replace(self, errors=errors, motions=fit.motions, time=fit.time)

    def views(self, raw: Sequence[View]) -> list[View]:
        """Return raw views with cameras corrected, and features moved to the time of the image."""
        if self.motions:
            raw = [view.untwisted(fit.motion.twist) for view, fit in zip(raw, self.motions, strict=True)]
        if self.time is not None and self.twists is not None:
            offset_s = self.time.offset_s
            raw = [view.moved(pose_at(twist, -offset_s)) for view, twist in zip(raw, self.twists, strict=True)]
        cameras = [self.error_of(view.camera).corrected(view.camera) for view in raw]
        return [replace(view, camera=camera) for view, camera in zip(raw, cameras, strict=True)]

    def intrinsics(
        self, raw: Sequence[View], camera_from_lidar: Float, parameters: Sequence[bool]
    ) -> IntrinsicsEstimate | None:
        """Estimate errors of the cameras of raw views at a pose (4, 4), together with the motions of their sweeps."""
        motions = [fit.motion for fit in self.motions]
        return estimate_intrinsics(self.views(raw), camera_from_lidar, parameters, self.prior, motions)

    def sweep_motions(self, views: Sequence[View]) -> tuple[SweepMotion, ...]:
        """Return the motions of those views whose sweeps are raw."""
        return tuple(
            sweep_motion(view.name, fit.motion, *np.sqrt(np.diag(fit.covariance)).tolist())
            for view, fit in zip(views, self.motions, strict=bool(self.motions))
            if view.cloud_edges.time_s.any()
        )


def sweep_motion(frame: str, motion: EgoMotion, speed_sigma: float, turn_sigma: float) -> SweepMotion:
    """Return the motion of a frame as part of a result, with its standard deviations in m/s and rad/s."""
    turn = float(np.degrees(motion.turn_rad_s)), float(np.degrees(turn_sigma))
    return SweepMotion(frame, motion.speed_m_s, speed_sigma, *turn, tuple(motion.twist.tolist()))


def fit_with_nuisances(
    problem: PointToLine, camera_from_lidar: Float, nuisance: Nuisance, *, fits_cameras: bool = True
) -> Adjustment:
    """Fit pose, radial errors of cameras, motions of sweeps and a time offset to pairs by least squares.

    The cameras of `problem` are uncorrected; the fit starts from the values of `nuisance`, whose errors of cameras are
    fixed with `fits_cameras` False. Motions are fitted if there is a prior; the points are compensated for those of
    `nuisance`. A time offset is fitted if `nuisance` has one. The robust sum is that of the problem (Huber; Eq. 1 of
    the paper). With cameras, the widths of outlines are fitted, too: systematic edge bias must not be absorbed by the
    focal length. Gaussian priors: errors of cameras 1 % and 0.02, the time offset 50 ms, motions as their prior, which
    counts with the weight of its frame, as its pairs do. Covariances are cluster robust: pairs of one direction within
    64 px are one measurement (Liang and Zeger, 1986), in all frames of one scene. Cameras without a radial coefficient
    are not fitted.
    """
    model, pose = _Model.of(problem, camera_from_lidar, nuisance, fits_cameras), camera_from_lidar
    state = model.start
    rows, own, residuals = model.linearised(pose, state)
    began = residuals
    for _ in range(_ITERATIONS):
        weight = problem.weight * problem.huber_px / np.maximum(np.abs(residuals), problem.huber_px)
        variance = model.outline_variance(weight, residuals)
        system = model.system(rows, own, weight, variance)
        shared_step, own_step = system.solve(*model.gradient(rows, own, weight * residuals, state, variance))
        step = -np.concatenate([shared_step[: 6 + model.shared], own_step.ravel()])
        pose, state = se3.exp(step[:6]) @ pose, model.within(state + step[6:])
        rows, own, residuals = model.linearised(pose, state)
        if np.abs(step).max() < _CONVERGED:
            break
    scores, places = _clustered(model, rows, own, residuals)
    by_pairs, by_prior = system.covariance(*scores), system.covariance(*model.prior_scores(variance))
    shared = slice(0, 6 + model.shared)
    surely = _SIGMA_INFLATION**2 * by_pairs.shared + by_prior.shared
    time_variance = surely[shared, shared].diagonal()[-1]
    if nuisance.time is not None:
        by_frame = _by_frame(model, system, rows, own, residuals, weight)
        time_variance = max(time_variance, by_frame + by_prior.shared[shared, shared].diagonal()[-1])
    pose_covariance: Float | None = None
    if places > 6:
        # With six places the fit has no residual for any pose: with few places, residuals underestimate the error.
        pose_covariance = (places / (places - 6) * by_pairs.shared + by_prior.shared)[:6, :6]
        # What the pose owes to the motions has their larger errors.
        of_pose = np.concatenate([np.zeros((6, 0)), *system.mixed[:, :6]], axis=1)
        by_motion = np.linalg.pinv(system.shared[:6, :6]) @ of_pose
        pose_covariance = pose_covariance + (_SIGMA_INFLATION**2 - 1) * by_pairs.through(by_motion)
        pose_covariance = np.asarray(0.5 * (pose_covariance + pose_covariance.T))
    return Adjustment(
        pose,
        pose_covariance,
        model.camera_fits(state, by_pairs.shared),
        model.motion_fits(state, _SIGMA_INFLATION**2 * by_pairs.own + by_prior.own),
        float(np.sqrt(np.mean((residuals - began) ** 2))),
        places,
        model.time_fit(state, float(time_variance)),
    )


@dataclass(frozen=True, eq=False)
class _Model:
    """What residuals depend on beside the pose.

    The state (N,) is focal and radial of every camera in `asked`, the widths of outlines, the time offset if one is
    fitted, then speed and turn of every frame. `by_shared` are derivatives by the first two, computed once. `motions`
    (F, 2) are those that the points are corrected for; `by_time` (K, 3) is the velocity of the points.
    """

    problem: PointToLine
    nuisance: Nuisance
    asked: tuple[Camera, ...]
    by_shared: Float
    motions: Float
    by_time: Float

    @classmethod
    def of(cls, problem: PointToLine, pose: Float, nuisance: Nuisance, fits_cameras: bool) -> _Model:
        asked = tuple(filter(is_correctable, dict.fromkeys(problem.cameras))) if fits_cameras else ()
        by_shared, by_time = np.zeros((len(problem), 0)), np.zeros((len(problem), 3))
        if fits_cameras:
            errors = {camera: nuisance.error_of(camera) for camera in asked}
            by_shared = np.hstack([_by_error(problem, pose, errors), _outward(problem)])
        motions = [[fit.motion.speed_m_s, fit.motion.turn_rad_s] for fit in nuisance.motions]
        if nuisance.time is not None and nuisance.twists is not None:
            velocity = nuisance.twists[problem.frame]
            by_time = -(np.cross(velocity[:, :3], problem.xyz) + velocity[:, 3:])
        return cls(problem, nuisance, asked, by_shared, np.reshape(motions, (-1, 2)), by_time)

    @cached_property
    def weights(self) -> Float:
        """The weights (F,) of the frames."""
        return np.ones(len(self.problem.cameras)) if self.nuisance.weights is None else self.nuisance.weights

    @property
    def shared(self) -> int:
        """How many numbers of the state are of all frames; the motions follow them."""
        return int(self.by_shared.shape[1]) + (self.nuisance.time is not None)

    @property
    def start(self) -> Float:
        """The state (N,) of the problem as it is."""
        errors = [[error.focal, error.radial] for error in map(self.nuisance.error_of, self.asked)]
        widths = np.zeros(self.by_shared.shape[1] - 2 * len(self.asked))
        offset = [] if self.nuisance.time is None else [self.nuisance.time.offset_s]
        return np.concatenate([np.ravel(errors), widths, offset, self.motions.ravel()])

    def linearised(self, pose: Float, state: Float) -> tuple[Float, Float, Float]:
        """Return derivatives by pose and shared state (K, 6 + S), by the own motion (K, 2), and residuals (K,).

        All are zero where a point is unseen.
        """
        problem, shared = self.problem, self.shared
        fitted = {camera: self._error(camera, state[2 * i : 2 * i + 2]) for i, camera in enumerate(self.asked)}
        cameras = tuple(fitted.get(c, self.nuisance.error_of(c)).corrected(c) for c in problem.cameras)
        # What a motion changes is small: its first order is enough.
        by_speed, by_turn = self._displacements()
        xyz = problem.xyz
        if self.nuisance.prior is not None:
            change = (state[shared:].reshape(-1, 2) - self.motions)[problem.frame]
            xyz = xyz + change[:, :1] * by_speed + change[:, 1:] * by_turn
        if self.nuisance.time is not None:
            xyz = xyz + (state[shared - 1] - self.nuisance.time.offset_s) * self.by_time
        residuals, by_pose = replace(problem, cameras=cameras, xyz=xyz).residuals_with_jacobian(pose)
        by_xyz = by_pose[:, 3:] @ pose[:3, :3]
        by_time = (by_xyz * self.by_time).sum(axis=1, keepdims=True)[:, : self.nuisance.time is not None]
        rows = np.hstack([by_pose, self.by_shared, by_time])
        own = np.column_stack([(by_xyz * by_speed).sum(axis=1), (by_xyz * by_turn).sum(axis=1)])
        unseen = ~(np.isfinite(residuals) & np.isfinite(rows).all(axis=1))
        # The sum of products with widths comes last: unseen rows hold NaN.
        rows, own = np.where(unseen[:, None], 0.0, rows), np.where(unseen[:, None], 0.0, own)
        widths = slice(2 * len(self.asked), self.by_shared.shape[1])
        residuals = np.where(unseen, 0.0, residuals + self.by_shared[:, widths] @ state[widths])
        return rows, own, residuals

    def _displacements(self) -> tuple[Float, Float]:
        """Return how points (K, 3) move in m by 1 m/s and by 1 rad/s of their sweeps' motions."""
        if self.nuisance.prior is None:
            return np.zeros((len(self.problem), 3)), np.zeros((len(self.problem), 3))
        motion, time_s = self.nuisance.prior.expected, self.problem.time_s[:, None]
        return time_s * motion.by_speed[3:], time_s * np.cross(motion.by_turn[:3], self.problem.xyz)

    @cached_property
    def _members(self) -> Any:
        """The pairs of each frame (F, K), none where no motions are fitted."""
        count = len(self.problem)
        if self.nuisance.prior is None:
            return sparse.csr_array((0, count))
        of_frame = (np.ones(count), (self.problem.frame, np.arange(count)))
        return sparse.csr_array(of_frame, shape=(len(self.motions), count))

    def outline_variance(self, weight: Float, residuals: Float) -> float:
        """Return the variance in px^2 of an outline, which counts as `_PAIRS_PER_OUTLINE` pairs."""
        variance = float(weight @ residuals**2) / max(float(weight.sum()), np.finfo(float).tiny)
        return _PAIRS_PER_OUTLINE * max(variance, _MIN_VARIANCE_PX2)

    @cached_property
    def _root(self) -> Float:
        """The roots (F,) of the weights of the frames."""
        return np.sqrt(self.weights[: len(self.motions)])

    @cached_property
    def _common(self) -> tuple[Float, float]:
        """What the common part of all speeds takes from the precision of the motions: -c a a^T with a (2 F,)."""
        assert self.nuisance.prior is not None
        own, common = self.nuisance.prior.own_variance[0], self.nuisance.prior.common_variance
        a = np.zeros((len(self.motions), 2))
        a[:, 0] = self._root / own
        return a.ravel(), 1 / (1 / common + len(a) / own)

    def system(self, rows: Float, own: Float, weight: Float, variance: float) -> BlockSystem:
        """Return the Hessian of the robust sum and the priors; `variance` is that of an outline.

        The last shared unknown is auxiliary where motions are fitted: it makes the own blocks independent.
        """
        shared, mixed, blocks = self._normal(rows, own, weight)
        first = np.zeros(6 + self.shared)
        first[6 : 6 + 2 * len(self.asked)] = np.tile(1 / _CAMERA_SIGMA**2, len(self.asked))
        if self.nuisance.time is not None:
            first[-1] = variance / TIME_SIGMA_S**2
        shared = shared + np.diag(first)
        if self.nuisance.prior is not None:
            a, share = self._common
            shared = block_diag(shared, np.array([[1 / (variance * share)]]))
            mixed = np.concatenate([mixed, a.reshape(-1, 1, 2)], axis=1)
            blocks = blocks + variance * self.weights[:, None, None] * np.diag(1 / self.nuisance.prior.own_variance)
        return BlockSystem(shared, mixed, blocks)

    def _normal(self, rows: Float, own: Float, weight: Float) -> tuple[Float, Float, Float]:
        """Return A^T W A of pairs in blocks: (6 + S, 6 + S), and (F, 6 + S, 2) and (F, 2, 2) of the motions."""
        heavy, count = rows * weight[:, None], rows.shape[1]
        mixed = np.stack([self._members @ (heavy * by_motion[:, None]) for by_motion in own.T], axis=-1)
        blocks = np.stack([self._members @ (own * (weight * by_motion)[:, None]) for by_motion in own.T], axis=-1)
        return heavy.T @ rows, mixed.reshape(-1, count, 2), blocks.reshape(-1, 2, 2)

    def gradient(self, rows: Float, own: Float, pull: Float, state: Float, variance: float) -> tuple[Float, Float]:
        """Return the gradient as right sides of the system; `pull` (K,) are weighted residuals."""
        shared = rows.T @ pull
        at = np.r_[0 : 2 * len(self.asked)]
        shared[6 + at] += np.tile(1 / _CAMERA_SIGMA**2, len(self.asked)) * state[at]
        if self.nuisance.time is not None:
            shared[-1] += variance / TIME_SIGMA_S**2 * state[self.shared - 1]
        of_motions = np.asarray(self._members @ (own * pull[:, None]))
        if self.nuisance.prior is None:
            return shared, of_motions.reshape(0, 2)
        (a, share), motion = self._common, self.nuisance.prior.expected
        away = state[self.shared :].reshape(-1, 2) - [motion.speed_m_s, motion.turn_rad_s]
        alone = self.weights[:, None] / self.nuisance.prior.own_variance * away
        weighted = (self._root[:, None] * away).ravel() @ (a / np.repeat(self._root, 2))
        return np.append(shared, 0.0), of_motions + variance * (alone - share * weighted * a.reshape(-1, 2))

    def prior_scores(self, variance: float) -> tuple[Float, Any]:
        """Return right sides whose squares make the covariance of the gradient by the priors of motions and time.

        Expected motions and times are not the true ones.
        """
        count = 6 + self.shared
        if self.nuisance.prior is None:
            shared = np.zeros((1, count))
            if self.nuisance.time is not None:
                shared[0, -1] = variance / TIME_SIGMA_S
            return shared, sparse.csr_array((1, 0))
        (a, _), own = self._common, np.tile(self.nuisance.prior.own_variance, len(self.motions))
        size, common = len(own), np.sqrt(self.nuisance.prior.common_variance)
        shared = np.zeros((size + 2, count + 1))
        shared[:size, -1] = np.sqrt(own) * a
        shared[size, -1] = common * a.sum()
        if self.nuisance.time is not None:
            shared[size + 1, count - 1] = variance / TIME_SIGMA_S
        alone = variance * np.repeat(self.weights, 2) / np.sqrt(own)
        together = variance * common * np.where(np.arange(size) % 2, 0.0, np.repeat(self.weights, 2) / own)
        return shared, sparse.csr_array(
            sparse.vstack([sparse.diags(alone), sparse.csr_array(np.stack([together, np.zeros(size)]))])
        )

    def scores(self, rows: Float, own: Float, residuals: Float, group: Int) -> tuple[Float, Any]:
        """Return the gradient of the robust sum by group of pairs (G, 6 + S) and, sparse, (G, 2 F); `group` (K,)."""
        psi = self.problem.weight * np.clip(residuals, -self.problem.huber_px, self.problem.huber_px)
        count, groups = len(self.problem), int(group.max()) + 1
        members = sparse.csr_array((psi, (group, np.arange(count))), shape=(groups, count))
        shared = np.asarray(members @ rows)
        if self.nuisance.prior is None:
            return shared, sparse.csr_array((groups, 0))
        columns = 2 * self.problem.frame[:, None] + np.array([0, 1])
        at = (own.ravel(), columns.ravel(), np.arange(0, 2 * count + 1, 2))
        spread = sparse.csr_array(at, shape=(count, self.motions.size))
        return np.column_stack([shared, np.zeros(groups)]), members @ spread

    def within(self, state: Float) -> Float:
        """Return the state (N,) with errors of cameras and the offset in time kept within bounds."""
        count, out = 2 * len(self.asked), np.array(state)
        out[:count] = np.clip(out[:count], -0.5 * LARGEST, 0.5 * LARGEST)
        if self.nuisance.time is not None:
            out[self.shared - 1] = np.clip(out[self.shared - 1], -_MAX_OFFSET_S, _MAX_OFFSET_S)
        return out

    def time_fit(self, state: Float, variance: float) -> TimeOffset | None:
        """Read the time offset from the state (N,), with its variance."""
        if self.nuisance.time is None:
            return None
        return TimeOffset(float(state[self.shared - 1]), float(np.sqrt(variance)), used=True)

    def camera_fits(self, state: Float, covariance: Float) -> tuple[RadialFit, ...]:
        """Read the corrections of the cameras from the state (N,); `covariance` is that of pose and state."""
        places = [(camera, 2 * i, 6 + 2 * i) for i, camera in enumerate(self.asked)]
        return tuple(
            RadialFit(camera, self._error(camera, state[at : at + 2]), covariance[row : row + 2, row : row + 2])
            for camera, at, row in places
        )

    def _error(self, camera: Camera, values: Float) -> RadialError:
        """Return the error of a camera with values (2,) of focal and radial; its principal point is not fitted."""
        return replace(self.nuisance.error_of(camera), focal=float(values[0]), radial=float(values[1]))

    def motion_fits(self, state: Float, covariances: Float) -> tuple[MotionFit, ...]:
        """Read the motions from the state (N,); `covariances` (F, 2, 2) are theirs."""
        prior, motions = self.nuisance.prior, state[self.shared :].reshape(-1, 2)
        if prior is None:
            return ()
        return tuple(
            MotionFit(replace(prior.expected, speed_m_s=float(speed), turn_rad_s=float(turn)), covariance)
            for (speed, turn), covariance in zip(motions, covariances, strict=True)
        )


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


def _clustered(model: _Model, rows: Float, own: Float, residuals: Float) -> tuple[tuple[Float, Any], int]:
    """Return the gradients of clusters, with pairs of one scene, side and cell as one, and their number."""
    problem, scenes = model.problem, model.nuisance.scenes
    cell = np.floor(problem.centre / OUTLINE_CELL_PX).astype(np.int64)
    scene = problem.frame if scenes is None else scenes[problem.frame]
    key = np.column_stack([scene, problem.side, cell])
    key -= key.min(axis=0)
    _, place = np.unique(np.ravel_multi_index(key.T, key.max(axis=0) + 1), return_inverse=True)
    return model.scores(rows, own, residuals, place), int(place.max()) + 1


def _by_frame(model: _Model, system: BlockSystem, rows: Float, own: Float, residuals: Float, weight: Float) -> float:
    """Return the variance of the time offset if all pairs of a frame have a common error, as of its pose.

    CR3 for few frames (Cameron and Miller, 2015): each frame's gradient, solved without the frame.
    """
    problem, at = model.problem, 5 + model.shared
    frames, group = np.unique(problem.frame, return_inverse=True)
    shared, of_motions = model.scores(rows, own, residuals, group.reshape(-1))
    of_motions, total = of_motions.toarray().reshape(len(frames), -1, 2), 0.0
    for number, frame in enumerate(frames):
        mine = group.reshape(-1) == number
        heavy = rows[mine] * weight[mine, None]
        by_frame = np.zeros_like(system.shared)
        by_frame[: rows.shape[1], : rows.shape[1]] = heavy.T @ rows[mine]
        mixed = np.zeros((len(system.shared), 2))
        mixed[: rows.shape[1]] = heavy.T @ own[mine]
        alone = system.without(int(frame), by_frame, mixed, (own[mine] * weight[mine, None]).T @ own[mine])
        total += float(alone.solve(shared[number], of_motions[number])[0][at]) ** 2
    return total * (1 - 1 / len(frames))
