"""Estimate the ring of each point of a sweep from the order of its points or from their elevations."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from p2o.arrays import Float, Int
from p2o.errors import InputError
from p2o.frames.cloud import Cloud

Single = NDArray[np.float32]

NEIGHBOUR_GAP = float(np.radians(0.6))
"""Azimuth in rad up to which returns of one ring are neighbours, whatever the step of the sweep."""
_WIDEST_GAP = float(np.radians(5.0))
_TURN = 2 * np.pi
_MOST_SCATTER = 0.25
"""Maximum variance of the elevation within rings, relative to the variance of all returns."""
_SAME_START, _SAME_VARIANCE = 0.02, 0.5
"""Starts of the rings have equal variances up to this share of the squared step between rings, and similar ones up to
this share of the variance."""
_SEAM = np.radians(30.0)
"""Rings start within this azimuth of each other: an OS0's beams are 22 degrees apart, and returns may be missing."""
# Candidate steps in elevation between rings, as tangents (the smallest that fits is used); minimum number of returns
# per ring; maximum number of rings; maximum share of returns between rings.
_STEPS, _FEWEST, _MOST_RINGS, _BETWEEN = np.geomspace(2e-4, 2e-2, 12), 5, 256, 0.03
_CLEAR = 3.0
"""Minimum ratio of the step in elevation between rings to the scatter within them, for rings that start at it."""


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


def neighbour_gap(gap: Float | Single, least: float = NEIGHBOUR_GAP) -> float:
    """Return the widest azimuth in rad between neighbours on a ring, from the gaps (N,) rad of all returns.

    It is 1.4 steps from column to column, at most 5 degrees, and at least `least`. The step is the median gap; single
    missing returns, sectors without returns, and pulses within less than half a step do not change it.
    """
    gap = gap[gap > 0]
    if not len(gap):
        return least
    # Means are of the gaps that are no sector without returns.
    usual = gap[gap <= 20 * np.median(gap)]
    step = float(np.median(usual[usual >= 0.5 * usual.mean()]))
    return max(least, min(1.4 * step, _WIDEST_GAP))


def azimuth_gaps(azimuth: Float, ring: Int) -> Float:
    """Return the angle (N,) rad from each return to the next one on its ring, from azimuths (N,) rad and rings (N,)."""
    turn = np.mod(azimuth, _TURN)
    order = np.lexsort((turn, ring))
    first = np.flatnonzero(np.diff(ring[order], prepend=-1))
    after = np.arange(1, len(order) + 1)
    after[np.append(first[1:], len(order)) - 1] = first
    gap: Float = np.mod(turn[order[after]] - turn[order], _TURN)
    return gap


