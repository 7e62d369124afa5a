"""Inverse distance transforms of edge images, and their mean at points of a sweep: for `idt` and `line-idt`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import p2o
from p2o import Float, UInt8, field
from p2o.solving import Objective

_CHUNK = 1 << 17  # number of points sampled at once, over all poses: about the size of a core's cache


@dataclass(frozen=True, eq=False)
class InverseDistanceMap(p2o.ImageMap):
    """How near each pixel is to strong edges (H, W): 0 far from all of them, at most the strength of the strongest."""

    word: ClassVar[str] = "image-idt"


def edge_strength(grey: Float | UInt8) -> Float:
    """Return the largest difference (H, W) of each pixel of `grey` (H, W) to one of its eight neighbours."""
    from scipy.ndimage import maximum_filter, minimum_filter

    grey = np.asarray(grey, np.float64)
    highest, lowest = (f(grey, size=3, mode="nearest") for f in (maximum_filter, minimum_filter))
    return np.asarray(np.maximum(highest - grey, grey - lowest))


def spread(strength: Float, gamma: float) -> Float:
    """Return max of strength gamma^max(|x - u|, |y - v|) over all pixels at every pixel (H, W): two raster passes."""
    lost = -np.log(gamma)  # per pixel; in logarithms the losses add up
    at = lost * np.arange(strength.shape[1])
    with np.errstate(divide="ignore"):  # no edge at all
        out = np.log(np.asarray(strength, np.float64))

    def beside(row: Float) -> Float:
        best = row.copy()
        np.maximum(best[1:], row[:-1], out=best[1:])
        np.maximum(best[:-1], row[1:], out=best[:-1])
        return best

    for one in (out, out[::-1, ::-1]):
        for v, row in enumerate(one):
            here = row if v == 0 else np.maximum(row, beside(one[v - 1]) - lost)
            row[:] = np.maximum.accumulate(here + at) - at
    return np.asarray(np.exp(out))


def inverse_distance(strength: Float, alpha: float, gamma: float) -> Float:
    """Return alpha E + (1 - alpha) max E gamma^distance of edges E (H, W), by Chebyshev: Levinson's Eq. 1."""
    return np.asarray(alpha * strength + (1 - alpha) * spread(strength, gamma))


@dataclass(frozen=True, eq=False)
class OnMap:
    """Points (N, 3) m of one view with weights (N,), the map (H, W) of its image, and the value outside, its mean."""

    camera: p2o.Camera
    values: Float
    xyz: Float
    weight: Float
    neutral: float

    def sums(self, poses: Float) -> Float:
        """Return the sum (B,) of weight times map over the points, at poses (B, 4, 4)."""
        poses = np.asarray(poses, np.float64)
        size = max(1, _CHUNK // max(len(self.xyz), 1))
        return np.concatenate([self._at(poses[i : i + size]) @ self.weight for i in range(0, len(poses), size)])

    def _at(self, poses: Float) -> Float:
        return sampled(self.values, *projected(self.camera, poses, self.xyz), self.neutral)


def projected(camera: p2o.Camera, poses: Float, xyz: Float) -> tuple[Float, Float]:
    """Return u and v (B, N) in px of points (N, 3) m at poses (B, 4, 4); NaN if they are not projected."""
    if not camera.is_pinhole:
        uv = camera.project(p2o.se3.apply(poses, xyz))
        return uv[..., 0], uv[..., 1]
    fx, fy, cx, cy = camera.params
    matrix = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1.0]]) @ poses[:, :3]
    # One product for all poses, far quicker than one for each.
    xyz1 = np.vstack([xyz.T, np.ones(len(xyz))])
    u, v, depth = np.moveaxis((matrix.reshape(-1, 4) @ xyz1).reshape(len(poses), 3, -1), 1, 0)
    inverse = np.divide(1.0, depth, out=np.full(depth.shape, np.nan), where=depth > 1e-6)
    return u * inverse, v * inverse


def sampled(values: Float, u: Float, v: Float, outside: float) -> Float:
    """Sample a map (H, W) bilinearly at pixels u and v (...); `outside` is used beyond the image and for NaN."""
    height, width = values.shape
    with np.errstate(invalid="ignore"):
        inside = (u >= 0) & (v >= 0) & (u <= width - 1) & (v <= height - 1)
    out = np.full(u.shape, outside)
    u, v = u[inside], v[inside]
    column, row = u.astype(np.int32), v.astype(np.int32)
    u -= column
    v -= row
    flat, index = values.ravel(), row * np.int32(width) + column
    # On the last column and row the weight of the values beyond the border is zero.
    right, below = column < width - 1, np.int32(width) * (row < height - 1)
    upper, lower = flat[index], flat[index + below]
    upper += u * (flat[index + right] - upper)
    lower += u * (flat[index + below + right] - lower)
    out[inside] = upper + v * (lower - upper)
    return out


def mean_on_maps(parts: Sequence[OnMap], poses: Float) -> Float:
    """Return the weighted mean (B,) of the maps at the points of all views together; 0 without any point."""
    weight = sum(float(part.weight.sum()) for part in parts)
    total = sum((part.sums(poses) for part in parts), np.zeros(len(poses)))
    return np.asarray(total / weight if weight > 0 else total)


def on_maps(
    views: Sequence[p2o.View], camera_from_lidar: Float, max_points: int, margin_px: float = 100.0
) -> list[OnMap]:
    """Return the cloud edges within `margin_px` of images at a pose, at most `max_points` each, with the maps."""
    parts = []
    for view in views:
        distance_map, edges = view.get(InverseDistanceMap.word), view.cloud_edges
        if distance_map is None or not len(edges):
            continue
        uv = view.camera.project(p2o.se3.apply(camera_from_lidar, edges.xyz))
        near = edges.select(view.camera.in_image(uv, margin_px)).thinned(max_points)
        parts.append(OnMap(view.camera, distance_map.values, near.xyz, near.weight, float(distance_map.values.mean())))
    return parts


class MapOptions(p2o.Options):
    """Options of inverse distance maps."""

    alpha: float = field(1 / 3, ge=0, le=1, help="Share of the edge image itself in the map.")
    gamma: float = field(0.98, gt=0.5, lt=1, help="What is left of an edge one pixel away from it.")


def map_features(strength: Float, options: MapOptions) -> p2o.ImageFeatures:
    """Return the inverse distance map of an edge image (H, W) as features."""
    return p2o.ImageFeatures(features=[InverseDistanceMap(inverse_distance(strength, options.alpha, options.gamma))])


def map_matcher(max_points: int) -> p2o.Matcher:
    """Return the matcher `(views, camera_from_lidar (4, 4), reach_px) -> Objective`: minus the mean of the maps."""

    def match(views: Sequence[p2o.View], camera_from_lidar: Float, reach_px: float) -> Objective:
        parts = on_maps(views, camera_from_lidar, max_points)
        return Objective(lambda poses: -mean_on_maps(parts, poses), reach_independent=True)

    return match
