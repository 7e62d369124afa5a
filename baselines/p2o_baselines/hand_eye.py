"""Hand-eye calibration of a drive: `--calibrator hand-eye --joint`, and `--init hand-eye --joint`. No start is needed.

After Ishikawa, Oishi, Ikeuchi, LiDAR and Camera Calibration using Motions Estimated by Sensor Fusion Odometry, IROS
2018.

1. Motion of the LiDAR: its sweeps aligned by small_gicp or KISS-ICP, or the poses that the frames hold. Motion of the
   camera up to scale: corners followed from picture to picture, essential matrices (`visual_odometry`).
2. The first extrinsic in closed form, then by least squares (`hand_eye_equations`); each camera step has a scale of its
   own.
3. Sensor fusion odometry: points of the sweeps, projected by the extrinsic, are followed in later pictures and tell the
   camera's motion in metres (`lidar_tracks`); then the least squares again. Both are repeated until nothing changes.
4. Ours: all corners, with the depth that the sweeps give them, in one least squares (`corner_depths`).
5. How camera and LiDAR turn over time tells the delay between them (`sensor_delay`). It is told, not corrected.

What the motion leaves open is told with the result: a car on flat ground leaves the height open. Such a direction, and
nothing else, is taken from the start, unless `fill` says otherwise.

Departures: the text of the paper was not at hand. Directions of motion tell rotation besides axes of turns, so that a
drive on flat ground gives a first rotation at all; which points are followed, the covariance of each step and how it
weighs, the damping of wrong ones, steps over several frames, the test for open directions, filling them, and the delay
are ours.
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import chain
from typing import Literal

import numpy as np
import p2o
from p2o import Result, Status
from p2o.arrays import Float

from p2o_baselines.corner_depths import Followed, refined
from p2o_baselines.hand_eye_equations import HandEye, OpenDirection, Steps, first_guess, solved
from p2o_baselines.lidar_tracks import MetricStep, metric_step, trackable
from p2o_baselines.moments import Moment, Run, accuracy, consecutive, lidar_poses, moment_of, moves
from p2o_baselines.sensor_delay import Delay, Drive, delay_of
from p2o_baselines.visual_odometry import camera_step, follow_on, followed

_TURN_RAD = np.radians(0.05)
"""Deviation of a camera's turn by corners alone, an axis: it only weighs turns against directions of motion."""
_LIDAR_RAD, _LIDAR_M = np.radians(0.01), 0.003
"""Deviations of a LiDAR's step from frame to frame, an axis."""
_OFF_PX = 1.6
"""Corners are off by 0.8 to 1.3 px where both motions fit, by 2.0 with poses of KITTI's car: few cases."""
_DRIFT_DEG, _DRIFT_M = 0.03, 0.012
"""LiDAR odometry that seems wrong by more in every step alike is told."""
_ENOUGH = 200
"""Corners that a first motion rests on."""


class HandEyeOptions(p2o.Options):
    """Options of `hand-eye`."""

    lidar: Literal["gicp", "kiss-icp", "given"] = p2o.field(
        "gicp", help="Motion of the LiDAR: by small_gicp, by KISS-ICP, or the poses that the frames hold."
    )
    gap_s: float = p2o.field(0.6, gt=0, le=60, help="Frames farther apart in time are not consecutive.")
    span: int = p2o.field(4, ge=1, le=50, help="Motions over up to so many frames are compared.")
    least_steps: int = p2o.field(3, ge=2, le=1000, help="Fewer steps from frame to frame are too few.")
    corners: int = p2o.field(1000, ge=50, le=100_000, help="Corners of a picture that are followed, at most.")
    points: int = p2o.field(600, ge=50, le=100_000, help="LiDAR points of a sweep that are followed, at most.")
    rounds: int = p2o.field(2, ge=0, le=100, help="Turns of odometry with LiDAR points, at most; 0 for none.")
    tolerance_deg: float = p2o.field(0.005, gt=0, le=5, help="A turn that changes the rotation less is the last.")
    tolerance_m: float = p2o.field(0.002, gt=0, le=1, help="The same for the translation.")
    joint: bool = p2o.field(
        True, help="At last, one least squares over all corners with the sweeps' depth; false for the paper's end."
    )
    open_deg: float = p2o.field(2.0, gt=0, le=90, help="A rotation known no better than this is open.")
    open_m: float = p2o.field(0.25, gt=0, le=10, help="A place known no better than this along a direction is open.")
    fill: bool = p2o.field(True, help="Take what the motion leaves open from the start; else refuse.")
    longest_s: float = p2o.field(0.1, gt=0, le=10, help="Longest delay of the camera that is tried, to either side.")


