"""How badly projected LiDAR edges miss the image edges of their own direction: what poses are judged by."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache

import numpy as np

from p2o.arrays import Bool, Float, Int
from p2o.features.side import Side
from p2o.features.view import View
from p2o.geometry import se3
from p2o.geometry.camera import Camera

Float32 = np.ndarray


@dataclass(frozen=True, eq=False)
class _Part:
    """One view: the points that take part, in the camera frame of `around`, each with the number of its map.

    `view` is the number of the view, `rows` those of its LiDAR edges.
    """

    view: int
    rows: Int
    camera: Camera
    xyz: Float
    weight: Float
    side_index: Int
    maps: Float32
    neutral: Float


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
    maps = np.full((len(sides), height, width), truncate_px, np.float32)
    edges = view.image_edges
    for number, side in enumerate(sides):
        rows = edges.index.get(side)
        if rows is None:
            continue
        cells = np.rint(edges.uv[rows] / scale).astype(np.int64)
        inside = ((cells >= 0) & (cells < [width, height])).all(axis=1)
        cells, weight = cells[inside], edges.weight[rows][inside]
        total, count, distance = np.zeros((height, width), np.float32), -1, maps[number]
        for level in confidences:
            # The lowest level keeps all edges: an extractor's own threshold may be lower.
            chosen = cells if level == confidences[0] else cells[weight >= level]
            if len(chosen) != count:
                count, distance = len(chosen), _distance(chosen, (height, width), truncate_px, scale, exact)
            total += distance
        maps[number] = total / np.float32(len(confidences))
    return maps


def _distance(cells: Int, shape: tuple[int, int], truncate_px: float, scale: int, exact: bool) -> Float32:
    """Return the truncated distance in px of every cell to the nearest of `cells` (N, 2)."""
    import cv2

    if not len(cells):
        return np.full(shape, truncate_px, np.float32)
    offsets = _brush(truncate_px / scale)
    if exact and len(cells) * sum(len(ring) for _, ring in offsets) < _BRUSHED * shape[0] * shape[1]:
        return _painted(cells, shape, truncate_px, scale, offsets)
    free = np.ones(shape, np.uint8)
    free[cells[:, 1], cells[:, 0]] = 0
    if exact:
        with _opencv_alone():
            distance = cv2.distanceTransform(free, cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
    else:
        distance = cv2.distanceTransform(free, cv2.DIST_L2, cv2.DIST_MASK_5)
    return np.asarray(np.minimum(distance * scale, np.float32(truncate_px)))


_BRUSHED = 3.0
"""Up to so many strokes a cell of the map, painting around edges is quicker than the distance transform."""


@lru_cache(maxsize=16)
def _brush(reach: float) -> tuple[tuple[float, Int], ...]:
    """Return the offsets (N, 2) in cells that are equally far, by distance, farthest first, all nearer than `reach`."""
    cells = int(np.ceil(reach))
    v, u = np.mgrid[-cells : cells + 1, -cells : cells + 1]
    square = u * u + v * v
    near = np.unique(square[square < reach * reach])[::-1]
    return tuple((float(np.sqrt(value)), np.argwhere(square == value)[:, ::-1] - cells) for value in near)


def _painted(
    cells: Int, shape: tuple[int, int], truncate_px: float, scale: int, brush: Sequence[tuple[float, Int]]
) -> Float32:
    """Return the distances that a distance transform gives, from rings painted around the cells, nearer ones last."""
    height, width = shape
    margin = int(np.ceil(truncate_px / scale))
    stride = width + 2 * margin
    maps = np.full((height + 2 * margin, stride), truncate_px, np.float32)
    flat, at = maps.reshape(-1), (cells[:, 1] + margin) * stride + cells[:, 0] + margin
    for distance, ring in brush:
        flat[(at + (ring[:, 1] * stride + ring[:, 0])[:, None]).reshape(-1)] = np.float32(distance) * np.float32(scale)
    return maps[margin : margin + height, margin : margin + width]


@contextmanager
def _opencv_alone() -> Iterator[None]:
    """Keep OpenCV from handing work of this thread to Intel's IPP.

    Its exact distances differ in their last bits with the address of the result in memory, and it is only used where
    OpenCV has one thread: two runs would not give the same bytes.
    """
    import cv2

    before = cv2.ipp.useIPP()
    cv2.ipp.setUseIPP(False)
    try:
        yield
    finally:
        cv2.ipp.setUseIPP(before)


@dataclass(frozen=True, eq=False)
class DirectedCost:
    """Mean truncated distance in pixels from projected LiDAR edges to image edges of their direction.

    Made by `DirectedCost.of`; calling it with camera_from_lidar (B, 4, 4) gives (B,). The set of points is fixed (those
    that the pose `around` brings into the image or near it), so costs of different poses compare. A point that leaves
    the image costs what a point at a random place would cost: leaving is neither punished nor rewarded by itself.
    Points count with their weight over one plus their variance in px^2. `smooth` interpolates between the cells of the
    maps; without it the nearest cell counts, which is quicker.
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
        smooth: bool = True,
    ) -> DirectedCost:
        """Return the cost of these views; `max_points` keeps an even subset over all views together."""
        masks = [_near_image(view, around, margin_px) for view in views]
        total = int(sum(m.sum() for m in masks))
        step = 1 if max_points is None else max(1, -(-total // max_points))
        parts = []
        for number_of_view, (view, mask) in enumerate(zip(views, masks, strict=True)):
            keep = np.flatnonzero(mask)[::step]
            if not len(keep):
                continue
            edges = view.cloud_edges.select(keep)
            sides = [Side(int(s)) for s in np.unique(edges.side)]
            number = np.zeros(len(Side), np.int64)
            for i, side in enumerate(sides):
                number[side] = i
            maps = distance_maps(view, sides, truncate_px, scale, exact=smooth, confidences=CONFIDENCES)
            neutral = _neutral(maps, truncate_px)
            # An edge between far apart beams may lie pixels off: it counts by the inverse of its variance in pixels.
            seen_from = se3.apply(around, edges.xyz)
            distance = np.linalg.norm(seen_from, axis=1)
            weight = edges.weight / (1.0 + (view.camera.focal_px * edges.sigma_m / distance) ** 2)
            parts.append(_Part(number_of_view, keep, view.camera, seen_from, weight, number[edges.side], maps, neutral))
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
        parts = tuple(
            replace(
                part,
                camera=views[part.view].camera,
                xyz=se3.apply(around, views[part.view].cloud_edges.xyz[part.rows]),
            )
            for part in self.parts
        )
        return replace(self, parts=parts)

    @cached_property
    def points(self) -> int:
        """How many LiDAR edge points take part."""
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
            at_once = max(1, _LOOKUPS_AT_ONCE // max(1, len(part.xyz)))
            for first in range(0, len(poses), at_once):
                rows = slice(first, first + at_once)
                total[rows] += _part_cost(part, poses[rows], self)
        return total / self.edges if self.edges > 0 else np.full(len(poses), np.inf)

    def at(self, pose: Float) -> float:
        """Return the cost in pixels of one pose (4, 4)."""
        return float(self(pose[None])[0])


_LOOKUPS_AT_ONCE = 60_000
"""So many coordinates and distances stay in the cache of one core: two to three times as quick as all at once."""


def _neutral(maps: Float32, truncate_px: float) -> Float:
    """Return the mean truncated distance of each map (sides,), from every fourth cell each way where it is large."""
    thin = maps[:, ::4, ::4] if maps.shape[1] * maps.shape[2] > 10_000 else maps
    cut = np.minimum(thin, np.float32(truncate_px)).reshape(len(maps), -1)
    return np.asarray(cut.mean(axis=1), dtype=np.float64)


def _near_image(view: View, around: Float, margin_px: float) -> Bool:
    edges = view.cloud_edges
    if not len(edges):
        return np.zeros(0, np.bool_)
    return view.camera.in_image(view.camera.project(se3.apply(around, edges.xyz)), margin_px)


def _part_cost(part: _Part, poses: Float, cost: DirectedCost) -> Float:
    """Weighted sum of looked-up distances of one view, (B,); in single precision for speed."""
    camera, scale = part.camera, cost.scale
    _, height, width = part.maps.shape
    if camera.is_pinhole:
        fx, fy, cx, cy = camera.params
        intrinsic = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1.0]])
        intrinsic[:2] /= scale
        matrix = (intrinsic @ poses[:, :3]).astype(np.float32)
        homogeneous = np.concatenate([part.xyz.T, np.ones((1, len(part.xyz)))]).astype(np.float32)
        u, v, w = np.moveaxis((matrix.reshape(-1, 4) @ homogeneous).reshape(len(poses), 3, -1), 1, 0)
        with np.errstate(divide="ignore", invalid="ignore"):
            inverse = 1.0 / w
            u, v = u * inverse, v * inverse
        outside = w < 1e-3
    else:
        uv = camera.project(se3.apply(poses, part.xyz)).astype(np.float32) / np.float32(scale)
        u, v = uv[..., 0], uv[..., 1]
        outside = np.isnan(u)
    with np.errstate(invalid="ignore"):
        outside |= (u < 0) | (v < 0) | (u > width - 1.001) | (v > height - 1.001)
    u[outside], v[outside] = 0.0, 0.0
    flat = part.maps.reshape(-1)
    first = (part.side_index * (height * width)).astype(np.int32)
    if not cost.smooth:
        value = flat[first + (v + 0.5).astype(np.int32) * np.int32(width) + (u + 0.5).astype(np.int32)]
    else:
        column, row = u.astype(np.int32), v.astype(np.int32)
        fu, fv = u - column, v - row
        index = first + row * np.int32(width) + column
        right, below = (1 if width > 1 else 0), (width if height > 1 else 0)
        top = flat[index] * (1 - fu) + flat[index + right] * fu
        bottom = flat[index + below] * (1 - fu) + flat[index + below + right] * fu
        value = top * (1 - fv) + bottom * fv
    value = np.minimum(value, np.float32(cost.truncate_px))
    value = np.where(outside, part.neutral[part.side_index].astype(np.float32), value)
    return np.asarray(value @ part.weight.astype(np.float32), dtype=np.float64)
