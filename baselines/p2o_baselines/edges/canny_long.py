"""Extract long contours of the grey image, `--extractor canny-long/CLOUD`: the image side of Yuan et al. (RA-L 2021).

After hku-mars/livox_camera_calib: Gaussian of 5x5 pixels, Canny with thresholds t and 3 t (t = 20 outdoors, 10
indoors), outer contours of more than 200 points. Masked pixels are dropped; no other departures are known. For small
images (issue 59 of the original: too few contours, and a crash) reduce `min_length_px`.
"""

from __future__ import annotations

import numpy as np
import p2o
from p2o import field

from p2o_baselines.edges.canny import edges_of


class CannyLongOptions(p2o.Options):
    """Options of `canny-long`."""

    threshold: float = field(20.0, gt=0, le=500, help="Lower threshold of Canny; the upper one is three times it.")
    min_length_px: int = field(200, ge=1, help="Contours of fewer points than this are dropped.")


def extract(image: p2o.Image, options: CannyLongOptions) -> p2o.ImageFeatures:
    """Return the long contours of an image."""
    import cv2

    grey = cv2.GaussianBlur(np.ascontiguousarray(image.grey), (5, 5), 0, 0)
    edges = cv2.Canny(grey, options.threshold, 3 * options.threshold, L2gradient=True)
    kept = np.zeros(edges.shape, np.bool_)
    for contour in cv2.findContours(edges, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)[0]:
        if len(contour) > options.min_length_px:
            kept[contour[:, 0, 1], contour[:, 0, 0]] = True
    if image.masked is not None:
        kept &= ~image.masked
    return edges_of(kept)


METHOD = p2o.Method(
    name="canny-long",
    build=lambda options: lambda image: extract(image, options),
    options=CannyLongOptions,
    summary="Long contours of grey-level edges, without direction.",
    gives={"image-edges"},
    cite="Yuan et al., Pixel-level Extrinsic Self Calibration of High Resolution LiDAR and Camera, RA-L 2021",
)
