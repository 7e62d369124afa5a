"""Detect candidates of boards in a sweep: plane segments of their size without continuation in the same plane."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
import p2o
from p2o import Bool, Float, Int, se3
from p2o.reading import moved, told_rings

from p2o_baselines.boards.rectangle import Holes, Rectangle, fitted, inside_m

_BEFORE_M = 0.12  # a run ends where the neighbour in the ring is farther by this, or where there is no return
_LEAST_RUN_M = 0.06
_MOST_SEEDS = 400


def standing(rays: Rays, farthest_m: float, longest_m: float, used: Bool) -> Iterator[Int]:
    """Yield the points (N,) of short runs around the middle of each, longest first, without those in `used`."""
    xyz, run = rays.xyz, rays.run
    if not len(xyz):
        return
    distance = np.linalg.norm(xyz, axis=1)
    first = np.flatnonzero(np.r_[True, np.diff(run) != 0])
    last = np.r_[first[1:], len(run)] - 1
    length = np.linalg.norm(xyz[last] - xyz[first], axis=1)
    before, after = np.maximum(first - 1, 0), np.minimum(last + 1, len(run) - 1)
    behind = np.ones(len(first), np.bool_)
    for end, neighbour in ((first, before), (last, after)):
        gap = np.abs(rays.azimuth[neighbour] - rays.azimuth[end]) > 3.5 * rays.step_rad
        behind &= gap | (rays.ring[neighbour] != rays.ring[end]) | (distance[neighbour] > distance[end] + _BEFORE_M)
    kept = behind & (length < longest_m) & (length > _LEAST_RUN_M) & (last - first >= 2)
    kept &= np.minimum(distance[first], distance[last]) < farthest_m
    first, last, length = first[kept], last[kept], length[kept]
    if not len(first):
        return
    points = np.concatenate([np.arange(a, b + 1) for a, b in zip(first, last, strict=True)])
    middle = np.array([xyz[a : b + 1].mean(axis=0) for a, b in zip(first, last, strict=True)])
    tried: list[Float] = []
    for at in np.argsort(-length, kind="stable"):
        here = middle[at]
        taken = used[first[at] : last[at] + 1].mean() > 0.5
        if taken or any(np.linalg.norm(here - m) < 0.15 * longest_m for m in tried):
            continue
        about = points[np.linalg.norm(xyz[points] - here, axis=1) < longest_m]
        about = about[~used[about]]
        if len(np.unique(rays.ring[about])) < _LEAST_RINGS:
            continue
        tried.append(here)
        yield about
        if len(tried) >= _MOST_SEEDS:
            return


_LEAST_RINGS, _LEAST_POINTS = 3, 15
_BREAK = 3.5  # azimuth gap, in typical steps, that ends a run
_STEEPEST = 2.5  # maximum tangent of the angle between the normal and the ray at which boards are detected
_SIGMAS = 3.0
_LEAST_FILLED, _MOST_BESIDE = 0.85, 0.35
"""Least share of the rays towards the board that hit it, and largest share of the rays just beside it that do."""
_BESIDE_M = 0.12
_LEAST_AREA, _MOST_AREA = 0.35, 1.3  # of the board's area in the hull of its rays: rings leave its ends uncovered
_LEAST_FOR_CONE, _CONE_RAD, _HIGHEST_M = 100, 0.002, 0.5
"""A ring is a cone if it has at least this many points, half of them within this angle from the axis."""
_MOST_SIDE_M, _LEAST_TRIM_M = 0.03, 0.015
"""Sides whose ends are farther from the outline are discarded; ends within the second limit of the others are kept."""
_LEAST_PIECE = (0.5, 0.25)  # shortest segment of a ring over the shorter side: for boards without holes, and with
_MOST_GAP_M = 0.3  # larger ring spacings exclude a board
_LEAST_THROUGH = 0.04  # fraction of the rays on a board with holes that pass through its hull
_FAR_M = 1e4
_THIN_M = 0.03  # returns so near to a plane are on it, however little it scatters
_FLOOR_M = 0.004  # lower limit of the range noise about a plane, independent of the fit


@dataclass(frozen=True)
class BoardInSweep:
    """A plane segment of a sweep that may be a board of a given size.

    `xyz` (N, 3) m are its points in the LiDAR frame, `normal` (3,) points to the LiDAR, normal . x = `offset_m`, with
    noise `sigma_m`. `lidar_from_board` (4, 4) is its pose with the longer side along that of the board; a rotation by
    180 deg about the normal fits equally well (by 90 deg for a square). `ends` (K, 3) are the ends of rings, `side`
    (K,) the side of the outline they cross (0: y = -h/2, 1: x = w/2, 2: y = h/2, 3: x = -w/2), `ends_m` (K,) their
    standard deviation across the side. `wrong_m` is the residual of the outline per ray at the border.
    """

    size_m: tuple[float, float]
    xyz: Float
    normal: Float
    offset_m: float
    sigma_m: float
    lidar_from_board: Float
    ends: Float
    side: Int
    ends_m: Float
    wrong_m: float

    @property
    def middle(self) -> Float:
        """The middle (3,) of its points."""
        return np.asarray(self.xyz.mean(axis=0))


@dataclass(frozen=True)
class Rays:
    """A sweep by rings: points (N, 3) sorted by ring and azimuth, their `ring` and `azimuth`, and the usual `step`.

    Rings and azimuths are those of the measured sweep; points, and the origins `start` (N, 3) of their beams, are those
    of the given sweep, motion-compensated or raw. Beams of some sensors start above or below the origin.
    """

    xyz: Float
    ring: Int
    azimuth: Float
    step_rad: float
    start: Float

    def meet(self, normal: Float, offset_m: float) -> tuple[Float, Float]:
        """Return intersections (N, 3) with the plane normal . x = offset, far away if none, and cosines (N,)."""
        start, direction = self.start, self.xyz - self.start
        direction /= np.maximum(np.linalg.norm(direction, axis=1), 1e-9)[:, None]
        cosine = direction @ normal
        with np.errstate(divide="ignore", invalid="ignore"):
            length = (offset_m - start @ normal) / cosine
        length = np.where(np.isfinite(length) & (length > 0), np.minimum(length, _FAR_M), _FAR_M)
        return start + direction * length[:, None], cosine

    @property
    def run(self) -> Int:
        """The number (N,) of the run that each point is of: neighbours in a ring without a jump between them."""
        distance = np.linalg.norm(self.xyz, axis=1)
        gap = np.diff(self.azimuth)
        apart = np.linalg.norm(np.diff(self.xyz, axis=0), axis=1)
        near = np.minimum(distance[1:], distance[:-1])
        # Neighbours on an oblique plane are farther apart than their directions indicate; range noise adds to that.
        reach = near * np.abs(gap) * np.hypot(1, _STEEPEST) + 0.1
        new = (np.diff(self.ring) != 0) | (gap > _BREAK * self.step_rad) | (apart > reach)
        return np.concatenate([[0], np.cumsum(new)])


def rays_of(cloud: p2o.Cloud, farthest_m: float) -> Rays:
    """Return the returns nearer than `farthest_m` by rings; raises RingsUnknownError if rings cannot be determined."""
    xyz = cloud.as_measured()
    azimuth = np.arctan2(xyz[:, 1], xyz[:, 0])
    ring = cloud.ring
    if ring is None:
        flat = np.hypot(xyz[:, 0], xyz[:, 1])
        ring, _ = told_rings(np.mod(azimuth, 2 * np.pi).astype(np.float32), (xyz[:, 2] / flat).astype(np.float32))
    # Place the seam where near returns are fewest, so that no board is cut.
    near = np.linalg.norm(xyz, axis=1) < farthest_m
    counts = np.histogram(azimuth[near], bins=180, range=(-np.pi, np.pi))[0]
    seam = (np.argmin(counts) + 0.5) / 180 * 2 * np.pi - np.pi
    azimuth = np.mod(azimuth - seam, 2 * np.pi)
    order = np.lexsort((azimuth, ring))
    step = np.diff(azimuth[order])
    step = step[(np.diff(ring[order]) == 0) & (step > 1e-5)]
    start = np.zeros_like(xyz)
    start[order, 2] = _heights(xyz[order], ring[order])
    if cloud.twist is not None and cloud.time_s is not None:
        start = moved(cloud.twist, cloud.time_s, start)
    usual = float(np.median(step)) if len(step) else 0.003
    return Rays(cloud.xyz[order], ring[order], azimuth[order], usual, start[order])


def _heights(xyz: Float, ring: Int) -> Float:
    """Return where on the z axis beams start (N,): z = height + rise * (distance) of their ring, 0 if uncertain."""
    out, flat = np.zeros(len(xyz)), np.hypot(xyz[:, 0], xyz[:, 1])
    for each in np.unique(ring):
        mine = ring == each
        rows = np.column_stack([np.ones(mine.sum()), flat[mine]])
        if len(rows) < _LEAST_FOR_CONE:
            continue
        # A beam's noise of angle grows with the distance.
        weight = 1 / np.maximum(flat[mine], 1.0)
        (height, rise), *_ = np.linalg.lstsq(rows * weight[:, None], xyz[mine, 2] * weight, rcond=None)
        off = np.abs(xyz[mine, 2] - height - rise * flat[mine]) * weight
        if np.median(off) < _CONE_RAD and abs(height) < _HIGHEST_M:
            out[mine] = height
    return out


def boards_in_sweep(
    cloud: p2o.Cloud, sizes_m: Sequence[tuple[float, float]], *, farthest_m: float, sigma_m: float
) -> tuple[BoardInSweep, ...]:
    """Return candidates of boards of some sizes, best outlines first; ranges scatter by at most `sigma_m`."""
    return pieces_of(rays_of(cloud, farthest_m), sizes_m, farthest_m=farthest_m, sigma_m=sigma_m)


def pieces_of(
    rays: Rays, sizes_m: Sequence[tuple[float, float]], *, farthest_m: float, sigma_m: float, holes: Holes = ()
) -> tuple[BoardInSweep, ...]:
    """Return candidates of boards of some sizes, like `boards_in_sweep`; rays pass through their `holes`."""
    near = np.linalg.norm(rays.xyz, axis=1) < farthest_m
    candidates: list[BoardInSweep] = []
    for size in dict.fromkeys(sizes_m):
        of_size: list[BoardInSweep] = []
        taken = np.zeros(len(near), np.bool_)
        for plane in _planes(rays, near, taken, size, sigma_m, _LEAST_PIECE[bool(holes)]):
            board = _outlined(rays, plane, size, holes)
            taken[plane.on] = True
            if board is not None and not any(np.linalg.norm(board.middle - b.middle) < min(size) / 2 for b in of_size):
                of_size.append(board)
                taken |= np.linalg.norm(rays.xyz - board.middle, axis=1) < min(size) / 2
        candidates += sorted(of_size, key=lambda board: board.wrong_m)
    return tuple(candidates)


@dataclass(frozen=True)
class _Plane:
    """A plane normal . x = offset through some points (N,) of the rays."""

    normal: Float
    offset: float
    on: Int


def _planes(
    rays: Rays, near: Bool, taken: Bool, size_m: tuple[float, float], sigma_m: float, piece_share: float
) -> Iterator[_Plane]:
    """Yield planes through runs of about the board's length and neighbouring points, longest runs first."""
    from scipy.spatial import cKDTree

    diagonal, run = float(np.hypot(*size_m)), rays.run
    pieces = list(_pieces(rays, run, near, diagonal, sigma_m))
    if not pieces:
        return
    index, least = np.concatenate(pieces), piece_share * min(size_m)
    which = np.repeat(np.arange(len(pieces)), [len(piece) for piece in pieces])
    tree = cKDTree(rays.xyz[index])
    length = np.array([np.linalg.norm(rays.xyz[piece[-1]] - rays.xyz[piece[0]]) for piece in pieces])
    for at in np.argsort(-length, kind="stable"):
        piece = pieces[at]
        if length[at] < least or len(piece) < 5 or taken[piece].mean() > 0.5:
            continue
        about = np.sort(index[tree.query_ball_point(rays.xyz[piece].mean(axis=0), diagonal)])
        others = np.unique(which[np.isin(index, about)])
        plane = _through(rays, piece, [pieces[k] for k in others if k != at], about, sigma_m)
        if plane is not None:
            yield plane


