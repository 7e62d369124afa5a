"""A LiDAR's sweep made from a depth map, for data that have no LiDAR (paper Sec. IV-B)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from p2o import Camera, Cloud, InputError, occlusion, se3
from p2o.arrays import Bool, Float

if TYPE_CHECKING:
    from p2o.simulate import Lidar

# Rays that leave the optical axis by more than this are not traced: no picture shows them.
_MIN_FORWARD = 0.05
# How far behind the surface a beam may be found where it meets it, in metres and as a share of the depth: the depth
# is quantised, and the beam is traced in steps of a pixel.
_TOUCH_M, _TOUCH_SHARE = 0.1, 0.01
# Beams traced at a time: bounds the memory, not the result.
_AT_ONCE = 4096


def depth_sweep(
    depth_m: Float, camera: Camera, camera_from_lidar: Float, lidar: Lidar, rng: np.random.Generator
) -> Cloud:
    """Return what a LiDAR would measure of the surfaces of a depth map (H, W) m of a pinhole camera; inf is sky.

    Each beam is traced through the picture from near to far until it meets the surface that the depth shows there:
    interpolated where the four pixels around the beam are one surface, else the nearest of the four (a beam has a
    width, and its first return counts). Beams into the sky, out of the picture, beyond the LiDAR's range, or behind a
    surface that hides from the camera what they meet there give nothing: no surface is invented. The LiDAR's
    `range_noise_m` is added to the range; by its `angle_noise_deg` beams go astray in azimuth and elevation while the
    sweep tells their nominal direction. Points come in the order of the LiDAR's pulses, with `ring` and `column`; the
    depth is of one moment, so there are no times.

    Raises InputError for another camera model and where no beam meets anything.
    """
    if not camera.is_pinhole:
        raise InputError("the depth of this camera cannot be traced", expected="a pinhole camera", got=camera.model)
    beams = lidar.beams
    noise = lidar.range_noise_m * rng.standard_normal(len(beams.directions))
    aim = _astray(beams.directions, np.radians(lidar.angle_noise_deg) * rng.standard_normal((len(noise), 2)))
    along = aim @ camera_from_lidar[:3, :3].T
    start = se3.apply(camera_from_lidar, beams.origins)
    surface = _Surface.of(depth_m, camera)
    rows = np.flatnonzero(_in_view(surface, camera, start, along))
    if not len(rows):
        raise InputError("the LiDAR meets nothing that the depth shows", got=f"no beam of {lidar.name} in the picture")
    along, start = along[rows], start[rows]
    z = np.concatenate(
        [
            _traced(surface, camera, start[i : i + _AT_ONCE], along[i : i + _AT_ONCE], lidar.max_range_m)
            for i in range(0, len(rows), _AT_ONCE)
        ]
    )
    range_m = (z - start[:, 2]) / along[:, 2]
    met = np.flatnonzero((range_m >= lidar.min_range_m) & (range_m <= lidar.max_range_m))
    if not len(met):
        raise InputError("the LiDAR meets nothing that the depth shows", got=f"no return of {lidar.name}")
    rows, measured = rows[met], range_m[met] + noise[rows[met]]
    return Cloud(
        beams.origins[rows] + measured[:, None] * beams.directions[rows],
        ring=None if beams.ring is None else beams.ring[rows],
        column=beams.column[rows],
    )


def _astray(directions: Float, angles: Float) -> Float:
    """Return unit directions (N, 3) turned by small angles (N, 2) rad in azimuth and elevation."""
    azimuth = np.arctan2(directions[:, 1], directions[:, 0]) + angles[:, 0]
    elevation = np.arcsin(np.clip(directions[:, 2], -1, 1)) + angles[:, 1]
    flat = np.cos(elevation)
    return np.column_stack([flat * np.cos(azimuth), flat * np.sin(azimuth), np.sin(elevation)])


@dataclass(frozen=True, eq=False)
class _Surface:
    """A depth map as beams meet it.

    `inverse` (H, W) is 1/z, 0 for sky and NaN where unknown. By cell of four pixels (H-1, W-1): whether they are `one`
    surface, and the inverse depth of the `nearest`.
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
        # The skyline is an edge for a beam however the depth bends before it.
        one &= (four > 0).all(axis=0) | (four == 0).all(axis=0)
        return cls(inverse, one, four.max(axis=0))

    def at(self, uv: Float) -> Float:
        """Return the inverse depth (...,) at pixels (..., 2); NaN outside the picture and where it is unknown."""
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
    """Return where beams (N, 3) in the camera frame end in the picture, far away (N, 2) px, and `travel` (N, 2) px m.

    The pixel at depth z is far + travel / z.
    """
    fx, fy, cx, cy = camera.params
    slope = along[:, :2] / along[:, 2:]
    return slope * (fx, fy) + (cx, cy), (start[:, :2] - slope * start[:, 2:]) * (fx, fy)


def _in_view(surface: _Surface, camera: Camera, start: Float, along: Float) -> Bool:
    """Return which beams (N,) cross the picture in front of the camera, no nearer than the nearest surface."""
    ahead = along[:, 2] > _MIN_FORWARD
    far, travel = _paths(camera, start, np.where(ahead[:, None], along, 1.0))
    near = far + travel * np.nanmax(surface.inverse)
    low, high = np.minimum(far, near), np.maximum(far, near)
    out: Bool = ahead & (high >= -0.5).all(axis=1) & (low <= (camera.width - 0.5, camera.height - 0.5)).all(axis=1)
    return out


def _traced(surface: _Surface, camera: Camera, start: Float, along: Float, max_range_m: float) -> Float:
    """Return the depth z (N,) in the camera frame where beams first meet the surface; NaN where they do not.

    `start` and `along` (N, 3) are in the camera frame. A beam is followed by its inverse depth t = 1/z: its pixel and
    the inverse depth of every plane are then linear in t, so that the crossing between two steps is exact on planes.
    """
    far, travel = _paths(camera, start, along)
    last = 1 / (start[:, 2] + max_range_m * along[:, 2])
    first = np.full(len(start), 1.01 * np.nanmax(surface.inverse))
    first = np.maximum(first, 2 * last)
    steps = int(np.ceil(np.max(np.linalg.norm(travel, axis=1) * (first - last), initial=0))) + 2
    share = np.linspace(0.0, 1.0, steps)
    t = first[:, None] + share * (last - first)[:, None]

    def gap(t: Float) -> Float:
        """Return how far in front of the surface (positive) a beam is, in inverse depth."""
        return np.asarray(t - surface.at(far[:, None] + t[..., None] * travel[:, None]))

    ahead = gap(t)
    behind = ahead <= 0
    beams, k = np.arange(len(start)), behind.argmax(axis=1)
    before = np.maximum(k - 1, 0)
    g0, g1 = ahead[beams, before], ahead[beams, k]
    with np.errstate(invalid="ignore", divide="ignore"):
        met = t[beams, before] + (t[beams, k] - t[beams, before]) * g0 / (g0 - g1)
        # Where the surface is not at the crossing, the beam went behind an outline: what is there is hidden.
        missed = np.abs(1 / met - 1 / (met - gap(met[:, None])[:, 0]))
        good = behind.any(axis=1) & (k > 0) & (missed < _TOUCH_M + _TOUCH_SHARE / met)
        return np.where(good, 1 / met, np.nan)
