"""Estimate the motion of a camera between two images, up to scale: tracked corners and the essential matrix.

- Corners are Shi and Tomasi's, tracked by the pyramidal method of Lucas and Kanade; those that return to their position
  when tracked backwards are kept.
- The essential matrix is Nister's, by RANSAC (OpenCV's USAC), for any camera model, since corners are converted to rays
  first. Of its two rotations the smaller one is used: the other differs by 180 deg, which no camera rotates between
  images.
- Rotation and direction are refined by the Sampson distances of all corners in pixels with a Cauchy loss. With a narrow
  field of view, forward motion and rotation are similar: the refinement is therefore repeated from the best pure
  rotation with motion along each axis of the camera, and the best of all four is used.

All constants are ours. If the camera hardly translates, the rotation is still accurate and the direction is undefined;
`parallax_px` indicates this.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
import p2o
from p2o import Bool, Float, UInt8

_AGREE_PX = 1.0  # corners within this Sampson distance agree with a motion
_BACK_PX = 0.5  # corners that return with a larger error were not tracked well
_USUAL_PX = 0.2  # typical residual of a well tracked corner
_FEWEST = 20  # least number of corners of a motion


@dataclass(frozen=True, eq=False)
class CameraStep:
    """The motion between two images.

    `second_from_first` (4, 4) maps points of the first camera frame to the second; its translation has length 1, since
    its scale is unknown. `corners` is the number of inliers, `off_px` their root mean square distance, and
    `parallax_px` their median displacement in the image that the rotation does not explain.
    """

    second_from_first: Float
    corners: int
    off_px: float
    parallax_px: float


def followed(
    first: UInt8, second: UInt8, *, most: int = 1500, masked: Bool | None = None, apart_px: float = 8.0
) -> tuple[Float, Float]:
    """Detect corners at unmasked pixels of a grey image and track them in another, each (N, 2) px, at most `most`."""
    import cv2

    free = None if masked is None else np.where(masked, 0, 255).astype(np.uint8)
    corners = cv2.goodFeaturesToTrack(np.ascontiguousarray(first), most, 0.005, apart_px, mask=free)
    if corners is None:
        return np.zeros((0, 2)), np.zeros((0, 2))
    uv_first = corners.reshape(-1, 2).astype(np.float64)
    uv_second = follow(first, second, uv_first)
    keep = np.isfinite(uv_second).all(axis=1)
    return uv_first[keep], uv_second[keep]


def follow(first: UInt8, second: UInt8, uv: Float) -> Float:
    """Track positions (N, 2) px from one grey image to another; NaN if they do not return to their origin."""
    import cv2

    if not len(uv):
        return np.zeros((0, 2))
    corners = np.ascontiguousarray(uv, np.float32).reshape(-1, 1, 2)
    ends = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 40, 0.005)
    options: dict[str, Any] = {"winSize": (21, 21), "maxLevel": 5, "criteria": ends}
    uv_second, status, _ = cv2.calcOpticalFlowPyrLK(first, second, corners, None, **options)
    back, again, _ = cv2.calcOpticalFlowPyrLK(second, first, uv_second, None, **options)
    far = np.linalg.norm((back - corners).reshape(-1, 2), axis=1)
    keep = (status.ravel() > 0) & (again.ravel() > 0) & (far < _BACK_PX)
    return np.where(keep[:, None], uv_second.reshape(-1, 2).astype(np.float64), np.nan)


def follow_on(images: Sequence[UInt8], uv: Float) -> Float:
    """Track positions (N, 2) px from the first of several grey images through the others, (K, N, 2); NaN if lost."""
    positions = np.full((max(len(images) - 1, 0), len(uv), 2), np.nan)
    here = np.asarray(uv, np.float64)
    for number, (first, second) in enumerate(pairwise(images)):
        known = np.isfinite(here).all(axis=1)
        uv_next = np.full_like(here, np.nan)
        uv_next[known] = follow(first, second, here[known])
        positions[number] = here = uv_next
    return positions


def camera_step(first_rays: Float, second_rays: Float, focal_px: float) -> CameraStep | None:
    """Return the motion between rays (N, 3) of two images, `focal_px` a radian; None with fewer than twenty inliers."""
    import cv2

    known = np.isfinite(first_rays).all(axis=1) & np.isfinite(second_rays).all(axis=1)
    known &= (first_rays[:, 2] > 0.1) & (second_rays[:, 2] > 0.1)
    if known.sum() < _FEWEST:
        return None
    # On the plane one unit ahead.
    here, later = (rays[known] / rays[known, 2:] for rays in (first_rays, second_rays))
    ransac: dict[str, Any] = {"method": cv2.USAC_ACCURATE, "prob": 0.9999, "threshold": _AGREE_PX / focal_px}
    essential, _ = cv2.findEssentialMat(here[:, :2], later[:, :2], np.eye(3), **ransac)
    starts = [p2o.se3.make(_pure_rotation(here, later), axis) for axis in np.eye(3)]
    if essential is not None and essential.shape[0] >= 3:
        one, other, direction = cv2.decomposeEssentialMat(essential[:3])
        starts.append(p2o.se3.make(one if np.trace(one) >= np.trace(other) else other, direction.ravel()))

    def cost(motion: Float) -> float:
        return float(np.minimum(np.abs(sampson(motion, here, later)) * focal_px, _AGREE_PX).sum())

    motion = min((_refined(start, here, later, focal_px) for start in starts), key=cost)
    agree = np.abs(sampson(motion, here, later)) * focal_px < _AGREE_PX
    if agree.sum() < _FEWEST:
        return None
    here, later = here[agree], later[agree]
    if not _ahead(motion, here, later):
        motion = p2o.se3.make(motion[:3, :3], -motion[:3, 3])
    turned = here @ motion[:3, :3].T
    parallax = np.linalg.norm(turned[:, :2] / turned[:, 2:] - later[:, :2], axis=1)
    off_px = float(np.sqrt((sampson(motion, here, later) ** 2).mean())) * focal_px
    return CameraStep(motion, int(agree.sum()), off_px, float(np.median(parallax)) * focal_px)


def sampson(second_from_first: Float, here: Float, later: Float) -> Float:
    """Return the signed Sampson distances (N,) of points (N, 3) at z = 1 of both cameras from an epipolar geometry."""
    essential = p2o.se3.skew(second_from_first[:3, 3]) @ second_from_first[:3, :3]
    lines, back = here @ essential.T, later @ essential
    slope = (lines[:, :2] ** 2).sum(axis=1) + (back[:, :2] ** 2).sum(axis=1)
    return np.asarray((lines * later).sum(axis=1) / np.sqrt(np.maximum(slope, 1e-24)))


def _pure_rotation(here: Float, later: Float) -> Float:
    """Return the rotation (3, 3) that aligns most rays, assuming no translation."""
    one, other = (rays / np.linalg.norm(rays, axis=1)[:, None] for rays in (here, later))
    rotation = np.eye(3)
    for _ in range(10):
        off = np.linalg.norm(other - one @ rotation.T, axis=1)
        weight = 1.0 / np.maximum(off, max(float(np.median(off)), 1e-9))
        u, _, vt = np.linalg.svd((weight[:, None] * other).T @ one)
        rotation = u @ np.diag([1.0, 1.0, np.linalg.det(u @ vt)]) @ vt
    return np.asarray(rotation)


def _refined(motion: Float, here: Float, later: Float, focal_px: float) -> Float:
    """Return the motion (4, 4) with the least Sampson distances under a robust loss."""
    from scipy.optimize import least_squares

    # Two directions across the translation: its length stays.
    across = np.linalg.svd(motion[None, :3, 3])[2][1:]

    def changed(x: Float) -> Float:
        direction = motion[:3, 3] + x[3:] @ across
        turn = p2o.se3.exp(np.concatenate([x[:3], np.zeros(3)]))[:3, :3]
        return p2o.se3.make(turn @ motion[:3, :3], direction / np.linalg.norm(direction))

    def residuals(x: Float) -> Float:
        return sampson(changed(x), here, later) * focal_px

    return changed(least_squares(residuals, np.zeros(5), loss="cauchy", f_scale=_USUAL_PX, max_nfev=60).x)


def _ahead(motion: Float, here: Float, later: Float) -> bool:
    """Return whether most points are in front of the first camera: the sign of the translation."""
    turned = here @ motion[:3, :3].T
    # later x (depth * turned + translation) = 0
    left, right = np.cross(later, turned), -np.cross(later, np.broadcast_to(motion[:3, 3], later.shape))
    return float(np.sign((left * right).sum(axis=1)).sum()) >= 0
