"""Calibrate by hand-eye motion: `--calibrator hand-eye --joint` and `--init hand-eye --joint`; no initial guess needed.

After Ishikawa, Oishi, Ikeuchi, LiDAR and Camera Calibration using Motions Estimated by Sensor Fusion Odometry, IROS
2018.

1. Motion of the LiDAR by small_gicp or KISS-ICP, or the poses of the frames. Motion of the camera up to scale by
   tracked corners and essential matrices (`visual_odometry`).
2. The initial extrinsic in closed form, then by least squares (`hand_eye_equations`); each camera step has its own
   scale.
3. Sensor fusion odometry: LiDAR points, projected by the extrinsic, are tracked in later images and determine the
   motion of the camera in metres (`lidar_tracks`); then the least squares again. Both are repeated until convergence.
4. Ours: all corners, with depth from the sweeps, in one least squares (`corner_depths`).
5. The rotations of camera and LiDAR over time determine the delay between them (`sensor_delay`). It is reported, not
   corrected.

Directions of the extrinsic that the motion does not make observable are reported: on flat ground, the height. Only
these keep the value of the initial extrinsic, unless `fill` is false.

Departures: the text of the paper was not at hand. Directions of motion determine the rotation in addition to rotation
axes, so that a drive on flat ground gives an initial rotation; the selection of points, the covariance and weight of
each step, the robust loss, steps over several frames, the test for unobservable directions, filling them, and the delay
are ours.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from itertools import chain
from typing import ClassVar

import numpy as np
import p2o
from p2o import Float, Result, Status
from p2o.solving import Doubt, Reason, TimeOffset, Verdict

from p2o_baselines import examples
from p2o_baselines.motion import moments
from p2o_baselines.motion.corner_depths import Followed, refined
from p2o_baselines.motion.hand_eye_equations import HandEye, OpenDirection, Steps, first_guess, solved
from p2o_baselines.motion.lidar_tracks import MetricStep, metric_step, trackable
from p2o_baselines.motion.moments import Moment, MotionCalibration, MotionOptions, RefusedError, Run
from p2o_baselines.motion.sensor_delay import Delay, Drive, delay_of
from p2o_baselines.motion.visual_odometry import CameraStep, camera_step, follow_on, followed
from p2o_baselines.start_by_calibrator import StartByCalibrator

_TURN_RAD = np.radians(0.05)
"""Deviation of a camera's turn by corners alone, an axis: it only weighs turns against directions of motion."""
_LIDAR_RAD, _LIDAR_M = np.radians(0.01), 0.003  # deviations of a LiDAR's step from frame to frame, an axis
_OFF_PX = 1.6
"""Corner residuals are 0.8 to 1.3 px if both motions fit, 2.0 px with the car's poses of KITTI (few cases)."""
_DRIFT_DEG, _DRIFT_M = 0.03, 0.012  # A larger error common to all steps of LiDAR odometry is reported
_ENOUGH = 200  # corners that a first motion rests on
_CORNERS = 1000  # largest number of corners tracked per image
_POINTS = 600  # largest number of LiDAR points tracked per sweep
_LEAST_STEPS = 3  # least number of steps from frame to frame
_TOLERANCE_DEG = 0.005  # stop if an iteration changes the rotation by less
_TOLERANCE_M = 0.002  # stop if an iteration changes the translation by less
_SPAN = 4  # largest number of frames over which motions are compared


class HandEyeOptions(MotionOptions):
    """Options of `hand-eye`."""

    rounds: int = p2o.field(2, ge=0, le=100, help="Largest number of iterations of odometry with LiDAR points.")
    joint: bool = p2o.field(True, help="Finish with one least squares over all corners with depth (not in the paper).")
    fill: bool = p2o.field(True, help="Keep unobservable directions of the initial extrinsic; else refuse.")
    longest_s: float = p2o.field(0.1, gt=0, le=10, help="Largest absolute delay of the camera that is evaluated.")


@dataclass(frozen=True, eq=False)
class Motions:
    """Steps, rotations (3, 3) of the camera between frames by run, number of tracked points, and their residual."""

    steps: Steps
    single: tuple[tuple[Float | None, ...], ...]
    points: int
    off_px: float


