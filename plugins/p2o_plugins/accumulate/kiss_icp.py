"""Accumulator `kiss-icp`: join sweeps by poses that KISS-ICP estimates against a map of earlier sweeps."""

from __future__ import annotations

from functools import partial

import p2o

from p2o_plugins.accumulate.joining import Joining, JoiningOptions


class KissIcpOptions(JoiningOptions):
    """Options of `kiss-icp`."""

    map_voxel_m: float = p2o.field(1.0, gt=0, le=20, help="Cubes of the map in metres.")
    map_range_m: float = p2o.field(100.0, gt=1, le=1000, help="Points farther than this do not help to align.")


def build(options: KissIcpOptions) -> p2o.Accumulator:
    """Return the accumulator `(frames, number) -> Cloud`."""
    import kiss_icp  # noqa: F401  (report a missing package before any frame is read)
    from p2o.solving import poses_by_kiss_icp

    voxel_m, max_range_m = options.map_voxel_m, options.map_range_m
    return Joining(options, partial(poses_by_kiss_icp, voxel_m=voxel_m, max_range_m=max_range_m))


METHOD = p2o.Method(
    name="kiss-icp",
    build=build,
    options=KissIcpOptions,
    summary="Joins sweeps of a sequence by poses that KISS-ICP finds against a map of the sweeps before.",
    needs={"sequence"},
    gives={"dense"},
    cite="Vizzo et al., KISS-ICP, RA-L 2023",
    extra="kiss-icp",
)