def told_rings(azimuth: Single, rise: Single) -> tuple[Int, str]:
    """Return the ring (N,) of points from azimuth (N,) rad in [0, 2 pi) and `rise` (N,), and the source as text.

    `rise` is the tangent of the elevation. Each ring must have one elevation, as for beams that intersect in the
    origin, or points must be ordered by ring. Raises RingsUnknownError otherwise.
    """
    # Distinct elevations determine the rings exactly; the order of the points does not where rings overlap in azimuth.
    level = _by_elevation(rise)
    if level is not None:
        return level, "the elevations of the points"
    label = _by_order(azimuth, rise)
    if not isinstance(label, str):
        return label, "the order of the points"
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

    `rise` is the tangent of the elevation. Rings may rotate in either direction and start ahead, behind, at the first
    point or where the elevation changes most: the start with the least variance of the elevation within rings is used,
    ahead if they are similar.
    """
    step = np.diff(azimuth)
    if len(step) and np.count_nonzero((step > 0) == (np.abs(step) < np.pi)) < 0.5 * len(step):
        azimuth = np.where(azimuth > 0, np.float32(_TURN) - azimuth, azimuth)
    candidates: list[_Candidate] = []
    for origin in dict.fromkeys((0.0, np.pi, float(azimuth[0]), *_steepest(azimuth, rise))):
        seen = azimuth
        if origin:
            seen = azimuth - np.float32(origin)
            seen[seen < 0] += np.float32(_TURN)
        begin = _ring_starts(seen, rise)
        if len(begin):
            candidates.append(_Candidate.of(begin, rise))
    if not candidates:
        return "the azimuth does not run round ring by ring"
    best = min(candidates, key=lambda entry: entry.variance)
    # A share f of each ring in the wrong label adds f (1 - f) of the squared step between rings to the variance.
    enough = best.variance + _SAME_START * best.step**2
    equal = [entry for entry in candidates if entry.variance <= enough]
    similar = [entry for entry in candidates if entry.variance <= enough + _SAME_VARIANCE * best.variance]
    # At the start of a ring the elevation changes by the step between rings, or less where rings are unevenly spaced.
    at_step = (entry for low in (0.7, 0.35) for entry in similar if low < entry.step_at_start / entry.step < 1.4)
    chosen = next(at_step, equal[0])
    if chosen.variance <= _MOST_SCATTER * max(float(np.var(rise)), 1e-12):
        return chosen.label
    return f"{chosen.label[-1] + 1} rings read from the azimuth hold returns of very different elevation"


@dataclass(frozen=True, eq=False)
class _Candidate:
    """Rings of one start: labels (N,), variance of `rise` within rings, its step between rings, and at their starts."""

    label: Int
    variance: float
    step: float
    step_at_start: float

    @classmethod
    def of(cls, begin: Int, rise: Single) -> _Candidate:
        """Return the rings that begin at points (R,), of points with the tangents `rise` (N,) of their elevations."""
        label = np.zeros(len(rise), np.int64)
        label[begin] = 1
        np.cumsum(label, out=label)
        mean = np.bincount(label, rise) / np.bincount(label)
        variance, step = np.mean((rise - mean[label]) ** 2), np.median(np.abs(np.diff(mean)))
        return cls(
            label, float(variance), max(float(step), 1e-12), float(np.median(np.abs(rise[begin] - rise[begin - 1])))
        )


def _steepest(azimuth: Single, rise: Single) -> list[float]:
    """Return the azimuth in rad around which the elevation changes most, in the median of all turns, if there is one.

    `azimuth` (N,) rad increases along a ring.
    """
    step = np.diff(azimuth, prepend=azimuth[:1])
    furthest = np.maximum.accumulate(np.cumsum(step - _TURN * np.rint(step / _TURN), dtype=np.float64))
    turns = int(furthest[-1] // _TURN) if len(furthest) else 0
    if turns < 3:
        return []
    angle = np.arange(36) * (_TURN / 36)
    point = np.searchsorted(furthest, angle + _TURN * np.arange(1, turns - 1)[:, None])
    height = rise[np.minimum(point, len(rise) - 1)]
    change = np.median(np.abs(np.roll(height, -2, axis=1) - np.roll(height, 2, axis=1)), axis=0)
    middle = np.angle(np.sum(np.exp(1j * angle) * (change > 0.5 * change.max())))
    return [float(np.mod(azimuth[0] + middle, _TURN))]


def _ring_starts(seen: Single, rise: Single) -> Int:
    """Return the first point of each ring but the first; none if the azimuths do not run round ring by ring.

    `seen` (N,) rad are azimuths from the start of the rings. A decrease by more than half the covered angle completes a
    turn, and a step back across the start takes it back: rings whose first returns are spread around the start cross it
    several times. Near each completed turn, the ring starts at the step of the elevation if that is unambiguous, else
    where the azimuth goes back.
    """
    step = np.diff(seen)
    half = 0.5 * float(np.ptp(seen))
    returned = (step > half) & (seen[:-1] < _SEAM) & (seen[1:] > _TURN - _SEAM)
    turned = (step < -half).astype(np.int64) - returned
    turn = np.cumsum(np.append(0, turned))
    turn -= turn.min()
    turns = int(turn.max())
    if turns == 0 or np.count_nonzero((step < 0) & (turned == 0)) > 0.05 * len(step):
        return np.zeros(0, np.int64)
    unrolled, whole = seen + _TURN * turn, _TURN * np.arange(1, turns + 1)
    # A step back is where a ring starts before the last one has ended, and counts before the first crossing of a turn.
    crossed = np.flatnonzero(turned)
    of, forward = np.maximum(turn[crossed], turn[crossed + 1]), turned[crossed] > 0
    best = np.lexsort((crossed, forward, of))
    begin = crossed[best[np.searchsorted(of[best], np.arange(1, turns + 1))]] + 1
    first = np.searchsorted(np.maximum.accumulate(unrolled), whole - _SEAM)
    end = np.searchsorted(np.minimum.accumulate(unrolled[::-1])[::-1], whole + _SEAM)
    levels = np.full((turns, 4), np.nan)
    for k in np.flatnonzero((first < begin) & (begin < end)):
        levels[k] = _two_levels(rise[first[k] : end[k]].astype(np.float64), begin[k] - first[k])
    near, (at, change, spread, spread_here) = np.isfinite(levels[:, 0]), levels.T
    typical = float(np.median(change[near])) if near.any() else 0.0
    clear = near.any() and typical > _CLEAR * float(np.median(spread[near]))
    if clear:
        better = near & (spread_here > 4 * spread)
        begin[better] = first[better] + at[better].astype(np.int64)
    # Returns of the first ring before the start of the file, or of the last one after its end, are no ring.
    count = np.diff(begin, prepend=0, append=len(seen))
    few = 0.05 * float(np.median(count))
    stray = near & ((change < 0.5 * typical) if clear else (np.minimum(count[:-1], count[1:]) < few))
    last, head = end[-1] == len(seen) and stray[-1], first[0] == 0 and stray[0]
    starts: Int = begin[int(head) : turns - int(last)]
    return starts


def _two_levels(height: Float, here: int) -> tuple[float, float, float, float]:
    """Split heights (N,) into two levels by least squares.

    Return the size of the first part, the difference of the levels, the standard deviation from them, and that of the
    split at `here`.
    """
    before, total = np.arange(1, len(height)), np.cumsum(height)
    after = len(height) - before
    mean, other = total[:-1] / before, (total[-1] - total[:-1]) / after
    rest = np.sqrt(np.maximum(np.mean(height**2) - (before * mean**2 + after * other**2) / len(height), 0.0))
    split = int(np.argmin(rest))
    return split + 1, float(np.abs(mean - other)[split]), float(rest[split]), float(rest[here - 1])


def _by_elevation(rise: Single) -> Int | None:
    """Return the ring (N,), 0 the lowest, of points with few distinct elevations; None otherwise.

    Rings are the clusters of the elevations; a few returns between them, from noise of the angles, are of the nearest.
    """
    order = np.argsort(rise, kind="stable")
    height = rise[order].astype(np.float64)
    reach = len(height) // (_MOST_RINGS * 60)
    around = np.full(len(height), np.inf)
    around[reach : len(height) - reach] = height[2 * reach :] - height[: len(height) - 2 * reach]
    for least in _STEPS:
        dense = height[around <= 2 * least]
        if len(dense) < (1 - _BETWEEN) * len(height):
            continue
        new = np.flatnonzero(np.diff(dense) > least)
        if not 1 <= len(new) < min(_MOST_RINGS, len(rise) // _FEWEST):
            continue
        low, high = dense[np.append(0, new + 1)], dense[np.append(new, len(dense) - 1)]
        if np.max(high - low) < np.min(low[1:] - high[:-1]):
            label = np.empty(len(rise), np.int64)
            label[order] = np.searchsorted(0.5 * (low[1:] + high[:-1]), height)
            return label
    return None
