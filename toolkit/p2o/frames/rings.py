"""Estimate the ring of each point of a sweep from the order of its points or from their elevations."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from p2o.arrays import Int
from p2o.errors import InputError
from p2o.frames.cloud import Cloud

Single = NDArray[np.float32]

_TURN = 2 * np.pi
_MOST_SCATTER = 0.25
"""Maximum variance of the elevation within rings, relative to the variance of all returns."""
# Candidate steps in elevation between rings, as tangents (the smallest that fits is used); minimum ratio of the step to
# the scatter within a ring; minimum number of returns per ring; maximum number of rings.
_STEPS, _CLEAR, _FEWEST, _MOST_RINGS = np.geomspace(2e-4, 2e-2, 12), 3.0, 5, 256


class RingsUnknownError(InputError):
    """The rings of a cloud are neither given nor observable from the order or the elevations of its points."""


def rings_of(cloud: Cloud) -> tuple[Int, str]:
    """Return the ring (N,) of each point, 0, 1, 2, ..., and the source as text, empty if the cloud has rings.

    Raises RingsUnknownError as `told_rings`.
    """
    if cloud.ring is not None:
        return np.unique(cloud.ring, return_inverse=True)[1], ""
    x, y, z = cloud.as_measured().T.astype(np.float32)
    return told_rings(np.mod(np.arctan2(y, x), np.float32(_TURN)), z / np.maximum(np.hypot(x, y), np.float32(1e-6)))


def told_rings(azimuth: Single, rise: Single) -> tuple[Int, str]:
    """Return the ring (N,) of points from azimuth (N,) rad in [0, 2 pi) and `rise` (N,), and the source as text.

    `rise` is the tangent of the elevation. Points must be ordered by ring, or each ring must have one elevation, as for
    beams that intersect in the origin. Raises RingsUnknownError otherwise.
    """
    label = _by_order(azimuth, rise)
    if not isinstance(label, str):
        return label, "the order of the points"
    level = _by_elevation(rise)
    if level is not None:
        return level, "the elevations of the points"
    raise RingsUnknownError(
        "the rings of the cloud are not observable",
        where="rings",
        expected="a `ring` per point, points in file order ring by ring (as KITTI stores them), or rings of distinct "
        "elevations",
        got=f"{len(azimuth)} points without `ring`: {label}",
        hint="pass the ring (channel, laser_id, row) field of the sensor driver as Cloud.ring, or do without: "
        "--extractor p2ornet/range-view",
    )


def _by_order(azimuth: Single, rise: Single) -> Int | str:
    """Return the ring (N,) of points ordered by ring, from azimuth (N,) rad in [0, 2 pi) and `rise` (N,), or a reason.

    `rise` is the tangent of the elevation. A new ring starts where the azimuth decreases by more than half the covered
    angle. Rings may rotate in either direction and start ahead, behind or at the first point: the start with the
    largest steps of elevation between rings is used, ahead if the steps are similar.
    """
    step = np.diff(azimuth)
    if len(step) and np.count_nonzero((step > 0) == (np.abs(step) < np.pi)) < 0.5 * len(step):
        azimuth = np.where(azimuth > 0, np.float32(_TURN) - azimuth, azimuth)
    most, label, rings, why = -1.0, None, 0, "the azimuth does not run round ring by ring"
    for origin in dict.fromkeys((0.0, np.pi, float(azimuth[0]))):
        seen = azimuth
        if origin:
            seen = azimuth - np.float32(origin)
            seen[seen < 0] += np.float32(_TURN)
        step = np.diff(seen)
        new = step < -0.5 * float(np.ptp(seen))
        begin = np.flatnonzero(new)
        back = np.count_nonzero(step < 0) - len(begin)
        if len(begin) == 0 or back > 0.05 * len(step):
            continue
        jump = float(np.median(np.abs(rise[begin + 1] - rise[begin])))
        if jump > 2 * most:
            most, rings, label = jump, len(begin) + 1, np.zeros(len(azimuth), np.int64)
            np.cumsum(new, out=label[1:])
    if label is not None:
        mean = np.bincount(label, rise) / np.bincount(label)
        scatter = float(np.mean((rise - mean[label]) ** 2) / max(float(np.var(rise)), 1e-12))
        if scatter <= _MOST_SCATTER:
            return label
        why = f"{rings} rings read from the azimuth hold returns of very different elevation"
    return why


def _by_elevation(rise: Single) -> Int | None:
    """Return the ring (N,), 0 the lowest, of points with few distinct elevations; None otherwise."""
    order = np.argsort(rise, kind="stable")
    height = rise[order].astype(np.float64)
    step = np.diff(height)
    for least in _STEPS:
        new = np.flatnonzero(step > least)
        if not 1 <= len(new) < min(_MOST_RINGS, len(rise) // _FEWEST):
            continue
        first, last = np.append(0, new + 1), np.append(new, len(rise) - 1)
        if np.max(height[last] - height[first]) * _CLEAR < np.min(step[new]):
            label = np.empty(len(rise), np.int64)
            label[order] = np.cumsum(np.append(False, step > least))
            return label
    return None