def _pieces(rays: Rays, run: Int, near: Bool, longest_m: float, sigma_m: float) -> Iterator[Int]:
    """Give the points of straight pieces of runs that are no longer than the board's diagonal."""
    starts = np.flatnonzero(np.r_[True, np.diff(run) != 0])
    for first, end in zip(starts, np.r_[starts[1:], len(run)], strict=True):
        if end - first >= 3 and near[first:end].any():
            for piece in _straight(rays.xyz, int(first), int(end), 2.5 * sigma_m):
                if len(piece) >= 3 and np.linalg.norm(rays.xyz[piece[-1]] - rays.xyz[piece[0]]) < 1.15 * longest_m:
                    yield piece


def _straight(xyz: Float, first: int, end: int, most_m: float) -> Iterator[Int]:
    """Yield straight segments of points first to end, split recursively at the point farthest from the chord."""
    waiting = [(first, end)]
    while waiting:
        a, b = waiting.pop()
        if b - a < 3:
            continue
        line = xyz[b - 1] - xyz[a]
        size = np.linalg.norm(line)
        off = xyz[a:b] - xyz[a]
        if size > 0:
            off = off - np.outer(off @ line / size**2, line)
        away = np.linalg.norm(off, axis=1)
        at = int(np.argmax(away))
        if away[at] <= most_m or not 0 < at < b - a - 1:
            yield np.arange(a, b)
        else:
            waiting += [(a + at, b), (a, a + at + 1)]


