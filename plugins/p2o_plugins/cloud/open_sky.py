"""Detect beams without return because of open sky: gaps connected with the sky that the ground does not explain.

Outlines of poles, roofs and lamps against the sky have no return behind them. If the beams beside them met no surface,
the outline is an occlusion edge against a background at infinity.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from p2o import Bool, Float, Int, UInt8

from p2o_plugins.cloud.sweep import TURN, Single, Sweep

FAR_M = np.float32(1e4)
"""Range assigned to beams into open space, in metres."""

_COLUMNS_A_TURN = 900
"""Number of azimuth columns, each 0.4 degrees wide."""
_CRACK = 3
"""Maximum width of gaps between leaves and of lost returns, in columns."""
_BEAMS_A_GAP = 2.5
"""Gaps narrower than this are lost returns."""


def opened(sweep: Sweep, beam: float, least_gap_deg: float, ground: Float | None, ground_m: float) -> Sweep:
    """Return the sweep with a return at the range `FAR_M` added for every beam into open space.

    A beam is open if its gap on the ring is at least `least_gap_deg` wide and connected with the gaps of the highest
    ring, if some lower ring has a return in the same direction (the direction is within the field of view), and if the
    beam does not intersect the `ground` plane (a, b, c, d), ax + by + cz + d metres above it, within `ground_m`.
    Windows and dark walls are surrounded by other returns; dark cars occlude the ground. `beam` is the step from beam
    to beam in rad. Rows of the added returns have `point` -1, because they have no position.
    """
    ring, azimuth, start = _in_gaps(sweep, beam, max(np.radians(least_gap_deg), _BEAMS_A_GAP * beam))
    rings = len(sweep.slope)
    column = _column(azimuth)
    keep = _sky(sweep, rings)[ring, column] & _filled_below(sweep, rings)[ring, column]
    if ground is not None and keep.any():
        keep &= ~_meets_ground(sweep.slope[ring], azimuth, ground, ground_m)
    # The rest of a gap is open only if it is wide enough alone.
    keep &= _wide_runs(keep, start, max(1, round(np.radians(least_gap_deg) / beam)))
    ring, azimuth = ring[keep], azimuth[keep]
    count = len(ring)
    both_ring, both_azimuth = np.concatenate([sweep.ring, ring]), np.concatenate([sweep.azimuth, azimuth])
    order = np.argsort(both_ring * TURN + both_azimuth, kind="stable")
    far = np.full(count, FAR_M)
    return replace(
        sweep,
        point=np.concatenate([sweep.point, np.full(count, -1)])[order],
        range_m=np.concatenate([sweep.range_m, far])[order],
        flat_m=np.concatenate([sweep.flat_m, far])[order],
        azimuth=both_azimuth[order],
        ring=both_ring[order],
        start=np.searchsorted(both_ring[order], np.arange(rings + 1)),
    )


def _in_gaps(sweep: Sweep, beam: float, least: float) -> tuple[Int, Single, Int]:
    """Return ring and azimuth of every beam expected in a gap, and the number of its gap."""
    first, end = sweep.start[:-1], sweep.start[1:]
    some = end > first
    after = np.arange(1, len(sweep) + 1)
    after[end[some] - 1] = first[some]
    gap = sweep.azimuth[after] - sweep.azimuth
    gap = np.where(gap <= 0, gap + np.float32(TURN), gap)
    rows = np.flatnonzero(gap > least)
    count = np.maximum(np.rint(gap[rows] / beam).astype(np.int64) - 1, 0)
    number = np.repeat(np.arange(len(rows)), count)
    step = np.arange(count.sum()) - np.repeat(np.cumsum(count) - count, count) + 1
    # Beams are evenly spaced, so that the first and the last are one beam away from the returns at both ends.
    azimuth = sweep.azimuth[rows][number] + step * (gap[rows] / (count + 1))[number]
    azimuth = np.mod(azimuth, TURN).astype(np.float32)
    azimuth[azimuth >= np.float32(TURN)] = 0.0
    return sweep.ring[rows][number], azimuth, number


def _column(azimuth: Single) -> Int:
    column: Int = (azimuth * (_COLUMNS_A_TURN / TURN)).astype(np.int64) % _COLUMNS_A_TURN
    return column


def _met(sweep: Sweep, rings: int) -> Bool:
    met = np.zeros((rings, _COLUMNS_A_TURN), bool)
    met[sweep.ring, _column(sweep.azimuth)] = True
    return met


def _sky(sweep: Sweep, rings: int) -> Bool:
    """Return a mask (rings, columns) of the columns in which each ring is directed at the sky.

    These are cells without returns that are connected with cells of the highest ring by more than a crack, and the
    columns beside them, because outlines may be inclined.
    """
    import cv2

    free = ~_met(sweep, rings)
    wide = np.concatenate([free[:, -_CRACK:], free, free[:, :_CRACK]], axis=1)
    _, label = cv2.connectedComponents(_opened(np.pad(wide, ((1, 1), (0, 0)), mode="edge"))[1:-1], connectivity=4)
    top = np.unique(label[0])
    sky = np.isin(label, top[top > 0])
    # Connect the components across the azimuth seam.
    sky = (sky | np.roll(sky, _COLUMNS_A_TURN, axis=1) | np.roll(sky, -_COLUMNS_A_TURN, axis=1))[:, _CRACK:-_CRACK]
    return np.asarray(cv2.dilate(sky.astype(np.uint8), np.ones((1, 3), np.uint8)), bool)


def _opened(mask: Bool) -> UInt8:
    """Return the union of the rectangles of two rings and `_CRACK` columns that lie within a mask, as 0 and 1."""
    import cv2

    kernel = np.ones((2, _CRACK), np.uint8)
    # Each corner is marked whose rectangle is within the mask, and then the rectangle of each mark.
    outside: dict[str, Any] = {"borderType": cv2.BORDER_CONSTANT, "borderValue": 0}
    corners = cv2.erode(mask.astype(np.uint8), kernel, anchor=(0, 0), **outside)
    return np.asarray(cv2.dilate(corners, kernel, anchor=(_CRACK - 1, 1), **outside))


def _filled_below(sweep: Sweep, rings: int) -> Bool:
    """Return a mask (rings, columns) of the columns in which a lower ring has a return."""
    below = np.zeros((rings, _COLUMNS_A_TURN), bool)
    below[:-1] = np.logical_or.accumulate(_met(sweep, rings)[::-1], axis=0)[::-1][1:]
    return below


def _meets_ground(slope: Float, azimuth: Single, ground: Float, ground_m: float) -> Bool:
    """Return a mask of the beams from the origin that intersect the ground plane within `ground_m`."""
    ray = np.column_stack([np.cos(azimuth), np.sin(azimuth), slope])
    falling = -(ray / np.linalg.norm(ray, axis=1, keepdims=True)) @ ground[:3]
    meets: Bool = falling * ground_m > ground[3]
    return meets


def _wide_runs(keep: Bool, gap: Int, least: int) -> Bool:
    """Return a mask of the kept beams that have at least N consecutive kept beams in their gap."""
    if not len(keep):
        return keep
    begins = np.append(True, (keep[1:] != keep[:-1]) | (gap[1:] != gap[:-1]))
    run = np.cumsum(begins) - 1
    wide: Bool = np.bincount(run)[run] >= least
    return wide
