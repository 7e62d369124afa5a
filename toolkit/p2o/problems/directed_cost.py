"""Cost of a pose: distance of projected LiDAR edges from image edges of the same direction."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from weakref import WeakKeyDictionary, WeakValueDictionary

import numpy as np

from p2o.arrays import Bool, Float, Int
from p2o.features.edges import ImageEdges
from p2o.features.side import Side
from p2o.features.view import View
from p2o.geometry import se3
from p2o.geometry.camera import Camera
from p2o.problems.distinct_views import evenly_chosen
from p2o.runtime.native import for_each, ipp_disabled

Float32 = np.ndarray


@dataclass(frozen=True, eq=False)
class _Part:
    """View number `view`: LiDAR edges `rows`, by direction, in the camera frame of `around`, each with its map."""

    view: int
    rows: Int
    camera: Camera
    xyz: Float
    weight: Float
    side_index: Int
    maps: Float32
    neutral: Float

    @cached_property
    def homogeneous(self) -> Float32:
        """Return the points (N, 4) in single precision."""
        return np.concatenate([self.xyz, np.ones((len(self.xyz), 1))], axis=1).astype(np.float32)

    @cached_property
    def weight32(self) -> Float32:
        """The weights (N,) in single precision."""
        return self.weight.astype(np.float32)

    @cached_property
    def first_cell(self) -> Int:
        """The numbers (N,) of the first cells of the points' maps."""
        return np.asarray(self.side_index * (self.maps.shape[1] * self.maps.shape[2]))

    @cached_property
    def neutral_of_points(self) -> Float:
        """What the points (N,) cost outside the image."""
        return np.asarray(self.neutral[self.side_index])

    @cached_property
    def by_side(self) -> tuple[tuple[int, slice], ...]:
        """The rows of each map."""
        ends = np.searchsorted(self.side_index, np.arange(len(self.maps) + 1))
        return tuple((side, slice(int(ends[side]), int(ends[side + 1]))) for side in range(len(self.maps)))


CONFIDENCES = (0.05, 0.15, 0.3, 0.5, 0.7)
"""Thresholds on the confidence of image edges over which the distances of `DirectedCost` are averaged.

No single threshold suits both a street, where sure edges abound, and a road between trees, where only weak ones are
left; an edge counts at all thresholds below its confidence. Chosen on two drives of KITTI's `train` frames.
"""