def _through(rays: Rays, piece: Int, others: Sequence[Int], about: Int, sigma_m: float) -> _Plane | None:
    """Return the plane through a segment of a ring and another one that contains most of the points `about`."""
    xyz, ring = rays.xyz[about], rays.ring[about]
    middle = rays.xyz[piece].mean(axis=0)
    along = np.linalg.svd(rays.xyz[piece] - middle)[2][0]
    third = np.array([rays.xyz[other].mean(axis=0) for other in others if rays.ring[other[0]] != rays.ring[piece[0]]])
    if not len(third):
        return None
    normals = np.cross(along, third - middle)
    size = np.linalg.norm(normals, axis=1)
    normals = normals[size > 0.03] / size[size > 0.03, None]
    if not len(normals):
        return None
    near = np.abs((xyz - middle) @ normals.T) < 2 * sigma_m
    normal = normals[np.argmax(near.sum(axis=0))]
    on = np.abs((xyz - middle) @ normal) < 2 * sigma_m
    offset = float(normal @ middle)
    for _ in range(3):
        if on.sum() < _LEAST_POINTS or len(np.unique(ring[on])) < _LEAST_RINGS:
            return None
        centre = xyz[on].mean(axis=0)
        values, vectors = np.linalg.eigh(np.cov((xyz[on] - centre).T))
        normal, offset = vectors[:, 0], float(vectors[:, 0] @ centre)
        if values[1] < 1e-4 or np.sqrt(values[0]) > sigma_m:
            return None
        on = np.abs(xyz @ normal - offset) < max(_SIGMAS * float(np.sqrt(values[0])), 2 * _FLOOR_M)
    view = abs(normal @ middle) / np.linalg.norm(middle)
    if view < 1 / np.hypot(1, _STEEPEST):
        return None
    return _Plane(normal, offset, about[on]) if offset < 0 else _Plane(-normal, -offset, about[on])


