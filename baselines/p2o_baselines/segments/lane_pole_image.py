"""Detect lanes and poles of an image by their shape, `--extractor lane-pole/lane-pole`, for `crlf`.

The paper (Ma et al. 2021) uses a network (DeepLab trained on Cityscapes). Here
- lanes are bright strips below the horizon, at most 25 px wide, on a road that is darker on both sides;
- poles are strips that are brighter or darker than both sides and vertical over 40 px or more.

Strips of facades are detected as poles and bright kerbs as lanes, because only geometry is used.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import p2o
from p2o import Bool, Float, ImageMap, UInt8

FAR_PX = 60.0  # distances to a lane or pole are truncated here


@dataclass(frozen=True, eq=False)
class LanePoleMap(ImageMap):
    """Distances (H, W, 2) in pixels to the nearest pixel of a lane and of a pole, truncated at `FAR_PX`."""

    word: ClassVar[str] = "image-lane-pole"


# All are ours.
_CONTRAST = 0.25  # least difference to both sides over the mean around
_LEAST_CONTRAST = 8.0  # least difference in grey levels
_WIDEST_PX = 25  # largest width of a strip
_LEAST_POLE_PX = 40  # least length of a pole
_LEAST_LANE_PX = 40  # least number of pixels of a lane
_HORIZON_PX = 20.0  # distance below the middle row at which lanes begin


def strips(grey: UInt8, across: tuple[int, int]) -> tuple[Bool, Bool]:
    """Return which pixels (H, W) are brighter, and darker, than both sides of a strip in a window of a size."""
    import cv2

    window = np.ones(across, np.uint8)
    around = cv2.blur(grey, (31, 31)).astype(np.float64)
    least = np.maximum(_CONTRAST * around, _LEAST_CONTRAST)
    bright, dark = (cv2.morphologyEx(grey, kind, window) > least for kind in (cv2.MORPH_TOPHAT, cv2.MORPH_BLACKHAT))
    return np.asarray(bright), np.asarray(dark)


def lanes_in(grey: UInt8, first_row: int) -> Bool:
    """Return which pixels (H, W) are of lanes."""
    import cv2

    size = _WIDEST_PX
    both = (strips(grey, window)[0] for window in ((1, size), (max(size // 2, 3), 1)))
    strip_mask = np.logical_or(*both).astype(np.uint8)
    strip_mask[: max(first_row, 0)] = 0
    count, label, about, _ = cv2.connectedComponentsWithStats(strip_mask, connectivity=8)
    area, extent = about[:, cv2.CC_STAT_AREA], about[:, [cv2.CC_STAT_WIDTH, cv2.CC_STAT_HEIGHT]].max(axis=1)
    # A lane is drawn out: specks and patches fill the box around them.
    keep = (area >= _LEAST_LANE_PX) & (extent**2 >= 5 * area)
    keep[0] = False
    return np.asarray(keep[label]) if count > 1 else np.zeros(grey.shape, np.bool_)


def poles_in(grey: UInt8) -> Bool:
    """Return which pixels (H, W) are of poles."""
    import cv2

    down = np.ones((_LEAST_POLE_PX, 1), np.uint8)
    pole_mask = np.zeros(grey.shape, np.bool_)
    for strip in strips(grey, (1, _WIDEST_PX)):
        # Poles lean and waver by a pixel.
        upright = cv2.dilate(strip.astype(np.uint8), np.ones((1, 3), np.uint8))
        pole_mask |= cv2.morphologyEx(upright, cv2.MORPH_OPEN, down) > 0
    return pole_mask


def build(options: p2o.Options) -> p2o.ImageExtractor:
    """Return the extractor of the distance to lanes and poles."""
    import cv2

    def distance(mask: Bool) -> Float:
        if not mask.any():
            return np.full(mask.shape, FAR_PX)
        away = cv2.distanceTransform((~mask).astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
        return np.asarray(np.minimum(away.astype(np.float64), FAR_PX))

    def extract(image: p2o.Image) -> p2o.ImageFeatures:
        middle = image.camera.project(np.array([[0.0, 0.0, 1.0]]))[0, 1]
        lanes = lanes_in(image.grey, int(middle + _HORIZON_PX))
        poles = poles_in(image.grey)
        return p2o.ImageFeatures(features=[LanePoleMap(np.stack([distance(lanes), distance(poles)], axis=2))])

    return extract


METHOD = p2o.Method(
    name="lane-pole",
    build=build,
    summary="Distance to lanes and poles, detected by shape.",
    gives={"image-lane-pole"},
    cite="Ma et al., CRLF: automatic calibration and refinement based on line feature, arXiv 2103.04558, 2021",
)
