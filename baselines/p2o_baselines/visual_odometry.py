"""How a camera moves between two pictures, up to scale: corners followed by their look, and the essential matrix.

- Corners are Shi and Tomasi's, followed by Lucas and Kanade's method in a pyramid; those count that come back to where
  they were when they are followed backwards.
- The essential matrix is Nister's, by RANSAC (OpenCV's USAC), for any camera, since corners become rays first. Of its
  two rotations the smaller one is taken: the other is half a turn away, and no camera turns so far between pictures.
- Rotation and direction are then refined by the Sampson distances of all corners in pixels, wrong ones damped
  (Cauchy). Where a camera sees little to the sides, driving ahead looks much like turning: so the same is done from the
  rotation alone that fits best, with the camera moving along each of its axes, and the best of all four counts.

All constants are ours. Where the camera hardly moves forward, the rotation is as good as ever and the direction means
nothing; `parallax_px` tells.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import p2o
from p2o.arrays import Bool, Float, UInt8

_AGREE_PX = 1.0
"""Corners within this Sampson distance agree with a motion."""
_BACK_PX = 0.5
"""Corners that come back farther off than this were not followed well."""
_USUAL_PX = 0.2
"""Corners that were followed well are off by about this."""
_FEWEST = 20
"""Corners that a motion takes at least."""


@dataclass(frozen=True, eq=False)
class CameraStep:
    """The motion between two pictures.

    `second_from_first` (4, 4) takes points of the first camera frame to the second; its translation has length 1, for
    its length is not known. `corners` agree with it, `off_px` is their root mean square distance, and `parallax_px` how
    far they go in the picture, in the median, besides what the rotation does.
    """

    second_from_first: Float
    corners: int
    off_px: float
    parallax_px: float


def followed(
    first: UInt8, second: UInt8, *, most: int = 1500, masked: Bool | None = None, apart_px: float = 8.0
) -> tuple[Float, Float]:
    """Return where corners are in two grey pictures (H, W), each (N, 2) px; at most so many, so far from each other.

    Corners begin at pixels of the first picture that are not `masked` (H, W).
    """
    import cv2

    free = None if masked is None else np.where(masked, 0, 255).astype(np.uint8)
    corners = cv2.goodFeaturesToTrack(np.ascontiguousarray(first), most, 0.005, apart_px, mask=free)
    if corners is None:
        return np.zeros((0, 2)), np.zeros((0, 2))
    here = corners.reshape(-1, 2).astype(np.float64)
    there = follow(first, second, here)
    keep = np.isfinite(there).all(axis=1)
    return here[keep], there[keep]


def follow(first: UInt8, second: UInt8, uv: Float) -> Float:
    """Return where places (N, 2) px of one grey picture are in another, NaN where they do not come back."""
    import cv2

    if not len(uv):
        return np.zeros((0, 2))
    corners = np.ascontiguousarray(uv, np.float32).reshape(-1, 1, 2)
    options = {
        "winSize": (21, 21),
        "maxLevel": 5,
        "criteria": (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 40, 0.005),
    }
    there, found, _ = cv2.calcOpticalFlowPyrLK(first, second, corners, None, **options)
    back, again, _ = cv2.calcOpticalFlowPyrLK(second, first, there, None, **options)
    far = np.linalg.norm((back - corners).reshape(-1, 2), axis=1)
    keep = (found.ravel() > 0) & (again.ravel() > 0) & (far < _BACK_PX)
    return np.where(keep[:, None], there.reshape(-1, 2).astype(np.float64), np.nan)


def follow_on(pictures: Sequence[UInt8], uv: Float) -> Float:
    """Return where places (N, 2) px of the first of several grey pictures are in each of the others, (K, N, 2).

    They are followed from picture to picture; NaN from where they are lost.
    """
    found = np.full((max(len(pictures) - 1, 0), len(uv), 2), np.nan)
    here = np.asarray(uv, np.float64)
    for number, (first, second) in enumerate(pairwise(pictures)):
        known = np.isfinite(here).all(axis=1)
        there = np.full_like(here, np.nan)
        there[known] = follow(first, second, here[known])
        found[number] = here = there
    return found


def camera_step(first_rays: Float, second_rays: Float, focal_px: float) -> CameraStep | None:
    """Return the motion that turns rays (N, 3) of things in one camera frame into those in the next, or None.

    `focal_px` is the size of a radian in pixels. None where fewer than twenty rays agree with any motion.
    """
    import cv2

    known = np.isfinite(first_rays).all(axis=1) & np.isfinite(second_rays).all(axis=1)
    known &= (first_rays[:, 2] > 0.1) & (second_rays[:, 2] > 0.1)
    if known.sum() < _FEWEST:
        return None
    # On the plane one unit ahead.
    here, there = (rays[known] / rays[known, 2:] for rays in (first_rays, second_rays))
    found, _ = cv2.findEssentialMat(
        here[:, :2],
        there[:, :2],
        np.eye(3),
        method=cv2.USAC_ACCURATE,
        prob=0.9999,
        threshold=_AGREE_PX / focal_px,
    )
    starts = [p2o.se3.make(_turn(here, there), way) for way in np.eye(3)]
    if found is not None and found.shape[0] >= 3:
        one, other, direction = cv2.decomposeEssentialMat(found[:3])
        starts.append(p2o.se3.make(one if np.trace(one) >= np.trace(other) else other, direction.ravel()))

    def cost(motion: Float) -> float:
        return float(np.minimum(np.abs(sampson(motion, here, there)) * focal_px, _AGREE_PX).sum())

    motion = min((_refined(start, here, there, focal_px) for start in starts), key=cost)
    agree = np.abs(sampson(motion, here, there)) * focal_px < _AGREE_PX
    if agree.sum() < _FEWEST:
        return None
    here, there = here[agree], there[agree]
    if not _ahead(motion, here, there):
        motion = p2o.se3.make(motion[:3, :3], -motion[:3, 3])
    turned = here @ motion[:3, :3].T
    parallax = np.linalg.norm(turned[:, :2] / turned[:, 2:] - there[:, :2], axis=1)
    off_px = float(np.sqrt((sampson(motion, here, there) ** 2).mean())) * focal_px
    return CameraStep(motion, int(agree.sum()), off_px, float(np.median(parallax)) * focal_px)


def sampson(second_from_first: Float, here: Float, there: Float) -> Float:
    """Return the signed Sampson distances (N,) of points (N, 3) at z = 1 of both cameras from an epipolar geometry."""
    essential = p2o.se3.skew(second_from_first[:3, 3]) @ second_from_first[:3, :3]
    lines, back = here @ essential.T, there @ essential
    slope = (lines[:, :2] ** 2).sum(axis=1) + (back[:, :2] ** 2).sum(axis=1)
    return np.asarray((lines * there).sum(axis=1) / np.sqrt(np.maximum(slope, 1e-24)))


def _turn(here: Float, there: Float) -> Float:
    """Return the rotation (3, 3) that brings most rays near to where they go, as if there were no translation."""
    one, other = (rays / np.linalg.norm(rays, axis=1)[:, None] for rays in (here, there))
    rotation = np.eye(3)
    for _ in range(10):
        off = np.linalg.norm(other - one @ rotation.T, axis=1)
        weight = 1.0 / np.maximum(off, max(float(np.median(off)), 1e-9))
        u, _, vt = np.linalg.svd((weight[:, None] * other).T @ one)
        rotation = u @ np.diag([1.0, 1.0, np.linalg.det(u @ vt)]) @ vt
    return np.asarray(rotation)


def _refined(motion: Float, here: Float, there: Float, focal_px: float) -> Float:
    """Return the motion (4, 4) with the least Sampson distances, those of wrong corners damped."""
    from scipy.optimize import least_squares

    # Two directions across the translation: its length stays.
    across = np.linalg.svd(motion[None, :3, 3])[2][1:]

    def changed(x: Float) -> Float:
        direction = motion[:3, 3] + x[3:] @ across
        turn = p2o.se3.exp(np.concatenate([x[:3], np.zeros(3)]))[:3, :3]
        return p2o.se3.make(turn @ motion[:3, :3], direction / np.linalg.norm(direction))

    found = least_squares(
        lambda x: sampson(changed(x), here, there) * focal_px,
        np.zeros(5),
        loss="cauchy",
        f_scale=_USUAL_PX,
        max_nfev=60,
    )
    return changed(found.x)


def _ahead(motion: Float, here: Float, there: Float) -> bool:
    """Return whether most points lie before the first camera: the sign of the translation."""
    turned = here @ motion[:3, :3].T
    # there x (depth * turned + translation) = 0
    left, right = np.cross(there, turned), -np.cross(there, np.broadcast_to(motion[:3, 3], there.shape))
    return float(np.sign((left * right).sum(axis=1)).sum()) >= 0
