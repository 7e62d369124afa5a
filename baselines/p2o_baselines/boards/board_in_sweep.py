"""What may be a board in a sweep: plane pieces of its size, with nothing of their plane beside them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
import p2o
from p2o import se3
from p2o.arrays import Bool, Float, Int
from p2o.frames.rings import told_rings
from p2o.geometry.motion import moved

from p2o_baselines.boards.rectangle import Holes, Rectangle, fitted, inside_m

_LEAST_RINGS, _LEAST_POINTS = 3, 15
_BREAK = 3.5  # a gap of azimuth by so many usual steps ends a run
_STEEPEST = 2.5  # tangent of the angle from head on up to which a board is looked for
_SIGMAS = 3.0
_LEAST_FILLED, _MOST_BESIDE = 0.85, 0.35
"""Of the rays that meet the board's place so many must lie on it, and of those just beside it no more."""
_BESIDE_M = 0.12
_LEAST_AREA, _MOST_AREA = 0.35, 1.3
"""Of the board's area, that of the hull of the rays on it: rings leave its upper and lower ends open."""
_LEAST_FOR_CONE, _CONE_RAD, _HIGHEST_M = 100, 0.002, 0.5
"""A ring is a cone if it has so many points and half of them lie so near to it, seen from the axis."""
_MOST_SIDE_M, _LEAST_TRIM_M = 0.03, 0.015
"""A side whose ends lie farther from the outline is none of the board's; ends this near to the others are kept."""
_LEAST_PIECE = (0.5, 0.25)
"""Of the shorter side, the shortest piece of a ring that a board is looked for at: without holes, and with."""
_MOST_GAP_M = 0.3  # rings farther apart are none of a board's
_LEAST_THROUGH = 0.04  # so many rays, of those on a board with holes, go through its hull
_FAR_M = 1e4
_THIN_M = 0.03  # returns so near to a plane are on it, however little it scatters
_FLOOR_M = 0.004  # no range is taken to scatter less about a plane, whatever the fit says


