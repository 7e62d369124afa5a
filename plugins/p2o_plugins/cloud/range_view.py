"""Detect directed occlusion edges of a cloud without rings, in the range view from the origin of its beams."""

from __future__ import annotations

import numpy as np
from p2o import Cloud, CloudEdges, CloudExtractor, CloudFeatures, CloudRemarks, Float, Int, Method, Side, field

from p2o_plugins.cloud.ground_plane import ground_plane
from p2o_plugins.cloud.jumps import (
    GRAZING_SHARE,
    MAX_POINTS,
    MIN_JUMP_SHARE,
    SLANT_RATIO,
    JumpOptions,
    edges_of,
    reliable_jumps,
    towards_background,
)
from p2o_plugins.cloud.scattered import Around, Scattered, ahead_of, around, in_front, kept, neighbour, scattered
from p2o_plugins.cloud.sweep import Neighbours, Single, turn_to

_MAX_SPACINGS = 3.0  # farthest neighbour that is not a missing return, in usual steps from one return to the next
_OPEN_SHARE = 0.5
"""Share of the neighbours on the side of an edge that lie further away; with fewer the surface goes on."""


class RangeViewOptions(JumpOptions):
    """Criteria for an occlusion edge of a cloud with unknown rings."""

    origin_m: tuple[float, float, float] = field(
        (0.0, 0.0, 0.0),
        help="Where the beams start, x y z in the cloud's frame, or about where the camera is: merged clouds lie in a "
        "frame of the vehicle, from whose origin nothing was seen.",
    )


def build(options: RangeViewOptions) -> CloudExtractor:
    """Return the extractor."""
    return lambda cloud: range_view_edges(cloud, options)


