"""Returns in no order: which lie in front, and which are neighbours to the left, right, above and below."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from p2o import Cloud, Side
from p2o.arrays import Bool, Float, Int
from scipy.spatial import cKDTree

from p2o_plugins.cloud.sweep import Neighbours, Returns, Single

_TURN = 2 * np.pi
# Of returns within this angle only the nearest counts: dual returns, double points, several sweeps of one ray.
_SAME_RAY_DEG = 0.01
# First by cells as fine as this, so that many returns of one ray are not compared pair by pair.
_FINE_RAY_DEG = 0.001
# Returns whose spacing is looked at, and how many around each: enough to reach the next ring of 16, ten beams away.
_SAMPLE, _AROUND = 2000, 192
# Returns around each that are looked at, in units of the spacing.
_NEAREST = 24
# A return is hidden where nearer ones lie around it: in so many of the eight directions, within so many spacings.
_ENCLOSED, _AROUND_SPACINGS = 6, 2.5
# Spacings are told from no fewer returns, and are no finer than this.
_FEWEST, _FINEST = 10, np.radians(0.01)


@dataclass(frozen=True, eq=False)
class Scattered(Returns):
    """The returns by rising azimuth, then elevation; of several in one direction the nearest.

    `elevation` (N,) rad. `spacing` (2,) rad: the usual step in azimuth and in elevation from one return to the next.
    """

    elevation: Single
    spacing: Float


@dataclass(frozen=True, eq=False)
class Around:
    """The returns nearest in angle to each return, near ones first.

    `row` (N, K) are their rows; `right` and `up` (N, K) how many spacings they lie to its right and above it;
    `away` (N, K) both together, inf where there is none.
    """

    row: Int
    right: Single
    up: Single
    away: Single


def scattered(cloud: Cloud, origin_m: tuple[float, float, float]) -> Scattered:
    """Return the returns as seen from where the beams start; those on the upright axis there have no azimuth."""
    x, y, z = np.ascontiguousarray((cloud.as_measured() - np.array(origin_m)).T, dtype=np.float32)
    flat = np.sqrt(x * x + y * y)
    azimuth = np.arctan2(y, x)
    azimuth[azimuth < 0] += np.float32(_TURN)
    azimuth[azimuth >= np.float32(_TURN)] = 0.0
    elevation, range_m = np.arctan2(z, flat), np.sqrt(flat * flat + z * z)
    point = np.flatnonzero(flat > 1e-3)
    cell = np.floor(np.column_stack([azimuth[point], elevation[point]]) / np.float32(np.radians(_FINE_RAY_DEG)))
    # By cell, then range, then place, whatever order the points came in.
    order = np.lexsort((elevation[point], azimuth[point], range_m[point], cell[:, 1], cell[:, 0]))
    cell, point = cell[order], point[order]
    point = point[np.append(True, (np.diff(cell, axis=0) != 0).any(axis=1))[: len(point)]]
    point = point[_first_of_ray(azimuth[point], elevation[point], range_m[point])]
    seen = Scattered(cloud, point, range_m[point], flat[point], azimuth[point], elevation[point], np.zeros(2))
    return replace(seen, spacing=_spacing(seen))


def around(seen: Scattered) -> Around:
    """Return what lies around each return."""
    return _around(seen, np.arange(len(seen)), _NEAREST, seen.spacing)


def in_front(seen: Scattered, near: Around, min_jump_m: float, min_jump_share: float) -> Bool:
    """Return which returns (N,) are the surface that is seen; the others lie behind one that goes on around them.

    So do returns of a second sensor, or of other places that were joined, which saw past it.
    """
    r, other = seen.range_m[:, None], seen.range_m[near.row]
    nearer = (other + min_jump_m + min_jump_share * other < r) & (near.away <= _AROUND_SPACINGS)
    eighth = np.rint(np.arctan2(near.up, near.right) / (np.pi / 4)).astype(np.int64) % 8
    covered = np.zeros((len(seen), 8), bool)
    rows, columns = np.nonzero(nearer)
    covered[rows, eighth[rows, columns]] = True
    front: Bool = covered.sum(axis=1) < _ENCLOSED
    return front


def kept(seen: Scattered, near: Around, keep: Bool) -> tuple[Scattered, Around]:
    """Return the returns of a mask (N,), and what of them lies around each; the others count as missing."""
    columns = (seen.point, seen.range_m, seen.flat_m, seen.azimuth, seen.elevation)
    row = near.row[keep]
    away = np.where(keep[row], near.away[keep], np.float32(np.inf))
    number = np.where(keep, np.cumsum(keep) - 1, 0)
    left = Scattered(seen.cloud, *(column[keep] for column in columns), seen.spacing)
    return left, Around(number[row], near.right[keep], near.up[keep], away)


def neighbour(seen: Scattered, near: Around, side: Side, max_spacings: float) -> Neighbours:
    """Return the nearest return in the quarter of directions around a side, and how far it lies to that side.

    Unknown where there is none within `max_spacings`, counted in wider spacings where returns are fewer.
    """
    forward, there = _towards(near, np.arange(len(seen)), side)
    first = there.argmax(axis=1)
    every = np.arange(len(seen))
    fourth = np.partition(near.away, min(3, near.away.shape[1] - 1), axis=1)[:, min(3, near.away.shape[1] - 1)]
    sparse = np.where(np.isfinite(fourth), np.maximum(fourth, 1.0), 1.0)
    known = there[every, first] & (near.away[every, first] <= max_spacings * sparse)
    step = seen.spacing[0 if side in (Side.LEFT, Side.RIGHT) else 1]
    row = np.where(known, near.row[every, first], 0)
    return Neighbours(row, known, (forward[every, first] * step).astype(np.float32))


def ahead_of(near: Around, rows: Int, side: Side, max_spacings: float) -> tuple[Int, Bool]:
    """Return the returns (M, K) around each of `rows` (M,), and which lie on a side of it within `max_spacings`."""
    _, there = _towards(near, rows, side)
    return near.row[rows], there & (near.away[rows] <= max_spacings)


def _first_of_ray(azimuth: Single, elevation: Single, range_m: Single) -> Bool:
    """Return which returns have none nearer in their direction."""
    keep = np.ones(len(azimuth), bool)
    if len(azimuth) < 2:
        return keep
    place = np.column_stack([np.cos(azimuth), np.sin(azimuth), elevation]).astype(np.float64)
    tree = cKDTree(place, balanced_tree=False, compact_nodes=False)
    pairs = tree.query_pairs(np.radians(_SAME_RAY_DEG), output_type="ndarray")
    one, two = pairs.T
    keep[np.where(range_m[one] > range_m[two], one, two)] = False
    return keep


def _towards(near: Around, rows: Int, side: Side) -> tuple[Single, Bool]:
    """Return how far to a side the returns (M, K) around each of `rows` lie, and which within 45 degrees of it."""
    ahead, beside = (near.right, near.up) if side in (Side.LEFT, Side.RIGHT) else (near.up, near.right)
    forward = ahead[rows] if side in (Side.RIGHT, Side.UPPER) else -ahead[rows]
    return forward, (forward > 0) & (np.abs(beside[rows]) <= forward) & np.isfinite(near.away[rows])


def _around(seen: Scattered, rows: Int, count: int, spacing: Float) -> Around:
    """Return the `count` returns nearest to each of `rows` (M,), steps counted in `spacing` (2,) rad.

    Directions are wound around a cylinder, on which azimuth has no seam.
    """
    across, up = spacing
    place = np.column_stack([np.cos(seen.azimuth) / across, np.sin(seen.azimuth) / across, seen.elevation / up]).astype(
        np.float64
    )
    # One more is asked for than there is, so that shapes are the same for few returns: it is infinitely far.
    distance, row = cKDTree(place, balanced_tree=False, compact_nodes=False).query(place[rows], k=count + 1)
    mine = row == rows[:, None]
    # The return itself comes first, but for others in the very same place.
    mine[:, -1] |= ~mine.any(axis=1)
    distance, row = (values[~mine].reshape(len(rows), count) for values in (distance, row))
    there = row < len(seen)
    row = np.where(there, row, 0)
    turn = seen.azimuth[rows, None] - seen.azimuth[row]
    turn = np.where(turn > np.pi, turn - _TURN, np.where(turn < -np.pi, turn + _TURN, turn))
    lift = seen.elevation[row] - seen.elevation[rows, None]
    away = np.where(there, distance, np.inf).astype(np.float32)
    return Around(row, (turn / across).astype(np.float32), (lift / up).astype(np.float32), away)


def _spacing(seen: Scattered) -> Float:
    """Return the usual steps (2,) rad in azimuth and in elevation between neighbours.

    Each is the median way to the nearest return within 45 degrees of level, and of upright. Beams of a ring lie so
    close that the next ring would not be among the nearest, so it is looked for among those that do not lie level.
    """
    if len(seen) < _FEWEST:
        return np.full(2, np.radians(1.0))
    rows = np.unique(np.linspace(0, len(seen) - 1, _SAMPLE).astype(np.int64))
    near = _around(seen, rows, min(_AROUND, len(seen) - 1), np.ones(2))
    level, upright = np.abs(near.right), np.abs(near.up)
    steps = []
    for ahead, beside in ((level, upright), (upright, level)):
        there = (ahead >= beside) & (ahead > 0) & np.isfinite(near.away)
        found = there.any(axis=1)
        first = there.argmax(axis=1)[found]
        steps.append(float(np.median(ahead[found, first])) if found.any() else np.nan)
    across, up = steps
    across = up if np.isnan(across) else across
    up = across if np.isnan(up) else up
    return np.maximum(np.nan_to_num([across, up], nan=np.radians(1.0)), _FINEST)
