"""Long contours of the grey image, `--extractor canny-long/CLOUD`: the image side of Yuan et al. (RA-L 2021).

After hku-mars/livox_camera_calib: Gaussian of 5x5 pixels, Canny with thresholds t and 3 t (t = 20 outdoors, 10
indoors), outer contours of more than 200 points. Departures: none known; masked pixels are left out. Where an image is
small (their issue 59: too few contours, and a crash) lower `min_length_px`.
"""

from __future__ import annotations

import numpy as np
import p2o


class CannyLongOptions(p2o.Options):
    """Options of `canny-long`."""

    threshold: float = p2o.field(20.0, gt=0, le=500, help="Lower threshold of Canny; the upper one is three times it.")
    min_length_px: int = p2o.field(200, ge=1, help="Contours of fewer points than this are dropped.")


def build(options: CannyLongOptions) -> p2o.ImageExtractor:
    """Return the extractor."""
    import cv2

    def extract(image: p2o.Image) -> p2o.ImageFeatures:
        grey = cv2.GaussianBlur(np.ascontiguousarray(image.grey), (5, 5), 0, 0)
        found = cv2.Canny(grey, options.threshold, 3 * options.threshold, L2gradient=True)
        kept = np.zeros(found.shape, np.bool_)
        for contour in cv2.findContours(found, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)[0]:
            if len(contour) > options.min_length_px:
                kept[contour[:, 0, 1], contour[:, 0, 0]] = True
        if image.masked is not None:
            kept &= ~image.masked
        v, u = np.nonzero(kept)
        return p2o.ImageFeatures(
            p2o.ImageEdges(np.column_stack([u, v]).astype(np.float64), np.full(len(u), p2o.Side.NONE, np.int8))
        )

    return extract


METHOD = p2o.Method(
    name="canny-long",
    build=build,
    options=CannyLongOptions,
    summary="Long contours of grey-level edges, without direction.",
    gives={"image-edges"},
    cite="Yuan et al., Pixel-level Extrinsic Self Calibration of High Resolution LiDAR and Camera, RA-L 2021",
)