def _outlined(rays: Rays, plane: _Plane, size_m: tuple[float, float], holes: Holes) -> BoardInSweep | None:
    """Return the board in a plane; None if no outline of its size separates the plane's points from others."""
    normal, diagonal = plane.normal, float(np.hypot(*size_m))
    points = rays.xyz[plane.on]
    scatter = float(np.sqrt(np.mean((points @ normal - plane.offset) ** 2)))
    within = max(_SIGMAS * scatter, _THIN_M)
    centre = points.mean(axis=0)
    # All rays that intersect the plane near the board, whatever surface returned them.
    hits, cosine = rays.meet(normal, plane.offset)
    index = np.flatnonzero((cosine < -0.02) & (np.linalg.norm(hits - centre, axis=1) < 1.3 * diagonal))
    if len(index) < _LEAST_POINTS:
        return None
    hits = hits[index]
    # Objects in front of the board occlude it: such a ray is not informative.
    off = rays.xyz[index] @ normal - plane.offset
    clear = off < within
    index, hits, off = index[clear], hits[clear], off[clear]
    on = np.abs(off) < within
    x_axis = np.cross(normal, [0.0, 0.0, 1.0])
    x_axis = np.array([1.0, 0, 0]) if np.linalg.norm(x_axis) < 0.1 else x_axis / np.linalg.norm(x_axis)
    y_axis = np.cross(normal, x_axis)
    xy = (hits - centre) @ np.stack([x_axis, y_axis], axis=1)
    far = np.linalg.norm(xy, axis=1) > 0.75 * diagonal
    if far.any() and on[far].mean() > _MOST_BESIDE:  # a piece of a wall
        return None
    joined = _joined(xy, on, rays.ring[index])
    if joined.sum() < _LEAST_POINTS:
        return None
    if holes and (~on & within_hull(xy, xy[joined])).sum() < _LEAST_THROUGH * joined.sum():
        return None
    extent = np.ptp(xy[joined], axis=0)
    if extent.max() > (2.2 if holes else 1.25) * diagonal or extent.max() < 0.5 * min(size_m):
        return None
    filled = _area(xy[joined]) / (size_m[0] * size_m[1])
    if not _LEAST_AREA < filled < (6.0 if holes else _MOST_AREA):
        return None
    gap = float(np.clip(ring_gap_m(xy[joined], rays.ring[index][joined], 0.3), 0.01, 0.4))
    rng = np.random.default_rng(len(index))
    # The hidden part of a partially visible board may extend beyond the observed part.
    reach = max(gap, 0.05, 0.6 * (1 - filled) * max(size_m))
    if holes:  # or the person who carries it enlarges its outline
        reach = max(reach, 0.5 * (float(extent.max()) - min(size_m)))
    place = fitted(xy, joined, size_m, reach, rng, holes)
    outline = inside_m(xy, np.array(place[:3]), size_m)
    deep = inside_m(xy, np.array(place[:3]), size_m, holes)
    inside, beside = deep > 0.02, (outline < -0.02) & (outline > -_BESIDE_M)
    ours = on & inside
    if ours.sum() < _LEAST_POINTS or len(np.unique(rays.ring[index][ours])) < _LEAST_RINGS:
        return None
    if on[inside].mean() < _LEAST_FILLED or beside.sum() < 4 or on[beside].mean() > _MOST_BESIDE + 0.1 * bool(holes):
        return None
    # Fit the plane again, only to the points inside the outline.
    xyz = rays.xyz[index[ours]]
    middle = xyz.mean(axis=0)
    values, vectors = np.linalg.eigh((xyz - middle).T @ (xyz - middle) / (len(xyz) - 3))
    normal = vectors[:, 0] * -np.sign(vectors[:, 0] @ middle)
    lidar_from_board = _pose(centre, x_axis, y_axis, normal, middle, place)
    border = np.abs(deep) < max(gap, 0.05)
    empty = np.zeros((0, 3))
    sigma = max(float(np.sqrt(values[0])), _FLOOR_M)
    wrong = place.wrong_m / max(int(border.sum()), 1)
    offset = float(normal @ middle)
    board = BoardInSweep(
        size_m, xyz, normal, offset, sigma, lidar_from_board, empty, np.zeros(0, np.int64), np.zeros(0), wrong
    )
    return _with_ends(board, rays)


