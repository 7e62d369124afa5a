"""Where a picture is smooth, `--extractor smoothness/returns`: small weights on edges of grey, for `tv-fusion`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import p2o
from p2o.features.maps import ImageMap


@dataclass(frozen=True, eq=False)
class SmoothMap(ImageMap):
    """Weights (H, W), 1 where the picture is smooth and towards 0 where its grey value changes."""

    word: ClassVar[str] = "image-smoothness"


class SmoothnessOptions(p2o.Options):
    """Options of `smoothness`; ours, since the paper names no figures that could be confirmed."""

    blur_px: float = p2o.field(1.0, ge=0, le=50, help="Width of the Gaussian before the gradient.")
    scale: float = p2o.field(8.0, gt=0, le=255, help="Gradient (grey levels a pixel) at which the weight is 1/e.")


def build(options: SmoothnessOptions) -> p2o.ImageExtractor:
    """Return the extractor of exp(-|gradient| / scale)."""
    from scipy.ndimage import gaussian_filter

    def extract(image: p2o.Image) -> p2o.ImageFeatures:
        grey = gaussian_filter(image.grey.astype(np.float64), options.blur_px)
        down, across = np.gradient(grey)
        return p2o.ImageFeatures(features=[SmoothMap(np.exp(-np.hypot(down, across) / options.scale))])

    return extract


METHOD = p2o.Method(
    name="smoothness",
    build=build,
    options=SmoothnessOptions,
    summary="Weights of 1 where the picture is smooth, small on its edges.",
    gives={"image-smoothness"},
    cite="Castorena et al., Autocalibration of LIDAR and optical cameras via edge alignment, ICASSP 2016",
)
