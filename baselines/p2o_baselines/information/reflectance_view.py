"""Virtual views of a sweep: pinhole images of its reflectances, as seen from the place of the LiDAR."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import p2o
from p2o import Bool, Float, UInt8
from p2o.solving import ipp_disabled

_NARROW_DEG = 50.0
"""A sweep whose points are within this angle of their mean direction gets one view along that direction."""
_STEEPEST_DEG = 50.0
"""Elevations to which views reach: pinhole images are stretched beyond."""
_OVERLAP = 0.5
"""Step between neighbouring views in fields of view of the camera, so that one of them contains most of the image."""
_MARGIN = 1.15
"""Width of a view in fields of view of the camera."""
_LEAST_PX, _MOST_PX = 64, 2048
_NEAREST_M = 0.3
_SAME_SURFACE, _OCCLUDED = 1.05, 1.5
"""Ranges, relative to the nearest of a pixel and of its neighbours, beyond which a point is hidden."""
_FINEST_PX, _WIDTHS = 0.8, 4
"""Hole filling: the narrowest of several Gaussians (each twice as wide) that has enough points at a pixel."""
_LEAST_POINTS = 2.4
_CONTRAST, _TILES = 3.0, (4, 4)
_LIFT_PX = 3.0
"""Farthest pixel with a point from which a keypoint takes its depth."""


@dataclass(frozen=True, eq=False)
class VirtualView:
    """A pinhole camera at the origin of the LiDAR: `view_from_lidar` (3, 3), focal length, centre and size in pixels.

    Its axes are x right, y down and z forward; pixel centres are at integers.
    """

    view_from_lidar: Float
    focal_px: float
    centre: tuple[float, float]
    width: int
    height: int

    def project(self, xyz: Float) -> Float:
        """Return the pixels (N, 2) of points (N, 3) in the LiDAR frame, NaN behind the view."""
        seen = xyz @ self.view_from_lidar.T
        ahead = seen[:, 2] > _NEAREST_M
        uv = np.full((len(xyz), 2), np.nan)
        uv[ahead] = self.focal_px * seen[ahead, :2] / seen[ahead, 2:] + self.centre
        return uv

    def rays(self, uv: Float) -> Float:
        """Return the directions (N, 3) of pixels (N, 2) in the LiDAR frame, with depth 1 along the optical axis."""
        plane = (np.asarray(uv) - self.centre) / self.focal_px
        return np.asarray(np.column_stack([plane, np.ones(len(plane))]) @ self.view_from_lidar)


@dataclass(frozen=True, eq=False)
class Rendering:
    """A reflectance image of a virtual view: `grey` (H, W) uint8, 0 where there are no points; `depth_m` (H, W).

    The depth is that of a point along the optical axis, NaN at pixels without points.
    """

    view: VirtualView
    grey: UInt8
    depth_m: Float

    def lift(self, uv: Float) -> Float:
        """Return the points (N, 3) at pixels (N, 2), at the depth of the nearest pixel with one, NaN if that is far."""
        from scipy.ndimage import distance_transform_edt

        out = np.full((len(uv), 3), np.nan)
        if not len(uv) or not np.isfinite(self.depth_m).any():
            return out
        away, (row, column) = distance_transform_edt(np.isnan(self.depth_m), return_indices=True)
        at = np.clip(np.rint(uv).astype(np.int64), 0, [self.view.width - 1, self.view.height - 1])
        near = away[at[:, 1], at[:, 0]] <= _LIFT_PX
        depth = self.depth_m[row[at[:, 1], at[:, 0]], column[at[:, 1], at[:, 0]]]
        out[near] = (self.view.rays(uv) * depth[:, None])[near]
        return out


def looking(azimuth_rad: float, elevation_rad: float) -> Float:
    """Return view_from_lidar (3, 3) of a view in a direction; its x axis is horizontal for a LiDAR with z upwards."""
    z = np.array([np.cos(azimuth_rad), np.sin(azimuth_rad), np.tan(elevation_rad)])
    z /= np.linalg.norm(z)
    x = np.array([np.sin(azimuth_rad), -np.cos(azimuth_rad), 0.0])
    return np.stack([x, np.cross(z, x), z])


def views_of(xyz: Float, focal_px: float, camera_width_deg: float) -> tuple[VirtualView, ...]:
    """Return the views that cover a sweep (N, 3): one for a narrow field of view, else a ring of overlapping ones.

    The elevations are those of the sweep, without the outermost hundredth. `camera_width_deg` is the field of view of
    the camera along its longer side, which determines width and number of the views of a ring.
    """
    unit = xyz / np.maximum(np.linalg.norm(xyz, axis=1, keepdims=True), 1e-9)
    mean = unit.mean(axis=0)
    mean /= max(float(np.linalg.norm(mean)), 1e-9)
    off_deg = np.degrees(np.arccos(np.clip(unit @ mean, -1.0, 1.0)))
    if np.quantile(off_deg, 0.98) < _NARROW_DEG and np.hypot(mean[0], mean[1]) > np.cos(np.radians(_STEEPEST_DEG)):
        axes = looking(float(np.arctan2(mean[1], mean[0])), float(np.arcsin(mean[2])))
        seen = unit @ axes.T
        plane = seen[:, :2] / np.maximum(seen[:, 2:], 0.1)
        return (_covering(axes, focal_px, *np.quantile(plane, [0.01, 0.99], axis=0)),)
    elevation = np.arctan2(xyz[:, 2], np.hypot(xyz[:, 0], xyz[:, 1]))
    steepest = np.tan(np.radians(_STEEPEST_DEG))
    down, up = np.clip(np.tan(np.quantile(elevation, [0.01, 0.99])), -steepest, steepest)
    count = int(np.ceil(360.0 / (_OVERLAP * camera_width_deg)))
    half = np.tan(np.radians(min(_MARGIN * camera_width_deg, 2 * _STEEPEST_DEG) / 2))
    low, high = np.array([-half, -up]), np.array([half, -down])
    azimuths = np.arange(count) * 2 * np.pi / count
    return tuple(_covering(looking(float(azimuth), 0.0), focal_px, low, high) for azimuth in azimuths)


def _covering(axes: Float, focal_px: float, low: Float, high: Float) -> VirtualView:
    """Return the view of a rectangle of the plane at depth 1."""
    width, height = np.clip(np.ceil((high - low) * focal_px).astype(int) + 1, _LEAST_PX, _MOST_PX)
    centre = -low * focal_px
    return VirtualView(axes, focal_px, (float(centre[0]), float(centre[1])), int(width), int(height))


def facing(camera_from_lidar: Float, image: FlatImage) -> VirtualView:
    """Return the view that an image has from the place of the LiDAR, with a margin, for a rotation (3, 3)."""
    size = np.array(image.grey.shape[::-1]) / image.focal_px
    middle, half = image.low + size / 2, _MARGIN * size / 2
    return _covering(camera_from_lidar, image.focal_px, middle - half, middle + half)


def rendered(view: VirtualView, xyz: Float, value: Float) -> Rendering:
    """Return the image of points (N, 3) with values (N,) in a view: hidden points removed, holes filled, equalised."""
    shape = view.height, view.width
    uv = view.project(xyz)
    inside = np.asarray(np.isfinite(uv).all(axis=1))
    inside[inside] &= (uv[inside] > -0.5).all(axis=1) & (uv[inside] < [view.width - 0.5, view.height - 0.5]).all(axis=1)
    rows = np.flatnonzero(inside)
    depth = xyz[rows] @ view.view_from_lidar[2]
    pixel = np.rint(uv[rows]).astype(np.int64)
    cell = pixel[:, 1] * view.width + pixel[:, 0]
    nearest = np.full(view.height * view.width, np.inf)
    np.minimum.at(nearest, cell, depth)
    keep = depth <= np.minimum(_SAME_SURFACE * nearest, _OCCLUDED * _least_around(nearest.reshape(shape)).ravel())[cell]
    cell, depth, kept = cell[keep], depth[keep], value[rows[keep]]
    count = np.bincount(cell, minlength=view.height * view.width)
    total = np.bincount(cell, kept, view.height * view.width)
    many = np.maximum(count, 1)
    places = np.where(count > 0, np.bincount(cell, depth, view.height * view.width) / many, np.nan).reshape(shape)
    filled, known = _filled((total / many).reshape(shape), (count > 0).reshape(shape))
    return Rendering(view, contrasted(filled, known), places)


def _least_around(depth: Float) -> Float:
    """Return the smallest value of each pixel (H, W) and its eight neighbours."""
    from scipy.ndimage import minimum_filter

    return np.asarray(minimum_filter(depth, 3, mode="nearest"))


def _filled(values: Float, given: Bool) -> tuple[Float, Bool]:
    """Return values (H, W) with holes filled by means of the surroundings, and a mask of pixels with a value."""
    import cv2

    weight = given.astype(np.float32)
    weighted = (values * weight).astype(np.float32)
    out, known = np.zeros(values.shape), np.zeros(values.shape, np.bool_)
    for width in (_FINEST_PX * 2**n for n in range(_WIDTHS)):
        with ipp_disabled():
            total, share = (cv2.GaussianBlur(part, (0, 0), width) for part in (weighted, weight))
        enough = ~known & (share * 4 * np.pi * width**2 > _LEAST_POINTS)
        out[enough] = total[enough] / share[enough]
        known |= enough
    return out, known


def contrasted(values: Float, known: Bool) -> UInt8:
    """Return values (H, W) as grey levels, equalised as a whole and then locally; 0 where they are not known."""
    import cv2

    grey = np.full(values.shape, 128, np.uint8)
    if known.any():
        given = values[known]
        order = np.sort(given)
        rank = np.searchsorted(order, given, "left") + np.searchsorted(order, given, "right")
        grey[known] = np.clip(rank * (255.0 / (2 * len(order))), 0, 255).astype(np.uint8)
    grey = np.asarray(cv2.createCLAHE(_CONTRAST, _TILES).apply(grey), np.uint8)
    grey[~known] = 0
    return grey


@dataclass(frozen=True, eq=False)
class FlatImage:
    """A camera image without distortion, at the focal length of the virtual views: `grey` (H, W) uint8.

    `low` (2,) is the corner of its first pixel on the plane at depth 1 of the camera frame.
    """

    grey: UInt8
    focal_px: float
    low: Float

    @property
    def width_deg(self) -> float:
        """The field of view along the longer side."""
        corners = self.rays(np.array([[0.0, 0.0], [self.grey.shape[1] - 1.0, self.grey.shape[0] - 1.0]]))
        plane = corners[:, :2] / corners[:, 2:]
        angles = np.degrees(np.arctan(plane[1]) - np.arctan(plane[0]))
        return float(angles.max())

    def rays(self, uv: Float) -> Float:
        """Return unit viewing rays (N, 3) of pixels (N, 2) in the camera frame."""
        rays = np.column_stack([np.asarray(uv) / self.focal_px + self.low, np.ones(len(uv))])
        return np.asarray(rays / np.linalg.norm(rays, axis=1, keepdims=True))

    def turned(self, quarters: int) -> UInt8:
        """Return the image turned counter-clockwise by quarters of a turn."""
        return np.ascontiguousarray(np.rot90(self.grey, quarters))

    def turned_back(self, uv: Float, quarters: int) -> Float:
        """Return the pixels (N, 2) of this image at pixels (N, 2) of the turned one."""
        height, width = self.grey.shape
        u, v = np.asarray(uv, np.float64).T
        across = {0: (u, v), 1: (width - 1 - v, u), 2: (width - 1 - u, height - 1 - v), 3: (v, height - 1 - u)}
        return np.column_stack(across[quarters % 4])


def flattened(image: p2o.Image, focal_px: float) -> FlatImage | None:
    """Return an image without distortion at a focal length in pixels; None if no ray of its camera points forward."""
    import cv2

    camera = image.camera
    extent = camera.extent()
    if extent is None:
        return None
    low, high = extent
    width, height = np.clip(np.ceil((high - low) * focal_px).astype(int) + 1, _LEAST_PX, 2 * _MOST_PX)
    xy = np.stack(np.meshgrid(np.arange(width), np.arange(height)), axis=-1) / focal_px + low
    uv = camera.project(np.concatenate([xy, np.ones((height, width, 1))], axis=-1)).astype(np.float32)
    inside = camera.in_image(np.asarray(uv, np.float64))
    if image.masked is not None:
        at = np.where(inside[..., None], np.rint(np.nan_to_num(uv)), 0).astype(np.int64)
        inside &= ~image.masked[at[..., 1].clip(0, camera.height - 1), at[..., 0].clip(0, camera.width - 1)]
    with ipp_disabled():
        grey = image.grey
        smaller = camera.focal_px / focal_px
        if smaller > 1.0:
            grey = cv2.GaussianBlur(grey, (0, 0), 0.4 * smaller)
        flat = cv2.remap(
            grey, np.nan_to_num(uv[..., 0], nan=-1.0), np.nan_to_num(uv[..., 1], nan=-1.0), cv2.INTER_LINEAR
        )
    return FlatImage(contrasted(flat.astype(np.float64), inside), focal_px, low)