@dataclass(frozen=True)
class HandEyeCalibration(MotionCalibration):
    """The calibrator."""

    options: HandEyeOptions
    part: ClassVar[str] = "motion"

    def _solved(self, result: Result, prepared: Sequence[Moment], matches: dict[str, int]) -> Result:
        """Return the extrinsic from the motion of all frames; only unobservable directions keep the initial value."""
        options, start = self.options, result.start
        groups = moments.consecutive(prepared, options.gap_s)
        count = matches["steps"] = sum(len(group) - 1 for group in groups)
        runs = moments.runs_of(groups, len(prepared), options, least_steps=_LEAST_STEPS, span=_SPAN)
        tracks = [corner_tracks(run) for run in runs]
        motions = corner_motions(runs, tracks)
        matches["spans"] = len(motions.steps)
        if len(motions.steps) < _LEAST_STEPS:
            reason = f"the motion of the camera is known in {len(motions.steps)} of {count} steps"
            raise RefusedError(Status.TOO_FEW_MATCHES, reason)
        hand_eye, motions, status = self._iterated(runs, motions, start)
        off_px, drift = motions.off_px, np.zeros(6)
        if options.joint:
            filled = hand_eye.filled(start, self._openings(hand_eye))
            joint = refined(list(chain.from_iterable(tracks)), filled.camera_from_lidar)
            if joint is None:
                raise RefusedError(Status.TOO_FEW_MATCHES, "too few corners of the images have a depth from the sweeps")
            hand_eye = replace(hand_eye, camera_from_lidar=joint.camera_from_lidar, covariance=joint.covariance)
            matches["corners"], off_px, drift = joint.corners, joint.off_px, joint.drift
            status = Status.CONVERGED if joint.settled else Status.ROUNDS_SPENT
        openings = self._openings(hand_eye)
        matches |= {"spans": len(motions.steps), "points": motions.points}
        summary, listed = _summary(runs, hand_eye), ", and ".join(map(str, openings))
        if openings and not options.fill:
            raise RefusedError(Status.NOT_OBSERVABLE, f"not observable from motion: {listed}; {summary}")
        kept = (f"not observable from motion, kept from the initial guess: {listed}",) if openings else ()
        warnings = (*kept, *_contradictions(off_px if options.joint else 0.0, drift))
        filled = hand_eye.filled(start, openings)
        delay = delay_between(runs, motions, filled.camera_from_lidar, options.longest_s)
        return replace(
            result,
            camera_from_lidar=filled.camera_from_lidar,
            status=status,
            reason=summary,
            covariance=hand_eye.covariance,
            accuracy=None if openings else moments.accuracy(hand_eye.covariance),
            # No measurement supports a direction that is kept from the start, even if edges agree there.
            verdict=Verdict(tuple(Reason(Doubt.TOO_UNSURE, text) for text in kept)),
            residual_px={"tracks": off_px},
            time=None if delay is None else TimeOffset(delay.delay_s, delay.sigma_s, used=False),
            warnings=warnings,
        )

    def _openings(self, hand_eye: HandEye) -> tuple[OpenDirection, ...]:
        return hand_eye.open_directions(over_deg=moments.OPEN_DEG, over_m=moments.OPEN_M)

    def _iterated(self, runs: Sequence[Run], motions: Motions, start: Float) -> tuple[HandEye, Motions, Status]:
        """Return the extrinsic by both kinds of odometry, the last motions, and whether it converged."""
        options = self.options
        count = sum(len(run.moments) - 1 for run in runs)
        first, _ = first_guess(motions.steps)
        hand_eye = solved(motions.steps, first, overlap=len(motions.steps) / count)
        # Directions that are unobservable without scales keep the closed form until LiDAR points determine them.
        pose = hand_eye.filled(first, self._openings(hand_eye)).camera_from_lidar
        for _ in range(options.rounds):
            metric = point_motions(runs, pose)
            if len(metric.steps) < _LEAST_STEPS:
                return hand_eye, motions, Status.ROUNDS_SPENT
            motions = metric
            hand_eye = solved(motions.steps, pose, overlap=len(motions.steps) / count)
            initial = start if options.fill else first
            last, pose = pose, hand_eye.filled(initial, self._openings(hand_eye)).camera_from_lidar
            change = pose @ p2o.se3.inverse(last)
            if p2o.se3.angle_deg(change) < _TOLERANCE_DEG and p2o.se3.distance_m(change) < _TOLERANCE_M:
                return hand_eye, motions, Status.CONVERGED
        return hand_eye, motions, Status.ROUNDS_SPENT if options.rounds else Status.CONVERGED


