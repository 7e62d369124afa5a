"""Score poses by the density of image edges at LiDAR edges of the same direction, relative to the surroundings."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from p2o import Bool, Camera, Float, Int, Int8, Side, View, se3
from p2o.solving import ipp_disabled

Float32 = NDArray[np.float32]

_FOCAL_PX, _MOST_PX = 720.0, 1300.0
"""Focal length of the pinhole model of every camera (smaller if the image exceeded N pixels), up to 60 degrees off
axis.

Parameters tuned on one camera are thereby valid for others, and projection is fast.
"""
_WIDTHS_PX = (2.0, 4.0, 8.0, 16.0, 32.0, 64.0)
"""Standard deviations of the blurs, in pixels of that pinhole model."""
_AROUND = 4.0
"""Width of the reference density: the density blurred by N more standard deviations."""
_NEAREST_M = 0.5
_AT_ONCE = 50_000


@dataclass(frozen=True, eq=False)
class _Maps:
    """Densities of one view, of the directions `sides` that its image edges have.

    `flat` holds (direction, row, column) of every blur one after the other, `slope` its derivative per pixel across the
    direction; `first`, `height`, `width`, `cell_px` (blurs,) are offset and size of each. Each map has a border of
    zeros, to which points outside of the image are mapped.
    """

    focal_px: float
    centre: tuple[float, float]
    sides: Int8
    flat: Float32
    slope: Float32
    first: Int
    height: Int
    width: Int
    cell_px: Int


@dataclass(frozen=True, eq=False)
class _Part:
    """The LiDAR edges of one view in use: in the camera frame of `around`, with their map and weight."""

    maps: _Maps
    xyz: Float32
    side: Int8
    weight: Float
    sigma_m: Float
    distance_m: Float


@dataclass(frozen=True, eq=False)
class _Points:
    """The points of a part at one blur width each; rows of (K,) arrays belong to points."""

    maps: _Maps
    xyz: Float32
    weight: Float32
    per_cell: Float32
    last_column: Float32
    last_row: Float32
    width: Int
    first: Int
    upright: Bool
    curvature: Float32


@dataclass(frozen=True, eq=False)
class EdgeDensity:
    """Score near and distant poses by the density of image edges at LiDAR edges of the same direction.

    The density of each point is blurred by the uncertainty of the pose at that point: distant points have the largest
    weight while the camera position is uncertain. The density of the wider surroundings is subtracted: points in
    cluttered regions and points outside the image have no influence, so that neither attracts poses. Higher scores are
    better; only scores of the same `at` are comparable.
    """

    parts: tuple[_Part, ...]

    @classmethod
    def of(cls, views: Sequence[View], around: Float, reachable: Sequence[Bool], max_points: int) -> EdgeDensity:
        """Return the density of views for poses relative to `around` (4, 4).

        `reachable` selects the LiDAR edges of each view in use; an even subset of `max_points` over all views is kept.
        """
        step = max(1, -(-int(sum(mask.sum() for mask in reachable)) // max_points))
        parts = []
        for view, mask in zip(views, reachable, strict=True):
            edges = view.cloud_edges.select(np.flatnonzero(mask)[::step])
            maps = _maps(view) if len(edges) and len(view.image_edges) else None
            if maps is None:
                continue
            edges = edges.select(np.isin(edges.side, maps.sides))
            xyz = se3.apply(around, edges.xyz)
            distance = np.maximum(np.linalg.norm(xyz, axis=1), 1.0)
            parts.append(_Part(maps, xyz.astype(np.float32), edges.side, edges.weight, edges.sigma_m, distance))
        return cls(tuple(part for part in parts if len(part.xyz)))

    @property
    def points(self) -> int:
        """Return the number of LiDAR edges in use."""
        return sum(len(part.xyz) for part in self.parts)

    def at(self, angle_rad: float, length_m: float) -> DensityAt:
        """Return the scores for poses with an uncertainty in angle and position."""
        return DensityAt(tuple(_points(part, angle_rad, length_m) for part in self.parts))


@dataclass(frozen=True, eq=False)
class DensityAt:
    """The scores at one width; poses (B, 4, 4) act on the camera frame of `around`."""

    parts: tuple[_Points, ...]

    def __call__(self, poses: Float) -> Float:
        """Return the score (B,) of each pose, higher is better."""
        total = np.zeros(len(poses))
        for points, rows in self._batches(len(poses)):
            total[rows] += _score(points, poses[rows])
        return total

    def _batches(self, count: int) -> Iterator[tuple[_Points, slice]]:
        """Yield each part with slices of `count` poses that limit the memory."""
        for points in self.parts:
            some = max(1, _AT_ONCE // len(points.xyz))
            yield from ((points, slice(begin, begin + some)) for begin in range(0, count, some))

    def normal_equations(self, poses: Float) -> tuple[Float, Float, Float]:
        """Return the score (B,), its gradient (B, 6) and a curvature (B, 6, 6) by rotations and translations.

        An edge constrains its point only across its direction: by the slope there, as stiffly as a blurred line.
        """
        score, gradient, curvature = np.zeros(len(poses)), np.zeros((len(poses), 6)), np.zeros((len(poses), 6, 6))
        for points, rows in self._batches(len(poses)):
            for total, value in zip((score, gradient, curvature), _normal(points, poses[rows]), strict=True):
                total[rows] += value
        return score, gradient, curvature


def _pinhole(camera: Camera) -> tuple[float, tuple[float, float], tuple[int, int]] | None:
    """Return focal length, principal point and (width, height) of the pinhole model that replaces a camera."""
    extent = camera.extent()
    if extent is None:
        return None
    low, high = extent
    focal = min(_FOCAL_PX, _MOST_PX / max(float((high - low).max()), 1e-3))
    size = np.maximum(np.ceil((high - low) * focal).astype(int) + 1, 2)
    return focal, (float(-low[0] * focal), float(-low[1] * focal)), (int(size[0]), int(size[1]))


def _maps(view: View) -> _Maps | None:
    """Return the densities of the image edges of a view, or None if its camera has no edges."""
    pinhole = _pinhole(view.camera)
    if pinhole is None:
        return None
    focal, centre, (columns, rows) = pinhole
    edges = view.image_edges
    rays = view.camera.rays(edges.uv)
    with np.errstate(divide="ignore", invalid="ignore"):
        uv = rays[:, :2] / rays[:, 2:] * focal + centre
        inside = (rays[:, 2] > 0) & (uv >= 0).all(axis=1) & (uv <= [columns - 1, rows - 1]).all(axis=1)
    uv, weight = uv[inside], edges.weight[inside]
    sides, number = np.unique(edges.side[inside], return_inverse=True)
    upright = np.isin(sides, _UPRIGHT)
    flats, slopes, shapes = [], [], []
    cells = [max(1, int(width // 4)) for width in _WIDTHS_PX]
    for width, cell in zip(_WIDTHS_PX, cells, strict=True):
        shape = ((rows - 1) // cell + 2, (columns - 1) // cell + 2)
        maps = np.zeros((len(sides), *shape), np.float32)
        at = np.rint(uv / cell).astype(np.int64)
        np.add.at(maps, (number, at[:, 1], at[:, 0]), weight.astype(np.float32))
        padded, slope = (np.zeros((len(sides), shape[0] + 2, shape[1] + 2), np.float32) for _ in range(2))
        for one, of_side in enumerate(maps):
            near = _blurred(of_side, width / cell)
            mean = float(near.mean())
            if mean > 0:
                padded[one, 1:-1, 1:-1] = (near - _blurred(near, _AROUND * width / cell)) / mean
        slope[upright, :, 2:-2] = (padded[upright, :, 3:-1] - padded[upright, :, 1:-3]) / (2 * cell)
        slope[~upright, 2:-2] = (padded[~upright, 3:-1] - padded[~upright, 1:-3]) / (2 * cell)
        flats.append(padded.ravel())
        slopes.append(slope.ravel())
        shapes.append(padded.shape[1:])
    first = np.cumsum([0, *(len(flat) for flat in flats[:-1])])
    height, width = np.array(shapes).T
    return _Maps(
        focal, centre, sides, np.concatenate(flats), np.concatenate(slopes), first, height, width, np.array(cells)
    )


# Edges without a direction constrain points vertically; horizontally their neighbours at corners do.
_UPRIGHT = (Side.LEFT, Side.RIGHT)


def _blurred(values: Float32, sigma: float) -> Float32:
    import cv2

    with ipp_disabled():
        return np.asarray(cv2.GaussianBlur(values, (0, 0), sigma, borderType=cv2.BORDER_REFLECT))


_SHARPNESS = 0.7
"""Factor of the blur relative to the uncertainty of a pose: the best of many poses has a smaller error."""


def _points(part: _Part, angle_rad: float, length_m: float) -> _Points:
    """Return the points of a part, each blurred by its uncertainty."""
    maps = part.maps
    off_px = _SHARPNESS * maps.focal_px * np.hypot(angle_rad, length_m / part.distance_m)
    level = np.clip(np.rint(np.log2(off_px / _WIDTHS_PX[0])), 0, len(_WIDTHS_PX) - 1).astype(np.int64)
    # An edge between widely spaced beams has its own uncertainty; the wider a blur, the smaller its weight.
    weight = part.weight / (1.0 + (maps.focal_px * part.sigma_m / part.distance_m / off_px) ** 2)
    weight = weight / np.sqrt(off_px / off_px.min())
    width, height, cell = maps.width[level], maps.height[level], maps.cell_px[level]
    number = np.searchsorted(maps.sides, part.side)
    return _Points(
        maps=maps,
        xyz=np.ascontiguousarray(part.xyz.T),
        weight=weight.astype(np.float32),
        per_cell=(1.0 / cell).astype(np.float32),
        last_column=(width - 1).astype(np.float32),
        last_row=(height - 1).astype(np.float32),
        width=width.astype(np.int32),
        first=(maps.first[level] + number * width * height).astype(np.int32),
        upright=np.isin(part.side, _UPRIGHT),
        curvature=(1.0 / np.square(_WIDTHS_PX)[level]).astype(np.float32),
    )


# The pixel's own cell, offset by one because of the border.
_TO_CELL = np.float32(1.5)


def _score(points: _Points, poses: Float) -> Float:
    """Return the scores (B,) of one part; in single precision and in place for speed."""
    maps = points.maps
    intrinsic = np.array([[maps.focal_px, 0, maps.centre[0]], [0, maps.focal_px, maps.centre[1]], [0, 0, 1.0]])
    matrix = intrinsic @ poses[:, :3]
    turn, shift = matrix[:, :, :3].astype(np.float32), matrix[:, :, 3:].astype(np.float32)
    u, v, depth = (turn[:, axis] @ points.xyz + shift[:, axis] for axis in range(3))
    behind = depth < np.float32(_NEAREST_M)
    np.maximum(depth, np.float32(_NEAREST_M), out=depth)
    np.divide(points.per_cell, depth, out=depth)
    u *= depth
    v *= depth
    u[behind] = -1.0
    value = maps.flat.take(_cells(points, u, v))
    return np.asarray(value @ points.weight, dtype=np.float64)


def _cells(points: _Points, u: Float32, v: Float32) -> NDArray[np.int32]:
    """Return the indices in the flat maps of positions (B, K) in cells, which are overwritten."""
    u += _TO_CELL
    v += _TO_CELL
    np.clip(u, 0, points.last_column, out=u)
    np.clip(v, 0, points.last_row, out=v)
    index = v.astype(np.int32)
    index *= points.width
    index += u.astype(np.int32)
    index += points.first
    return index


def _normal(points: _Points, poses: Float) -> tuple[Float, Float, Float]:
    """Return scores (B,), gradients (B, 6) and curvatures (B, 6, 6) of one part."""
    maps, focal = points.maps, np.float32(points.maps.focal_px)
    turn, shift = poses[:, :3, :3].astype(np.float32), poses[:, :3, 3:].astype(np.float32)
    x, y, depth = (turn[:, axis] @ points.xyz + shift[:, axis] for axis in range(3))
    behind = depth < np.float32(_NEAREST_M)
    inverse = 1.0 / np.maximum(depth, np.float32(_NEAREST_M))
    x *= inverse
    y *= inverse
    u, v = ((focal * at + np.float32(c)) * points.per_cell for at, c in zip((x, y), maps.centre, strict=True))
    u[behind] = -1.0
    cells = _cells(points, u, v)
    value, slope = maps.flat.take(cells), maps.slope.take(cells)
    # Derivatives of a point's position across its direction by rotations about x, y, z and translations along them.
    upright, zero = points.upright, np.float32(0.0)
    gain = np.empty((len(poses), 6, x.shape[1]), np.float32)
    gain[:, 0] = np.where(upright, -x * y, -1.0 - y * y)
    gain[:, 1] = np.where(upright, 1.0 + x * x, x * y)
    gain[:, 2] = np.where(upright, -y, x)
    gain[:, 3] = np.where(upright, inverse, zero)
    gain[:, 4] = np.where(upright, zero, inverse)
    gain[:, 5] = np.where(upright, -x, -y) * inverse
    gain *= focal
    score = value @ points.weight
    gradient = (gain @ (slope * points.weight)[:, :, None])[:, :, 0]
    firmness = points.weight * points.curvature * np.maximum(value, zero)
    curvature = (gain * firmness[:, None, :]) @ gain.transpose(0, 2, 1)
    return score.astype(np.float64), gradient.astype(np.float64), curvature.astype(np.float64)
