"""Accumulator `poses`: joins sweeps by the poses of the LiDAR that the data give."""

from __future__ import annotations

from p2o import Accumulator, Method

from p2o_plugins.accumulate.joining import Joining, JoiningOptions


def build(options: JoiningOptions) -> Accumulator:
    """Return the accumulator `(frames, number) -> Cloud`."""
    return Joining(options)


METHOD = Method(
    name="poses",
    build=build,
    options=JoiningOptions,
    summary="Joins sweeps of a sequence by the poses of the LiDAR that the data give.",
    needs={"sequence", "lidar-pose"},
    gives={"dense"},
)
