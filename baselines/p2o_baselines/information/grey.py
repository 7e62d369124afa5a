"""Grey values of the image, slightly smoothed, `--extractor grey/CLOUD`: for mutual information."""

from __future__ import annotations

import numpy as np
import p2o

_BLUR_SIGMA_PX = 1.0  # width of the Gaussian blur


def extract(image: p2o.Image) -> p2o.ImageFeatures:
    """Return `image-grey`, 0 to 255."""
    import cv2

    values = cv2.GaussianBlur(np.array(image.grey, np.uint8).astype(np.float32), (0, 0), _BLUR_SIGMA_PX)
    return p2o.ImageFeatures(features=[p2o.GreyMap(values.astype(np.float64))])


METHOD = p2o.Method(
    name="grey",
    build=lambda options: extract,
    summary="Grey values of every pixel, slightly smoothed.",
    gives={"image-grey"},
)
