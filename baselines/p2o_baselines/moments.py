"""Moments of drives: what methods that live on motion share (`hand-eye`, `csc`).

Which frames follow one another, the poses of the LiDAR at them, whether it moves at all, and how wrong an extrinsic of
a covariance is likely to be.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import p2o
from p2o.arrays import Bool, Float, UInt8

_THEN_M = 0.3
"""Sweeps are aligned again without what is farther from the other one: traffic draws steps by centimetres."""
_MAP_M = 0.5
"""Cubes of the map of KISS-ICP: with its usual metre, turns are wrong by a tenth of a degree."""
_STILL_RAD, _STILL_M = np.radians(0.2), 0.05
"""Steps that turn and move less than this tell nothing."""


@dataclass(frozen=True, eq=False)
class Moment:
    """What is prepared of a frame: when it was taken, its grey picture, and its sweep (N, 3) m at that time."""

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


def moment_of(frame: p2o.Frame) -> Moment:
    """Return what is needed of a frame. Raises InputError where it is of no drive.

    The sweep is taken as at the time of the picture where the velocity is known.
    """
    if not frame.sequence or frame.time_s is None:
        raise p2o.InputError(
            "the frame is of no drive, and the method lives on motion",
            where=frame.name,
            expected="frames with `sequence` and `time_s`",
        )
    image = p2o.image_at_scale(frame.image)
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


def consecutive(moments: Sequence[Moment], gap_s: float) -> list[list[Moment]]:
    """Return the frames of each stretch of a drive in which none is farther from the next than `gap_s`, two and more.

    Of frames at one time, as of several cameras, the first counts.
    """
    drives: dict[str, dict[float, Moment]] = {}
    for moment in moments:
        drives.setdefault(moment.sequence, {}).setdefault(moment.time_s, moment)
    found: list[list[Moment]] = []
    for drive in drives.values():
        ordered = [drive[time_s] for time_s in sorted(drive)]
        group = ordered[:1]
        for before, after in pairwise(ordered):
            if after.time_s - before.time_s > gap_s or after.grey.shape != before.grey.shape:
                found.append(group)
                group = []
            group.append(after)
        found.append(group)
    return [group for group in found if len(group) > 1]


def lidar_poses(moments: Sequence[Moment], how: str) -> Float:
    """Return world_from_lidar (N, 4, 4) of consecutive frames."""
    if how == "given":
        return np.array([moment.world_from_lidar for moment in moments])
    from p2o.frames.lidar_odometry import poses_by_gicp, poses_by_kiss_icp

    clouds = [p2o.Cloud(moment.xyz) for moment in moments]
    return np.array(
        poses_by_gicp(clouds, then_m=_THEN_M) if how == "gicp" else poses_by_kiss_icp(clouds, voxel_m=_MAP_M)
    )


def moves(run: Run, span: int) -> bool:
    """Return whether the LiDAR turns or goes at all over steps of up to `span` frames."""
    steps = [run.lidar_step(first, later[-1]) for first, later in run.spans(span)]
    return any(
        np.radians(p2o.se3.angle_deg(step)) > _STILL_RAD or p2o.se3.distance_m(step) > _STILL_M for step in steps
    )


def accuracy(covariance: Float) -> p2o.Accuracy:
    """Return how wrong an extrinsic of a covariance (6, 6) is likely to be, by drawing from it."""
    drawn = np.random.default_rng(0).multivariate_normal(np.zeros(6), covariance, 4000)
    turn, move = (np.linalg.norm(drawn[:, part], axis=1) for part in (slice(0, 3), slice(3, 6)))
    return p2o.Accuracy(
        *(float(np.degrees(np.quantile(turn, 2 / 3))), float(np.quantile(move, 2 / 3))),
        *(float(np.degrees(np.quantile(turn, 0.95))), float(np.quantile(move, 0.95))),
    )