@dataclass(frozen=True)
class BoardInSweep:
    """A plane piece of a sweep that may be a board of a size.

    `xyz` (N, 3) m are its points in the LiDAR frame, `normal` (3,) looks at the LiDAR, normal . x = `offset_m`, the
    points scatter about it by `sigma_m`. `lidar_from_board` (4, 4) is its pose with the longer side along the board's
    own; turned by half a turn about the normal it fits as well (a quarter where it is square). `spread` (3,) are the
    deviations of its middle along x and y of the board in m, and of its turn in rad. `ends` (K, 3) are where rings
    leave it, `side` (K,) over which side of the outline (0: y = -h/2, 1: x = w/2, 2: y = h/2, 3: x = -w/2), `ends_m`
    (K,) how sure that is across the side. `wrong_m` is the misfit of the outline for each ray at the border.
    """

    size_m: tuple[float, float]
    xyz: Float
    normal: Float
    offset_m: float
    sigma_m: float
    lidar_from_board: Float
    spread: Float
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

    Rings and azimuths are those of the sweep as it was measured; points, and where their beams `start` (N, 3), are
    those of the sweep as it is, motion-compensated or raw. Beams of some sensors start above or below the origin.
    """

    xyz: Float
    ring: Int
    azimuth: Float
    step_rad: float
    start: Float

    def meet(self, normal: Float, offset_m: float) -> tuple[Float, Float]:
        """Return where each ray meets the plane normal . x = offset, (N, 3), and the cosine (N,) at which it does.

        What does not meet it before the sensor is far away.
        """
        start = self.start
        way = self.xyz - start
        way /= np.maximum(np.linalg.norm(way, axis=1), 1e-9)[:, None]
        cosine = way @ normal
        with np.errstate(divide="ignore", invalid="ignore"):
            length = (offset_m - start @ normal) / cosine
        length = np.where(np.isfinite(length) & (length > 0), np.minimum(length, _FAR_M), _FAR_M)
        return start + way * length[:, None], cosine

    @property
    def run(self) -> Int:
        """The number (N,) of the run that each point is of: neighbours in a ring without a jump between them."""
        distance = np.linalg.norm(self.xyz, axis=1)
        gap = np.diff(self.azimuth)
        apart = np.linalg.norm(np.diff(self.xyz, axis=0), axis=1)
        near = np.minimum(distance[1:], distance[:-1])
        # A steep plane makes neighbours farther apart than their directions, and so does the noise of ranges.
        reach = near * np.abs(gap) * np.hypot(1, _STEEPEST) + 0.1
        new = (np.diff(self.ring) != 0) | (gap > _BREAK * self.step_rad) | (apart > reach)
        return np.concatenate([[0], np.cumsum(new)])


def rays_of(cloud: p2o.Cloud, farthest_m: float) -> Rays:
    """Return the returns nearer than `farthest_m` by rings; raises RingsUnknownError where rings are not known."""
    xyz = cloud.as_measured()
    azimuth = np.arctan2(xyz[:, 1], xyz[:, 0])
    ring = cloud.ring
    if ring is None:
        flat = np.hypot(xyz[:, 0], xyz[:, 1])
        ring, _ = told_rings(np.mod(azimuth, 2 * np.pi).astype(np.float32), (xyz[:, 2] / flat).astype(np.float32))
    # The seam lies where the fewest near returns are, so that no board is cut.
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
    """Return the height (N,) on the z axis at which the beam of each point starts: that of the cone of its ring.

    A ring obeys z = height + rise * (distance from the axis). Where it does not, or tells it badly, height is 0.
    """
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
    """Return what may be boards of some sizes, best outlines first for each size; twice where two sizes fit.

    `sigma_m` is how much ranges may scatter about a board at most.
    """
    return pieces_of(rays_of(cloud, farthest_m), sizes_m, farthest_m=farthest_m, sigma_m=sigma_m)


def pieces_of(
    rays: Rays, sizes_m: Sequence[tuple[float, float]], *, farthest_m: float, sigma_m: float, holes: Holes = ()
) -> tuple[BoardInSweep, ...]:
    """Return what may be boards of some sizes, as `boards_in_sweep` does; rays go through their `holes`.

    Who holds a board with holes stands beside it, so that more of its plane may be beside the board.
    """
    near = np.linalg.norm(rays.xyz, axis=1) < farthest_m
    found: list[BoardInSweep] = []
    for size in dict.fromkeys(sizes_m):
        of_size: list[BoardInSweep] = []
        taken = np.zeros(len(near), np.bool_)
        for plane in _planes(rays, near, taken, size, sigma_m, _LEAST_PIECE[bool(holes)]):
            board = _outlined(rays, plane, size, sigma_m, holes)
            taken[plane.on] = True
            if board is not None and not any(np.linalg.norm(board.middle - b.middle) < min(size) / 2 for b in of_size):
                of_size.append(board)
                taken |= np.linalg.norm(rays.xyz - board.middle, axis=1) < min(size) / 2
        found += sorted(of_size, key=lambda board: board.wrong_m)
    return tuple(found)


@dataclass(frozen=True)
class _Plane:
    """A plane normal . x = offset through some points (N,) of the rays."""

    normal: Float
    offset: float
    on: Int


def _planes(
    rays: Rays, near: Bool, taken: Bool, size_m: tuple[float, float], sigma_m: float, piece_share: float
) -> Iterator[_Plane]:
    """Give planes through runs of about the board's length and what lies near, longest runs first."""
    from scipy.spatial import cKDTree

    diagonal, run = float(np.hypot(*size_m)), rays.run
    pieces = list(_pieces(rays, run, near, diagonal, sigma_m))
    if not pieces:
        return
    index = np.concatenate(pieces)
    which = np.repeat(np.arange(len(pieces)), [len(piece) for piece in pieces])
    tree = cKDTree(rays.xyz[index])
    least = piece_share * min(size_m)
    length = np.array([np.linalg.norm(rays.xyz[piece[-1]] - rays.xyz[piece[0]]) for piece in pieces])
    for at in np.argsort(-length, kind="stable"):
        piece = pieces[at]
        if length[at] < least or len(piece) < 5 or taken[piece].mean() > 0.5:
            continue
        xyz = rays.xyz[piece]
        about = index[tree.query_ball_point(xyz.mean(axis=0), diagonal)]
        about = np.sort(about)
        others = np.unique(which[np.isin(index, about)])
        plane = _through(rays, piece, [pieces[k] for k in others if k != at], about, sigma_m)
        if plane is not None:
            yield plane


def _pieces(rays: Rays, run: Int, near: Bool, longest_m: float, sigma_m: float) -> Iterator[Int]:
    """Give the points of straight pieces of runs that are no longer than the board's diagonal."""
    starts = np.flatnonzero(np.r_[True, np.diff(run) != 0])
    for first, end in zip(starts, np.r_[starts[1:], len(run)], strict=True):
        if end - first >= 3 and near[first:end].any():
            for piece in _straight(rays.xyz, first, end, 2.5 * sigma_m):
                if len(piece) >= 3 and np.linalg.norm(rays.xyz[piece[-1]] - rays.xyz[piece[0]]) < 1.15 * longest_m:
                    yield piece


