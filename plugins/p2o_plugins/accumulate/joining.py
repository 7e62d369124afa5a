"""Accumulators `poses`, `gicp` and `kiss-icp`: join sweeps of neighbouring frames by given or estimated poses."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import p2o
from p2o import Float
from p2o.solving import accumulated


class JoiningOptions(p2o.Options):
    """Number of sweeps to join, and the points of them to keep."""

    past: int = p2o.field(2, ge=0, le=200, help="Frames before the frame whose sweeps are joined to its own.")
    future: int = p2o.field(2, ge=0, le=200, help="Frames after it.")
    voxel_m: float | None = p2o.field(
        None, gt=0, le=10, help="Keep one point in each cube of this side in metres; null keeps all."
    )
    max_range_m: float | None = p2o.field(
        None, gt=1, le=1000, help="Leave out points farther than this from the frame's LiDAR in metres; null keeps all."
    )


@dataclass(frozen=True)
class Joining:
    """Join sweeps by the poses of their frames, or by those that `poses` estimates.

    `poses` takes the sweeps of a sequence in order, corrected to the time of their frames where the velocity is known,
    and returns world_from_lidar (4, 4) of each.
    """

    options: JoiningOptions
    poses: Callable[[Sequence[p2o.Cloud]], Sequence[Float]] | None = None

    @property
    def past(self) -> int:
        """Number of frames to join before a frame."""
        return self.options.past

    @property
    def future(self) -> int:
        """Number of frames to join after a frame."""
        return self.options.future

    def __call__(self, frames: Sequence[p2o.Frame], number: int) -> p2o.Cloud:
        """Return the sweeps of all frames in the LiDAR frame of frame `number`, its own first."""
        if self.poses is not None:
            poses = self.poses([f.cloud if f.twist is None else f.cloud.untwisted(f.twist) for f in frames])
            frames = [replace(f, lidar_world_from_lidar=pose) for f, pose in zip(frames, poses, strict=True)]
        options = self.options
        return accumulated(frames[number], frames, voxel_m=options.voxel_m, max_range_m=options.max_range_m)


def build_gicp(options: JoiningOptions) -> p2o.Accumulator:
    """Return the accumulator by poses of small_gicp."""
    import small_gicp  # noqa: F401  (report a missing package before any frame is read)
    from p2o.solving import poses_by_gicp

    return Joining(options, poses_by_gicp)


def build_kiss_icp(options: JoiningOptions) -> p2o.Accumulator:
    """Return the accumulator by poses of KISS-ICP."""
    import kiss_icp  # noqa: F401  (report a missing package before any frame is read)
    from p2o.solving import poses_by_kiss_icp

    return Joining(options, poses_by_kiss_icp)


GICP = p2o.Method(
    name="gicp",
    build=build_gicp,
    options=JoiningOptions,
    summary="Joins sweeps of a sequence by poses that small_gicp finds from each sweep to the next.",
    needs={"sequence"},
    gives={"dense"},
    cite="Koide, small_gicp, JOSS 2024; Segal et al., Generalized-ICP, RSS 2009",
    extra="gicp",
)
KISS_ICP = p2o.Method(
    name="kiss-icp",
    build=build_kiss_icp,
    options=JoiningOptions,
    summary="Joins sweeps of a sequence by poses that KISS-ICP finds against a map of the sweeps before.",
    needs={"sequence"},
    gives={"dense"},
    cite="Vizzo et al., KISS-ICP, RA-L 2023",
    extra="kiss-icp",
)
POSES = p2o.Method(
    name="poses",
    build=Joining,
    options=JoiningOptions,
    summary="Joins sweeps of a sequence by the poses of the LiDAR that the data give.",
    needs={"sequence", "lidar-pose"},
    gives={"dense"},
)
