"""Grey-level edges without direction, `--extractor canny`: where most of the paper's rivals start."""

from __future__ import annotations

import numpy as np
from p2o import Image, ImageEdges, ImageExtractor, ImageFeatures, InputError, Method, Options, Side, field, occlusion


class CannyOptions(Options):
    """Thresholds of the detector; grey levels are 0 to 255."""

    low: float = field(50.0, ge=0, help="Edges are followed down to this gradient (3x3 Sobel, 8 times grey levels/px).")
    high: float = field(150.0, gt=0, help="An edge needs this gradient somewhere (3x3 Sobel, 8 times grey levels/px).")
    blur_sigma_px: float = field(1.4, ge=0, le=20, help="Width of the Gaussian blur before, in pixels; 0 for none.")
    min_length_px: int = field(10, ge=1, help="Connected edges of fewer pixels than this are dropped.")


def build(options: CannyOptions) -> ImageExtractor:
    """Return the extractor; raises InputError if `low` exceeds `high`."""
    import cv2

    if options.low > options.high:
        raise InputError(
            "the thresholds are in the wrong order",
            where="canny",
            expected=f"low <= high = {options.high:g}",
            got=f"low = {options.low:g}",
            hint="set both --set extractor.low and extractor.high",
        )

    def extract(image: Image) -> ImageFeatures:
        grey = image.grey
        if options.blur_sigma_px > 0:
            grey = cv2.GaussianBlur(grey, (0, 0), options.blur_sigma_px)
        found = cv2.Canny(grey, options.low, options.high, L2gradient=True) > 0
        if image.masked is not None:
            found &= ~image.masked
        v, u = np.nonzero(occlusion.without_short(found[None], options.min_length_px)[0])
        uv = np.stack([u, v], axis=1).astype(np.float64)
        return ImageFeatures(ImageEdges(uv, np.full(len(uv), Side.NONE, np.int8)))

    return extract


METHOD = Method(
    name="canny",
    build=build,
    options=CannyOptions,
    summary="Grey-level edges at pixel centres, without direction.",
    gives={"image-edges"},
    cite="Canny, A Computational Approach to Edge Detection, TPAMI 1986",
)