def _joined(xy: Float, on: Bool, ring: Int) -> Bool:
    """Return which rays (N,) on the plane are connected with most of the others."""
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components
    from scipy.spatial import cKDTree

    index = np.flatnonzero(on)
    out = np.zeros(len(on), np.bool_)
    if not len(index):
        return out
    gap = float(np.clip(ring_gap_m(xy[index], ring[index], 0.3), 0.01, 0.4))
    reach = 1.3 * max(gap, 0.03)
    close = cKDTree(xy[index]).query_pairs(reach, output_type="ndarray")
    pairs = np.concatenate([close, *_bridges(xy, ring, index, reach)])
    graph = coo_matrix((np.ones(len(pairs), np.int8), (pairs[:, 0], pairs[:, 1])), shape=(len(index), len(index)))
    label = connected_components(graph, directed=False)[1]
    out[index[label == np.bincount(label).argmax()]] = True
    return out


def _bridges(xy: Float, ring: Int, index: Int, reach_m: float) -> Iterator[Int]:
    """Yield pairs (K, 2) of `index` in neighbouring rings with a gap, as between both blocks of an HDL-64E."""
    from scipy.spatial import cKDTree

    names, which = np.unique(ring, return_inverse=True)
    if len(names) < 2:
        return
    middles = np.stack([np.bincount(which, xy[:, k]) for k in (0, 1)], axis=1) / np.bincount(which)[:, None]
    direction = np.linalg.svd(middles - middles.mean(axis=0))[2][0]
    order = np.argsort(middles @ direction)
    apart = np.linalg.norm(np.diff(middles[order], axis=0), axis=1)
    mine = which[index]
    for at in np.flatnonzero((1.3 * apart > reach_m) & (apart < _MOST_GAP_M)):
        one, other = (np.flatnonzero(mine == order[k]) for k in (at, at + 1))
        if len(one) and len(other):
            near = cKDTree(xy[index[one]]).query_ball_tree(cKDTree(xy[index[other]]), 1.3 * float(apart[at]))
            pairs = [(one[k], other[j]) for k, neighbours in enumerate(near) for j in neighbours[:1]]
            if pairs:
                yield np.array(pairs)


