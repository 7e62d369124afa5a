"""Estimate the disparity of a rectified pair, with a left-right consistency check."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray
from p2o import Bool, UInt8

Map = NDArray[np.float32]
_T = TypeVar("_T", bound=np.generic)


@dataclass(frozen=True, eq=False)
class PairView:
    """One image of a rectified pair, oriented as the left one (the right image is stored mirrored).

    `own` and `other` (H, W, 4): red, green, blue, and the horizontal derivative of the luma, in grey levels; the
    exposure of `other` is scaled to that of `own`. `disparity` (H, W) px has no gaps; `known` (H, W) marks the pixels
    at which both views agree.
    """

    own: Map
    other: Map
    disparity: Map
    known: Bool


def both_views(left: UInt8, right: UInt8, count: int, block: int) -> tuple[PairView, PairView]:
    """Return the left view of images (H, W, 3) and the mirrored right view, in which left and right are exchanged.

    A pixel is `known` if its match maps back to it within 1 px; `count` and `block` as in `match`.
    """
    import cv2

    mirrored_left, mirrored_right = _mirror(left), _mirror(right)
    from_left, from_right = match(left, right, count, block), match(mirrored_right, mirrored_left, count, block)
    known_left = consistent(from_left, _mirror(from_right), tolerance_px=1.0)
    known_right = consistent(from_right, _mirror(from_left), tolerance_px=1.0)
    gain = _gain(left, right, from_left, known_left)
    own = _with_derivative(left)
    other = _with_derivative(np.clip(right.astype(np.float32) * gain, 0, 255))

    def view(own: Map, other: Map, disparity: Map, known: Bool) -> PairView:
        return PairView(own, other, cv2.medianBlur(fill_with_background(disparity, known), 5), known)

    sign = np.array([1, 1, 1, -1], np.float32)
    return (
        view(own, other, from_left, known_left),
        view(_mirror(other) * sign, _mirror(own) * sign, from_right, known_right),
    )


def match(left: UInt8, right: UInt8, count: int, block: int) -> Map:
    """Return the disparity (H, W) of the left image in px by semi-global matching; NaN where there is no match.

    `count` disparities from 0 (a multiple of 16), windows of `block` px. Hirschmueller, TPAMI 2008.
    """
    import cv2

    area = 3 * block * block
    matcher = cv2.StereoSGBM.create(
        minDisparity=0,
        numDisparities=count,
        blockSize=block,
        P1=8 * area,
        P2=32 * area,
        disp12MaxDiff=-1,
        preFilterCap=31,
        uniquenessRatio=5,
        speckleWindowSize=60,
        speckleRange=2,
        mode=cv2.STEREO_SGBM_MODE_SGBM_3WAY,
    )
    # SGBM returns no disparity for the first columns, whose match may be outside the image: pad both images on the
    # left.
    padded = [cv2.copyMakeBorder(p, 0, 0, count, 0, cv2.BORDER_REPLICATE) for p in (left, right)]
    raw = matcher.compute(*padded)[:, count:]
    return np.where(raw < 0, np.float32(np.nan), raw.astype(np.float32) / 16)


def consistent(disparity: Map, other: Map, tolerance_px: float) -> Bool:
    """Return a mask (H, W) of the pixels that pass the left-right consistency check."""
    height, width = disparity.shape
    at = np.arange(width) - disparity
    inside = np.isfinite(at) & (at >= -0.5)
    column = np.where(inside, at, 0).round().astype(np.int64)
    back = other[np.arange(height)[:, None], column]
    with np.errstate(invalid="ignore"):
        return np.asarray(inside & (np.abs(back - disparity) <= tolerance_px))


def fill_with_background(disparity: Map, known: Bool) -> Map:
    """Return disparity (H, W) with the unknown runs of each row filled by the smaller disparity at their two ends.

    Pixels that are hidden from the other camera belong to the background. A run that touches the border takes the value
    of its only end; rows without any value become 0 (infinitely far).
    """
    width = disparity.shape[1]
    column = np.arange(width)
    before = np.maximum.accumulate(np.where(known, column, -1), axis=1)
    after = np.minimum.accumulate(np.where(known, column, width)[:, ::-1], axis=1)[:, ::-1]
    padded = np.pad(np.where(known, disparity, np.inf), ((0, 0), (1, 1)), constant_values=np.inf)
    rows = np.arange(len(disparity))[:, None]
    filled = np.minimum(padded[rows, before + 1], padded[rows, after + 1])
    return np.where(np.isfinite(filled), filled, 0.0).astype(np.float32)


def ground(view: PairView, tolerance_px: float = 0.7) -> tuple[float, float, float] | None:
    """Return (a, b, c) of the ground, whose disparity is a + b u + c v px at pixel (u, v), or None without ground.

    The plane with the most inliers in the lower half of the image (RANSAC with a fixed seed, then least squares), if
    the inliers are at least a fifth of the pixels, the disparity grows downwards (c at least 0.05) and the lateral
    slope is small (b at most c / 2).
    """
    height = len(view.disparity)
    v, u = np.nonzero(view.known[height // 2 :])
    v = v + height // 2
    if len(v) < 500:
        return None
    rng = np.random.default_rng(0)
    picked = rng.choice(len(v), 4000)
    points = np.column_stack([np.ones(4000), u[picked], v[picked]])
    disparity = view.disparity[v[picked], u[picked]].astype(np.float64)
    corners = rng.integers(0, 4000, (400, 3))
    matrix = points[corners]
    regular = np.abs(np.linalg.det(matrix)) > 100
    planes = np.linalg.solve(matrix[regular], disparity[corners[regular]][..., None])[..., 0]
    planes = planes[(planes[:, 2] >= 0.05) & (np.abs(planes[:, 1]) <= 0.5 * planes[:, 2])]
    if len(planes) == 0:
        return None
    agree = np.abs(planes @ points.T - disparity) <= tolerance_px
    best = agree[agree.sum(1).argmax()]
    if best.mean() < 0.2:
        return None
    a, b, c = np.linalg.lstsq(points[best], disparity[best], rcond=None)[0]
    return float(a), float(b), float(c)


def _mirror(array: NDArray[_T]) -> NDArray[_T]:
    return np.ascontiguousarray(array[:, ::-1])


def _gain(left: UInt8, right: UInt8, disparity: Map, known: Bool) -> float:
    """Return the exposure factor from the right to the left image: the median ratio of matched pixels."""
    v, u = (index[::31] for index in np.nonzero(known))
    if len(u) == 0:
        return 1.0
    match_u = np.maximum((u - disparity[v, u]).round().astype(np.int64), 0)
    return float(np.median((left[v, u].sum(1) + 3.0) / (right[v, match_u].sum(1) + 3.0)))


def _with_derivative(rgb: UInt8 | Map) -> Map:
    import cv2

    colour = rgb.astype(np.float32)
    luma = colour @ np.array([0.299, 0.587, 0.114], np.float32)
    return np.dstack([colour, cv2.Sobel(luma, cv2.CV_32F, 1, 0, ksize=3) / 4])
