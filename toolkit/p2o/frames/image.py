"""A colour image with its camera, and optional stereo image, depth and mask."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from p2o.arrays import Bool, Float, UInt8, checked
from p2o.errors import InputError
from p2o.geometry.camera import Camera

_BAND = 256


@dataclass(frozen=True, eq=False)
class Image:
    """One image; `rgb` (H, W, 3) uint8, `camera` of the same size.

    Optional: `right` (H, W, 3) uint8, the right image of a rectified pair whose camera has the same intrinsics and is
    `baseline_m` metres along +x; `depth_m` (H, W) float, depth along the optical axis in metres, +inf for sky, NaN
    where unknown; `masked` (H, W) bool, pixels whose edges are to be ignored (foliage, the own car). Raises InputError
    for wrong shapes, a grey image, a size that does not fit the camera, or depth that is not positive.
    """

    rgb: UInt8
    camera: Camera
    right: UInt8 | None = None
    baseline_m: float | None = None
    depth_m: Float | None = None
    masked: Bool | None = None

    def __post_init__(self) -> None:
        for name in ("rgb", "right"):
            value = getattr(self, name)
            if value is None:
                continue
            if np.ndim(value) == 2 or (np.ndim(value) == 3 and np.shape(value)[2] != 3):
                text, hint = f"the image ({name}) is not RGB", "repeat a grey image on three channels"
                raise InputError(text, expected="(H, W, 3) uint8", got=np.shape(value), hint=hint)
            if np.asarray(value).dtype != np.uint8:
                raise InputError(f"the image ({name}) is not 8 bit", expected="uint8", got=np.asarray(value).dtype)
            object.__setattr__(self, name, checked(name, value, (None, None, 3), np.uint8))
        size = (self.camera.height, self.camera.width)
        for name in ("rgb", "right", "depth_m", "masked"):
            value = getattr(self, name)
            if value is not None and np.shape(value)[:2] != size:
                text = f"the image size ({name}) does not fit the camera"
                got = f"{np.shape(value)[1]}x{np.shape(value)[0]} px" if np.ndim(value) >= 2 else np.shape(value)
                hint = "is this the calibration of another camera or of the unrectified images?"
                raise InputError(text, expected=f"{size[1]}x{size[0]} px", got=got, hint=hint)
        if self.depth_m is not None:
            depth = checked("depth_m", self.depth_m, size, np.float64, finite=False)
            if (depth <= 0).any():
                expected = "metres > 0, NaN where unknown"
                raise InputError("depth is not positive", expected=expected, got=f"{np.nanmin(depth):g}")
            object.__setattr__(self, "depth_m", depth)
        if self.masked is not None:
            object.__setattr__(self, "masked", checked("masked", self.masked, size, np.bool_))
        if (self.right is None) != (self.baseline_m is None):
            message = "a rectified pair needs both its right image and its baseline"
            raise InputError(message, expected="right and baseline_m")

    @cached_property
    def grey(self) -> UInt8:
        """Luma (H, W) uint8 (ITU-R BT.601 weights)."""
        grey = np.empty(self.rgb.shape[:2], np.uint8)
        # In bands of rows, because the whole image in double precision needs 24 times its memory.
        for start in range(0, len(grey), _BAND):
            band = self.rgb[start : start + _BAND] @ np.array([0.299, 0.587, 0.114])
            grey[start : start + _BAND] = (band + 0.5).astype(np.uint8)
        return grey

    def undistorted(self) -> Image:
        """Return the image, without right image, depth and mask, of a pinhole camera of the same focal length and size.

        Pixels that the lens does not show are black. The image of a pinhole camera is returned as it is.
        """
        import cv2

        camera = self.camera
        if camera.is_pinhole:
            return Image(self.rgb, camera)
        focal, width, height = camera.focal_px, camera.width, camera.height
        pinhole = Camera.pinhole(focal, focal, (width - 1) / 2, (height - 1) / 2, width, height)
        v, u = np.indices((height, width))
        uv = camera.project(pinhole.rays(np.stack([u, v], axis=-1).astype(np.float64)))
        x, y = np.where(np.isfinite(uv), uv, -10.0).astype(np.float32).transpose(2, 0, 1)
        return Image(np.asarray(cv2.remap(self.rgb, x, y, cv2.INTER_LINEAR), dtype=np.uint8), pinhole)