def corner_tracks(run: Run) -> list[Followed]:
    """Return the corners of each image of a run except the last, and their tracks in later images."""
    tracks = []
    for first, later in run.spans(_SPAN):
        here, later_moments = run.moments[first], [run.moments[number] for number in later]
        corners, _ = followed(here.grey, later_moments[0].grey, most=_CORNERS, masked=here.masked)
        places = follow_on([here.grey, *(moment.grey for moment in later_moments)], corners)
        rays = np.array([_rays(moment.camera, uv) for moment, uv in zip(later_moments, places, strict=True)])
        lidar = np.array([run.lidar_step(first, second) for second in later])
        tracks.append(Followed(here.camera, here.xyz, corners, here.camera.rays(corners), rays, lidar))
    return tracks


def corner_motions(runs: Sequence[Run], tracks: Sequence[Sequence[Followed]]) -> Motions:
    """Return steps to the next and to the farthest frame with the camera's motion by corners alone, up to scale."""
    motions = _Sums()
    for run, each in zip(runs, tracks, strict=True):
        motions.single.append([])
        for (first, later), track in zip(run.spans(_SPAN), each, strict=True):
            motions.single[-1].append(None)
            for second in sorted({later[0], later[-1]}):
                rays = track.later[second - first - 1]
                kept = np.flatnonzero(np.isfinite(rays).all(axis=1))
                kept = kept[:: max(len(kept) // _ENOUGH, 1)]
                step = camera_step(track.rays[kept], rays[kept], run.moments[second].camera.focal_px)
                if step is None:
                    continue
                # Without parallax the direction of motion means nothing.
                sigma_rad = float(np.clip(1.0 / max(step.parallax_px, 1e-3), 0.005, 1.0))
                covariance = np.diag(np.repeat([_TURN_RAD**2, sigma_rad**2], 3))
                motions.add(run, first, second, step, covariance, step.corners)
    return motions.total(metric=False)


def point_motions(runs: Sequence[Run], camera_from_lidar: Float) -> Motions:
    """Return all steps with the camera's motion in metres, by LiDAR points followed in its images at a pose."""
    motions = _Sums()
    for run in runs:
        motions.single.append([])
        for first, later in run.spans(_SPAN):
            motions.single[-1].append(None)
            for second, step in fused_steps(run, first, later, camera_from_lidar):
                motions.add(run, first, second, step, step.covariance, step.points)
    return motions.total(metric=True)


@dataclass(eq=False)
class _Sums:
    """The rows and sums of motions, run by run."""

    rows: list[tuple[Float, Float, Float, int]] = field(default_factory=list)
    single: list[list[Float | None]] = field(default_factory=list)
    points: int = 0
    squares: float = 0.0

    def add(
        self, run: Run, first: int, second: int, step: CameraStep | MetricStep, covariance: Float, points: int
    ) -> None:
        """Add a step of the camera, from `points` corners or points, with that of the LiDAR."""
        if second == first + 1:
            self.single[-1][-1] = step.second_from_first[:3, :3]
        self.rows.append((step.second_from_first, run.lidar_step(first, second), covariance, second - first))
        self.points += points
        self.squares += points * step.off_px**2

    def total(self, *, metric: bool) -> Motions:
        """Return the motions; errors of odometry add up over a step."""
        camera, lidar, covariance = (
            np.array([row[k] for row in self.rows]).reshape(-1, size, size) for k, size in ((0, 4), (1, 4), (2, 6))
        )
        longer = np.sqrt([row[3] for row in self.rows])
        whole = np.full(len(self.rows), metric)
        steps = Steps(camera, lidar, whole, covariance, _LIDAR_RAD * longer, _LIDAR_M * longer)
        off_px = float(np.sqrt(self.squares / max(self.points, 1)))
        return Motions(steps, tuple(map(tuple, self.single)), self.points, off_px)


def fused_steps(
    run: Run, first: int, later: Sequence[int], camera_from_lidar: Float
) -> Iterator[tuple[int, MetricStep]]:
    """Return the camera's motion from frame `first` of a run to later ones, as far as its points can be followed."""
    here = run.moments[first]
    uv, xyz = trackable(here.grey, here.camera, here.masked, here.xyz, camera_from_lidar, most=_POINTS)
    images = [run.moments[number].grey for number in (first, *later)]
    for second, positions in zip(later, follow_on(images, uv), strict=True):
        camera = run.moments[second].camera
        guess = camera_from_lidar @ run.lidar_step(first, second) @ p2o.se3.inverse(camera_from_lidar)
        step = metric_step(xyz, _rays(camera, positions), camera.focal_px, guess)
        if step is None:
            return
        yield second, step


def delay_between(runs: Sequence[Run], motions: Motions, camera_from_lidar: Float, longest_s: float) -> Delay | None:
    """Return the delay of the camera relative to its sweeps; None if its rotations do not determine it."""
    drives = [
        Drive.of(np.array([m.time_s for m in run.moments]), turns, run.world_from_lidar, span_s=0.5)
        for run, turns in zip(runs, motions.single, strict=True)
        if any(turn is not None for turn in turns)
    ]
    delay = delay_of(drives, camera_from_lidar, longest_s=longest_s) if drives else None
    return delay if delay is not None and delay.inside and np.isfinite(delay.sigma_s) else None


def _rays(camera: p2o.Camera, uv: Float) -> Float:
    """Return the rays (N, 3) of places (N, 2), NaN for those that are lost."""
    rays = np.full((len(uv), 3), np.nan)
    known = np.isfinite(uv).all(axis=1)
    rays[known] = camera.rays(uv[known])
    return rays


def _summary(runs: Sequence[Run], hand_eye: HandEye) -> str:
    path_m, turn_deg = moments.path_of(runs)
    agree = f"agree to {hand_eye.off_deg:.3f} deg and {100 * hand_eye.off_m:.1f} cm per step"
    return f"the motions of both sensors over {path_m:.1f} m and {turn_deg:.0f} deg of rotation {agree}"


def _contradictions(off_px: float, drift: Float) -> Iterator[str]:
    """Return warnings about a motion of the LiDAR that the images contradict; `drift` (6,) in rad and m per step."""
    if off_px > _OFF_PX:
        yield f"corners are off by {off_px:.1f} px: the motion of the LiDAR contradicts that of the images"
    drift_deg, drift_m = np.degrees(np.linalg.norm(drift[:3])), np.linalg.norm(drift[3:])
    if drift_deg > _DRIFT_DEG or drift_m > _DRIFT_M:
        wrong = f"{drift_deg:.3f} deg and {100 * drift_m:.1f} cm"
        yield f"the LiDAR's motion seems wrong by {wrong} in every step: predicted errors are larger for it"


def build(options: HandEyeOptions) -> p2o.Calibrator:
    """Return the calibrator. Raises ModuleNotFoundError if the package of the odometry is missing."""
    moments.require_odometry(options.lidar)
    return HandEyeCalibration(options)


def build_start(options: HandEyeOptions) -> p2o.Initializer:
    """Return the initializer. Raises ModuleNotFoundError if the package of the odometry is missing."""
    moments.require_odometry(options.lidar)
    hint = "--joint with frames of one drive, or --init search"
    return StartByCalibrator(HandEyeCalibration(options), "motion", hint)


METHOD = p2o.Method(
    name="hand-eye",
    build=build,
    options=HandEyeOptions,
    summary="Hand-eye calibration on a drive, without an initial guess; reports unobservable directions.",
    needs={"sequence", "frame-time"},
    cite="Ishikawa, Oishi, Ikeuchi, LiDAR and Camera Calibration using Motions Estimated by Sensor Fusion Odometry, "
    "IROS 2018",
    extra="gicp",
    example=p2o.Example(examples.DRIVE, perturb="10deg 0.5m", joint=True),
)
START = replace(
    METHOD,
    build=build_start,
    summary="Initialises by hand-eye calibration on a drive (--joint).",
    expected_failures=(("starts_without_edges_are_no_crash", "a single view has no motion, which is reported"),),
)
