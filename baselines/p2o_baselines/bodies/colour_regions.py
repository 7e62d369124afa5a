"""Segment regions of one saturated colour in an image as candidates of bodies, which need a distinct colour."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from p2o import Bool, Float, UInt8

Single = NDArray[np.float32]
_HUES, _WINDOW = range(0, 180, 10), 10  # middles and half widths of windows of hue, in OpenCV's half degrees
_SATURATIONS, _LEAST_VALUE = (80, 140), 12
_LARGEST = 0.4  # of the image; larger is a wall or the sky


class Region(NamedTuple):
    """A connected region: its `area` in pixels and its outer `contour` (N, 2) px."""

    area: float
    contour: Float


def regions(rgb: UInt8, least_px: float) -> Iterator[Region]:
    """Yield regions of similar hue and some saturation with at least `least_px` pixels; an object may occur twice."""
    import cv2

    hsv = cv2.cvtColor(cv2.GaussianBlur(rgb, (5, 5), 0), cv2.COLOR_RGB2HSV)
    hue, saturation, value = (hsv[..., channel].astype(np.int16) for channel in range(3))
    height, width = hue.shape
    for least in _SATURATIONS:
        strong = (saturation >= least) & (value >= _LEAST_VALUE)
        for middle in _HUES:
            mask = strong & (np.abs((hue - middle + 90) % 180 - 90) <= _WINDOW)
            opened = cv2.morphologyEx(mask.astype(np.uint8), cv2.MORPH_OPEN, np.ones((3, 3), np.uint8))
            contours, _ = cv2.findContours(opened, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
            for outline in contours:
                area = float(cv2.contourArea(outline))
                if least_px <= area <= _LARGEST * height * width:
                    yield Region(area, outline.reshape(-1, 2).astype(np.float64))


def at_border(uv: Float, width: int, height: int) -> Bool:
    """Return which pixels (N, 2) lie at the border of an image, where a region is truncated."""
    return np.asarray((uv < 2).any(axis=1) | (uv > np.array([width, height]) - 3).any(axis=1))


def step_at(light: Single, uv: Float, most: float, *, least_step: float = 0.006, smooth: int = 3) -> Float:
    """Return the position (N,) in 0..K-1 of the colour step along samples (N, K, 2) px, from inside to outside.

    The colour is projected onto the difference between the means of the first and the last samples; the step is where
    it crosses half of that. `light` (H, W, 3) is linear, because a lens blurs light: the sRGB curve would shift steps
    by a third of a pixel. `smooth` adjacent lines are averaged first, so that their errors are correlated. NaN without
    a step within `most` samples of the middle.
    """
    import cv2

    places = uv.astype(np.float32)
    seen = cv2.remap(light, places[..., 0], places[..., 1], cv2.INTER_LINEAR)
    seen = cv2.blur(seen, (3, smooth), borderType=cv2.BORDER_REPLICATE).astype(np.float64)
    count, end = seen.shape[1], max(2, seen.shape[1] // 4)
    inner, outer = seen[:, :end].mean(axis=1), seen[:, -end:].mean(axis=1)
    gradient = inner - outer
    size = np.linalg.norm(gradient, axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        share = np.einsum("nkc,nc->nk", seen - outer[:, None], gradient) / size[:, None] ** 2
    above = share >= 0.5
    crosses = above[:, :-1] & ~above[:, 1:]
    at = np.argmax(crosses, axis=1)
    rows = np.arange(len(seen))
    high, low = share[rows, at], share[rows, at + 1]
    with np.errstate(divide="ignore", invalid="ignore"):
        out = at + (high - 0.5) / (high - low)
    # Several crossings are texture, not a step.
    bad = (crosses.sum(axis=1) != 1) | (size < least_step) | (np.abs(out - (count - 1) / 2) > most)
    return np.where(bad, np.nan, out)


def linear_light(rgb: UInt8) -> Single:
    """Return the light (H, W, 3), 0 to 1, that an image of sRGB stands for."""
    value = np.arange(256) / 255
    light = np.where(value <= 0.04045, value / 12.92, ((value + 0.055) / 1.055) ** 2.4).astype(np.float32)
    return np.asarray(light[rgb])