def _area(xy: Float) -> float:
    """Return the area of the hull of points (N, 2); 0 for collinear points."""
    from scipy.spatial import ConvexHull, QhullError

    try:
        return float(ConvexHull(xy).volume)
    except QhullError:
        return 0.0


def within_hull(xy: Float, of: Float) -> Bool:
    """Return which points (N, 2) are within the hull of others; none if these are collinear."""
    from scipy.spatial import ConvexHull, QhullError

    try:
        sides = ConvexHull(of).equations
    except QhullError:
        return np.zeros(len(xy), np.bool_)
    return np.asarray((xy @ sides[:, :2].T + sides[:, 2]).max(axis=1) < 0)


def ring_gap_m(xy: Float, ring: Int, single_m: float) -> float:
    """Return the median distance of rings that intersect a plane at `xy` (N, 2); `single_m` for a single ring."""
    middles = np.array([xy[ring == each].mean(axis=0) for each in np.unique(ring)])
    if len(middles) < 2:
        return single_m
    return float(np.median(np.linalg.norm(np.diff(middles, axis=0), axis=1)))


def _pose(centre: Float, x_axis: Float, y_axis: Float, normal: Float, middle: Float, place: Rectangle) -> Float:
    """Return lidar_from_board (4, 4) of a rectangle in a plane; z of the board looks away from the LiDAR."""
    cosine, sine = np.cos(place.turn_rad), np.sin(place.turn_rad)
    along = cosine * x_axis + sine * y_axis
    along = along - (along @ normal) * normal
    along /= np.linalg.norm(along)
    where = centre + place.x_m * x_axis + place.y_m * y_axis
    where = where - ((where - middle) @ normal) * normal
    return se3.make(np.stack([along, np.cross(-normal, along), -normal], axis=1), where)