def _straight(xyz: Float, first: int, end: int, most_m: float) -> Iterator[Int]:
    """Give straight pieces of points first to end: cut where one is farthest from the line of the ends, while far."""
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
    """Return the plane through a piece of a ring, and another piece, on which most of the points `about` lie."""
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
        points = xyz[on]
        centre = points.mean(axis=0)
        values, vectors = np.linalg.eigh(np.cov((points - centre).T))
        normal, offset = vectors[:, 0], float(vectors[:, 0] @ centre)
        if values[1] < 1e-4 or np.sqrt(values[0]) > sigma_m:
            return None
        on = np.abs(xyz @ normal - offset) < max(_SIGMAS * float(np.sqrt(values[0])), 2 * _FLOOR_M)
    view = abs(normal @ middle) / np.linalg.norm(middle)
    if view < 1 / np.hypot(1, _STEEPEST):
        return None
    return _Plane(normal, offset, about[on]) if offset < 0 else _Plane(-normal, -offset, about[on])


def _outlined(
    rays: Rays, plane: _Plane, size_m: tuple[float, float], sigma_m: float, holes: Holes
) -> BoardInSweep | None:
    """Return the board in a plane; None where no outline of its size has the plane's points inside and no others."""
    normal, diagonal = plane.normal, float(np.hypot(*size_m))
    points = rays.xyz[plane.on]
    scatter = float(np.sqrt(np.mean((points @ normal - plane.offset) ** 2)))
    within = max(_SIGMAS * scatter, _THIN_M)
    centre = points.mean(axis=0)
    # Every ray that meets the plane near the board, whatever it hit.
    hits, cosine = rays.meet(normal, plane.offset)
    index = np.flatnonzero((cosine < -0.02) & (np.linalg.norm(hits - centre, axis=1) < 1.3 * diagonal))
    if len(index) < _LEAST_POINTS:
        return None
    hits = hits[index]
    # What stands before the board hides it: such a ray says nothing.
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
    gap = _gap_m(xy[joined], rays.ring[index][joined])
    rng = np.random.default_rng(len(index))
    # A board that the sweep sees in part may reach as far as it is not seen.
    reach = max(gap, 0.05, 0.6 * (1 - filled) * max(size_m))
    if holes:  # or who holds it makes it larger
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
    # The plane once more, by the points inside of the outline alone.
    xyz = rays.xyz[index[ours]]
    middle = xyz.mean(axis=0)
    values, vectors = np.linalg.eigh((xyz - middle).T @ (xyz - middle) / (len(xyz) - 3))
    normal = vectors[:, 0] * -np.sign(vectors[:, 0] @ middle)
    lidar_from_board = _pose(centre, x_axis, y_axis, normal, middle, place)
    border = np.abs(deep) < max(gap, 0.05)
    board = BoardInSweep(
        size_m,
        xyz,
        normal,
        float(normal @ middle),
        max(float(np.sqrt(values[0])), _FLOOR_M),
        lidar_from_board,
        np.sqrt(np.diag(place.covariance)),
        np.zeros((0, 3)),
        np.zeros(0, np.int64),
        np.zeros(0),
        place.wrong_m / max(int(border.sum()), 1),
    )
    return _with_ends(board, rays)


def _joined(xy: Float, on: Bool, ring: Int) -> Bool:
    """Return which rays (N,) on the plane hang together with most of the others."""
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components
    from scipy.spatial import cKDTree

    index = np.flatnonzero(on)
    out = np.zeros(len(on), np.bool_)
    if not len(index):
        return out
    reach = 1.3 * max(_gap_m(xy[index], ring[index]), 0.03)
    pairs = np.concatenate(
        [cKDTree(xy[index]).query_pairs(reach, output_type="ndarray"), *_bridges(xy, ring, index, reach)]
    )
    graph = coo_matrix((np.ones(len(pairs), np.int8), (pairs[:, 0], pairs[:, 1])), shape=(len(index), len(index)))
    label = connected_components(graph, directed=False)[1]
    out[index[label == np.bincount(label).argmax()]] = True
    return out


def _bridges(xy: Float, ring: Int, index: Int, reach_m: float) -> Iterator[Int]:
    """Give pairs (K, 2) of those `index` (M,) in neighbouring rings that lie farther apart than `reach_m`.

    Between the two blocks of an HDL-64E's lasers, whose beams start at different heights, no ray meets a near board.
    """
    from scipy.spatial import cKDTree

    names, which = np.unique(ring, return_inverse=True)
    if len(names) < 2:
        return
    middles = np.stack([np.bincount(which, xy[:, k]) for k in (0, 1)], axis=1) / np.bincount(which)[:, None]
    way = np.linalg.svd(middles - middles.mean(axis=0))[2][0]
    order = np.argsort(middles @ way)
    apart = np.linalg.norm(np.diff(middles[order], axis=0), axis=1)
    mine = which[index]
    for at in np.flatnonzero((1.3 * apart > reach_m) & (apart < _MOST_GAP_M)):
        one, other = (np.flatnonzero(mine == order[k]) for k in (at, at + 1))
        if len(one) and len(other):
            near = cKDTree(xy[index[one]]).query_ball_tree(cKDTree(xy[index[other]]), 1.3 * float(apart[at]))
            pairs = [(one[k], other[j]) for k, found in enumerate(near) for j in found[:1]]
            if pairs:
                yield np.array(pairs)


