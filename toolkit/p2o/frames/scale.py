"""Downsample images to a focal length of 1000 px, for which all pixel thresholds were tuned.

Truncation distances, widths of edges and the receptive fields of networks correspond to angles, which depend on the
focal length.
"""

from __future__ import annotations

from typing import Any
from weakref import WeakKeyDictionary

import numpy as np

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
        # Interpolated depths would not correspond to a surface.
        depth_m=smaller(image.depth_m, cv2.INTER_NEAREST_EXACT),
        masked=None if masked is None else masked > 0,
    )