def _with_ends(board: BoardInSweep, rays: Rays) -> BoardInSweep:
    """Return the board with the ends of rings: between the last ray on it and the first that misses it."""
    normal, width, height = board.normal, *board.size_m
    board_from_lidar = se3.inverse(board.lidar_from_board)
    hits, cosine = rays.meet(normal, board.offset_m)
    distance = np.linalg.norm(hits, axis=1)
    own = se3.apply(board_from_lidar, hits)
    deep = np.minimum(width / 2 - np.abs(own[:, 0]), height / 2 - np.abs(own[:, 1]))
    off, within = rays.xyz @ normal - board.offset_m, max(_SIGMAS * board.sigma_m, _THIN_M)
    on = (np.abs(off) < within) & (deep > -0.1)
    hidden = (off > within) & (deep > -0.2)
    ends: list[tuple[Float, int, float, float]] = []
    for ring in np.unique(rays.ring[on]):
        members = np.flatnonzero(rays.ring == ring)
        mine = members[on[members]]
        if len(mine) < 3:
            continue
        for last, outward in ((mine[0], -1), (mine[-1], 1)):
            first = last + outward
            if not 0 <= first < len(on) or rays.ring[first] != ring or hidden[first]:
                continue
            step = hits[first] - hits[last]
            usual = distance[last] * rays.step_rad / max(abs(cosine[last]), 0.2)
            if np.linalg.norm(step) > 2.5 * usual:  # no ray came back from just beyond: half a usual step
                towards = hits[last] - hits[last - outward]
                size = np.linalg.norm(towards)
                step = towards * min(usual / size, 1.0) if size > 0 else towards
            end = hits[last] + step / 2
            at = se3.apply(board_from_lidar, end[None])[0]
            away = np.array([-at[1] - height / 2, at[0] - width / 2, at[1] - height / 2, -at[0] - width / 2])
            side = int(np.argmin(np.abs(away)))
            if np.abs(away[side]) > 0.06 or np.sort(np.abs(away))[1] < 0.04:  # another end, or at a corner
                continue
            across = abs(se3.apply(board_from_lidar, (hits[last] + step)[None])[0][1 - side % 2] - at[1 - side % 2])
            ends.append((end, side, away[side], float(np.hypot(2 * across / np.sqrt(12), 0.003))))
    which = np.array([row[1] for row in ends], np.int64)
    beside_m, spread_m = (np.array([row[k] for row in ends], np.float64) for k in (2, 3))
    # Hands and arms beside a board move single ends outwards, or a whole side.
    keep = np.zeros(len(which), np.bool_)
    for side in np.unique(which):
        mine = which == side
        middle = np.median(beside_m[mine])
        if abs(middle) < _MOST_SIDE_M:
            keep |= mine & (np.abs(beside_m - middle) < np.maximum(_SIGMAS * spread_m, _LEAST_TRIM_M))
    positions = np.reshape([row[0] for row in ends], (-1, 3))
    return replace(board, ends=positions[keep], side=which[keep], ends_m=spread_m[keep])
