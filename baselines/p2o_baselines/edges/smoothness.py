"""Compute image smoothness, `--extractor smoothness/returns`: small weights on grey edges, for `tv-fusion`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import p2o
from p2o import ImageMap


@dataclass(frozen=True, eq=False)
class SmoothMap(ImageMap):
    """Weights (H, W), 1 where the image is smooth and towards 0 at grey edges."""

    word: ClassVar[str] = "image-smoothness"


# Both are ours, since those of the paper could not be confirmed.
_BLUR_PX = 1.0  # width of the Gaussian before the gradient
_SCALE = 8.0  # gradient (grey levels a pixel) at which the weight is 1/e


def extract(image: p2o.Image) -> p2o.ImageFeatures:
    """Return exp(-|gradient| / scale) of an image."""
    from scipy.ndimage import gaussian_filter

    grey = gaussian_filter(image.grey.astype(np.float64), _BLUR_PX)
    down, across = np.gradient(grey)
    return p2o.ImageFeatures(features=[SmoothMap(np.exp(-np.hypot(down, across) / _SCALE))])


METHOD = p2o.Method(
    name="smoothness",
    build=lambda options: extract,
    summary="Weights of 1 where the image is smooth, small on its edges.",
    gives={"image-smoothness"},
    cite="Castorena et al., Autocalibration of LIDAR and optical cameras via edge alignment, ICASSP 2016",
)
