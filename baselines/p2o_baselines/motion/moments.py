"""Frames of a drive as time series, for methods that use motion (`hand-eye`, `csc`).

Grouping into consecutive frames, poses of the LiDAR, detection of a static sensor, and the predicted error that follows
from a covariance.
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import ClassVar, Literal

import numpy as np
import p2o
from p2o import Bool, Float, UInt8, field
from p2o.solving import Accuracy, image_at_scale

from p2o_baselines.outcome import refused

_THEN_M = 0.3
"""Sweeps are registered a second time without points farther than this from the other one, such as dynamic objects."""
_MAP_M = 0.5
"""Voxel size of the map of KISS-ICP in metres; with its default of 1 m, rotations are wrong by a tenth of a degree."""
_STILL_RAD, _STILL_M = np.radians(0.2), 0.05  # steps below these thresholds are a static sensor


OPEN_DEG = 2.0  # rotations with a larger standard deviation are unobservable
OPEN_M = 0.25  # translations with a larger standard deviation are unobservable


class MotionOptions(p2o.Options):
    """Options of methods that use the motion of both sensors on a drive."""

    lidar: Literal["gicp", "kiss-icp", "given"] = field(
        "gicp", help="Motion of the LiDAR: small_gicp, KISS-ICP, or the poses of the frames."
    )
    gap_s: float = field(0.6, gt=0, le=60, help="Largest time between consecutive frames.")


@dataclass(frozen=True, eq=False)
class Moment:
    """The prepared part of a frame: time, grey image, and its sweep (N, 3) m at that time."""

    name: str
    sequence: str
    time_s: float
    camera: p2o.Camera
    grey: UInt8
    masked: Bool | None
    xyz: Float
    world_from_lidar: Float | None


@dataclass(frozen=True, eq=False)
class Run:
    """Consecutive frames of one drive with the LiDAR's pose (N, 4, 4) at each."""

    moments: tuple[Moment, ...]
    world_from_lidar: Float

    def spans(self, most: int) -> Iterator[tuple[int, list[int]]]:
        """Return each frame but the last with the numbers of those up to `most` after it."""
        count = len(self.moments)
        for first in range(count - 1):
            yield first, list(range(first + 1, min(first + most, count - 1) + 1))

    def lidar_step(self, first: int, second: int) -> Float:
        """Return the motion (4, 4) that takes points of the LiDAR frame of one moment to that of another."""
        return np.asarray(p2o.se3.inverse(self.world_from_lidar[second]) @ self.world_from_lidar[first])


class RefusedError(Exception):
    """A calibration that cannot be solved, with the status and the reason of its result."""

    def __init__(self, status: p2o.Status, reason: str) -> None:
        super().__init__(reason)
        self.status, self.reason = status, reason


@dataclass(frozen=True)
class MotionCalibration:
    """A calibrator by motion; `part` names what its time is spent on."""

    options: MotionOptions
    part: ClassVar[str]

    def prepare(self, frame: p2o.Frame) -> Moment:
        """Return the part of a frame that is used. Raises InputError for a frame without a drive or a required pose."""
        return moment_of(frame, self.options.lidar)

    def solve(self, prepared: Sequence[Moment], camera_from_lidar: Float) -> p2o.Result:
        """Return the extrinsic from the motion of all frames, refused if the motion does not determine it."""
        began, start = time.perf_counter(), np.asarray(camera_from_lidar, np.float64)
        result = p2o.Result(tuple(moment.name for moment in prepared), start, start, p2o.Status.NO_FEATURES, "")
        matches: dict[str, int] = {}
        try:
            result = self._solved(result, prepared, matches)
        except RefusedError as refusal:
            result = refused(result, refusal.reason, refusal.status)
        cameras = {moment.camera for moment in prepared} if result.status.solved else set()
        camera = cameras.pop() if len(cameras) == 1 else None
        return replace(result, matches=matches, intrinsics=camera, seconds={self.part: time.perf_counter() - began})

    def _solved(self, result: p2o.Result, prepared: Sequence[Moment], matches: dict[str, int]) -> p2o.Result:
        raise TypeError("a subclass solves")


def require_odometry(lidar: str) -> None:
    """Raise ModuleNotFoundError if the package of an odometry is missing, before any frame is read."""
    if lidar == "gicp":
        import small_gicp  # noqa: F401
    if lidar == "kiss-icp":
        import kiss_icp  # noqa: F401


