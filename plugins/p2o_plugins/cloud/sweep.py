"""Order a sweep: the beam of each return, and its neighbouring returns."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from p2o import Bool, Cloud, Float, Int
from p2o.reading import RingsUnknownError, told_rings

from p2o_plugins.cloud.firing_order import rings_in_firing_order

Single = NDArray[np.float32]

TURN = 2 * np.pi
# Two returns of one ring closer than this angle belong to one ray (dual return, duplicate).
_SAME_RAY_DEG = 0.01
# Maximum offset of a sensor's lasers above or below its origin.
_LARGEST_OFFSET_M = 0.3


@dataclass(frozen=True, eq=False)
class Returns:
    """The returns of one sweep in a defined order.

    `point` (N,) is each return's row in the cloud; `range_m` (N,) from the origin of the beams, `flat_m` (N,) from the
    vertical axis through it; `azimuth` (N,) rad in [0, 2 pi), increasing counter-clockwise seen from +z. These are
    single precision: 4 micrometres at 80 m.
    """

    cloud: Cloud
    point: Int
    range_m: Single
    flat_m: Single
    azimuth: Single

    def __len__(self) -> int:
        return len(self.point)

    def xyz(self, rows: Any) -> Float:
        """Return the points (M, 3) m in the LiDAR frame of rows (M,) or a slice."""
        taken: Float = np.take(self.cloud.xyz, self.point[rows], axis=0)
        return taken


@dataclass(frozen=True, eq=False)
class Sweep(Returns):
    """The returns ring by ring from the highest to the lowest, each ring by increasing azimuth.

    `ring` (N,) 0 is the highest; `start` (R + 1,) first row of each ring. `slope` and `offset` (R,): the points of each
    ring are on the cone z = slope * flat_m + offset. Beams start at the origin.
    """

    ring: Int
    start: Int
    slope: Float
    offset: Float

    def gaps(self) -> Single:
        """Return the angle (N,) rad from each return to the next one on its ring, which is closed."""
        first, end = self.start[:-1], self.start[1:]
        first, last = first[end > first], end[end > first] - 1
        gap = np.empty_like(self.azimuth)
        gap[:-1] = np.diff(self.azimuth)
        gap[last] = self.azimuth[first] - self.azimuth[last] + np.float32(TURN)
        return gap


@dataclass(frozen=True, eq=False)
class Neighbours:
    """The next return on one side of each return.

    `row` (N,) is its row; `known` (N,) is False where there is no return (then `row` is arbitrary); `gap` (N,) rad the
    angle between the two beams.
    """

    row: Int
    known: Bool
    gap: Single

    @property
    def median_gap(self) -> float:
        """The median gap of every eighth known neighbour in rad, 0 without any."""
        return float(np.median(self.gap[self.known][::8])) if self.known.any() else 0.0


def order_sweep(cloud: Cloud) -> Sweep:
    """Return the sweep in order; of several returns of one ray only the nearest is kept.

    Rings come from `cloud.ring`, else from the order or the elevations of the points (see `told_rings`), else from the
    cones of a sweep in firing order. Raises RingsUnknownError where they are unknown.
    """
    x, y, z = np.ascontiguousarray(cloud.as_measured().T, dtype=np.float32)
    azimuth = azimuth_of(x, y)
    flat = np.sqrt(x * x + y * y)
    label = _recovered(cloud, azimuth, z / np.maximum(flat, 1e-6)) if cloud.ring is None else _compact(cloud.ring)
    count = int(label.max()) + 1
    slope, offset = _cones(label, flat, z, count)
    top_down = _from_top(slope, np.bincount(label, z / np.maximum(flat, 1e-3)) / np.bincount(label))
    rank = np.empty(count, np.int64)
    rank[top_down] = np.arange(count)
    ring = rank[label]
    range_m = np.sqrt(flat * flat + z * z)
    key = ring * TURN + azimuth
    # Stable sorting merges runs and is therefore fast for points that are already ordered.
    point = np.argsort(key, kind="stable")
    point = point[_nearest_of_ray(range_m[point], flat[point], azimuth[point], ring[point])]
    range_m, flat, azimuth, ring = range_m[point], flat[point], azimuth[point], ring[point]
    start = np.searchsorted(ring, np.arange(count + 1))
    return Sweep(cloud, point, range_m, flat, azimuth, ring, start, slope[top_down], offset[top_down])


def _recovered(cloud: Cloud, azimuth: Single, rise: Single) -> Int:
    """Return the ring (N,) of the points of a cloud without rings; raises RingsUnknownError as `order_sweep`."""
    try:
        return told_rings(azimuth, rise)[0]
    except RingsUnknownError:
        ring = rings_in_firing_order(cloud)
        if ring is None:
            raise
        return ring


def azimuth_of(x: Single, y: Single) -> Single:
    """Return the azimuths of points in rad, in [0, 2 pi)."""
    azimuth = np.arctan2(y, x)
    azimuth[azimuth < 0] += np.float32(TURN)
    azimuth[azimuth >= np.float32(TURN)] = 0.0
    return azimuth


def turn_to(azimuth: Single, other: Single) -> Single:
    """Return the angles from other azimuths to `azimuth` in rad, -pi to pi."""
    turn = azimuth - other
    return np.where(turn > np.pi, turn - TURN, np.where(turn < -np.pi, turn + TURN, turn))


def _compact(label: Int) -> Int:
    """Return labels 0, 1, 2, ... in the order of the given labels."""
    low, high = int(label.min()), int(label.max())
    if high - low > 65535:
        return np.unique(label, return_inverse=True)[1]
    used = np.bincount(label - low, minlength=high - low + 1) > 0
    number: Int = np.cumsum(used) - 1
    return number[label - low]


def _cones(label: Int, flat: Single, z: Single, count: int) -> tuple[Float, Float]:
    """Return slope and offset (R,) of z = slope * flat + offset for each ring, with a zero-mean prior on the offset.

    Sensors whose lasers do not intersect at the origin (HDL-64E: 0.12 to 0.2 m above it) need the offset; if all
    returns of a ring have nearly the same range, offset and slope cannot be separated, and zero is the better estimate.
    """
    d, h = flat.astype(np.float64), z.astype(np.float64)
    n, sd, sz, sdd, sdz = (np.bincount(label, w, minlength=count) for w in (None, d, h, d * d, d * h))
    prior = (0.05 / 0.3) ** 2  # Standard deviations: 5 cm about the cone, 0.3 m of the offsets.
    det = np.maximum(sdd * (n + prior) - sd * sd, 1e-12)
    slope, offset = (sdz * (n + prior) - sd * sz) / det, (sdd * sz - sd * sdz) / det
    # In a motion-corrected sweep a beam intersects flat ground in a plane curve that is not on a cone.
    plane = np.abs(offset) > _LARGEST_OFFSET_M
    return np.where(plane, sdz / np.maximum(sdd, 1e-12), slope), np.where(plane, 0.0, offset)


def _from_top(slope: Float, rise: Float) -> Int:
    """Return the labels from the highest ring to the lowest, by the slopes of their cones or their mean elevation (R,).

    Labels that are monotonic nearly everywhere in one of these take precedence over the fitted slopes, which are
    uncertain for few returns and for motion-corrected sweeps.
    """
    count = len(slope)
    if count > 2:
        for height in (slope, rise):
            falling = float(np.mean(np.diff(height) < 0))
            if falling >= 0.9:
                return np.arange(count)
            if falling <= 0.1:
                return np.arange(count)[::-1]
    return np.argsort(-slope, kind="stable")


def _nearest_of_ray(range_m: Single, flat_m: Single, azimuth: Single, ring: Int) -> Bool:
    """Return a mask of the ordered returns that are the nearest of their ray; those on the z axis have no azimuth."""
    beside: Bool = flat_m > 1e-3
    same = (np.diff(azimuth) < np.radians(_SAME_RAY_DEG)) & (ring[1:] == ring[:-1])
    keep = np.ones(len(ring), bool)
    if same.any():
        touched = np.flatnonzero(np.append(same, False) | np.append(False, same))
        first = np.append(True, ~same)[touched]
        by_range = np.lexsort((np.where(beside, range_m, np.inf)[touched], np.cumsum(first)))
        keep[touched] = False
        keep[touched[by_range[first]]] = True
    return keep & beside


def along_ring(sweep: Sweep, max_gap_deg: float) -> tuple[Neighbours, Neighbours]:
    """Return the left (increasing azimuth) and right neighbours on the ring.

    Unknown where the azimuth gap is wider than `max_gap_deg`. Rings are closed: the last return of a ring has its first
    as left neighbour (on KITTI this seam is straight ahead).
    """
    count = len(sweep)
    left, right = np.arange(1, count + 1), np.arange(-1, count - 1)
    first, end = sweep.start[:-1], sweep.start[1:]
    first, last = first[end > first], end[end > first] - 1
    left[last], right[first] = first, last
    gap = sweep.gaps()
    known = gap <= np.radians(max_gap_deg)
    return Neighbours(left, known, gap), Neighbours(right, known[right], gap[right])


def across_rings(sweep: Sweep, step: int, max_azimuth_deg: float, max_step_deg: float) -> Neighbours:
    """Return the returns nearest in azimuth on the next ring: below for `step` 1, above for -1.

    Unknown where that ring is more than `max_step_deg` away in elevation or has no return within `max_azimuth_deg`.
    `gap` is the angle between the two rings.
    """
    count, rings, reach = len(sweep), len(sweep.slope), np.radians(max_azimuth_deg)
    key = sweep.ring * TURN + sweep.azimuth
    query = key + step * TURN
    # All rings share one sorted list, so that one search returns the position of every return on its next ring.
    place = np.searchsorted(key, query)
    after, before = np.minimum(place, count - 1), np.maximum(place - 1, 0)
    gap_after, gap_before = np.abs(key[after] - query), np.abs(query - key[before])
    row = np.where(gap_before < gap_after, before, after)
    known = np.minimum(gap_before, gap_after) <= reach
    # Near the seam the neighbour may be at the other end of its ring, where the list continues with another ring.
    edge = np.flatnonzero((sweep.azimuth < reach) | (sweep.azimuth > TURN - reach))
    target = np.clip(sweep.ring[edge] + step, 0, rings - 1)
    first, end = sweep.start[target], sweep.start[target + 1]
    filled = np.flatnonzero(end > first)
    first, end, at = first[filled], end[filled], edge[filled]
    size = end - first
    both = first[:, None] + (place[at, None] - first[:, None] + np.array([-1, 0])) % size[:, None]
    away = np.abs(sweep.azimuth[both] - sweep.azimuth[at, None])
    away = np.minimum(away, TURN - away)
    best = away.argmin(axis=1)
    known[edge] = False
    row[at], known[at] = both[np.arange(len(at)), best], away.min(axis=1, initial=np.inf) <= reach
    # At the median range of the returns, where the cones are well determined.
    away_m = np.maximum(np.bincount(sweep.ring, sweep.flat_m, rings) / np.maximum(np.diff(sweep.start), 1), 1.0)
    middle = np.sqrt(away_m[1:] * away_m[:-1])
    above, below = (np.arctan(sweep.slope[part] + sweep.offset[part] / middle) for part in (np.s_[:-1], np.s_[1:]))
    between = np.full(rings, np.inf)
    between[max(0, -step) : rings - max(0, step)] = np.abs(above - below)
    gap = between.astype(np.float32)[sweep.ring]
    return Neighbours(row, known & (gap <= np.radians(max_step_deg)), gap)