def range_view_edges(cloud: Cloud, options: RangeViewOptions) -> CloudFeatures:
    """Return the occlusion edges and thinned surface points of an unordered cloud, LiDAR frame, metres.

    Sides, jumps, signs and shifts are those of `rings`; neighbours are the returns nearest in angle within 45 degrees
    of a side. Whether the surface continues beyond a return is decided by the plane through the surrounding returns on
    the opposite side of the neighbour. Returns behind a surface that continues around them are removed first.
    """
    origin = np.array(options.origin_m)
    seen = scattered(cloud, options.origin_m)
    if len(seen) < 2:
        return CloudFeatures(CloudEdges.empty(), seen.xyz(slice(0, MAX_POINTS)))
    near = around(seen)
    front = in_front(seen, near, options.min_jump_m, MIN_JUMP_SHARE)
    remarks = _about_origin(1 - float(front.mean()), options)
    seen, near = kept(seen, near, front)
    neighbours = {side: neighbour(seen, near, side, _MAX_SPACINGS) for side in _SIDES}
    plane = ground_plane(seen) if options.ground_height_m > 0 else None
    step = float(seen.spacing[1])
    parts = []
    for side in _SIDES:
        rows = jumps_between(seen, near, neighbours[side], side, options)
        rows, support = reliable_jumps(seen, neighbours, side, rows, plane, step, options)
        ray = seen.xyz(rows) - origin
        background = towards_background(ray, side)
        # Halfway to the neighbour, counting only the component towards this side.
        gap, own = neighbours[side].gap[rows].astype(np.float64), own_step(seen, near, rows, side, options)
        gap = np.where(gap > _STRIP * own, own, gap)
        gap *= seen.flat_m[rows] if side in _LEVEL else seen.range_m[rows]
        xyz = ray + options.shift_beams * gap[:, None] * background + origin
        parts.append((rows, side, xyz, support, gap / np.sqrt(12), background))
    every = slice(None, None, -(-len(seen) // MAX_POINTS))
    return CloudFeatures(edges_of(seen, parts), seen.xyz(every), features=remarks)


# Maximum fraction of returns that are hidden behind others as seen from the origin of their beams: 2 to 4 % for single
# sensors, 4 to 5 % for merged ones from the centre between them, 9 % and more from the ground below them.
_MOST_HIDDEN = 0.07


def _about_origin(hidden: float, options: RangeViewOptions) -> tuple[CloudRemarks, ...]:
    """Return a warning if more of the returns are hidden than from any place near the sensor."""
    if hidden <= _MOST_HIDDEN:
        return ()
    place = " ".join(f"{v:g}" for v in options.origin_m)
    text = (
        f"{100 * hidden:.0f} % of the points lie behind others, seen from ({place}): if the beams do not start there, "
        "say where with --extractor IMAGE/range-view --set cloud.origin_m=[x,y,z]"
    )
    return (CloudRemarks((text,)),)


_LEVEL = (Side.LEFT, Side.RIGHT)
# A background step of at least N spacings of the surface means that a strip beyond the surface was not scanned.
_STRIP = 2.0
# Number of returns of a surface from which its spacing is estimated.
_OWN = 6
_SIDES = (Side.LEFT, Side.RIGHT, Side.UPPER, Side.BOTTOM)
# Minimum number of returns of one surface to estimate its plane, and the regularisation for nearly singular cases.
_FEWEST, _FIRMNESS = 3, 1e-2


def jumps_between(seen: Scattered, near: Around, behind: Neighbours, side: Side, options: RangeViewOptions) -> Int:
    """Return the rows whose neighbour on `side` is farther away by a step that no single surface explains."""
    r = seen.range_m
    jump = r[behind.row] - r
    rows = np.flatnonzero(behind.known & (jump > options.min_jump_m + MIN_JUMP_SHARE * r))
    beyond, ahead = ahead_of(near, rows, side, _MAX_SPACINGS)
    leap = 0.5 * (options.min_jump_m + MIN_JUMP_SHARE * r[rows])
    far = ahead & (r[beyond] - r[rows, None] > leap[:, None])
    rows = rows[far.sum(axis=1) >= _OPEN_SHARE * ahead.sum(axis=1)]
    if len(rows):
        predicted = _continued(seen, near, rows, behind.row[rows], jump[rows])
        rows = rows[~(jump[rows] <= SLANT_RATIO * (predicted - r[rows]))]
    if len(rows):
        back = behind.row[rows]
        predicted = _continued(seen, near, back, rows, jump[rows])
        rows = rows[~(r[back] - predicted > GRAZING_SHARE * jump[rows])]
    return np.asarray(rows)


def own_step(seen: Scattered, near: Around, rows: Int, side: Side, options: RangeViewOptions) -> Single:
    """Return the typical step (M,) in rad towards `side` between the returns of the surfaces of `rows`.

    Infinite if there are too few returns. A surface ends within one step of its last return. The step to the background
    may be much larger: sensors at other positions (merged clouds, several sweeps) leave an unscanned strip behind every
    outline.
    """
    r = seen.range_m[rows, None]
    same = np.abs(seen.range_m[near.row[rows]] - r) < options.min_jump_m + MIN_JUMP_SHARE * r
    away = np.partition(np.where(same, near.away[rows], np.float32(np.inf)), _OWN - 1, axis=1)[:, _OWN - 1]
    # Number of returns that fill the half circle on the near side of the outline.
    step: Single = away * np.float32(np.sqrt(0.5 * np.pi / _OWN) * seen.spacing[0 if side in _LEVEL else 1])
    return step


def _continued(seen: Scattered, near: Around, rows: Int, to: Int, jump: Float) -> Float:
    """Return the ranges (M,) of the surfaces of `rows` in the directions of `to`, NaN where they are not observable.

    On a plane the inverse range is linear in the angle (to second order). The plane is fitted to the returns around a
    row on the opposite side of `to` whose range differs from the row by at most about the step `jump` (M,) between the
    two.
    """
    inverse = 1 / seen.range_m.astype(np.float64)
    turn = turn_to(seen.azimuth[rows], seen.azimuth[to])
    ahead = np.column_stack([turn / seen.spacing[0], (seen.elevation[to] - seen.elevation[rows]) / seen.spacing[1]])
    right, up, other = near.right[rows], near.up[rows], near.row[rows]
    r = seen.range_m[rows, None]
    other_m = seen.range_m[other]
    away = np.isfinite(near.away[rows]) & (right * ahead[:, :1] + up * ahead[:, 1:] <= 0)
    away &= other_m - r < jump[:, None]
    same = away & (r - other_m < jump[:, None])
    # Surfaces at a grazing angle have few returns within this distance.
    few = same.sum(axis=1) < _FEWEST
    same[few] = (away & (r - other_m < 2 * jump[:, None]))[few]
    rise = np.where(same, inverse[other] - inverse[rows, None], 0.0)
    right, up = np.where(same, right, 0.0), np.where(same, up, 0.0)
    a, b, c = (right * right).sum(1) + _FIRMNESS, (right * up).sum(1), (up * up).sum(1) + _FIRMNESS
    p, q = (right * rise).sum(1), (up * rise).sum(1)
    det = a * c - b * b
    slope = np.column_stack([c * p - b * q, a * q - b * p]) / det[:, None]
    continued = inverse[rows] + (slope * ahead).sum(axis=1)
    ranges = np.where(continued > 1e-6, 1 / np.maximum(continued, 1e-6), 1e6)
    return np.where(same.sum(axis=1) >= _FEWEST, ranges, np.nan)


METHOD = Method(
    name="range-view",
    build=build,
    options=RangeViewOptions,
    summary="Occlusion edges with direction of clouds without rings, from jumps between returns nearest in angle.",
    gives=frozenset({"cloud-edges", "side", "cloud-points"}),
    parallel=True,
    cite="Wang et al., P2O-Calib, 2023, Sec. III-C",
)
