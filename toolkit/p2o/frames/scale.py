"""Downsample images to a focal length of 1000 px, for which all pixel thresholds were tuned.

Truncation distances, widths of edges and the receptive fields of networks correspond to angles, which depend on the
focal length.
"""

from __future__ import annotations

from typing import Any
from weakref import WeakKeyDictionary

import numpy as np

from p2o.arrays import Float
from p2o.frames.image import Image
from p2o.geometry.camera import Camera

LONGEST_FOCAL_PX = 1000.0
"""Images of longer focal lengths are downsampled to this one. KITTI's cameras have 720 px; a limit of 720 px was not
better on nuScenes, Waymo and indoors, and upsampling KITTI to 1000 px was worse (docs/benchmarks.md).
"""
_LEAST_SIDE_PX = 32


def camera_at_scale(camera: Camera) -> Camera:
    """Return the camera of the downsampled image."""
    share = LONGEST_FOCAL_PX / camera.focal_px
    width, height = (max(round(share * side), min(side, _LEAST_SIDE_PX)) for side in (camera.width, camera.height))
    return camera if share >= 1 else camera.resized(width, height)


_known: WeakKeyDictionary[Image, Image] = WeakKeyDictionary()


def image_at_scale(image: Image) -> Image:
    """Return the downsampled image with its depth, mask and right image; the same object for the same image."""
    camera = camera_at_scale(image.camera)
    if camera is image.camera:
        return image
    if image not in _known:
        _known[image] = _resized(image, camera)
    return _known[image]


def _resized(image: Image, camera: Camera) -> Image:
    import cv2

    size = camera.width, camera.height

    def smaller(image: Any, interpolation: int) -> Any:
        return None if image is None else np.asarray(cv2.resize(image, size, interpolation=interpolation))

    masked = None if image.masked is None else smaller(image.masked.astype(np.uint8), cv2.INTER_NEAREST_EXACT)
    return Image(
        smaller(image.rgb, cv2.INTER_AREA),
        camera,
        right=smaller(image.right, cv2.INTER_AREA),
        baseline_m=image.baseline_m,
        depth_m=None if image.depth_m is None else _depth_on_surfaces(image.depth_m, size),
        masked=None if masked is None else masked > 0,
    )


def _depth_on_surfaces(depth_m: Float, size: tuple[int, int]) -> Float:
    """Return a depth map (H, W) resampled to `size` (width, height): the tangent plane at the nearest pixel.

    Interpolated depths would lie between surfaces, and those of the nearest pixels would make steps in a distant road.
    Inverse depth is affine on planes; its slope is the smaller one of both sides, which lies on the same surface.
    """
    with np.errstate(divide="ignore"):
        inverse = 1.0 / depth_m
    places = [(np.arange(n) + 0.5) * full / n - 0.5 for n, full in zip(size[::-1], depth_m.shape, strict=True)]
    nearest = [np.rint(place).astype(np.int64) for place in places]
    at = np.ix_(*nearest)
    moved = inverse[at]
    for axis, offset in enumerate(place - near for place, near in zip(places, nearest, strict=True)):
        steps = np.diff(inverse, axis=axis)
        unknown = np.full_like(np.take(inverse, [0], axis), np.nan)
        sides = np.stack([np.concatenate(pair, axis) for pair in ((unknown, steps), (steps, unknown))])[:, *at]
        size_of = np.where(np.isnan(sides), np.inf, np.abs(sides))
        slope = np.where(size_of[0] < size_of[1], sides[0], sides[1])
        moved = moved + np.nan_to_num(slope) * (offset[:, None] if axis == 0 else offset)
    with np.errstate(divide="ignore"):
        depth: Float = 1.0 / np.where((inverse[at] == 0) | (moved <= 0), inverse[at], moved)
    return depth
