"""Delay of the camera by odometry of both sensors, then `line-idt`: `--calibrator line-time --joint`.

After Wang et al., Temporal and Spatial Online Integrated Calibration for Camera and LiDAR, ITSC 2022, the successor of
`line-idt` (Zhang et al. 2021) by the same idea: time first, space second.

1. Time: visual odometry between successive pictures (`visual_odometry`), poses of the LiDAR from the frames; the delay
   is the shift at which both turn alike (`sensor_delay`). The rotation of the start, which is about right, tells the
   axes; nothing else of the start matters here.
2. Sweeps are moved to the moments of their pictures, by the delay and the motion of the LiDAR.
3. Space: the stages of `line-idt`, its cloud side `line-points` and a solver, on all frames together.

Departures: the text of the paper was not at hand. That turns are compared rather than whole motions (their scale is
not known), least squares, the parabola, its deviation, and when a drive tells nothing, are ours; so is what comes from
`line-idt`. They publish an online method, which follows a delay as it changes; this one takes it as constant. The
witness that checks the result sees sweeps where they were, not where the delay puts them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Literal

import numpy as np
import p2o
from p2o import Result, Status
from p2o.arrays import Bool, Float, UInt8
from p2o.geometry.motion import pose_at

from p2o_baselines.sensor_delay import Delay, Drive, delay_of, twists
from p2o_baselines.visual_odometry import camera_step, followed


class LineTimeOptions(p2o.Options):
    """Options of `line-time`."""

    longest_s: float = p2o.field(0.2, gt=0, le=10, help="Longest delay that is tried, to either side.")
    step_s: float = p2o.field(0.005, gt=0, le=1, help="Delays that are tried lie so far apart.")
    gap_s: float = p2o.field(0.5, gt=0, le=60, help="Pictures farther apart in time are not compared.")
    span_s: float = p2o.field(0.5, ge=0, le=60, help="Turns between pictures up to so far apart are compared.")
    least_steps: int = p2o.field(4, ge=2, help="Fewer steps from picture to picture are too few.")
    sigma_s: float = p2o.field(0.02, gt=0, le=10, help="A delay with a larger standard deviation is not told.")
    explained: float = p2o.field(
        0.5, ge=0, lt=1, help="Share of the camera's turns, squared, that have to be the LiDAR's as well."
    )
    corners: int = p2o.field(1500, ge=50, le=100_000, help="Corners of a picture that are followed, at most.")
    solver: Literal["grid729", "coordinate"] = p2o.field("grid729", help="Solver of the second half.")


@dataclass(frozen=True, eq=False)
class Moment:
    """What is prepared of a frame: when and where it was taken, its grey picture, and the features of `line-idt`."""

    sequence: str
    time_s: float
    world_from_lidar: Float
    grey: UInt8
    masked: Bool | None
    view: p2o.View


@dataclass(frozen=True)
class LineTime:
    """The whole method; `space` are the stages of the second half."""

    options: LineTimeOptions
    space: p2o.Pipeline

    def prepare(self, frame: p2o.Frame) -> Moment:
        """Return what both halves need of a frame. Raises InputError where it has no sequence, time or LiDAR pose."""
        if not frame.sequence or frame.time_s is None or frame.lidar_world_from_lidar is None:
            raise p2o.InputError(
                "the frame is of no drive", where=frame.name, expected="sequence, time and pose of the LiDAR"
            )
        view = self.space.prepare(frame)
        image = frame.image
        return Moment(frame.sequence, frame.time_s, frame.lidar_world_from_lidar, image.grey, image.masked, view)

    def solve(self, prepared: Sequence[Moment], camera_from_lidar: Float) -> Result:
        """Return the pose of all frames together, each sweep moved by the delay that they tell."""
        names = tuple(moment.view.name for moment in prepared)
        start = np.asarray(camera_from_lidar, np.float64)
        drives = drives_of(prepared)
        found = delay_of(
            [turns_of(drive, self.options) for drive in drives],
            start,
            longest_s=self.options.longest_s,
            step_s=self.options.step_s,
        )
        counts = {"steps": 0 if found is None else found.steps}
        trouble = self._trouble(found, sum(map(len, drives)))
        if found is None or trouble is not None:
            status, reason = trouble or (Status.TOO_FEW_MATCHES, "no steps")
            return Result(names, start, start, status, reason, matches=counts)
        told = (
            f"pictures were taken {1e3 * abs(found.delay_s):.1f} +- {1e3 * found.sigma_s:.1f} ms "
            f"{'after' if found.delay_s >= 0 else 'before'} their sweeps, as {found.steps} steps tell"
        )
        views = [view for drive in drives for view in synchronised(drive, found.delay_s)]
        result = self.space.solve(views, start)
        known = {*names} - {view.name for view in views}
        alone = (f"left out, for their drives have no other frame: {', '.join(sorted(known))}",) if known else ()
        return replace(
            result,
            frames=names,
            reason=f"{told}; {result.reason}",
            matches={**counts, **result.matches},
            warnings=(*result.warnings, told, *alone),
        )

    def _trouble(self, found: Delay | None, frames: int) -> tuple[Status, str] | None:
        """Return why the delay is not known, or None where it is."""
        options = self.options
        if found is None or found.steps < options.least_steps:
            return Status.TOO_FEW_MATCHES, (
                f"{0 if found is None else found.steps} steps between pictures of one drive, of {frames} frames, lie "
                f"{options.longest_s:g} s and more within its poses; {options.least_steps} are needed, calibrated "
                "jointly"
            )
        if found.explained < options.explained:
            return Status.NOT_OBSERVABLE, (
                f"no delay of up to {options.longest_s:g} s lays the turns of camera and LiDAR upon each other: they "
                f"share {max(found.explained, 0):.0%} of them; drive so that it turns, and check what times belong to"
            )
        if not found.inside:
            return Status.NOT_OBSERVABLE, (
                f"the delay is {options.longest_s:g} s or longer, the longest that is tried: calibrator.longest_s"
            )
        if not found.sigma_s <= options.sigma_s:
            known = f"to {1e3 * found.sigma_s:.0f} ms only" if np.isfinite(found.sigma_s) else "not at all"
            return Status.NOT_OBSERVABLE, (
                f"the drive turns too little, or too evenly, to tell the delay: it is known {known}; drive curves to "
                "either side"
            )
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
    """Return the rotation (3, 3) of the camera between two pictures, None where they do not tell."""
    if second.time_s - first.time_s > options.gap_s or first.grey.shape != second.grey.shape:
        return None
    here, there = followed(first.grey, second.grey, most=options.corners, masked=first.masked)
    camera = first.view.camera
    step = camera_step(camera.rays(here), second.view.camera.rays(there), camera.focal_px)
    return None if step is None else step.second_from_first[:3, :3]


def synchronised(drive: Sequence[Moment], delay_s: float) -> list[p2o.View]:
    """Return the views of a drive, each with its sweep as the LiDAR would see it `delay_s` later."""
    times_s = np.array([moment.time_s for moment in drive])
    rates = twists(times_s, np.array([moment.world_from_lidar for moment in drive]), backwards=delay_s < 0)
    return [moment.view.moved(pose_at(rate, -delay_s)) for moment, rate in zip(drive, rates, strict=True)]


def build(options: LineTimeOptions) -> p2o.Calibrator:
    """Return the calibrator. Raises UnknownNameError where no plugin with the solver is loaded."""
    recipe = p2o.Recipe.of(
        data=None,
        extractor="line-idt/line-points",
        matcher="line-idt",
        solver=options.solver,
        init="given",
        witness="none",
    )
    stages = recipe.resolve(p2o.Registry.load()).calibrator()
    assert isinstance(stages, p2o.Pipeline)
    return LineTime(options, stages)


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
