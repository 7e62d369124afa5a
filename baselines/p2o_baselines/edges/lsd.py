"""Detect line segments of the grey image, `--extractor lsd/CLOUD`: as undirected edges and as segments.

Von Gioi et al., LSD: A Line Segment Detector, Image Processing On Line 2, 2012, in OpenCV's implementation with its
default settings. Edges are points one pixel apart along the segments, each of weight 1. Segments that touch masked
pixels or are shorter than 10 px (ours) are dropped.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np
import p2o
from p2o import Float
from p2o.solving import checked


@dataclass(frozen=True, eq=False)
class ImageLines(p2o.ImageFeature):
    """Line segments of an image: `ends` (N, 2, 2) px, first and last point of each."""

    word: ClassVar[str] = "image-lines"

    ends: Float

    def __post_init__(self) -> None:
        object.__setattr__(self, "ends", checked("ends of the image lines", self.ends, (None, 2, 2), np.float64))

    def __len__(self) -> int:
        return len(self.ends)

    def select(self, keep: Any) -> ImageLines:
        """Return the segments of a mask or index."""
        return replace(self, ends=self.ends[keep])


_MIN_LENGTH_PX = 10.0  # shortest segment that is kept, in pixels


def segments(image: p2o.Image, min_length_px: float) -> Float:
    """Return the segments (N, 2, 2) px of an image that are long enough and touch no masked pixel."""
    import cv2

    detected = cv2.createLineSegmentDetector().detect(np.ascontiguousarray(image.grey))[0]
    if detected is None:
        return np.zeros((0, 2, 2))
    # The detector may reach half a pixel beyond the border.
    last = np.array([image.camera.width - 1, image.camera.height - 1], np.float64)
    ends = np.clip(detected.reshape(-1, 2, 2).astype(np.float64), 0.0, last)
    ends = ends[np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1) >= max(min_length_px, 1e-6)]
    if image.masked is None or not len(ends):
        return np.asarray(ends)
    uv, segment = points_along(ends)
    u, v = np.rint(uv).astype(np.int64).T
    return np.asarray(ends[np.bincount(segment, image.masked[v, u], len(ends)) == 0])


def points_along(ends: Float) -> tuple[Float, Any]:
    """Return points (M, 2) about one pixel apart along segments (N, 2, 2), both ends included, and their segment."""
    count = np.ceil(np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)).astype(np.int64) + 1
    segment = np.repeat(np.arange(len(ends)), count)
    number = np.arange(len(segment)) - np.repeat(np.cumsum(count) - count, count)
    share = (number / np.maximum(count[segment] - 1, 1))[:, None]
    return (1 - share) * ends[segment, 0] + share * ends[segment, 1], segment


def extract(image: p2o.Image) -> p2o.ImageFeatures:
    """Return the line segments of an image, and edges along them."""
    ends = segments(image, _MIN_LENGTH_PX)
    uv, _ = points_along(ends)
    edges = p2o.ImageEdges(uv, np.full(len(uv), p2o.Side.NONE, np.int8))
    return p2o.ImageFeatures(edges, features=[ImageLines(ends)])


METHOD = p2o.Method(
    name="lsd",
    build=lambda options: extract,
    summary="Line segments of the grey image, and edges without direction along them.",
    gives={"image-edges", "image-lines"},
    cite="Von Gioi et al., LSD: A Line Segment Detector, Image Processing On Line 2, 2012",
)