@dataclass(frozen=True, eq=False)
class Motions:
    """Steps of both sensors, with what the camera's rest on.

    `single` are the camera's turns (3, 3) from each frame to the next, by run, None where they are not known; `points`
    is how many corners or points were followed, and `off_px` how far, root mean square, they are off.
    """

    steps: Steps
    single: tuple[tuple[Float | None, ...], ...]
    points: int
    off_px: float


@dataclass(frozen=True)
class HandEyeCalibration:
    """The whole method."""

    options: HandEyeOptions

    def prepare(self, frame: p2o.Frame) -> Moment:
        """Return what is needed of a frame. Raises InputError where it is of no drive, or lacks a pose asked for.

        The sweep is taken as at the time of the picture where the velocity is known.
        """
        if self.options.lidar == "given" and frame.lidar_world_from_lidar is None:
            raise p2o.InputError(
                "the frame holds no pose of the LiDAR", where=frame.name, hint="leave out calibrator.lidar=given"
            )
        return moment_of(frame)

    def solve(self, prepared: Sequence[Moment], camera_from_lidar: Float) -> Result:
        """Return the extrinsic that the motion of all frames tells; of the start, what it leaves open."""
        began = time.perf_counter()
        options, start = self.options, np.asarray(camera_from_lidar, np.float64)
        names = tuple(moment.name for moment in prepared)
        groups = consecutive(prepared, options.gap_s)
        count = sum(len(group) - 1 for group in groups)
        if count < options.least_steps:
            reason = (
                f"{count} steps between consecutive frames, of {len(names)} frames; {options.least_steps} are needed: "
                f"frames of one drive, at most {options.gap_s:g} s apart, calibrated jointly"
            )
            return Result(names, start, start, Status.TOO_FEW_MATCHES, reason, matches={"steps": count})
        try:
            runs = [Run(tuple(group), lidar_poses(group, options.lidar)) for group in groups]
        except p2o.InputError as error:
            reason = f"the motion of the LiDAR is not known: {error}"
            return Result(names, start, start, Status.TOO_FEW_MATCHES, reason, matches={"steps": count})
        if not any(moves(run, options.span) for run in runs):
            return Result(
                names, start, start, Status.NOT_OBSERVABLE, "the LiDAR stands still: motion is all that hand-eye has"
            )
        tracks = [corner_tracks(run, options) for run in runs]
        motions = corner_motions(runs, tracks, options)
        matches = {"steps": count, "spans": len(motions.steps)}
        if len(motions.steps) < options.least_steps:
            reason = f"the camera's motion is known in {len(motions.steps)} of {count} steps: its pictures hardly tell"
            return Result(names, start, start, Status.TOO_FEW_MATCHES, reason, matches=matches)
        found, motions, status = self._found(runs, motions, start)
        off_px, drift = motions.off_px, np.zeros(6)
        if options.joint:
            openings = found.open_directions(over_deg=options.open_deg, over_m=options.open_m)
            joint = refined(list(chain.from_iterable(tracks)), found.filled(start, openings).camera_from_lidar)
            if joint is None:
                reason = "the sweeps give too few corners of the pictures a depth"
                return Result(names, start, start, Status.TOO_FEW_MATCHES, reason, matches=matches)
            found = replace(found, camera_from_lidar=joint.camera_from_lidar, covariance=joint.covariance)
            matches["corners"], off_px, drift = joint.corners, joint.off_px, joint.drift
            status = Status.CONVERGED if joint.settled else Status.ROUNDS_SPENT
        openings = found.open_directions(over_deg=options.open_deg, over_m=options.open_m)
        matches |= {"spans": len(motions.steps), "points": motions.points}
        said = _said(runs, found)
        if openings and not options.fill:
            reason = f"the motion does not tell {_listed(openings)}; {said}"
            return Result(names, start, start, Status.NOT_OBSERVABLE, reason, matches=matches)
        off: tuple[str, ...] = ()
        if options.joint and off_px > _OFF_PX:
            off = (f"corners are off by {off_px:.1f} px: the LiDAR's motion contradicts that of the pictures",)
        if np.degrees(np.linalg.norm(drift[:3])) > _DRIFT_DEG or np.linalg.norm(drift[3:]) > _DRIFT_M:
            wrong = f"{np.degrees(np.linalg.norm(drift[:3])):.3f} deg and {100 * np.linalg.norm(drift[3:]):.1f} cm"
            off = (*off, f"the LiDAR's motion seems wrong by {wrong} in every step: likely errors are larger for it")
        told = (f"the motion leaves open {_listed(openings)}: taken from the start",) if openings else ()
        result = found.filled(start, openings)
        delay = delay_between(runs, motions, result.camera_from_lidar, options.longest_s)
        cameras = {moment.camera for moment in prepared}
        return Result(
            names,
            start,
            result.camera_from_lidar,
            status,
            "; ".join((said, *told, *off)),
            covariance=found.covariance,
            accuracy=None if openings else accuracy(found.covariance),
            # What the start gave nobody has measured, however well the edges of a witness meet there.
            verdict=p2o.Verdict(tuple(p2o.Reason(p2o.Doubt.TOO_UNSURE, text) for text in told)),
            matches=matches,
            residual_px={"tracks": off_px},
            time=None if delay is None else p2o.TimeOffset(delay.delay_s, delay.sigma_s, used=False),
            intrinsics=cameras.pop() if len(cameras) == 1 else None,
            seconds={"motion": time.perf_counter() - began},
            warnings=(*told, *off),
        )

    def _found(self, runs: Sequence[Run], motions: Motions, start: Float) -> tuple[HandEye, Motions, Status]:
        """Return the extrinsic by both kinds of odometry, the last motions, and whether it settled."""
        options = self.options
        count = sum(len(run.moments) - 1 for run in runs)
        first, _ = first_guess(motions.steps)
        found = solved(motions.steps, first, overlap=len(motions.steps) / count)
        # Without scales much is open that LiDAR points will tell; until then the closed form, near the LiDAR, will do.
        openings = found.open_directions(over_deg=options.open_deg, over_m=options.open_m)
        pose = found.filled(first, openings).camera_from_lidar
        for _ in range(options.rounds):
            metric = point_motions(runs, pose, options)
            if len(metric.steps) < options.least_steps:
                return found, motions, Status.ROUNDS_SPENT
            motions = metric
            found = solved(motions.steps, pose, overlap=len(motions.steps) / count)
            openings = found.open_directions(over_deg=options.open_deg, over_m=options.open_m)
            last, pose = pose, found.filled(start if options.fill else first, openings).camera_from_lidar
            change = pose @ p2o.se3.inverse(last)
            if p2o.se3.angle_deg(change) < options.tolerance_deg and p2o.se3.distance_m(change) < options.tolerance_m:
                return found, motions, Status.CONVERGED
        return found, motions, Status.ROUNDS_SPENT if options.rounds else Status.CONVERGED


