"""Order a cloud without rings: visible returns, and the neighbours to the left, right, above and below."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from p2o import Bool, Cloud, Float, Int, Side
from scipy.spatial import cKDTree

from p2o_plugins.cloud.sweep import Neighbours, Returns, Single, azimuth_of, turn_to

# Within this angle only the nearest return is kept: dual returns, duplicates, several sweeps of one ray.
_SAME_RAY_DEG = 0.01
# Returns are first grouped in cells of this size, so that returns of one ray are not compared pairwise.
_FINE_RAY_DEG = 0.001
# Number of returns whose spacing is measured, and of neighbours of each: enough to reach the next ring of 16, ten beams
# away.
_SAMPLE, _AROUND = 2000, 192
# Number of nearest returns per return, with distances in units of the spacing.
_NEAREST = 24
# A return is hidden if nearer returns surround it: in at least N of the eight directions, within M spacings.
_ENCLOSED, _AROUND_SPACINGS = 6, 2.5
# Minimum number of returns to estimate spacings, and lower limit of the spacing.
_FEWEST, _FINEST = 10, np.radians(0.01)


@dataclass(frozen=True, eq=False)
class Scattered(Returns):
    """The returns by increasing azimuth, then elevation; of several in one direction only the nearest.

    `elevation` (N,) rad. `spacing` (2,) rad: the typical step in azimuth and in elevation between neighbouring returns.
    """

    elevation: Single
    spacing: Float


@dataclass(frozen=True, eq=False)
class Around:
    """The returns nearest in angle to each return, in increasing distance.

    `row` (N, K) are their rows; `right` and `up` (N, K) their offsets to the right and upwards in spacings; `away` (N,
    K) the distance of both combined, inf where there is no return.
    """

    row: Int
    right: Single
    up: Single
    away: Single


def scattered(cloud: Cloud, origin_m: tuple[float, float, float]) -> Scattered:
    """Return the returns as seen from the origin of the beams, without those on the vertical axis (no azimuth)."""
    x, y, z = np.ascontiguousarray((cloud.as_measured() - np.array(origin_m)).T, dtype=np.float32)
    flat, azimuth = np.sqrt(x * x + y * y), azimuth_of(x, y)
    elevation, range_m = np.arctan2(z, flat), np.sqrt(flat * flat + z * z)
    point = np.flatnonzero(flat > 1e-3)
    cell = np.floor(np.column_stack([azimuth[point], elevation[point]]) / np.float32(np.radians(_FINE_RAY_DEG)))
    # Sort by cell, then range, then position, so that the result does not depend on the order of the points.
    order = np.lexsort((elevation[point], azimuth[point], range_m[point], cell[:, 1], cell[:, 0]))
    cell, point = cell[order], point[order]
    point = point[np.append(True, (np.diff(cell, axis=0) != 0).any(axis=1))[: len(point)]]
    point = point[_first_of_ray(azimuth[point], elevation[point], range_m[point])]
    seen = Scattered(cloud, point, range_m[point], flat[point], azimuth[point], elevation[point], np.zeros(2))
    return replace(seen, spacing=_spacing(seen))


def around(seen: Scattered) -> Around:
    """Return the neighbours of each return."""
    return _around(seen, np.arange(len(seen)), _NEAREST, seen.spacing)


def in_front(seen: Scattered, near: Around, min_jump_m: float, min_jump_share: float) -> Bool:
    """Return a mask (N,) of the visible returns; the others are behind a surface that continues around them.

    Hidden returns also come from a second sensor, or from other positions of an accumulated sweep, with another
    viewpoint.
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
    """Return the returns of a mask (N,), and their neighbours; the others count as missing."""
    row = near.row[keep]
    away = np.where(keep[row], near.away[keep], np.float32(np.inf))
    number = np.where(keep, np.cumsum(keep) - 1, 0)
    own = {name: getattr(seen, name)[keep] for name in ("point", "range_m", "flat_m", "azimuth", "elevation")}
    return replace(seen, **own), Around(number[row], near.right[keep], near.up[keep], away)


