"""The sweep on the image, coloured by range or by reflectance: what a person checks a calibration with."""

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
"""Percentiles at the ends of the scale: a few points far away, or a few reflectors, do not take all the colours."""
_PX_A_DOT = 600
"""So many pixels of width are one pixel of a dot: larger ones hide the image between the rings."""


def draw_sweep(rgb: UInt8, cloud: Cloud, camera: Camera, camera_from_lidar: Float, by: By = "range") -> UInt8:
    """Return (H, W, 3): a sweep at a pose (4, 4) over the darkened image, with a scale in the lower left corner.

    By range it goes from red (near) to blue (far), evenly in its logarithm; by reflectance from dark blue (low) to
    yellow (high). The ends are those of the points that are seen. Dots grow with the width of the image; near ones are
    on top.

    Raises InputError if the image does not fit the camera, or the sweep tells no reflectance.
    """
    canvas = dimmed(rgb, camera)
    if by == "reflectance" and cloud.intensity is None:
        raise InputError("the sweep tells no reflectance", expected="an intensity for each point")
    xyz = se3.apply(camera_from_lidar, cloud.xyz)
    uv = camera.project(xyz)
    distance = np.linalg.norm(xyz, axis=1)
    seen = np.flatnonzero(camera.in_image(uv) & (distance > 0))
    if not len(seen):
        return canvas
    seen = seen[np.argsort(-distance[seen], kind="stable")]
    values = distance[seen] if by == "range" or cloud.intensity is None else np.asarray(cloud.intensity, float)[seen]
    low, high = (float(value) for value in np.percentile(values, _SPREAD))
    share = _share(values, low, high, by)
    size = max(2, camera.width // _PX_A_DOT)
    square = np.stack(np.meshgrid(np.arange(size), np.arange(size)), -1).reshape(-1, 2) - (size - 1) // 2
    stamp(canvas, np.rint(uv[seen]).astype(np.int64), square, _table(by)[np.rint(share * 255).astype(np.int64)])
    _scale(canvas, low, high, by)
    return canvas


def sweep_colours(cloud: Cloud, by: By = "range") -> UInt8:
    """Return a colour (N, 3) for each point of a sweep, by its distance from the LiDAR or by its reflectance.

    The colours are those of `draw_sweep`, the ends of the scale those of all points. Raises InputError if the sweep
    tells no reflectance.
    """
    if by == "reflectance" and cloud.intensity is None:
        raise InputError("the sweep tells no reflectance", expected="an intensity for each point")
    distance = np.maximum(np.linalg.norm(cloud.xyz, axis=1), 1e-3)
    values = distance if by == "range" or cloud.intensity is None else np.asarray(cloud.intensity, float)
    if not len(values):
        return np.zeros((0, 3), np.uint8)
    low, high = (float(value) for value in np.percentile(values, _SPREAD))
    return np.asarray(_table(by)[np.rint(_share(values, low, high, by) * 255).astype(np.int64)])


def _share(values: Float, low: float, high: float, by: By) -> Float:
    """Return the places of values in the scale, 0 to 1."""
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
    """Draw the scale with its two ends, as large as the image asks for, if there is room."""
    import cv2

    height, width = canvas.shape[:2]
    # Pages show wide pictures smaller.
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
