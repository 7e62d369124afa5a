"""Extract grey-level edges without direction, `--extractor canny`: the input of most edge-based baselines."""

from __future__ import annotations

import numpy as np
import p2o
from p2o import Bool, Image, ImageEdges, ImageFeatures, InputError, Options, Side, field, occlusion


class CannyOptions(Options):
    """Thresholds of the detector; grey levels are 0 to 255."""

    low: float = field(50.0, ge=0, help="Edges are followed down to this gradient (3x3 Sobel, 8 times grey levels/px).")
    high: float = field(150.0, gt=0, help="An edge needs this gradient somewhere (3x3 Sobel, 8 times grey levels/px).")
    blur_sigma_px: float = field(1.4, ge=0, le=20, help="Width of the Gaussian blur in pixels; 0 for none.")
    min_length_px: int = field(10, ge=1, help="Connected edges of fewer pixels than this are dropped.")


def check_thresholds(low: float, high: float, where: str) -> None:
    """Raise InputError if `low` exceeds `high`."""
    if low > high:
        raise InputError(
            "the thresholds are in the wrong order",
            where=where,
            expected=f"low <= high = {high:g}",
            got=f"low = {low:g}",
            hint="set both --set extractor.low and extractor.high",
        )


def edge_pixels(image: Image, options: CannyOptions) -> Bool:
    """Return the mask (H, W) of edge pixels; masked pixels of the image are no edges."""
    import cv2

    grey = image.grey
    if options.blur_sigma_px > 0:
        grey = cv2.GaussianBlur(grey, (0, 0), options.blur_sigma_px)
    edges = cv2.Canny(grey, options.low, options.high, L2gradient=True) > 0
    if image.masked is not None:
        edges &= ~image.masked
    return np.asarray(occlusion.without_short(edges[None], options.min_length_px)[0])


def edges_of(pixels: Bool) -> ImageFeatures:
    """Return pixels (H, W) as edges without direction, row by row."""
    v, u = np.nonzero(pixels)
    uv = np.stack([u, v], axis=1).astype(np.float64)
    return ImageFeatures(ImageEdges(uv, np.full(len(uv), Side.NONE, np.int8)))


def build(options: CannyOptions) -> p2o.ImageExtractor:
    """Return the extractor; raises InputError if `low` exceeds `high`."""
    check_thresholds(options.low, options.high, "canny")
    return lambda image: edges_of(edge_pixels(image, options))


METHOD = p2o.Method(
    name="canny",
    build=build,
    options=CannyOptions,
    summary="Grey-level edges at pixel centres, without direction.",
    gives={"image-edges"},
    cite="Canny, A Computational Approach to Edge Detection, TPAMI 1986",
)
