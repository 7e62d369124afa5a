"""Draw the sweep on the image, coloured by range or by reflectance, for visual checks of a calibration."""

from __future__ import annotations

from typing import Literal

import numpy as np

from p2o.arrays import Float, UInt8
from p2o.draw.overlay import dimmed, stamp
from p2o.errors import InputError
from p2o.frames.cloud import Cloud
from p2o.geometry import se3
from p2o.geometry.camera import Camera

By = Literal["range", "reflectance"]
_UNITS = {"range": " m", "reflectance": ""}
_SPREAD = (2.0, 98.0)
"""Percentiles at the ends of the scale, to exclude outliers such as retroreflectors."""
_PX_A_DOT = 600
"""Image width per pixel of a dot: larger dots would cover the image between the rings."""


def draw_sweep(rgb: UInt8, cloud: Cloud, camera: Camera, camera_from_lidar: Float, by: By = "range") -> UInt8:
    """Return (H, W, 3): a sweep at a pose (4, 4) over the darkened image, with a scale in the lower left corner.

    Colours by range are from red (near) to blue (far) on a logarithmic scale, by reflectance from dark blue (low) to
    yellow (high), over the range of the visible points. The size of dots is proportional to the image width; near ones
    are on top. Raises InputError if the image does not fit the camera, or the sweep has no intensity.
    """
    canvas = dimmed(rgb, camera)
    xyz = se3.apply(camera_from_lidar, cloud.xyz)
    uv = camera.project(xyz)
    distance = np.linalg.norm(xyz, axis=1)
    values = _values(cloud, distance, by)
    seen = np.flatnonzero(camera.in_image(uv) & (distance > 0))
    if not len(seen):
        return canvas
    seen = seen[np.argsort(-distance[seen], kind="stable")]
    values = values[seen]
    low, high = (float(value) for value in np.percentile(values, _SPREAD))
    share = _share(values, low, high, by)
    size = max(2, camera.width // _PX_A_DOT)
    square = np.stack(np.meshgrid(np.arange(size), np.arange(size)), -1).reshape(-1, 2) - (size - 1) // 2
    stamp(canvas, np.rint(uv[seen]).astype(np.int64), square, _table(by)[np.rint(share * 255).astype(np.int64)])
    _scale(canvas, low, high, by)
    return canvas


def sweep_colours(cloud: Cloud, by: By = "range") -> UInt8:
    """Return a colour (N, 3) for each point of a sweep, by its distance from the LiDAR or by its reflectance.

    The colours are those of `draw_sweep`, over the range of all points. Raises InputError for a sweep without
    intensity.
    """
    values = _values(cloud, np.maximum(np.linalg.norm(cloud.xyz, axis=1), 1e-3), by)
    if not len(values):
        return np.zeros((0, 3), np.uint8)
    low, high = (float(value) for value in np.percentile(values, _SPREAD))
    return np.asarray(_table(by)[np.rint(_share(values, low, high, by) * 255).astype(np.int64)])


def _values(cloud: Cloud, distance: Float, by: By) -> Float:
    """Return the distances (N,) of points or their intensities; raises InputError for a sweep without intensity."""
    if by == "range":
        return distance
    if cloud.intensity is None:
        raise InputError("the sweep has no reflectance", expected="an intensity for each point")
    return np.asarray(cloud.intensity, float)


def _share(values: Float, low: float, high: float, by: By) -> Float:
    """Return values normalised to the scale, 0 to 1."""
    if by == "range":
        values, low, high = np.log(values), float(np.log(low)), float(np.log(high))
    return np.asarray(np.clip((values - low) / max(high - low, 1e-9), 0, 1))


def _table(by: By) -> UInt8:
    """Return the 256 colours (256, 3) from the low to the high end."""
    import cv2

    ramp = np.arange(256, dtype=np.uint8)[:, None]
    table = cv2.applyColorMap(ramp, cv2.COLORMAP_TURBO if by == "range" else cv2.COLORMAP_PLASMA)[:, 0, ::-1]
    return np.ascontiguousarray(table[::-1] if by == "range" else table)


def _scale(canvas: UInt8, low: float, high: float, by: By) -> None:
    """Draw the scale with its two ends, if there is enough space."""
    import cv2

    height, width = canvas.shape[:2]
    # Pages scale wide images down.
    unit = max(1.0, width / 800)
    if width < 200 or height < 60:
        return
    bar_w, bar_h, margin = int(150 * unit), int(10 * unit), int(8 * unit)
    font, thick = 0.4 * unit, max(1, int(unit))
    texts = [f"{by} {low:.3g}", f"{high:.3g}{_UNITS[by]}"]
    (left, text_h), (right, _) = (cv2.getTextSize(text, cv2.FONT_HERSHEY_SIMPLEX, font, thick)[0] for text in texts)
    bottom = height - margin
    total = left + bar_w + right + 4 * margin
    canvas[bottom - text_h - 2 * margin : height, : min(total, width)] //= 4
    base = (margin, bottom - margin // 2)
    cv2.putText(canvas, texts[0], base, cv2.FONT_HERSHEY_SIMPLEX, font, (235, 235, 235), thick, cv2.LINE_AA)
    start = left + 2 * margin
    row = _table(by)[np.linspace(0, 255, bar_w).astype(int)]
    top = bottom - margin // 2 - bar_h
    canvas[top : top + bar_h, start : start + bar_w] = row[: max(0, width - start)]
    place = (start + bar_w + margin, base[1])
    cv2.putText(canvas, texts[1], place, cv2.FONT_HERSHEY_SIMPLEX, font, (235, 235, 235), thick, cv2.LINE_AA)
