"""Read sweeps of KITTI's Velodyne HDL-64E and reconstruct their rings, times and motion compensation."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from p2o import Cloud, Float, Int

from p2o_datasets.bin_file import KITTI_COLUMNS
from p2o_datasets.cloud_file import read_cloud

SWEEP_S = 0.1
"""Nominal duration of a revolution; the LiDAR rotates at 9.68 to 10 Hz."""
IMAGE_DELAY_S = 0.004
"""Time of KITTI's images after the LiDAR points straight ahead.

Measured: motion-compensated sweeps of fast `train` drives (0028, 0015, 0032 with 0056) fit the edges of the images best
3.7, 3.8 and 2.2 ms after, and their calibrations have no error along the road at 4.6, 4.6 and 2.3 ms
(`docs/benchmarks.md`).
"""
NOT_UNTWISTED = "the sweep is raw, and the velocity of the vehicle is unknown"
"""Remark on frames whose sweep is raw."""
# Sweeps cut to a sector may lack whole rings; more than 64 indicate that points are not in the order of the LiDAR.
_PLAUSIBLE_RINGS = range(32, 65)


def read_sweep(path: Path, *, sweep_s: float | None, elevation_fix_deg: float = 0.0) -> tuple[Cloud, tuple[str, ...]]:
    """Return a KITTI sweep (.bin) with rings, with times unless `sweep_s` is None, and warnings.

    `sweep_s` is the duration of a revolution in seconds; `elevation_fix_deg` is added to every elevation. Raises
    InputError as `read_cloud`.
    """
    cloud, warnings = read_cloud(path, columns=KITTI_COLUMNS)
    azimuth = np.arctan2(cloud.xyz[:, 1], cloud.xyz[:, 0])
    xyz = raise_elevation(cloud.xyz, elevation_fix_deg) if elevation_fix_deg else cloud.xyz
    time_s = None if sweep_s is None else times_from_azimuth(azimuth, sweep_s)
    ring = rings_from_azimuth(azimuth)
    if ring is None:
        warnings += (f"{path.name}: rings not recovered: the points are not in the order of the LiDAR",)
    return replace(cloud, xyz=xyz, ring=ring, time_s=time_s), warnings


def rings_from_azimuth(azimuth: Float) -> Int | None:
    """Return the rings (N,) of points in file order from their azimuths (N,) in radians; ring 0 is the highest.

    Points are stored ring by ring from the highest, each counter-clockwise from straight ahead, so that a decrease of
    the azimuth (in 0..2 pi) by more than pi starts the next ring. Returns None for an implausible number of rings.
    """
    turn = np.mod(azimuth, 2 * np.pi)
    ring = np.cumsum(np.diff(turn, prepend=turn[:1]) < -np.pi, dtype=np.int64)
    return ring if len(ring) and ring[-1] + 1 in _PLAUSIBLE_RINGS else None


def times_from_azimuth(azimuth: Float, sweep_s: float) -> Float:
    """Return the times (N,) of azimuths (N,) in -pi..pi radians, in seconds after straight ahead.

    The LiDAR rotates clockwise seen from above: the left side (positive azimuth) is measured before straight ahead.
    """
    return np.asarray(-azimuth / (2 * np.pi) * sweep_s)


def raise_elevation(xyz: Float, angle_deg: float) -> Float:
    """Return points (N, 3) with every elevation increased by `angle_deg`, at the same ranges and azimuths."""
    flat = np.hypot(xyz[:, 0], xyz[:, 1])
    cos, sin = np.cos(np.radians(angle_deg)), np.sin(np.radians(angle_deg))
    scale = cos - sin * xyz[:, 2] / np.where(flat > 0, flat, np.inf)
    return np.column_stack([xyz[:, :2] * scale[:, None], xyz[:, 2] * cos + flat * sin])


def compensated(cloud: Cloud, twist: Float | None, *, asked: bool, lacking: str) -> tuple[Cloud, tuple[str, ...]]:
    """Return a sweep compensated for its velocity (6,) if `asked`, else unchanged with a remark.

    `lacking` names the missing input if the velocity is unknown.
    """
    if asked and twist is not None:
        return cloud.untwisted(twist), ()
    return cloud, (NOT_UNTWISTED + (f": {lacking}" if asked else ""),)
