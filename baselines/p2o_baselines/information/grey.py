"""Grey values of the image, on demand equalised and smoothed, `--extractor grey/CLOUD`: for mutual information."""

from __future__ import annotations

from typing import Literal

import numpy as np
import p2o
from p2o import field


class GreyOptions(p2o.Options):
    """Options of `grey`."""

    equalise: Literal["none", "histogram", "local"] = field(
        "none",
        help="Make grey values equally frequent: over the whole image, or in tiles with limited contrast (CLAHE).",
    )
    blur_sigma_px: float = field(1.0, ge=0, le=50, help="Width of the final Gaussian blur; 0 for none.")


def extract(image: p2o.Image, options: GreyOptions) -> p2o.ImageFeatures:
    """Return `image-grey`, 0 to 255."""
    import cv2

    grey = np.array(image.grey, np.uint8)
    if options.equalise == "histogram":
        grey = cv2.equalizeHist(grey)
    elif options.equalise == "local":
        grey = cv2.createCLAHE(clipLimit=2.0, tileGridSize=(8, 8)).apply(grey)
    values = grey.astype(np.float32)
    if options.blur_sigma_px > 0:
        values = cv2.GaussianBlur(values, (0, 0), options.blur_sigma_px)
    return p2o.ImageFeatures(features=[p2o.GreyMap(values.astype(np.float64))])


METHOD = p2o.Method(
    name="grey",
    build=lambda options: lambda image: extract(image, options),
    options=GreyOptions,
    summary="Grey values of every pixel, on demand equalised and smoothed.",
    gives={"image-grey"},
    cite="Zuiderveld, CLAHE, Graphics Gems IV, 1994",
)
