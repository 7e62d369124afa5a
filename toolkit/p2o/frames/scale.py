"""The size at which pictures are looked at: that of the cameras that lengths in pixels were chosen for.

What is a pixel to one camera is a tenth of one to another. Cutting distances, widths of edges and what a network has
learnt to see all mean angles, so pictures of long focal lengths are looked at smaller.
"""

from __future__ import annotations

from typing import Any
from weakref import WeakKeyDictionary

import numpy as np

from p2o.frames.image import Image
from p2o.geometry.camera import Camera

LONGEST_FOCAL_PX = 1000.0
"""Pictures of longer focal lengths are looked at at this one. KITTI's cameras have 720 px; 720 was tried and was no
better on nuScenes, Waymo and indoors, enlarging KITTI's pictures to 1000 worse (docs/benchmarks.md).
"""
_LEAST_SIDE_PX = 32


def camera_at_scale(camera: Camera) -> Camera:
    """Return the camera of the picture that is looked at."""
    share = LONGEST_FOCAL_PX / camera.focal_px
    width, height = (max(round(share * side), min(side, _LEAST_SIDE_PX)) for side in (camera.width, camera.height))
    return camera if share >= 1 else camera.resized(width, height)


_known: WeakKeyDictionary[Image, Image] = WeakKeyDictionary()


def image_at_scale(image: Image) -> Image:
    """Return the picture that is looked at, with all that comes with it; the same object for the same image."""
    camera = camera_at_scale(image.camera)
    if camera is image.camera:
        return image
    if image not in _known:
        _known[image] = _resized(image, camera)
    return _known[image]


def _resized(image: Image, camera: Camera) -> Image:
    import cv2

    size = camera.width, camera.height

    def smaller(picture: Any, how: int) -> Any:
        return None if picture is None else np.asarray(cv2.resize(picture, size, interpolation=how))

    masked = None if image.masked is None else smaller(image.masked.astype(np.uint8), cv2.INTER_NEAREST_EXACT)
    return Image(
        smaller(image.rgb, cv2.INTER_AREA),
        camera,
        right=smaller(image.right, cv2.INTER_AREA),
        baseline_m=image.baseline_m,
        # Between two depths there is nothing.
        depth_m=smaller(image.depth_m, cv2.INTER_NEAREST_EXACT),
        masked=None if masked is None else masked > 0,
    )