def _area(xy: Float) -> float:
    """Return the area of the hull of points (N, 2); 0 where they lie on a line."""
    from scipy.spatial import ConvexHull, QhullError

    try:
        return float(ConvexHull(xy).volume)
    except QhullError:
        return 0.0


def within_hull(xy: Float, of: Float) -> Bool:
    """Return which points (N, 2) lie within the hull of others; none where these lie on a line."""
    from scipy.spatial import ConvexHull, QhullError

    try:
        sides = ConvexHull(of).equations
    except QhullError:
        return np.zeros(len(xy), np.bool_)
    return np.asarray((xy @ sides[:, :2].T + sides[:, 2]).max(axis=1) < 0)


def _gap_m(xy: Float, ring: Int) -> float:
    """Return how far apart rings are, in the median, on the plane where they meet it at `xy` (N, 2)."""
    middles = np.array([xy[ring == each].mean(axis=0) for each in np.unique(ring)])
    if len(middles) < 2:
        return 0.3
    apart = np.linalg.norm(np.diff(middles, axis=0), axis=1)
    return float(np.clip(np.median(apart), 0.01, 0.4))


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
    """Return the board with where rings leave it: between the last ray on it and the first that is not."""
    normal, width, height = board.normal, *board.size_m
    board_from_lidar = se3.inverse(board.lidar_from_board)
    hits, cosine = rays.meet(normal, board.offset_m)
    distance = np.linalg.norm(hits, axis=1)
    own = se3.apply(board_from_lidar, hits)
    deep = np.minimum(width / 2 - np.abs(own[:, 0]), height / 2 - np.abs(own[:, 1]))
    off, within = rays.xyz @ normal - board.offset_m, max(_SIGMAS * board.sigma_m, _THIN_M)
    on = (np.abs(off) < within) & (deep > -0.1)
    hidden = (off > within) & (deep > -0.2)
    ends, sides, sure, offs = [], [], [], []
    for ring in np.unique(rays.ring[on]):
        members = np.flatnonzero(rays.ring == ring)
        mine = members[on[members]]
        if len(mine) < 3:
            continue
        for last, way in ((mine[0], -1), (mine[-1], 1)):
            first = last + way
            if not 0 <= first < len(on) or rays.ring[first] != ring or hidden[first]:
                continue
            step = hits[first] - hits[last]
            usual = distance[last] * rays.step_rad / max(abs(cosine[last]), 0.2)
            if np.linalg.norm(step) > 2.5 * usual:  # no ray came back from just beyond: half a usual step
                towards = hits[last] - hits[last - way]
                size = np.linalg.norm(towards)
                step = towards * min(usual / size, 1.0) if size > 0 else towards
            end = hits[last] + step / 2
            at = se3.apply(board_from_lidar, end[None])[0]
            away = np.array([-at[1] - height / 2, at[0] - width / 2, at[1] - height / 2, -at[0] - width / 2])
            side = int(np.argmin(np.abs(away)))
            if np.abs(away[side]) > 0.06 or np.sort(np.abs(away))[1] < 0.04:  # another end, or at a corner
                continue
            across = abs(se3.apply(board_from_lidar, (hits[last] + step)[None])[0][1 - side % 2] - at[1 - side % 2])
            ends.append(end)
            sides.append(side)
            offs.append(away[side])
            sure.append(float(np.hypot(2 * across / np.sqrt(12), 0.003)))
    which, spread_m, beside_m = np.array(sides, np.int64), np.array(sure, np.float64), np.array(offs, np.float64)
    # Hands and arms beside a board move single ends outwards, or a whole side.
    keep = np.zeros(len(which), np.bool_)
    for side in np.unique(which):
        mine = which == side
        middle = np.median(beside_m[mine])
        if abs(middle) < _MOST_SIDE_M:
            keep |= mine & (np.abs(beside_m - middle) < np.maximum(_SIGMAS * spread_m, _LEAST_TRIM_M))
    return replace(board, ends=np.reshape(ends, (-1, 3))[keep], side=which[keep], ends_m=spread_m[keep])
