"""One frame as it is displayed: image and cloud reduced to a limited size, and colours of the points."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np
from p2o.arrays import Float, UInt8
from p2o.draw.coloured_cloud import colours_of
from p2o.draw.overlay import brightened, display_gamma
from p2o.draw.sweep_image import By, draw_sweep, sweep_colours
from p2o.frames.cloud import Cloud
from p2o.frames.frame import Frame
from p2o.frames.scale import camera_at_scale, image_at_scale
from p2o.geometry import se3
from p2o.geometry.camera import Camera

MOST_POINTS = 60_000
"""Maximum number of points displayed in 3-D, a regular subset of the sweep."""
LONGEST_PX = 1400
"""Maximum width and height of the displayed image."""
Colouring = Literal["range", "reflectance", "image"]
COLOURINGS: tuple[Colouring, ...] = get_args(Colouring)


@dataclass(frozen=True, eq=False)
class ShownFrame:
    """An image `rgb` (H, W, 3) and its camera, the whole sweep `cloud`, and `thinned`, the part displayed in 3-D."""

    name: str
    rgb: UInt8
    camera: Camera
    cloud: Cloud
    thinned: Cloud

    @classmethod
    def of(cls, frame: Frame, most_points: int = MOST_POINTS) -> ShownFrame:
        """Return a frame reduced for display."""
        rgb, camera = image_at_scale(frame.image).rgb, camera_at_scale(frame.camera)
        longest = max(camera.width, camera.height)
        if longest > LONGEST_PX:
            import cv2

            width, height = (max(1, round(side * LONGEST_PX / longest)) for side in (camera.width, camera.height))
            camera = camera.resized(width, height)
            rgb = np.asarray(cv2.resize(rgb, (width, height), interpolation=cv2.INTER_AREA))
        cloud, even = frame.cloud, np.linspace(0, len(frame.cloud) - 1, most_points).astype(np.int64)
        return cls(frame.name, rgb, camera, cloud, cloud if len(cloud) <= most_points else cloud.select(even))

    @property
    def colourings(self) -> tuple[Colouring, ...]:
        """Quantities by which the cloud can be coloured."""
        return tuple(by for by in COLOURINGS if by != "reflectance" or self.cloud.intensity is not None)

    @property
    def legible(self) -> UInt8:
        """The image, brightened if it is dark."""
        return brightened(self.rgb, display_gamma(self.rgb))

    def overlay(self, camera_from_lidar: Float, by: By = "range") -> UInt8:
        """Return (H, W, 3): the whole sweep projected at a pose (4, 4) on the darkened image."""
        shown = by if by == "range" or self.cloud.intensity is not None else "range"
        return draw_sweep(self.rgb, self.cloud, self.camera, camera_from_lidar, shown)

    def seen(self, camera_from_lidar: Float) -> int:
        """Return the number of points of the whole sweep inside the image at a pose."""
        uv = self.camera.project(se3.apply(camera_from_lidar, self.cloud.xyz))
        return int(self.camera.in_image(uv).sum())

    def colours(self, by: Colouring, camera_from_lidar: Float) -> UInt8:
        """Return colours (N, 3) of the thinned cloud; colours of the image are sampled at a pose (4, 4)."""
        if by == "image":
            return colours_of(self.legible, self.thinned, self.camera, camera_from_lidar)[0]
        return sweep_colours(self.thinned, by)

    @property
    def upward_view_rad(self) -> float:
        """Vertical field of view [rad] of a pinhole camera with the same focal length."""
        return 2 * float(np.arctan(self.camera.height / (2 * self.camera.focal_px)))
