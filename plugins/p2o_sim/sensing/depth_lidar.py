"""Simulate the sweep of a LiDAR from a depth map, for data sets without a LiDAR (paper Sec. IV-B)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from p2o import Bool, Camera, Cloud, Float, InputError, occlusion, se3

if TYPE_CHECKING:
    from p2o_sim.sensing.lidar import Lidar

# Smallest cosine between a traced ray and the optical axis; other rays are outside the image.
_MIN_FORWARD = 0.05
# Tolerance for a hit behind the surface, in metres and as a share of the depth: the depth is quantised, and the beam is
# traced in steps of one pixel.
_TOLERANCE_M, _TOLERANCE_SHARE = 0.1, 0.01
# Number of beams that are traced at once; limits the memory and does not change the result.
_BATCH = 4096


def depth_sweep(
    depth_m: Float, camera: Camera, camera_from_lidar: Float, lidar: Lidar, rng: np.random.Generator
) -> Cloud:
    """Simulate the points that a LiDAR measures of the depth map (H, W) in m of a pinhole camera; inf is sky.

    Each beam is traced through the image from near to far to its first intersection with the depth surface. If the four
    pixels around the beam belong to one surface, the depth is interpolated, else the nearest of the four is used (a
    beam has a width, and its first return counts). Beams that end in the sky, outside the image, beyond the range of
    the LiDAR, or on a surface that is occluded for the camera have no return. Noise of `range_noise_m` is added to the
    range; noise of `angle_noise_deg` changes the azimuth and elevation of the beam, but not the reported direction.
    Points are in the order of the pulses, with `ring` and `column`; they have no times, because the depth is of one
    moment.

    Raises InputError for another camera model and without a return.
    """
    if not camera.is_pinhole:
        raise InputError("the depth of this camera cannot be traced", expected="a pinhole camera", got=camera.model)
    beams = lidar.beams
    noise = lidar.range_noise_m * rng.standard_normal(len(beams.directions))
    aim = _with_angle_noise(beams.directions, np.radians(lidar.angle_noise_deg) * rng.standard_normal((len(noise), 2)))
    along = aim @ camera_from_lidar[:3, :3].T
    start = se3.apply(camera_from_lidar, beams.origins)
    surface = _Surface.of(depth_m, camera)
    rows = np.flatnonzero(_in_view(surface, camera, start, along))
    if not len(rows):
        raise InputError("the depth map gives no LiDAR returns", got=f"no beam of {lidar.name} in the image")
    along, start = along[rows], start[rows]
    batches = [slice(i, i + _BATCH) for i in range(0, len(rows), _BATCH)]
    z = np.concatenate([_traced(surface, camera, start[b], along[b], lidar.max_range_m) for b in batches])
    range_m = (z - start[:, 2]) / along[:, 2]
    hit = np.flatnonzero((range_m >= lidar.min_range_m) & (range_m <= lidar.max_range_m))
    if not len(hit):
        raise InputError("the depth map gives no LiDAR returns", got=f"no return of {lidar.name}")
    rows, measured = rows[hit], range_m[hit] + noise[rows[hit]]
    return Cloud(
        beams.origins[rows] + measured[:, None] * beams.directions[rows],
        ring=None if beams.ring is None else beams.ring[rows],
        column=beams.column[rows],
    )


def _with_angle_noise(directions: Float, angles: Float) -> Float:
    """Return unit directions (N, 3) rotated by small angles (N, 2) rad in azimuth and elevation."""
    azimuth = np.arctan2(directions[:, 1], directions[:, 0]) + angles[:, 0]
    elevation = np.arcsin(np.clip(directions[:, 2], -1, 1)) + angles[:, 1]
    flat = np.cos(elevation)
    return np.column_stack([flat * np.cos(azimuth), flat * np.sin(azimuth), np.sin(elevation)])


@dataclass(frozen=True, eq=False)
class _Surface:
    """Depth map for ray tracing.

    `inverse` (H, W) is 1/z, 0 for sky and NaN if unknown. For each cell between four pixels (H-1, W-1): whether they
    belong to `one` surface, and the inverse depth of the `nearest`.
    """

    inverse: Float
    one: Bool
    nearest: Float

    @classmethod
    def of(cls, depth_m: Float, camera: Camera) -> _Surface:
        orders = occlusion.occlusion_orders(depth_m, camera)
        east, south = orders.east != 0, orders.south != 0
        inverse = 1 / depth_m
        four = np.stack([inverse[:-1, :-1], inverse[:-1, 1:], inverse[1:, :-1], inverse[1:, 1:]])
        one = ~(east[:-1, :-1] | east[1:, :-1] | south[:-1, :-1] | south[:-1, 1:])
        # The skyline is always an edge for a beam.
        one &= (four > 0).all(axis=0) | (four == 0).all(axis=0)
        return cls(inverse, one, four.max(axis=0))

    def at(self, uv: Float) -> Float:
        """Return the inverse depth (...,) at pixels (..., 2); NaN outside the image and if unknown."""
        height, width = self.inverse.shape
        u, v = uv[..., 0], uv[..., 1]
        inside = (u >= -0.5) & (u <= width - 0.5) & (v >= -0.5) & (v <= height - 0.5)
        column = np.clip(np.nan_to_num(u), 0, width - 2).astype(np.int64)
        row = np.clip(np.nan_to_num(v), 0, height - 2).astype(np.int64)
        a, b = u - column, v - row
        top = (1 - a) * self.inverse[row, column] + a * self.inverse[row, column + 1]
        low = (1 - a) * self.inverse[row + 1, column] + a * self.inverse[row + 1, column + 1]
        value = np.where(self.one[row, column], (1 - b) * top + b * low, self.nearest[row, column])
        return np.asarray(np.where(inside, value, np.nan))


def _paths(camera: Camera, start: Float, along: Float) -> tuple[Float, Float]:
    """Return pixel `far` (N, 2) of each beam (N, 3) at infinity, and `travel` (N, 2): far + travel / z at depth z."""
    fx, fy, cx, cy = camera.params
    slope = along[:, :2] / along[:, 2:]
    return slope * (fx, fy) + (cx, cy), (start[:, :2] - slope * start[:, 2:]) * (fx, fy)


def _in_view(surface: _Surface, camera: Camera, start: Float, along: Float) -> Bool:
    """Return the mask (N,) of beams that cross the image in front of the camera, behind the nearest surface."""
    ahead = along[:, 2] > _MIN_FORWARD
    far, travel = _paths(camera, start, np.where(ahead[:, None], along, 1.0))
    near = far + travel * np.nanmax(surface.inverse)
    low, high = np.minimum(far, near), np.maximum(far, near)
    out: Bool = ahead & (high >= -0.5).all(axis=1) & (low <= (camera.width - 0.5, camera.height - 0.5)).all(axis=1)
    return out


def _traced(surface: _Surface, camera: Camera, start: Float, along: Float, max_range_m: float) -> Float:
    """Return the depth z (N,) in the camera frame of the first intersection of beams with the surface, or NaN.

    `start` and `along` (N, 3) are in the camera frame. A beam is parametrised by its inverse depth t = 1/z: its pixel
    and the inverse depth of every plane are linear in t, so that the intersection between two steps is exact on planes.
    """
    far, travel = _paths(camera, start, along)
    last = 1 / (start[:, 2] + max_range_m * along[:, 2])
    first = np.maximum(1.01 * np.nanmax(surface.inverse), 2 * last)
    steps = int(np.ceil(np.max(np.linalg.norm(travel, axis=1) * (first - last), initial=0))) + 2
    share = np.linspace(0.0, 1.0, steps)
    t = first[:, None] + share * (last - first)[:, None]

    def gap(t: Float) -> Float:
        """Return the distance of a beam in front of the surface (positive), in inverse depth."""
        return np.asarray(t - surface.at(far[:, None] + t[..., None] * travel[:, None]))

    ahead = gap(t)
    behind = ahead <= 0
    beams, k = np.arange(len(start)), behind.argmax(axis=1)
    before = np.maximum(k - 1, 0)
    g0, g1 = ahead[beams, before], ahead[beams, k]
    with np.errstate(invalid="ignore", divide="ignore"):
        crossing = t[beams, before] + (t[beams, k] - t[beams, before]) * g0 / (g0 - g1)
        # If the surface is not at the crossing, the beam passed behind an outline into an occluded region.
        missed = np.abs(1 / crossing - 1 / (crossing - gap(crossing[:, None])[:, 0]))
        good = behind.any(axis=1) & (k > 0) & (missed < _TOLERANCE_M + _TOLERANCE_SHARE / crossing)
        return np.where(good, 1 / crossing, np.nan)
