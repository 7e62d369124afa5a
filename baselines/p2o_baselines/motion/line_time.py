"""Estimate the camera delay by odometry of both sensors, then run `line-idt`: `--calibrator line-time --joint`.

After Wang et al., Temporal and Spatial Online Integrated Calibration for Camera and LiDAR, ITSC 2022, the successor of
`line-idt` (Zhang et al. 2021): first time, then space.

1. Time: visual odometry between successive images (`visual_odometry`) and LiDAR poses from the frames; the delay is the
   time shift at which the rotations of both agree (`sensor_delay`). The rotation of the initial extrinsic, which is
   approximately right, aligns the axes; its translation has no effect here.
2. Sweeps are moved to the times of their images, by the delay and the motion of the LiDAR.
3. Space: the stages of `line-idt`, its cloud side `line-points` and a solver, on all frames jointly.

Departures: the text of the paper was not at hand. Comparing rotations instead of whole motions (their scale is
unknown), least squares, the parabola, its standard deviation, and the test of observability are ours, as are the parts
of `line-idt`. The original is an online method that tracks a changing delay; here it is constant. The independent check
of the result uses sweeps at their nominal times, without the delay.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
import p2o
from p2o import Bool, Float, Result, Status, UInt8, field
from p2o.reading import pose_at
from p2o.solving import Pipeline

from p2o_baselines.motion.sensor_delay import Delay, Drive, delay_of, twists
from p2o_baselines.motion.visual_odometry import camera_step, followed

_STEP_S = 0.005  # spacing of the evaluated delays
_LEAST_STEPS = 4  # fewer steps from image to image are too few
_SIGMA_S = 0.02  # refuse delays with a larger standard deviation
_EXPLAINED = 0.5  # least share of the camera's squared turns in the LiDAR's
_CORNERS = 1500  # largest number of corners tracked per image


class LineTimeOptions(p2o.Options):
    """Options of `line-time`."""

    longest_s: float = field(0.2, gt=0, le=10, help="Longest delay that is tried, to either side.")
    gap_s: float = field(0.5, gt=0, le=60, help="Largest time between compared images.")
    span_s: float = field(0.5, ge=0, le=60, help="Largest time over which rotations are compared.")


@dataclass(frozen=True, eq=False)
class Moment:
    """The prepared part of a frame: time, pose, grey image, and the features of `line-idt`."""

    sequence: str
    time_s: float
    world_from_lidar: Float
    grey: UInt8
    masked: Bool | None
    view: p2o.View


@dataclass(frozen=True)
class LineTime:
    """The calibrator; `space` are the stages of the second half."""

    options: LineTimeOptions
    space: Pipeline

    def prepare(self, frame: p2o.Frame) -> Moment:
        """Return the part of a frame that is used. Raises InputError if it has no sequence, time or LiDAR pose."""
        if not frame.sequence or frame.time_s is None or frame.lidar_world_from_lidar is None:
            expected = "sequence, time and pose of the LiDAR"
            raise p2o.InputError("the frame belongs to no drive", where=frame.name, expected=expected)
        image, view = frame.image, self.space.prepare(frame)
        return Moment(frame.sequence, frame.time_s, frame.lidar_world_from_lidar, image.grey, image.masked, view)

    def solve(self, prepared: Sequence[Moment], camera_from_lidar: Float) -> Result:
        """Return the pose from all frames, with each sweep moved by the estimated delay."""
        names = tuple(moment.view.name for moment in prepared)
        start = np.asarray(camera_from_lidar, np.float64)
        drives, options = drives_of(prepared), self.options
        turns = [turns_of(drive, options) for drive in drives]
        delay = delay_of(turns, start, longest_s=options.longest_s, step_s=_STEP_S)
        counts = {"steps": 0 if delay is None else delay.steps}
        trouble = self._trouble(delay, sum(map(len, drives)))
        if delay is None or trouble is not None:
            status, reason = trouble or (Status.TOO_FEW_MATCHES, "no steps")
            return Result(names, start, start, status, reason, matches=counts)
        summary = (
            f"images were taken {1e3 * abs(delay.delay_s):.1f} +- {1e3 * delay.sigma_s:.1f} ms "
            f"{'after' if delay.delay_s >= 0 else 'before'} their sweeps, as {delay.steps} steps tell"
        )
        views = [view for drive in drives for view in synchronised(drive, delay.delay_s)]
        result = self.space.solve(views, start)
        known = {*names} - {view.name for view in views}
        alone = (f"left out, for their drives have no other frame: {', '.join(sorted(known))}",) if known else ()
        return replace(
            result,
            frames=names,
            reason=f"{summary}; {result.reason}",
            matches={**counts, **result.matches},
            warnings=(*result.warnings, summary, *alone),
        )

    def _trouble(self, delay: Delay | None, frames: int) -> tuple[Status, str] | None:
        """Return why the delay is unknown; None if it is known."""
        options = self.options
        longest = f"{options.longest_s:g} s"
        if delay is None or delay.steps < _LEAST_STEPS:
            return Status.TOO_FEW_MATCHES, (
                f"{0 if delay is None else delay.steps} steps between images of one drive, of {frames} frames, lie "
                f"{longest} and more within its poses; {_LEAST_STEPS} are needed, calibrated jointly"
            )
        if delay.explained < _EXPLAINED:
            return Status.NOT_OBSERVABLE, (
                f"no delay of up to {longest} lays the turns of camera and LiDAR upon each other: they share "
                f"{max(delay.explained, 0):.0%} of them; drive so that it turns, and check what times belong to"
            )
        if not delay.inside:
            reason = f"the delay is {longest} or longer, the longest that is tried: calibrator.longest_s"
            return Status.NOT_OBSERVABLE, reason
        if not delay.sigma_s <= _SIGMA_S:
            known = f"to {1e3 * delay.sigma_s:.0f} ms only" if np.isfinite(delay.sigma_s) else "not at all"
            reason = f"the drive turns too little, or too evenly, to tell the delay: it is known {known}"
            return Status.NOT_OBSERVABLE, f"{reason}; drive curves to either side"
        return None


def drives_of(moments: Sequence[Moment]) -> list[list[Moment]]:
    """Return the frames of each drive with two and more, in order of time; of two at one time the first counts."""
    drives: dict[str, dict[float, Moment]] = {}
    for moment in moments:
        drives.setdefault(moment.sequence, {}).setdefault(moment.time_s, moment)
    return [[drive[time_s] for time_s in sorted(drive)] for drive in drives.values() if len(drive) > 1]


def turns_of(drive: Sequence[Moment], options: LineTimeOptions) -> Drive:
    """Return how camera and LiDAR turn on a drive."""
    times_s = np.array([moment.time_s for moment in drive])
    steps = [_step(first, second, options) for first, second in pairwise(drive)]
    poses = np.array([moment.world_from_lidar for moment in drive])
    return Drive.of(times_s, steps, poses, span_s=options.span_s)


def _step(first: Moment, second: Moment, options: LineTimeOptions) -> Float | None:
    """Return the rotation (3, 3) of the camera between two images; None if they do not determine it."""
    if second.time_s - first.time_s > options.gap_s or first.grey.shape != second.grey.shape:
        return None
    uv_first, uv_second = followed(first.grey, second.grey, most=_CORNERS, masked=first.masked)
    camera = first.view.camera
    step = camera_step(camera.rays(uv_first), second.view.camera.rays(uv_second), camera.focal_px)
    return None if step is None else step.second_from_first[:3, :3]


def synchronised(drive: Sequence[Moment], delay_s: float) -> list[p2o.View]:
    """Return the views of a drive, each with its sweep as the LiDAR would see it `delay_s` later."""
    times_s = np.array([moment.time_s for moment in drive])
    rates = twists(times_s, np.array([moment.world_from_lidar for moment in drive]), backwards=delay_s < 0)
    return [moment.view.moved(pose_at(rate, -delay_s)) for moment, rate in zip(drive, rates, strict=True)]


def build(options: LineTimeOptions) -> p2o.Calibrator:
    """Return the calibrator. Raises UnknownNameError if no plugin with the solver is loaded."""
    stages = {"extractor": "line-idt/line-points", "matcher": "line-idt", "solver": "grid729", "init": "given"}
    recipe = p2o.Recipe.of(data=None, **stages, witness="none")
    space = recipe.resolve(p2o.Registry.load()).calibrator()
    assert isinstance(space, Pipeline)
    return LineTime(options, space)


_THREE_FRAMES = "the drive of the stage has three frames a second apart, and a delay takes more"
METHOD = p2o.Method(
    name="line-time",
    build=build,
    options=LineTimeOptions,
    summary="Delay of the camera from how both sensors turn on a drive, then lines on inverse distance maps.",
    needs={"sequence", "frame-time", "lidar-pose"},
    cite="Wang et al., Temporal and Spatial Online Integrated Calibration for Camera and LiDAR, ITSC 2022",
    expected_failures=(("calibrator_comes_near_the_truth", _THREE_FRAMES),),
)
