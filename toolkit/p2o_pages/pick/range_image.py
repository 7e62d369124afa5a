"""The range image of a sweep: each pixel is one point, so that a click selects a point."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from p2o.arrays import Float, Int, UInt8, checked
from p2o.frames.cloud import Cloud
from p2o.frames.frame import Frame

Layer = Literal["depth", "bearing", "intensity"]
LAYERS: tuple[Layer, ...] = ("depth", "bearing", "intensity")

_MARGIN_DEG = 15.0
_ROUNDED_DEG = 10.0
_COLUMNS, _ROWS = 4096, 512
_FINEST_DEG, _COARSEST_DEG = 0.05, 1.0
_MAX_STRETCH = 8
_EMPTY = 24  # grey of pixels without a point


@dataclass(frozen=True)
class Sector:
    """Azimuths of a range image: their middle, counter-clockwise from forward (x), and their width."""

    middle_deg: float = 0.0
    width_deg: float = 360.0


@dataclass(frozen=True, eq=False)
class RangeImage:
    """Points of a sweep by direction, seen from the LiDAR, not mirrored.

    `index` (H, W) is the number of a pixel's point in the sweep, -1 in empty pixels; `xyz` (N, 3) are all points.
    Rows are rings, highest first, or steps of elevation; a row is as high as `stretch` columns are wide.
    """

    index: Int
    xyz: Float
    intensity: Float | None
    stretch: int

    def __post_init__(self) -> None:
        object.__setattr__(self, "index", checked("index", self.index, (None, None), np.int64))

    @property
    def range_m(self) -> Float:
        """Ranges (H, W), NaN in empty pixels."""
        return np.where(self.index >= 0, np.linalg.norm(self.xyz, axis=1)[self.index], np.nan)

    def nearest(self, column: float, row: float, reach: float = 4.0) -> tuple[int, int] | None:
        """Return column and row of the filled pixel nearest to a position, None if none is within `reach` columns."""
        height, width = self.index.shape
        far = np.ceil(reach)
        left, right = (int(np.clip(column + step, 0, width)) for step in (-far, far + 1))
        top, bottom = (int(np.clip(row + step, 0, height)) for step in (-far, far + 1))
        rows, columns = np.nonzero(self.index[top:bottom, left:right] >= 0)
        if not len(rows):
            return None
        away = np.hypot(columns + left - column, (rows + top - row) * self.stretch)
        best = int(np.argmin(away))
        return (int(columns[best] + left), int(rows[best] + top)) if away[best] <= reach else None

    def pixel_of(self, xyz: Float) -> tuple[int, int] | None:
        """Return column and row of the point nearest to a point (3,), None if that point has no pixel."""
        if not len(self.xyz):
            return None
        rows, columns = np.nonzero(self.index == np.argmin(np.linalg.norm(self.xyz - xyz, axis=1)))
        return (int(columns[0]), int(rows[0])) if len(rows) else None

    def drawn(self, layer: Layer) -> UInt8:
        """Return a layer as an RGB image (H, W, 3): bearing angles, logarithm of the range, or intensity."""
        import cv2

        if layer == "depth":
            shade = _stretched(-np.log(np.maximum(self.range_m, 0.1)), 0.0, 100.0)
            coloured = cv2.cvtColor(cv2.applyColorMap(shade, cv2.COLORMAP_TURBO), cv2.COLOR_BGR2RGB)
        else:
            if layer == "bearing" or self.intensity is None:
                shade = np.nan_to_num(bearing_angles(self) * (255 / np.pi)).astype(np.uint8)
            else:
                shade = _stretched(np.where(self.index >= 0, self.intensity[self.index], np.nan), 1.0, 97.0)
            coloured = np.repeat(shade[..., None], 3, axis=2)
        return np.where(self.index[..., None] >= 0, coloured, _EMPTY).astype(np.uint8)


def range_image(cloud: Cloud, sector: Sector = Sector()) -> RangeImage:
    """Return the range image of a sweep: rows are its rings if they are known, else steps of elevation.

    The nearest of several points in a pixel is kept. Directions are those measured, without motion compensation.
    """
    xyz = cloud.as_measured()
    distance = np.linalg.norm(xyz, axis=1)
    azimuth = np.degrees(np.arctan2(xyz[:, 1], xyz[:, 0]))
    # Degrees to the right of the left border of the sector.
    right = sector.width_deg / 2 - _wrapped(azimuth - sector.middle_deg)
    elevation = np.degrees(np.arctan2(xyz[:, 2], np.hypot(xyz[:, 0], xyz[:, 1])))
    rows_at = np.flatnonzero((right >= 0) & (right < sector.width_deg) & (distance > 0))
    if not len(rows_at):
        return RangeImage(np.full((1, 1), -1), cloud.xyz, cloud.intensity, 1)
    if cloud.ring is None:
        step_deg = _even_step(sector, elevation[rows_at], len(rows_at))
        down = (elevation[rows_at].max() - elevation[rows_at]) / step_deg
        row, stretch = np.minimum(down.astype(np.int64), _ROWS - 1), 1
    else:
        step_deg = _ring_step(cloud.ring, azimuth, sector)
        rings, which = np.unique(cloud.ring[rows_at], return_inverse=True)
        mean = np.bincount(which, elevation[rows_at]) / np.bincount(which)
        row = np.argsort(np.argsort(-mean, kind="stable"), kind="stable")[which]
        apart = float(np.ptp(mean)) / max(len(rings) - 1, 1)
        stretch = int(np.clip(round(apart / step_deg), 1, _MAX_STRETCH))
    column = (right[rows_at] / step_deg).astype(np.int64)
    width = int(np.ceil(sector.width_deg / step_deg))
    index = np.full((int(row.max()) + 1, width), -1)
    far_first = np.argsort(-distance[rows_at], kind="stable")  # the last assignment is kept
    index[row[far_first], np.minimum(column, width - 1)[far_first]] = rows_at[far_first]
    return RangeImage(index, cloud.xyz, cloud.intensity, stretch)


def sector_of(frame: Frame) -> Sector:
    """Return the azimuths that the camera of a frame sees, with a margin, or all if its direction is unknown.

    The direction is that of the initial guess of the frame, else of its extrinsic, rounded to 10 deg, so that the
    image reveals nothing about the calibration.
    """
    pose = frame.start if frame.start is not None else frame.camera_from_lidar
    if pose is None:
        return Sector()
    ahead = pose[:3, :3].T @ [0.0, 0.0, 1.0]
    middle = _ROUNDED_DEG * round(float(np.degrees(np.arctan2(ahead[1], ahead[0]))) / _ROUNDED_DEG)
    camera = frame.camera
    ends = camera.rays(np.array([[0.0, camera.height / 2], [camera.width - 1.0, camera.height / 2]]))
    seen = np.degrees(np.arccos(np.clip(float(ends[0] @ ends[1]), -1, 1)))
    return Sector(middle, float(min(seen + 2 * _MARGIN_DEG, 360.0)) if np.isfinite(seen) else 210.0)


def bearing_angles(image: RangeImage, apart: int = 4) -> Float:
    """Return the bearing angles (H, W) in rad of a range image, NaN if a pixel or its neighbour is empty.

    The bearing angle is that between the beam of the neighbour and the line from its point to this pixel's point. It
    shows edges and folds of surfaces at any distance (Scaramuzza et al., IROS 2007, Sec. III). The neighbour is `apart`
    columns to the left. The paper uses the adjacent column, whose angle is noise for beams 1/6 deg apart.
    """
    points = np.where(image.index[..., None] >= 0, image.xyz[image.index], np.nan)
    ranges = np.linalg.norm(points, axis=-1)
    out = np.full(image.index.shape, np.nan)
    before, after = ranges[:, :-apart], ranges[:, apart:]
    cosine = (points[:, apart:] * points[:, :-apart]).sum(axis=-1) / (after * before)
    out[:, apart:] = bearing_angle(before, after, np.clip(cosine, -1, 1))
    return out


def bearing_angle(before_m: Float, range_m: Float, cosine: Float) -> Float:
    """Return acos((d1 - d2 cos a) / sqrt(d1^2 + d2^2 - 2 d1 d2 cos a)) in rad, for ranges d1, d2 an angle a apart."""
    before_m, range_m = np.asarray(before_m, np.float64), np.asarray(range_m, np.float64)
    apart = np.sqrt(np.maximum(before_m**2 + range_m**2 - 2 * before_m * range_m * cosine, 1e-18))
    return np.asarray(np.arccos(np.clip((before_m - range_m * cosine) / apart, -1, 1)))


def _wrapped(angle_deg: Float) -> Float:
    """Wrap angles to -180 to 180 deg."""
    return np.asarray(np.mod(angle_deg + 180.0, 360.0) - 180.0)


def _ring_step(ring: Int, azimuth_deg: Float, sector: Sector) -> float:
    """Return the median azimuth step [deg] between beams of a ring."""
    order = np.lexsort((azimuth_deg, ring))
    step = np.diff(azimuth_deg[order])[(np.diff(ring[order]) == 0)]
    step = step[(step > 1e-4) & (step < 5)]
    usual = float(np.median(step)) if len(step) else _COARSEST_DEG
    return max(float(np.clip(usual, _FINEST_DEG, _COARSEST_DEG)), sector.width_deg / _COLUMNS)


def _even_step(sector: Sector, elevation_deg: Float, count: int) -> float:
    """Return the step [deg] at which about every second pixel contains a point."""
    high = max(float(np.ptp(elevation_deg)), 1.0)
    step = float(np.clip(np.sqrt(2 * sector.width_deg * high / count) / 2, _FINEST_DEG, _COARSEST_DEG))
    return max(step, sector.width_deg / _COLUMNS, high / (_ROWS - 1))


def _stretched(values: Float, low: float, high: float) -> UInt8:
    """Scale values (H, W) between two percentiles to 1 to 255; NaN becomes 0."""
    known = values[np.isfinite(values)]
    if not len(known):
        return np.zeros(values.shape, np.uint8)
    bottom, top = np.percentile(known, [low, high])
    share = np.clip((values - bottom) / max(float(top - bottom), 1e-9), 0, 1)
    return np.where(np.isfinite(values), 1 + 254 * np.nan_to_num(share), 0).astype(np.uint8)
