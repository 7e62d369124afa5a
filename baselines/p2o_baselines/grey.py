"""Grey values of the picture, on demand equalised and smoothed, `--extractor grey/CLOUD`: for mutual information."""

from __future__ import annotations

from typing import Literal

import numpy as np
import p2o


class GreyOptions(p2o.Options):
    """Options of `grey`."""

    equalise: Literal["none", "histogram", "local"] = p2o.field(
        "none",
        help="Make every grey value as frequent as any other: over the whole picture, or in tiles, with limited "
        "contrast (CLAHE). Matchers that want equal shares equalise by themselves.",
    )
    bilateral_px: int = p2o.field(
        0, ge=0, le=51, help="Diameter of a bilateral filter, which smooths texture and keeps outlines; 0 for none."
    )
    bilateral_sigma: float = p2o.field(
        75.0, gt=0, le=1000, help="Deviation of that filter, in pixels and in grey levels of 255."
    )
    blur_sigma_px: float = p2o.field(1.0, ge=0, le=50, help="Width of the Gaussian blur at last; 0 for none.")


def build(options: GreyOptions) -> p2o.ImageExtractor:
    """Return the extractor `Image -> ImageFeatures` with `image-grey`, 0 to 255."""
    import cv2

    def extract(image: p2o.Image) -> p2o.ImageFeatures:
        grey = np.array(image.grey, np.uint8)
        if options.bilateral_px > 0:
            grey = cv2.bilateralFilter(grey, options.bilateral_px, options.bilateral_sigma, options.bilateral_sigma)
        if options.equalise == "histogram":
            grey = cv2.equalizeHist(grey)
        elif options.equalise == "local":
            grey = cv2.createCLAHE(clipLimit=2.0, tileGridSize=(8, 8)).apply(grey)
        values = grey.astype(np.float32)
        if options.blur_sigma_px > 0:
            values = cv2.GaussianBlur(values, (0, 0), options.blur_sigma_px)
        return p2o.ImageFeatures(features=[p2o.GreyMap(values.astype(np.float64))])

    return extract


METHOD = p2o.Method(
    name="grey",
    build=build,
    options=GreyOptions,
    summary="Grey values of every pixel, on demand equalised and smoothed.",
    gives={"image-grey"},
    cite="Tomasi and Manduchi, Bilateral filtering, ICCV 1998; Zuiderveld, CLAHE, Graphics Gems IV, 1994",
)
