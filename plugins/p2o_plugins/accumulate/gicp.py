"""Accumulator `gicp`: join sweeps by poses that small_gicp estimates from sweep to sweep."""

from __future__ import annotations

from functools import partial

import p2o

from p2o_plugins.accumulate.joining import Joining, JoiningOptions


class GicpOptions(JoiningOptions):
    """Options of `gicp`."""

    align_voxel_m: float = p2o.field(
        0.25, gt=0, le=10, help="Voxel size in metres to which sweeps are downsampled before alignment."
    )
    max_distance_m: float = p2o.field(1.0, gt=0, le=20, help="Points of two sweeps are paired up to this distance.")


def build(options: GicpOptions) -> p2o.Accumulator:
    """Return the accumulator `(frames, number) -> Cloud`."""
    import small_gicp  # noqa: F401  (report a missing package before any frame is read)
    from p2o.solving import poses_by_gicp

    voxel_m, max_distance_m = options.align_voxel_m, options.max_distance_m
    return Joining(options, partial(poses_by_gicp, voxel_m=voxel_m, max_distance_m=max_distance_m))


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
