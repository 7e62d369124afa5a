"""Detect directed occlusion edges in a rectified pair, without training: `--extractor stereo`."""

from __future__ import annotations

import numpy as np
import p2o
from p2o import SIDES, Float, Image, ImageExtractor, ImageFeatures, InputError, Method, Options, Side, UInt8, field

from p2o_plugins.image.disparity import both_views, ground
from p2o_plugins.image.silhouette import SPAN, Silhouettes, confidence, line_lengths, locate, snap, steps, votes_against

MIN_VOTES = 0.2
"""Minimum majority of votes for the foreground against the ground plane and against infinity.

Lane markings and shadows fit the ground, and sky fits infinity, as well as any other disparity, and do not reach it.
"""
INFINITY = (0.0, 0.0, 0.0)
"""The plane of disparity 0."""


_BLOCK_PX = 3  # window of the matcher in pixels, odd
_MIN_JUMP_PX = 2.0  # smallest disparity step from background to foreground, in pixels
_MIN_JUMP_RATIO = 0.12  # smallest such step as a fraction of the foreground disparity
_MIN_HEIGHT_M = 0.25  # smallest height of the foreground above the ground, in metres
_MIN_LINE_PX = 5  # lines of fewer edge points than this are dropped


class StereoOptions(Options):
    """Criteria for an occlusion edge in the disparity of a rectified pair."""

    max_disparity_px: int = field(
        128, ge=16, le=512, help="Largest disparity searched, rounded up to a multiple of 16."
    )
    min_confidence: float = field(0.6, ge=0, le=1, help="Edges less certain than this are dropped.")


def silhouettes(left: UInt8, right: UInt8, baseline_m: float, options: StereoOptions) -> dict[Side, Silhouettes]:
    """Return the silhouettes of all four directions of a rectified pair (H, W, 3), of any confidence.

    R, U and B edges come from the left view, where the background beside them is visible to both cameras. The strip
    left of an object is hidden from the right camera; therefore L edges are detected in the right view, where nothing
    beside them is hidden, and transferred by the disparity of the foreground.
    """
    if min(left.shape[:2]) < 2 * SPAN + 1:
        nothing = Silhouettes(np.zeros((0, 2)), np.zeros(0), np.zeros((0, 13)))
        return dict.fromkeys(SIDES, nothing)
    count = -(-options.max_disparity_px // 16) * 16
    left_view, right_view = both_views(left, right, count, _BLOCK_PX)
    by_side = {}
    for side in SIDES:
        view, towards = (right_view, (1, 0)) if side is Side.LEFT else (left_view, side.background)
        v, u = steps(view.disparity, towards, _MIN_JUMP_PX, _MIN_JUMP_RATIO)
        by_side[side] = locate(view, v, u, towards)
    mirrored = by_side[Side.LEFT]
    uv = np.stack([left.shape[1] - 1 - mirrored.uv[:, 0] + mirrored.disparity, mirrored.uv[:, 1]], axis=1)
    uv[:, 0] = snap(left_view.own, uv, reach_px=1.5)
    by_side[Side.LEFT] = Silhouettes(uv, mirrored.disparity, mirrored.features).select(np.isfinite(uv[:, 0]))
    plane = ground(left_view)
    for side, candidates in by_side.items():
        sure = candidates
        if plane is not None:
            sure = sure.select(height_m(sure, plane, baseline_m) > _MIN_HEIGHT_M)
            sure = sure.select(votes_against(left_view, sure, side.background, plane) > MIN_VOTES)
        by_side[side] = sure.select(votes_against(left_view, sure, side.background, INFINITY) > MIN_VOTES)
    return by_side


def height_m(candidates: Silhouettes, plane: tuple[float, float, float], baseline_m: float) -> Float:
    """Return the height (N,) in metres of silhouettes above the ground, whose disparity is given by `plane`.

    The ground projects at v px below the horizon with disparity c v, c = baseline / h, for a camera h metres above the
    ground (square pixels); a point of disparity d has the height h (1 - c v / d). Lane markings have height 0.
    """
    a, b, c = plane
    below = a + b * candidates.uv[:, 0] + c * candidates.uv[:, 1]
    return np.asarray(baseline_m / c * (1 - below / np.maximum(candidates.disparity, 0.1)))


def build(options: StereoOptions) -> ImageExtractor:
    """Return the extractor; raises InputError for an image without its right image."""
    import cv2  # noqa: F401  (a missing package shows here, before data are read)

    def extract(image: Image) -> ImageFeatures:
        if image.right is None or image.baseline_m is None:
            raise InputError(
                "the image has no right image",
                where="stereo",
                expected="a rectified pair",
                got="one image",
                hint="use a dataset with pairs, or an extractor for single images such as --extractor canny/rings",
            )
        by_side = silhouettes(image.rgb, image.right, image.baseline_m, options)
        size = image.rgb.shape[:2]
        parts = []
        for side, candidates in by_side.items():
            certain = confidence(candidates, side, size)
            keep = certain >= options.min_confidence
            if image.masked is not None:
                u, v = np.clip(candidates.pixels(side.background), 0, (size[1] - 1, size[0] - 1)).T
                keep &= ~image.masked[v, u]
            keep[keep] = line_lengths(candidates.uv[keep], size) >= _MIN_LINE_PX
            parts.append((candidates.uv[keep], np.full(keep.sum(), side, np.int8), certain[keep]))
        uv, sides, weight = (np.concatenate(column) for column in zip(*parts, strict=True))
        return ImageFeatures(p2o.ImageEdges(uv, sides, weight))

    return extract


METHOD = Method(
    name="stereo",
    build=build,
    options=StereoOptions,
    summary="Directed occlusion edges at the disparity jumps of a rectified pair; needs no training.",
    needs={"right"},
    gives={"image-edges", "side"},
    cite="Hirschmueller, Stereo Processing by Semiglobal Matching and Mutual Information, TPAMI 2008",
)
