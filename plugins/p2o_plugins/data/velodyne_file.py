"""Sweeps of KITTI's Velodyne HDL-64E: rings, times and the motion of the car, none of which their files hold."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from p2o import Cloud
from p2o.arrays import Float, Int

from p2o_plugins.data.bin_file import KITTI_COLUMNS
from p2o_plugins.data.cloud_file import read_cloud

SWEEP_S = 0.1
"""Nominal time of one turn; the unit spins at 9.68 to 10 Hz."""
IMAGE_DELAY_S = 0.004
"""When KITTI's cameras see the scene, after the LiDAR looks straight ahead.

Measured: motion-compensated sweeps of fast `train` drives (0028, 0015, 0032 with 0056) fit the edges of the images best
3.7, 3.8 and 2.2 ms after, and calibrations of them are right along the road at 4.6, 4.6 and 2.3 ms
(`docs/benchmarks.md`).
"""
NOT_UNTWISTED = "the sweep is raw, and the velocity of the car is not given"
"""Remark on frames whose sweep is raw."""
# Sweeps cut to a sector may lack whole rings; more than 64 means that the order of the file is not the sensor's.
_PLAUSIBLE_RINGS = range(32, 65)


def read_sweep(path: Path, *, sweep_s: float | None, elevation_fix_deg: float = 0.0) -> tuple[Cloud, tuple[str, ...]]:
    """Return a KITTI sweep (.bin) with rings, and times unless `sweep_s` is None, and warnings.

    `sweep_s` is the time of one turn in seconds; every elevation grows by `elevation_fix_deg`.

    Raises InputError as `read_cloud`.
    """
    cloud, warnings = read_cloud(path, columns=KITTI_COLUMNS)
    azimuth = np.arctan2(cloud.xyz[:, 1], cloud.xyz[:, 0])
    xyz = raise_elevation(cloud.xyz, elevation_fix_deg) if elevation_fix_deg else cloud.xyz
    time_s = None if sweep_s is None else times_from_azimuth(azimuth, sweep_s)
    ring = rings_from_azimuth(azimuth)
    if ring is None:
        warnings += (f"{path.name}: rings not recovered: the points are not in the order of the sensor",)
    return replace(cloud, xyz=xyz, ring=ring, time_s=time_s), warnings


def rings_from_azimuth(azimuth: Float) -> Int | None:
    """Return the ring (N,) of points in file order from their azimuths (N,) in radians; 0 is the highest.

    Rows come ring by ring, highest first, each counter-clockwise from straight ahead: a drop of the azimuth (in
    0..2 pi) by more than pi starts the next ring. None if that gives no plausible number of rings.
    """
    turn = np.mod(azimuth, 2 * np.pi)
    ring = np.cumsum(np.diff(turn, prepend=turn[:1]) < -np.pi, dtype=np.int64)
    return ring if len(ring) and ring[-1] + 1 in _PLAUSIBLE_RINGS else None


def times_from_azimuth(azimuth: Float, sweep_s: float) -> Float:
    """Return when each azimuth (N,), in -pi..pi radians, was measured, in seconds from straight ahead (N,).

    The unit spins clockwise seen from above: the left side (positive azimuth) comes before straight ahead.
    """
    return np.asarray(-azimuth / (2 * np.pi) * sweep_s)


def raise_elevation(xyz: Float, angle_deg: float) -> Float:
    """Return points (N, 3) with every elevation raised by `angle_deg`, ranges and azimuths kept."""
    flat = np.hypot(xyz[:, 0], xyz[:, 1])
    cos, sin = np.cos(np.radians(angle_deg)), np.sin(np.radians(angle_deg))
    scale = cos - sin * xyz[:, 2] / np.where(flat > 0, flat, np.inf)
    return np.column_stack([xyz[:, :2] * scale[:, None], xyz[:, 2] * cos + flat * sin])


def compensated(cloud: Cloud, twist: Float | None, *, asked: bool, lacking: str) -> tuple[Cloud, tuple[str, ...]]:
    """Return a sweep motion-compensated for its velocity (6,), or as it is with a remark why not.

    `asked` says whether it shall be, `lacking` what there is no velocity for want of.
    """
    if asked and twist is not None:
        return cloud.untwisted(twist), ()
    return cloud, (NOT_UNTWISTED + (f": {lacking}" if asked else ""),)