def neighbour(seen: Scattered, near: Around, side: Side, max_spacings: float) -> Neighbours:
    """Return the nearest return in the quadrant around a side, and its distance to that side.

    Unknown if there is none within `max_spacings`, counted in wider spacings where returns are sparser.
    """
    forward, in_quadrant = _towards(near, np.arange(len(seen)), side)
    first = in_quadrant.argmax(axis=1)
    every = np.arange(len(seen))
    fourth = np.partition(near.away, min(3, near.away.shape[1] - 1), axis=1)[:, min(3, near.away.shape[1] - 1)]
    sparse = np.where(np.isfinite(fourth), np.maximum(fourth, 1.0), 1.0)
    known = in_quadrant[every, first] & (near.away[every, first] <= max_spacings * sparse)
    step = seen.spacing[0 if side in (Side.LEFT, Side.RIGHT) else 1]
    row = np.where(known, near.row[every, first], 0)
    return Neighbours(row, known, (forward[every, first] * step).astype(np.float32))


def ahead_of(near: Around, rows: Int, side: Side, max_spacings: float) -> tuple[Int, Bool]:
    """Return the neighbours (M, K) of each of `rows` (M,), and a mask of those on a side within `max_spacings`."""
    _, in_quadrant = _towards(near, rows, side)
    return near.row[rows], in_quadrant & (near.away[rows] <= max_spacings)


def _first_of_ray(azimuth: Single, elevation: Single, range_m: Single) -> Bool:
    """Return a mask of the returns without a nearer one in their direction."""
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
    """Return the distance of the neighbours (M, K) of `rows` to a side, and a mask of those within 45 degrees of it."""
    ahead, beside = (near.right, near.up) if side in (Side.LEFT, Side.RIGHT) else (near.up, near.right)
    forward = ahead[rows] if side in (Side.RIGHT, Side.UPPER) else -ahead[rows]
    return forward, (forward > 0) & (np.abs(beside[rows]) <= forward) & np.isfinite(near.away[rows])


def _around(seen: Scattered, rows: Int, count: int, spacing: Float) -> Around:
    """Return the `count` returns nearest to each of `rows` (M,), with steps in units of `spacing` (2,) rad.

    Directions are mapped to a cylinder, on which azimuth has no seam.
    """
    across, up = spacing
    cylinder = (np.cos(seen.azimuth) / across, np.sin(seen.azimuth) / across, seen.elevation / up)
    place = np.column_stack(cylinder).astype(np.float64)
    # Query one more neighbour than exists, so that shapes are equal for few returns: its distance is infinite.
    tree = cKDTree(place, balanced_tree=False, compact_nodes=False)
    distance, row = map(np.asarray, tree.query(place[rows], k=count + 1))
    mine = row == rows[:, None]
    # The first neighbour is the return itself, unless others have exactly the same position.
    mine[:, -1] |= ~mine.any(axis=1)
    distance, row = (values[~mine].reshape(len(rows), count) for values in (distance, row))
    exists = row < len(seen)
    row = np.where(exists, row, 0)
    turn = turn_to(seen.azimuth[rows, None], seen.azimuth[row])
    lift = seen.elevation[row] - seen.elevation[rows, None]
    away = np.where(exists, distance, np.inf).astype(np.float32)
    return Around(row, (turn / across).astype(np.float32), (lift / up).astype(np.float32), away)


def _spacing(seen: Scattered) -> Float:
    """Return the typical steps (2,) rad in azimuth and in elevation between neighbours.

    Each is the median distance to the nearest return within 45 degrees of the horizontal or the vertical. The beams of
    a ring are so dense that the next ring would not be among the nearest, so that it is searched among the neighbours
    outside the horizontal sector.
    """
    if len(seen) < _FEWEST:
        return np.full(2, np.radians(1.0))
    rows = np.unique(np.linspace(0, len(seen) - 1, _SAMPLE).astype(np.int64))
    near = _around(seen, rows, min(_AROUND, len(seen) - 1), np.ones(2))
    level, upright = np.abs(near.right), np.abs(near.up)
    steps = []
    for ahead, beside in ((level, upright), (upright, level)):
        in_sector = (ahead >= beside) & (ahead > 0) & np.isfinite(near.away)
        any_ahead = in_sector.any(axis=1)
        first = in_sector.argmax(axis=1)[any_ahead]
        steps.append(float(np.median(ahead[any_ahead, first])) if any_ahead.any() else np.nan)
    across, up = steps
    across = up if np.isnan(across) else across
    up = across if np.isnan(up) else up
    return np.asarray(np.maximum(np.nan_to_num([across, up], nan=np.radians(1.0)), _FINEST))
