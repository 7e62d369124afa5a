"""Accumulator `gicp`: joins sweeps by poses that small_gicp finds from sweep to sweep."""

from __future__ import annotations

from collections.abc import Sequence

import p2o
from p2o.arrays import Float

from p2o_plugins.accumulate.joining import Joining, JoiningOptions


class GicpOptions(JoiningOptions):
    """Options of `gicp`."""

    align_voxel_m: float = p2o.field(
        0.25, gt=0, le=10, help="Cubes in metres that sweeps are thinned to before they are aligned."
    )
    max_distance_m: float = p2o.field(1.0, gt=0, le=20, help="Points of two sweeps are paired up to this distance.")


def build(options: GicpOptions) -> p2o.Accumulator:
    """Return the accumulator `(frames, number) -> Cloud`."""
    import small_gicp  # noqa: F401  (a missing package is told before any frame is read)
    from p2o.frames.lidar_odometry import poses_by_gicp

    def poses(clouds: Sequence[p2o.Cloud]) -> Sequence[Float]:
        return poses_by_gicp(clouds, voxel_m=options.align_voxel_m, max_distance_m=options.max_distance_m)

    return Joining(options, poses)


METHOD = p2o.Method(
    name="gicp",
    build=build,
    options=GicpOptions,
    summary="Joins sweeps of a sequence by poses that small_gicp finds from each sweep to the next.",
    needs={"sequence"},
    gives={"dense"},
    cite="Koide, small_gicp, JOSS 2024; Segal et al., Generalized-ICP, RSS 2009",
    extra="gicp",
)
