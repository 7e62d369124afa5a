"""Estimate a pose from picked pairs: RANSAC on three points, least squares on angles, and residuals of each pick."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from p2o.arrays import Bool, Float, Int
from p2o.errors import InputError
from p2o.geometry.camera import Camera
from p2o.geometry.pose_error import deviations
from p2o.problems.normal_equations import linearise, normal_equations, why_singular
from p2o.problems.picked_pairs import PickedPairs
from p2o.problems.points_on_rays import MIN_POINTS, PointsOnRays, consensus, leave_one_out, px_per_rad, shape, spread
from p2o.results.evidence import Accuracy
from p2o.results.result import Status

_LINE, _PLANE = 0.02, 0.01
"""Points on a line, or in a plane: their size across it is less than this share of their largest."""
_MAX_CONDITION = 1e5  # as the solvers'
_SIGMAS = 3.0  # an alternative pose within this many standard deviations is not rejected
_CLICK_PX = 1.0  # minimum standard deviation of a manual click


@dataclass(frozen=True, eq=False)
class PickedFrame:
    """The pairs of one frame and its camera."""

    name: str
    camera: Camera
    pairs: PickedPairs


@dataclass(frozen=True, eq=False)
class PickedPose:
    """Result of picks. `camera_from_lidar` (4, 4) is None unless `status.solved`; `reason` is one sentence.

    For every pick, frame by frame: `frame_of` (N,) the number of its frame, `off_px` (N,) how far it is from its place,
    `left_out_px` (N,) how far where it had no say in the pose (of those that agree), `agrees` (N,) whether it was used.
    `covariance` (6, 6) is the leave-one-out spread of a left update in rad and m. `rival` is another pose that fits
    about as well, if there is one, with its root mean square in px.
    """

    status: Status
    reason: str
    frames: tuple[str, ...]
    camera_from_lidar: Float | None
    off_px: Float
    left_out_px: Float
    agrees: Bool
    frame_of: Int
    covariance: Float | None = None
    accuracy: Accuracy | None = None
    rival: tuple[Float, float] | None = None

    @property
    def rms_px(self) -> float:
        """Root mean square of the picks that agree; NaN without any."""
        used = self.off_px[self.agrees]
        return float(np.sqrt((used**2).mean())) if len(used) else float("nan")


def solve_picks(
    frames: Sequence[PickedFrame], *, reach_px: float = 10.0, trials: int = 500, seed: int = 0, spread_too: bool = True
) -> PickedPose:
    """Estimate one pose from the picks of several frames jointly.

    `reach_px` is how far a pick may be off and still have a say; `trials` how many triples are tried. Without
    `spread_too` the leave-one-out poses, most of the time that it takes, are left out. Raises InputError for a pixel
    outside of its image, or where its camera sees nothing.
    """
    problem = _problem(frames)
    names, count = tuple(frame.name for frame in frames), len(problem.xyz)
    frame_of = problem.frame[::2]
    unknown, unused = np.full(count, np.nan), np.zeros(count, np.bool_)

    def refused(status: Status, reason: str, off_px: Float = unknown, agrees: Bool = unused) -> PickedPose:
        return PickedPose(status, reason, names, None, off_px, unknown, agrees, frame_of)

    if count < MIN_POINTS:
        return refused(Status.TOO_FEW_MATCHES, f"{count} pick{'s' * (count != 1)}, at least {MIN_POINTS} are needed")
    flat = _flat(problem.xyz)
    if flat:
        return refused(Status.NOT_OBSERVABLE, f"the picked points lie {flat}")
    best = consensus(problem, reach_px, np.random.default_rng(seed), trials)
    if best is None:
        return refused(Status.NOT_OBSERVABLE, "no three picks give a pose")
    off, agree = problem.off_px(best.camera_from_lidar), best.agree
    needed = max(MIN_POINTS, count // 2 + 1)
    if agree.sum() < needed:
        text = f"{int(agree.sum())} of {count} picks agree on a pose within {reach_px:g} px, {needed} are needed"
        return refused(Status.TOO_FEW_MATCHES, text, off)
    used = problem.select(agree)
    flat = _flat(used.xyz)
    if flat:
        return refused(Status.NOT_OBSERVABLE, f"the picks that agree lie {flat}", off, agree)
    residuals, jacobian = linearise(used, best.camera_from_lidar)
    hessian, _ = normal_equations(used, residuals, jacobian)
    why = why_singular(used, best.camera_from_lidar, residuals, hessian, _MAX_CONDITION)
    if why:
        return refused(Status.NOT_OBSERVABLE, why, off, agree)
    pose, freedom = best.camera_from_lidar, 2 * len(used.xyz) - 6
    sigma = max(float(np.sqrt(residuals @ residuals / freedom)), _CLICK_PX)
    near = [(other, cost) for other, cost in best.rivals if cost - best.cost < (_SIGMAS * sigma) ** 2]
    rival = (near[0][0], float(np.sqrt(near[0][1] / count))) if near else None
    covariance, accuracy, left_out = None, None, unknown.copy()
    if spread_too:
        others = leave_one_out(used, pose)
        left_out[agree] = used.off_px(others).diagonal()
        covariance = spread(others, pose)
        accuracy = _accuracy(covariance, pose, freedom)
    rms = float(np.sqrt((off[agree] ** 2).mean()))
    reason = f"{int(agree.sum())} of {count} picks agree, {rms:.2f} px off (root mean square)"
    return PickedPose(
        Status.CONVERGED, reason, names, pose, off, left_out, agree, frame_of, covariance, accuracy, rival
    )


def picks_off_px(frames: Sequence[PickedFrame], camera_from_lidar: Float) -> Float:
    """Return the residual of each pick (N,) in px at a pose (4, 4), frame by frame; raises as `solve_picks`."""
    return _problem(frames).off_px(camera_from_lidar)


def _problem(frames: Sequence[PickedFrame]) -> PointsOnRays:
    rays, scales = [], []
    for frame in frames:
        uv = frame.pairs.uv
        outside = np.flatnonzero(~frame.camera.in_image(uv))
        if len(outside):
            u, v = uv[outside[0]]
            text = f"pick {outside[0] + 1} lies outside of the image"
            expected = f"0 to {frame.camera.width - 1}, 0 to {frame.camera.height - 1}"
            hint = "pixels are those of the image that p2o reads: are the pairs of another camera?"
            raise InputError(text, where=frame.name, expected=expected, got=f"{u:g}, {v:g}", hint=hint)
        own_rays = frame.camera.rays(uv)
        unseen = np.flatnonzero(np.isnan(own_rays).any(axis=1))
        if len(unseen):
            message = f"the camera sees nothing at pick {unseen[0] + 1}"
            raise InputError(message, where=frame.name, got=uv[unseen[0]].tolist())
        rays.append(own_rays)
        scales.append(px_per_rad(frame.camera, uv))
    number = np.repeat(np.arange(len(frames)), [len(frame.pairs) for frame in frames])
    if not frames:
        return PointsOnRays(np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0))
    xyz = np.concatenate([frame.pairs.xyz for frame in frames])
    return PointsOnRays(xyz, np.concatenate(rays), np.concatenate(scales), frame=number)


def _flat(xyz: Float) -> str:
    """Return in words that points (N, 3) lie on a line or in a plane, or "" where they do not."""
    longest, second, third = shape(xyz)
    if longest < 1e-6:
        return "in one place: pick others"
    if second < _LINE * longest:
        return "on a line, around which the pose can turn: pick others beside it"
    if third < _PLANE * longest:
        return "in a plane, which two poses may show in the same way: pick others before or behind it"
    return ""


def _accuracy(covariance: Float, camera_from_lidar: Float, freedom: int) -> Accuracy | None:
    """Predict the accuracy of a pose from its covariance with `freedom` degrees of freedom (Student's t)."""
    from scipy.stats import t

    if not np.isfinite(covariance).all():
        return None
    usual, rare = (float(t.ppf(0.5 + share / 2, freedom)) for share in (2 / 3, 0.95))
    rotation_deg, translation_m = deviations(covariance, camera_from_lidar)
    return Accuracy(usual * rotation_deg, usual * translation_m, rare * rotation_deg, rare * translation_m)