def moment_of(frame: p2o.Frame, lidar: str) -> Moment:
    """Return the part of a frame that is used, deskewed if possible. Raises InputError without drive or pose."""
    if lidar == "given" and frame.lidar_world_from_lidar is None:
        raise p2o.InputError("the frame has no pose of the LiDAR", where=frame.name, hint="omit calibrator.lidar=given")
    if not frame.sequence or frame.time_s is None:
        raise p2o.InputError(
            "the frame belongs to no drive, and the method needs motion",
            where=frame.name,
            expected="frames with `sequence` and `time_s`",
        )
    image = image_at_scale(frame.image)
    cloud = frame.cloud if frame.sweep is None else frame.sweep
    if frame.twist is not None:
        cloud = cloud.untwisted(frame.twist)
    return Moment(
        frame.name,
        frame.sequence,
        frame.time_s,
        image.camera,
        image.grey,
        image.masked,
        np.asarray(cloud.xyz),
        frame.lidar_world_from_lidar,
    )


def runs_of(
    groups: Sequence[Sequence[Moment]], frames: int, options: MotionOptions, *, least_steps: int, span: int
) -> list[Run]:
    """Return groups with LiDAR poses. Raises RefusedError for few steps, failed odometry, a static LiDAR."""
    steps = sum(len(group) - 1 for group in groups)
    if steps < least_steps:
        few = f"{steps} steps between consecutive frames, of {frames} frames; {least_steps} are needed"
        advice = f"frames of one drive, at most {options.gap_s:g} s apart, calibrated jointly"
        raise RefusedError(p2o.Status.TOO_FEW_MATCHES, f"{few}: {advice}")
    try:
        runs = [Run(tuple(group), lidar_poses(group, options.lidar)) for group in groups]
    except p2o.InputError as error:
        raise RefusedError(p2o.Status.TOO_FEW_MATCHES, f"the motion of the LiDAR is unknown: {error}") from error
    if not any(moves(run, span) for run in runs):
        raise RefusedError(p2o.Status.NOT_OBSERVABLE, "the LiDAR is static: the method needs motion")
    return runs


def path_of(runs: Sequence[Run]) -> tuple[float, float]:
    """Return the length of the path of the LiDAR in m and the sum of its rotations in deg."""
    steps = [run.lidar_step(first, later[0]) for run in runs for first, later in run.spans(1)]
    return sum(map(p2o.se3.distance_m, steps)), sum(map(p2o.se3.angle_deg, steps))


def consecutive(moments: Sequence[Moment], gap_s: float) -> list[list[Moment]]:
    """Return the groups of at least two frames of a drive at most `gap_s` apart; of one time the first is used."""
    drives: dict[str, dict[float, Moment]] = {}
    for moment in moments:
        drives.setdefault(moment.sequence, {}).setdefault(moment.time_s, moment)
    groups: list[list[Moment]] = []
    for drive in drives.values():
        ordered = [drive[time_s] for time_s in sorted(drive)]
        group = ordered[:1]
        for before, after in pairwise(ordered):
            if after.time_s - before.time_s > gap_s or after.grey.shape != before.grey.shape:
                groups.append(group)
                group = []
            group.append(after)
        groups.append(group)
    return [group for group in groups if len(group) > 1]


def lidar_poses(moments: Sequence[Moment], how: str) -> Float:
    """Return world_from_lidar (N, 4, 4) of consecutive frames."""
    if how == "given":
        return np.array([moment.world_from_lidar for moment in moments])
    from p2o.solving import poses_by_gicp, poses_by_kiss_icp

    clouds = [p2o.Cloud(moment.xyz) for moment in moments]
    return np.array(
        poses_by_gicp(clouds, then_m=_THEN_M) if how == "gicp" else poses_by_kiss_icp(clouds, voxel_m=_MAP_M)
    )


def moves(run: Run, span: int) -> bool:
    """Return whether the LiDAR moves over steps of up to `span` frames."""
    steps = [run.lidar_step(first, later[-1]) for first, later in run.spans(span)]
    turned, moved = (np.array([of(step) for step in steps]) for of in (p2o.se3.angle_deg, p2o.se3.distance_m))
    return bool(((np.radians(turned) > _STILL_RAD) | (moved > _STILL_M)).any())


def accuracy(covariance: Float) -> Accuracy:
    """Return the predicted error of an extrinsic with a covariance (6, 6), by sampling from it."""
    drawn = np.random.default_rng(0).multivariate_normal(np.zeros(6), covariance, 4000)
    turn, move = (np.linalg.norm(drawn[:, part], axis=1) for part in (slice(0, 3), slice(3, 6)))
    return Accuracy(
        *(float(np.degrees(np.quantile(turn, 2 / 3))), float(np.quantile(move, 2 / 3))),
        *(float(np.degrees(np.quantile(turn, 0.95))), float(np.quantile(move, 0.95))),
    )
