"""Convert light to pixel values: lens, exposure, sensor noise, tone curve and compression of a camera."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from p2o import UInt8

Single = NDArray[np.float32]

_FULL_WELL = 9000.0
"""Electrons at white, which determine the shot noise."""
_STEPS = 4096


@dataclass(frozen=True)
class Photo:
    """Settings that convert light to pixel values.

    `gain` multiplies the light, which saturates at 1. `blur_px` is the standard deviation of the lens blur;
    `vignetting` the share of light lost in the corners; `grain` the standard deviation of the read noise in grey levels
    of 255, to which shot noise is added (both are 0 for 0); `jpeg_quality` is 1 to 100, 0 without compression.
    """

    gain: float = 1.0
    blur_px: float = 0.0
    vignetting: float = 0.0
    grain: float = 0.0
    jpeg_quality: int = 0


def metered_gain(light: Single, exposure_ev: float = 0.0, *, whole: bool = False) -> float:
    """Return the gain that brings the lower half of an image (H, W, 3) to middle grey, times 2^exposure_ev.

    With `whole`, the whole image is used, for cameras that may be upside down.
    """
    lower = light[0 if whole else len(light) // 2 :: 4, ::4] @ np.array([0.3, 0.6, 0.1], np.float32)
    return float(0.16 * 2.0**exposure_ev / max(float(np.exp(np.log(lower + 1e-3).mean())), 1e-3))


def develop(light: Single, photo: Photo, rng: np.random.Generator) -> UInt8:
    """Return the image (H, W, 3) uint8 of linear light (H, W, 3)."""
    import cv2

    shown = np.asarray(light, np.float32)
    if photo.blur_px > 0:
        shown = cv2.GaussianBlur(shown, (0, 0), photo.blur_px)
    height, width = shown.shape[:2]
    scale = np.full((height, width), np.float32(photo.gain))
    if photo.vignetting > 0:
        y = (np.arange(height, dtype=np.float32) * 2 - height + 1) / np.float32(np.hypot(height, width))
        x = (np.arange(width, dtype=np.float32) * 2 - width + 1) / np.float32(np.hypot(height, width))
        scale *= 1 - np.float32(photo.vignetting) * (x**2 + y[:, None] ** 2)
    shown = np.asarray(shown * scale[..., None], np.float32)
    if photo.grain > 0:
        noise = rng.standard_normal(shown.shape, np.float32)
        # A grey level near middle grey is 1/255 of white times the slope of the tone curve, about one half.
        read = np.float32(photo.grain / 255 * 0.25)
        np.clip(shown, 0.0, 1.2, out=shown)
        shown += noise * np.sqrt(read**2 + shown * np.float32(photo.grain / _FULL_WELL))
    rgb = _curve()[np.clip(shown * np.float32(_STEPS) + np.float32(0.5), 0, _STEPS).astype(np.uint16)]
    if photo.jpeg_quality > 0:
        _, data = cv2.imencode(".jpg", rgb[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, photo.jpeg_quality])
        rgb = np.ascontiguousarray(np.asarray(cv2.imdecode(data, cv2.IMREAD_COLOR))[..., ::-1])
    return np.asarray(rgb, np.uint8)


def _curve() -> UInt8:
    """Return the 8-bit sRGB value of each step of linear light from 0 to 1."""
    linear = np.linspace(0.0, 1.0, _STEPS + 1)
    curve = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
    return np.asarray(255 * curve + 0.5, np.uint8)