def distance_maps(
    view: View,
    sides: Sequence[Side],
    truncate_px: float,
    scale: int,
    *,
    exact: bool = True,
    confidences: Sequence[float] = (0.0,),
) -> Float32:
    """Return truncated distances in px (len(sides), H', W') to the nearest image edge of each direction.

    One value every `scale` pixels; without `exact` up to 2 % off, and quicker. A direction without edges is
    `truncate_px` everywhere. With several `confidences` the result is the mean over these thresholds on the weight of
    the edges; where no edge is below the first, it counts as 0.
    """
    height, width = -(-view.camera.height // scale), -(-view.camera.width // scale)
    maps = np.empty((len(sides), height, width), np.float32)
    # One buffer for all: pages of fresh ones cost as much as the distances in them.
    distance = np.empty((height, width), np.float32)
    edges = view.image_edges
    for number, side in enumerate(sides):
        rows = edges.index.get(side)
        if rows is None:
            maps[number] = truncate_px
            continue
        column, row = np.rint(edges.uv[rows].T / scale).astype(np.int64)
        inside = (column >= 0) & (column < width) & (row >= 0) & (row < height)
        cells, weight = (row * width + column)[inside], edges.weight[rows][inside]
        total, count = maps[number], -1
        for level in confidences:
            # The lowest level keeps all edges: an extractor's own threshold may be lower.
            chosen = cells if level == confidences[0] else cells.compress(weight >= level)
            if len(chosen) != count:
                count = len(chosen)
                _distance(chosen, truncate_px, scale, exact, distance)
            if level == confidences[0]:
                total[:] = distance
            else:
                total += distance
        total /= np.float32(len(confidences))
    return maps


_MAPS: WeakKeyDictionary[ImageEdges, WeakValueDictionary[tuple[object, ...], Float32]] = WeakKeyDictionary()
"""Maps of image edges as long as a cost uses them."""


def _shared_maps(view: View, sides: list[Side], truncate_px: float, scale: int, exact: bool) -> Float32:
    """Return the maps of `DirectedCost` of a view: those of another cost if there is one with the same settings."""
    maps_of = _MAPS.setdefault(view.image_edges, WeakValueDictionary())
    key = (*sides, view.camera.width, view.camera.height, truncate_px, scale, exact)
    maps = maps_of.get(key)
    if maps is None:
        maps = distance_maps(view, sides, truncate_px, scale, exact=exact, confidences=CONFIDENCES)
        maps_of[key] = maps
    return maps


def _distance(cells: Int, truncate_px: float, scale: int, exact: bool, out: Float32) -> None:
    """Write the truncated distance in px of every cell to the nearest of `cells` (N,), by number, to `out` (H, W)."""
    import cv2

    if not len(cells):
        out.fill(truncate_px)
        return
    if exact and truncate_px / scale <= _FARTHEST_SWEPT:
        _swept(cells, truncate_px, scale, out)
        return
    free = np.ones(out.shape, np.uint8)
    free.reshape(-1)[cells] = 0
    if exact:
        with ipp_disabled():
            cv2.distanceTransform(free, cv2.DIST_L2, cv2.DIST_MASK_PRECISE, dst=out)
    else:
        cv2.distanceTransform(free, cv2.DIST_L2, cv2.DIST_MASK_5, dst=out)
    if scale != 1:
        out *= np.float32(scale)
    cv2.threshold(out, truncate_px, 0, cv2.THRESH_TRUNC, dst=out)  # in place, an eighth of NumPy's time


_FARTHEST_SWEPT = 11.0
"""Squares of distances up to this many cells, and sums of two of them where one is the bound, are bytes."""


def _swept(cells: Int, truncate_px: float, scale: int, out: Float32) -> None:
    """Write the truncated distances from squares of whole cells, down, then across: ten times as fast for few cells."""
    import cv2

    (height, width), reach = out.shape, int(np.ceil(truncate_px / scale))
    none = 255 - reach * reach  # at least the square of the reach, and no sum with one of it overflows
    # Columns beyond both ends let rows follow one another in memory.
    edge = np.full((height, width + 2 * reach), none, np.uint8)
    edge.reshape(-1)[cells + cells // width * (2 * reach) + reach] = 0
    down, other = edge.copy(), np.empty_like(edge)
    for step in range(1, min(reach, height - 1) + 1):
        np.bitwise_or(edge, np.uint8(step * step), out=other)
        np.minimum(down[step:], other[:-step], out=down[step:])
        np.minimum(down[:-step], other[step:], out=down[:-step])
    across = down.copy()
    before, after, squares = down.reshape(-1), across.reshape(-1), other.reshape(-1)
    for step in range(1, reach + 1):
        np.add(before, np.uint8(step * step), out=squares)
        np.minimum(after[step:], squares[:-step], out=after[step:])
        np.minimum(after[:-step], squares[step:], out=after[:-step])
    table = np.minimum(np.sqrt(np.arange(256, dtype=np.float32)) * np.float32(scale), np.float32(truncate_px))
    cv2.LUT(across[:, reach : reach + width], table, dst=out)


@dataclass(frozen=True, eq=False)
class DirectedCost:
    """Mean truncated distance in pixels from projected LiDAR edges to image edges of their direction.

    Made by `DirectedCost.of`; calling it with camera_from_lidar (B, 4, 4) gives (B,). The set of points is fixed (those
    that the pose `around` brings into the image or near it), so costs of different poses compare. A point that leaves
    the image costs what a point at a random place would cost: leaving neither adds nor removes cost.
    Points count with their weight over one plus their variance in px^2, times the weight of their view. `smooth`
    interpolates between the cells of the maps; without it the nearest cell counts, which is quicker.
    """

    parts: tuple[_Part, ...]
    truncate_px: float
    scale: int
    lidar_from_around: Float
    smooth: bool = True

    @classmethod
    def of(
        cls,
        views: Sequence[View],
        around: Float,
        truncate_px: float,
        *,
        scale: int = 1,
        margin_px: float = 0.0,
        max_points: int | None = None,
        max_views: int | None = None,
        smooth: bool = True,
        known: dict[tuple[object, ...], Float32] | None = None,
    ) -> DirectedCost:
        """Return the cost of these views; `max_points` keeps an even subset over all views together.

        `max_views` keeps a subset of the views that have points, even over their weights; each takes 16 bytes a pixel.
        Costs of the same image edges share their maps while one of them lives, or `known` holds the maps.
        """
        points = [se3.apply(around, view.cloud_edges.xyz) for view in views]
        pixels = [v.camera.project(xyz) if len(xyz) else np.zeros((0, 2)) for v, xyz in zip(views, points, strict=True)]
        masks = [view.camera.in_image(uv, margin_px) for view, uv in zip(views, pixels, strict=True)]
        seeing = [number for number, mask in enumerate(masks) if mask.any()]
        if max_views is not None and len(seeing) > max_views:
            chosen = evenly_chosen(np.array([views[number].weight for number in seeing]), max_views)
            kept = {seeing[at] for at in chosen}
            masks = [mask & (number in kept) for number, mask in enumerate(masks)]
        total = int(sum(m.sum() for m in masks))
        step = 1 if max_points is None else max(1, -(-total // max_points))

        def part_of(number_of_view: int) -> _Part:
            """Return the points of a view with their maps."""
            view, keep = views[number_of_view], np.flatnonzero(masks[number_of_view])[::step]
            # Sorted by column within each direction, so that points of one batch access a narrow part of a map.
            column = view.camera.project(se3.apply(around, view.cloud_edges.xyz[keep]))[:, 0]
            keep = keep[np.lexsort((column, view.cloud_edges.side[keep]))]
            edges = view.cloud_edges.select(keep)
            sides = [Side(int(s)) for s in np.unique(edges.side)]
            number = np.zeros(len(Side), np.int64)
            number[sides] = np.arange(len(sides))
            maps = _shared_maps(view, sides, truncate_px, scale, smooth)
            if known is not None:
                known[number_of_view, *sides, truncate_px, scale, smooth] = maps
            neutral = _neutral(maps, truncate_px)
            # An edge between far apart beams may lie pixels off: it counts by the inverse of its variance in pixels.
            seen_from = se3.apply(around, edges.xyz)
            distance = np.linalg.norm(seen_from, axis=1)
            weight = view.weight * edges.weight / (1.0 + (view.camera.focal_px * edges.sigma_m / distance) ** 2)
            return _Part(number_of_view, keep, view.camera, seen_from, weight, number[edges.side], maps, neutral)

        having = [number for number, mask in enumerate(masks) if mask.any()]
        parts = for_each(part_of, having, parallel=True)
        return cls(tuple(parts), truncate_px, scale, se3.inverse(around), smooth)

    def truncated(self, truncate_px: float) -> DirectedCost:
        """Return the same cost with distances cut off earlier, at `truncate_px`; the maps are shared."""
        limit = min(truncate_px, self.truncate_px)
        parts = tuple(replace(part, neutral=_neutral(part.maps, limit)) for part in self.parts)
        return replace(self, parts=parts, truncate_px=limit)

    def on(self, views: Sequence[View]) -> DirectedCost:
        """Return the cost of the same points with the same weights, where `views` put them and see them.

        The views are those that the cost was made of, with other cameras of the same size or with LiDAR edges that have
        moved: costs of different views compare because nothing else differs.
        """
        around = se3.inverse(self.lidar_from_around)
        parts = []
        for part in self.parts:
            view = views[part.view]
            parts.append(replace(part, camera=view.camera, xyz=se3.apply(around, view.cloud_edges.xyz[part.rows])))
        return replace(self, parts=tuple(parts))

    @cached_property
    def points(self) -> int:
        """Return the number of LiDAR edge points in the cost."""
        return sum(len(p.xyz) for p in self.parts)

    @cached_property
    def edges(self) -> float:
        """How many edges of full weight the points amount to."""
        return float(sum(part.weight.sum() for part in self.parts))

    def __call__(self, poses: Float) -> Float:
        """Return the cost (B,) in pixels of poses (B, 4, 4); infinite where there are no points."""
        # Relative to the pose `around`, so that the numbers do not depend on where the LiDAR frame is.
        poses = np.asarray(poses, dtype=np.float64) @ self.lidar_from_around
        total = np.zeros(len(poses))
        for part in self.parts:
            total += _part_cost(part, poses, self)
        return total / self.edges if self.edges > 0 else np.full(len(poses), np.inf)

    def sampled(self, part: int, uv: Float) -> Float:
        """Return the truncated distances (N,) of the points of a part if projected to pixels (N, 2), interpolated.

        Pixels outside the image and NaN have the mean distance of the direction.
        """
        own = self.parts[part]
        u, v = self._cells(uv)
        values = np.minimum(interpolated(own.maps, u, v, own.first_cell), self.truncate_px)
        return np.where(_inside(own.maps, u, v), values, own.neutral_of_points)

    def slopes(self, part: int, uv: Float) -> Float:
        """Return the derivatives (2, N) of `sampled` by pixels (N, 2): central differences over one cell each way.

        They are 0 within a cell of the border of the map, and outside.
        """
        own, at = self.parts[part], self._cells(uv)
        height, width = own.maps.shape[1:]
        inner = ((at >= 1) & (at < [[width - 2], [height - 2]])).all(axis=0)
        cell = np.floor(np.where(inner, at, np.float32(1.0)))
        u, v = at - cell
        # Four cells of the rows above and below the pixel, and two of the rows beyond them.
        steps = [row * width + column for row in (0, 1) for column in range(-1, 3)]
        steps += [row * width + column for row in (-1, 2) for column in (0, 1)]
        index = _numbers(cell[0], cell[1], width) + own.first_cell
        cells = own.maps.reshape(-1).take(np.array(steps)[:, None] + index, mode="clip")
        along = _between(cells[:4], cells[4:8], v)
        across = [_between(cells[left], cells[left + 1], u) for left in (8, 1, 5, 10)]
        ahead = _between(along[2], along[3], u), _between(across[2], across[3], v)
        behind = _between(along[0], along[1], u), _between(across[0], across[1], v)
        limit = np.float32(self.truncate_px)
        return np.where(inner, np.minimum(ahead, limit) - np.minimum(behind, limit), 0.0) / (2 * self.scale)

    def _cells(self, uv: Float) -> Float32:
        """Return columns and rows (2, N) of the maps at pixels (N, 2); -1 for NaN."""
        cells = np.asarray((uv.T / self.scale).astype(np.float32))
        np.copyto(cells, np.float32(-1.0), where=np.isnan(cells))
        return cells

    def at(self, pose: Float) -> float:
        """Return the cost in pixels of one pose (4, 4)."""
        if not self.smooth or not self.edges > 0:
            return float(self(pose[None])[0])
        total, pose = 0.0, pose @ self.lidar_from_around
        for number, part in enumerate(self.parts):
            total += float(part.weight @ self.sampled(number, part.camera.project(se3.apply(pose, part.xyz))))
        return total / self.edges

    def thinned(self, most: int) -> DirectedCost:
        """Return the cost of an even subset of at most about `most` points."""
        step = slice(None, None, max(1, -(-self.points // most)))
        names = ("rows", "xyz", "weight", "side_index")
        parts = (replace(part, **{name: getattr(part, name)[step] for name in names}) for part in self.parts)
        return self if step.step == 1 else replace(self, parts=tuple(parts))


_LOOKUPS_AT_ONCE, _POSES_AT_ONCE, _POINTS_AT_ONCE = 64_000, 2_000, 30_000
"""Batch sizes of coordinates and distances that fit in the cache of one core: two to three times faster than one batch.

OpenCV spreads more look-ups over its threads, and takes no more points.
"""


def _neutral(maps: Float32, truncate_px: float) -> Float:
    """Return the mean truncated distance of each map (sides,), from every fourth cell each way where it is large."""
    thin = maps[:, ::4, ::4] if maps.shape[1] * maps.shape[2] > 10_000 else maps
    cut = np.minimum(thin, np.float32(truncate_px)).reshape(len(maps), -1)
    return np.asarray(cut.mean(axis=1), dtype=np.float64)


def _part_cost(part: _Part, poses: Float, cost: DirectedCost) -> Float:
    """Return the weighted sums (B,) of sampled distances of one view, in batches that fit in the cache of a core."""
    total = np.zeros(len(poses))
    for first in range(0, len(poses), _POSES_AT_ONCE):
        some = slice(first, first + _POSES_AT_ONCE)
        matrix = _pixel_matrices(part.camera, poses[some], cost.scale)
        at_once = min(max(1, _LOOKUPS_AT_ONCE // matrix.shape[2]), _POINTS_AT_ONCE)
        for side, rows in part.by_side:
            for begin in range(rows.start, rows.stop, at_once):
                chunk = slice(begin, min(begin + at_once, rows.stop))
                value = _sample_distance(part, matrix, chunk, side, cost)
                total[some] += part.weight32[chunk] @ value
    return total


def _pixel_matrices(camera: Camera, poses: Float, scale: int) -> Float32:
    """Return (3, 4, B): what makes u z, v z and z in cells of a pinhole, x, y and z of any other camera."""
    matrix = poses[:, :3]
    if camera.is_pinhole:
        fx, fy, cx, cy = camera.params
        intrinsic = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1.0]])
        intrinsic[:2] /= scale
        matrix = intrinsic @ matrix
    return np.ascontiguousarray(matrix.transpose(1, 2, 0), dtype=np.float32)


def _sample_distance(part: _Part, matrix: Float32, chunk: slice, side: int, cost: DirectedCost) -> Float32:
    """Return the truncated distances (N, B) of a chunk of points of one direction at all poses."""
    import cv2

    cells = part.maps[side]
    u, v = _project_to_cells(part, matrix, chunk, cost.scale)
    last_v, last_u = (np.float32(max(size - 1.001, 0.0)) for size in cells.shape)
    # As unsigned bits, negative floats exceed all positive ones: one comparison checks both bounds.
    inside = (u.view(np.uint32) <= last_u.view(np.uint32)) & (v.view(np.uint32) <= last_v.view(np.uint32))
    if cost.smooth:
        value = interpolated(cells, u, v)
    else:
        # One pass of OpenCV: rounding, bounds and look-up.
        value = cv2.remap(cells, u, v, cv2.INTER_NEAREST, borderMode=cv2.BORDER_CONSTANT)
    cv2.threshold(value, cost.truncate_px, 0, cv2.THRESH_TRUNC, dst=value)
    if inside.all():
        return value
    # OpenCV copies by a mask in a fifth of NumPy's time.
    out = np.full_like(value, part.neutral[side])
    return np.asarray(cv2.copyTo(value, inside.view(np.uint8), out))


def _project_to_cells(part: _Part, matrix: Float32, chunk: slice, scale: int) -> tuple[Float32, Float32]:
    """Return columns and rows (N, B) of the maps where a chunk of points falls at all poses; -1 where unseen."""
    u, v, z = np.matmul(part.homogeneous[chunk], matrix)
    behind = z < _NEAREST_M if z.min(initial=1.0) < _NEAREST_M else None
    if part.camera.is_pinhole:
        with np.errstate(divide="ignore", invalid="ignore"):
            np.divide(1, z, out=z)
            u *= z
            v *= z
    else:
        u, v = part.camera.pixels_of(u, v, z)
        if scale != 1:
            u /= np.float32(scale)
            v /= np.float32(scale)
        for at in (u, v):
            np.copyto(at, np.float32(-1.0), where=np.isnan(at))
    if behind is not None:
        u[behind] = v[behind] = -1.0
    return u, v


def _inside(maps: Float32, u: Float32, v: Float32) -> Bool:
    """Return whether columns and rows are between the cells of maps (..., H, W)."""
    height, width = maps.shape[-2:]
    return np.asarray((u >= 0) & (v >= 0) & (u <= width - 1) & (v <= height - 1))


def interpolated(cells: Float32, u: Float32, v: Float32, first: Int | None = None) -> Float32:
    """Return the values of a map (H, W) between its cells at columns and rows (N, B); anything outside the map.

    Of several maps (..., H, W), `first` (N, B) are the numbers of the first cells of those that are read.
    """
    height, width = cells.shape[-2:]
    last_u, last_v = (np.float32(max(size - 1.001, 0.0)) for size in (width, height))
    u, v = np.minimum(np.maximum(u, np.float32(0)), last_u), np.minimum(np.maximum(v, np.float32(0)), last_v)
    column, row = np.floor(u), np.floor(v)
    u -= column
    v -= row
    flat, index = cells.reshape(-1), _numbers(column, row, width)
    if first is not None:
        index += first
    right, below = (1 if width > 1 else 0), (width if height > 1 else 0)
    top = flat.take(index)
    top += (flat.take(index + right) - top) * u
    value = flat.take(index + below)
    value += (flat.take(index + (below + right)) - value) * u
    value -= top
    value *= v
    value += top
    return value


def _between(first: Float32, second: Float32, share: Float32) -> Float32:
    """Return the values at a share of the way from the first to the second."""
    return np.asarray(first + (second - first) * share)


_NEAREST_M = 1e-3
_MOST_EXACT = 1 << 24


def _numbers(column: Float32, row: Float32, width: int) -> Int:
    """Return the numbers of the cells of a map; `row` is overwritten."""
    if row.size and float(row.max()) * width + width >= _MOST_EXACT:  # more than single precision counts
        return row.astype(np.intp) * width + column.astype(np.intp)
    row *= np.float32(width)
    row += column
    return row.astype(np.intp)
