"""Lanes and poles of a picture by their shape, `--extractor lane-pole/lane-pole`, for `crlf`.

The paper (Ma et al. 2021) takes them from a network (DeepLab trained on Cityscapes). Ours looks for
- lanes: bright strips below the horizon, at most `widest_px` wide, on a road that is darker on both sides;
- poles: strips that differ from both sides alike and run straight down for `least_pole_px` or more.
A strip of a facade is a pole to it, and a bright kerb is a lane: geometry does not know better.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import p2o
from p2o.arrays import Bool, UInt8
from p2o.features.maps import ImageMap

FAR_PX = 60.0
"""What is farther from any lane, or pole, than this is as far as it can be."""


@dataclass(frozen=True, eq=False)
class LanePoleMap(ImageMap):
    """Distances (H, W, 2) in pixels to the nearest pixel of a lane and of a pole, cut off at `FAR_PX`."""

    word: ClassVar[str] = "image-lane-pole"


class LanePoleImageOptions(p2o.Options):
    """Options of the image side of `lane-pole`; all ours."""

    contrast: float = p2o.field(
        0.25, gt=0, le=10, help="A strip differs from both its sides by this share of the grey level around."
    )
    least_contrast: float = p2o.field(8.0, gt=0, le=255, help="And by so many grey levels.")
    widest_px: int = p2o.field(25, ge=3, le=201, help="Strips wider than this are none.")
    least_pole_px: int = p2o.field(40, ge=5, le=1000, help="A pole runs straight down for so many pixels.")
    least_lane_px: int = p2o.field(40, ge=1, help="Lanes of fewer pixels are none.")
    horizon_px: float = p2o.field(20.0, ge=-2000, le=2000, help="Lanes are looked for so far below the middle row.")


def strips(grey: UInt8, across: tuple[int, int], options: LanePoleImageOptions) -> tuple[Bool, Bool]:
    """Return which pixels (H, W) are brighter, and darker, than both sides of a strip that fits in a window.

    `across` are the rows and columns of the window: (1, K) finds strips that run down, (K, 1) those that run across.
    """
    import cv2

    window = np.ones(across, np.uint8)
    around = cv2.blur(grey, (31, 31)).astype(np.float64)
    least = np.maximum(options.contrast * around, options.least_contrast)
    bright = cv2.morphologyEx(grey, cv2.MORPH_TOPHAT, window) > least
    dark = cv2.morphologyEx(grey, cv2.MORPH_BLACKHAT, window) > least
    return np.asarray(bright), np.asarray(dark)


def lanes_in(grey: UInt8, first_row: int, options: LanePoleImageOptions) -> Bool:
    """Return which pixels (H, W) are of lanes."""
    import cv2

    size = options.widest_px
    both = (strips(grey, window, options)[0] for window in ((1, size), (max(size // 2, 3), 1)))
    found = np.logical_or(*both).astype(np.uint8)
    found[: max(first_row, 0)] = 0
    count, label, about, _ = cv2.connectedComponentsWithStats(found, connectivity=8)
    keep = about[:, cv2.CC_STAT_AREA] >= options.least_lane_px
    # A lane is drawn out: specks and patches fill the box around them.
    keep &= np.maximum(about[:, cv2.CC_STAT_WIDTH], about[:, cv2.CC_STAT_HEIGHT]) ** 2 >= 5 * about[:, cv2.CC_STAT_AREA]
    keep[0] = False
    return np.asarray(keep[label]) if count > 1 else np.zeros(grey.shape, np.bool_)


def poles_in(grey: UInt8, options: LanePoleImageOptions) -> Bool:
    """Return which pixels (H, W) are of poles."""
    import cv2

    down = np.ones((options.least_pole_px, 1), np.uint8)
    found = np.zeros(grey.shape, np.bool_)
    for strip in strips(grey, (1, options.widest_px), options):
        # Poles lean and waver by a pixel.
        upright = cv2.dilate(strip.astype(np.uint8), np.ones((1, 3), np.uint8))
        found |= cv2.morphologyEx(upright, cv2.MORPH_OPEN, down) > 0
    return found


def build(options: LanePoleImageOptions) -> p2o.ImageExtractor:
    """Return the extractor of the distance to lanes and poles."""
    import cv2

    def distance(mask: Bool) -> np.ndarray:
        if not mask.any():
            return np.full(mask.shape, FAR_PX)
        away = cv2.distanceTransform((~mask).astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
        return np.minimum(away.astype(np.float64), FAR_PX)

    def extract(image: p2o.Image) -> p2o.ImageFeatures:
        middle = image.camera.project(np.array([[0.0, 0.0, 1.0]]))[0, 1]
        lanes = lanes_in(image.grey, int(middle + options.horizon_px), options)
        poles = poles_in(image.grey, options)
        return p2o.ImageFeatures(features=[LanePoleMap(np.stack([distance(lanes), distance(poles)], axis=2))])

    return extract


METHOD = p2o.Method(
    name="lane-pole",
    build=build,
    options=LanePoleImageOptions,
    summary="Distance to lanes and poles, found by their shape.",
    gives={"image-lane-pole"},
    cite="Ma et al., CRLF: automatic calibration and refinement based on line feature, arXiv 2103.04558, 2021",
)
