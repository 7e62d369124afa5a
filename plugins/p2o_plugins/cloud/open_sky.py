"""Where a sweep looks into the open: gaps that hang together with the sky, and that no ground explains.

Outlines of poles, roofs and lamps against the sky have no return behind them. Where the beams beside them went into the
open, that is an occlusion edge against something infinitely far.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from p2o.arrays import Bool, Float, Int
from scipy import ndimage

from p2o_plugins.cloud.sweep import Single, Sweep

FAR_M = np.float32(1e4)
"""The range that beams into the open get."""

_TURN = 2 * np.pi
_COLUMNS_A_TURN = 900
"""Columns are 0.4 degrees wide."""
_CRACK = 3
"""Columns: gaps between leaves, and returns that were lost, are no wider."""
_BEAMS_A_GAP = 2.5
"""Narrower gaps are returns that were lost."""


def opened(sweep: Sweep, beam: float, least_gap_deg: float, ground: Float | None, ground_m: float) -> Sweep:
    """Return the sweep with a return `FAR_M` away for every beam that went into the open.

    A beam did so where it lies in a gap of its ring at least `least_gap_deg` wide that hangs together with what the
    highest ring misses, where some ring below has a return (the sensor looks there at all), and where it would not have
    met the `ground` plane (a, b, c, d), ax + by + cz + d metres above it, within `ground_m`. Windows and dark walls are
    surrounded by other returns, dark cars lie in front of the ground. `beam` is the step from beam to beam in rad. Rows
    of the added returns have `point` -1: they have no place.
    """
    ring, azimuth, start = _in_gaps(sweep, beam, max(np.radians(least_gap_deg), _BEAMS_A_GAP * beam))
    rings = len(sweep.slope)
    column = _column(azimuth)
    keep = _sky(sweep, rings)[ring, column] & _filled_below(sweep, rings)[ring, column]
    if ground is not None and keep.any():
        keep &= ~_meets_ground(sweep.slope[ring], azimuth, ground, ground_m)
    # What is left of a gap is open only where it is wide enough by itself.
    keep &= _wide_runs(keep, start, max(1, round(np.radians(least_gap_deg) / beam)))
    ring, azimuth = ring[keep], azimuth[keep]
    count = len(ring)
    both_ring, both_azimuth = np.concatenate([sweep.ring, ring]), np.concatenate([sweep.azimuth, azimuth])
    order = np.argsort(both_ring * _TURN + both_azimuth, kind="stable")
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
    """Return ring and azimuth of every beam that should have been in a gap, and the number of its gap."""
    first, end = sweep.start[:-1], sweep.start[1:]
    some = end > first
    after = np.arange(1, len(sweep) + 1)
    after[end[some] - 1] = first[some]
    gap = sweep.azimuth[after] - sweep.azimuth
    gap = np.where(gap <= 0, gap + np.float32(_TURN), gap)
    rows = np.flatnonzero(gap > least)
    count = np.maximum(np.rint(gap[rows] / beam).astype(np.int64) - 1, 0)
    number = np.repeat(np.arange(len(rows)), count)
    step = np.arange(count.sum()) - np.repeat(np.cumsum(count) - count, count) + 1
    # Evenly from one end to the other, so that the first and the last lie one beam away from what was met.
    azimuth = sweep.azimuth[rows][number] + step * (gap[rows] / (count + 1))[number]
    azimuth = np.mod(azimuth, _TURN).astype(np.float32)
    azimuth[azimuth >= np.float32(_TURN)] = 0.0
    return sweep.ring[rows][number], azimuth, number


def _column(azimuth: Single) -> Int:
    column: Int = (azimuth * (_COLUMNS_A_TURN / _TURN)).astype(np.int64) % _COLUMNS_A_TURN
    return column


def _met(sweep: Sweep, rings: int) -> Bool:
    met = np.zeros((rings, _COLUMNS_A_TURN), bool)
    met[sweep.ring, _column(sweep.azimuth)] = True
    return met


def _sky(sweep: Sweep, rings: int) -> Bool:
    """Return in which columns (rings, columns) each ring looks into the sky.

    These are cells without returns that hang together with some of the highest ring by more than a crack, and the
    columns beside them: outlines lean.
    """
    free = ~_met(sweep, rings)
    wide = np.concatenate([free[:, -_CRACK:], free, free[:, :_CRACK]], axis=1)
    wide = ndimage.binary_opening(np.pad(wide, ((1, 1), (0, 0)), mode="edge"), np.ones((2, _CRACK), bool))[1:-1]
    label, _ = ndimage.label(wide)
    top = np.unique(label[0])
    sky = np.isin(label, top[top > 0])
    # The seam is no border.
    sky = (sky | np.roll(sky, _COLUMNS_A_TURN, axis=1) | np.roll(sky, -_COLUMNS_A_TURN, axis=1))[:, _CRACK:-_CRACK]
    return ndimage.binary_dilation(sky, np.ones((1, 3), bool))


def _filled_below(sweep: Sweep, rings: int) -> Bool:
    """Return in which columns (rings, columns) something was met by a ring below."""
    below = np.zeros((rings, _COLUMNS_A_TURN), bool)
    below[:-1] = np.logical_or.accumulate(_met(sweep, rings)[::-1], axis=0)[::-1][1:]
    return below


def _meets_ground(slope: Float, azimuth: Single, ground: Float, ground_m: float) -> Bool:
    """Return which beams from the origin meet the ground plane within `ground_m`."""
    way = np.column_stack([np.cos(azimuth), np.sin(azimuth), slope])
    falling = -(way / np.linalg.norm(way, axis=1, keepdims=True)) @ ground[:3]
    meets: Bool = falling * ground_m > ground[3]
    return meets


def _wide_runs(keep: Bool, gap: Int, least: int) -> Bool:
    """Return which of the kept beams have so many kept ones beside each other in their gap."""
    if not len(keep):
        return keep
    begins = np.append(True, (keep[1:] != keep[:-1]) | (gap[1:] != gap[:-1]))
    run = np.cumsum(begins) - 1
    wide: Bool = np.bincount(run)[run] >= least
    return wide