def corner_tracks(run: Run, options: HandEyeOptions) -> list[Followed]:
    """Return the corners of each picture of a run but the last, and where they are in the pictures after it."""
    found = []
    for first, later in run.spans(options.span):
        here, there = run.moments[first], [run.moments[number] for number in later]
        corners, _ = followed(here.grey, there[0].grey, most=options.corners, masked=here.masked)
        places = follow_on([here.grey, *(moment.grey for moment in there)], corners)
        rays = np.array([_rays(moment.camera, uv) for moment, uv in zip(there, places, strict=True)])
        lidar = np.array([run.lidar_step(first, second) for second in later])
        found.append(Followed(here.camera, here.xyz, corners, here.camera.rays(corners), rays, lidar))
    return found


def corner_motions(runs: Sequence[Run], tracks: Sequence[Sequence[Followed]], options: HandEyeOptions) -> Motions:
    """Return steps to the next and to the farthest frame with the camera's motion by corners alone, up to scale."""
    rows, single, points, squares = [], [], 0, 0.0
    for run, each in zip(runs, tracks, strict=True):
        turns: list[Float | None] = []
        for (first, later), track in zip(run.spans(options.span), each, strict=True):
            turns.append(None)
            for second in sorted({later[0], later[-1]}):
                there = track.there[second - first - 1]
                kept = np.flatnonzero(np.isfinite(there).all(axis=1))
                # So many are enough to begin with.
                kept = kept[:: max(len(kept) // _ENOUGH, 1)]
                step = camera_step(track.rays[kept], there[kept], run.moments[second].camera.focal_px)
                if step is None:
                    continue
                if second == first + 1:
                    turns[-1] = step.second_from_first[:3, :3]
                # Without parallax the direction of motion means nothing.
                way = float(np.clip(1.0 / max(step.parallax_px, 1e-3), 0.005, 1.0))
                covariance = np.diag(np.repeat([_TURN_RAD**2, way**2], 3))
                rows.append((step.second_from_first, run.lidar_step(first, second), covariance, second - first))
                points += step.corners
                squares += step.corners * step.off_px**2
        single.append(tuple(turns))
    return Motions(_steps(rows, metric=False), tuple(single), points, float(np.sqrt(squares / max(points, 1))))


def point_motions(runs: Sequence[Run], camera_from_lidar: Float, options: HandEyeOptions) -> Motions:
    """Return all steps with the camera's motion in metres, by LiDAR points followed in its pictures at a pose."""
    rows, single, points, squares = [], [], 0, 0.0
    for run in runs:
        turns: list[Float | None] = []
        for first, later in run.spans(options.span):
            turns.append(None)
            for second, step in fused_steps(run, first, later, camera_from_lidar, options):
                if second == first + 1:
                    turns[-1] = step.second_from_first[:3, :3]
                rows.append((step.second_from_first, run.lidar_step(first, second), step.covariance, second - first))
                points += step.points
                squares += step.points * step.off_px**2
        single.append(tuple(turns))
    return Motions(_steps(rows, metric=True), tuple(single), points, float(np.sqrt(squares / max(points, 1))))


def fused_steps(
    run: Run, first: int, later: Sequence[int], camera_from_lidar: Float, options: HandEyeOptions
) -> Iterator[tuple[int, MetricStep]]:
    """Return the camera's motion from frame `first` of a run to later ones, as far as its points can be followed."""
    here = run.moments[first]
    uv, xyz = trackable(here.grey, here.camera, here.masked, here.xyz, camera_from_lidar, most=options.points)
    pictures = [run.moments[number].grey for number in (first, *later)]
    for second, there in zip(later, follow_on(pictures, uv), strict=True):
        camera = run.moments[second].camera
        guess = camera_from_lidar @ run.lidar_step(first, second) @ p2o.se3.inverse(camera_from_lidar)
        step = metric_step(xyz, _rays(camera, there), camera.focal_px, guess)
        if step is None:
            return
        yield second, step


def delay_between(runs: Sequence[Run], motions: Motions, camera_from_lidar: Float, longest_s: float) -> Delay | None:
    """Return how much later than its sweeps the camera is, None where its turns do not tell."""
    drives = [
        Drive.of(np.array([m.time_s for m in run.moments]), turns, run.world_from_lidar, span_s=0.5)
        for run, turns in zip(runs, motions.single, strict=True)
        if any(turn is not None for turn in turns)
    ]
    found = delay_of(drives, camera_from_lidar, longest_s=longest_s) if drives else None
    return found if found is not None and found.inside and np.isfinite(found.sigma_s) else None


def _steps(rows: Sequence[tuple[Float, Float, Float, int]], *, metric: bool) -> Steps:
    camera, lidar, covariance = (
        np.array([row[column] for row in rows]).reshape(-1, size, size) for column, size in ((0, 4), (1, 4), (2, 6))
    )
    # Errors of odometry add up.
    longer = np.sqrt([row[3] for row in rows])
    return Steps(camera, lidar, np.full(len(rows), metric), covariance, _LIDAR_RAD * longer, _LIDAR_M * longer)


def _rays(camera: p2o.Camera, uv: Float) -> Float:
    """Return the rays (N, 3) of places (N, 2), NaN for those that are lost."""
    rays = np.full((len(uv), 3), np.nan)
    known = np.isfinite(uv).all(axis=1)
    rays[known] = camera.rays(uv[known])
    return rays


def _said(runs: Sequence[Run], found: HandEye) -> str:
    """Return in words what the result rests on."""
    way_m = sum(p2o.se3.distance_m(run.lidar_step(first, later[0])) for run in runs for first, later in run.spans(1))
    turn_deg = sum(p2o.se3.angle_deg(run.lidar_step(first, later[0])) for run in runs for first, later in run.spans(1))
    return (
        f"the motions of both sensors over {way_m:.1f} m and {turn_deg:.0f} deg of turns agree to {found.off_deg:.3f} "
        f"deg and {100 * found.off_m:.1f} cm a step"
    )


def _listed(openings: Sequence[OpenDirection]) -> str:
    return ", and ".join(map(str, openings))


class HandEyeStart:
    """The initializer: the same from frames of one drive together, handed on to the matcher."""

    def __init__(self, options: HandEyeOptions) -> None:
        self._method = HandEyeCalibration(options)

    def prepare(self, frame: p2o.Frame) -> Moment:
        """Return what is needed of a frame."""
        return self._method.prepare(frame)

    def __call__(self, views: Sequence[p2o.View], camera_from_lidar: Float) -> list[Float]:
        """Return the one pose that the motion tells. Raises InputError where it tells none."""
        result = self._method.solve([view.prepared for view in views if view.prepared is not None], camera_from_lidar)
        if not result.status.solved:
            raise p2o.InputError(
                "no start from motion: " + result.reason, hint="--joint with frames of one drive, or --init search"
            )
        return [result.camera_from_lidar]


def build(options: HandEyeOptions) -> p2o.Calibrator:
    """Return the calibrator. Raises ModuleNotFoundError where the odometry that is asked is not installed."""
    _require(options)
    return HandEyeCalibration(options)


def build_start(options: HandEyeOptions) -> p2o.Initializer:
    """Return the initializer. Raises ModuleNotFoundError where the odometry that is asked is not installed."""
    _require(options)
    return HandEyeStart(options)


def _require(options: HandEyeOptions) -> None:
    # A missing package is told before any frame is read.
    if options.lidar == "gicp":
        import small_gicp  # noqa: F401
    if options.lidar == "kiss-icp":
        import kiss_icp  # noqa: F401


_EXAMPLE = p2o.Example(
    "synthetic:?place=street&frames_per_scene=5&period_s=0.2&speed_m_s=4&swing_deg=25&tilt_deg=3&sway=0&right=false"
    "&seed=1",
    perturb="10deg 0.5m",
    joint=True,
)
METHOD = p2o.Method(
    name="hand-eye",
    build=build,
    options=HandEyeOptions,
    summary="Extrinsic from how both sensors move on a drive, without a start; tells what the motion leaves open.",
    needs={"sequence", "frame-time"},
    cite="Ishikawa, Oishi, Ikeuchi, LiDAR and Camera Calibration using Motions Estimated by Sensor Fusion Odometry, "
    "IROS 2018",
    extra="gicp",
    example=_EXAMPLE,
)
START = replace(
    METHOD,
    build=build_start,
    summary="Starts where the motion of both sensors on a drive says (--joint).",
    expected_failures=(("starts_without_edges_are_no_crash", "a single view has no motion, which is said"),),
)
