"""One frame as it is shown: a picture of moderate size, a cloud of a stated number of points, and their colours."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np

from p2o.arrays import Float, UInt8
from p2o.draw.brightness import brightened, display_gamma
from p2o.draw.coloured_cloud import colours_of
from p2o.draw.sweep_picture import By, draw_sweep, sweep_colours
from p2o.frames.cloud import Cloud
from p2o.frames.frame import Frame
from p2o.frames.scale import camera_at_scale, image_at_scale
from p2o.geometry import se3
from p2o.geometry.camera import Camera

MOST_POINTS = 60_000
"""So many points of a sweep are shown in space, spread evenly over those that there are."""
LONGEST_PX = 1400
"""No side of the picture is longer; it is the one that methods look at, made smaller where need be."""
Colouring = Literal["range", "reflectance", "image"]
COLOURINGS: tuple[Colouring, ...] = get_args(Colouring)


@dataclass(frozen=True, eq=False)
class ShownFrame:
    """A picture `rgb` (H, W, 3) and its camera, the whole sweep, and the thinned one that stands in space."""

    name: str
    rgb: UInt8
    camera: Camera
    cloud: Cloud
    thinned: Cloud

    @classmethod
    def of(cls, frame: Frame, most_points: int = MOST_POINTS) -> ShownFrame:
        """Return a frame as it is shown."""
        rgb, camera = image_at_scale(frame.image).rgb, camera_at_scale(frame.camera)
        longest = max(camera.width, camera.height)
        if longest > LONGEST_PX:
            import cv2

            width, height = (max(1, round(side * LONGEST_PX / longest)) for side in (camera.width, camera.height))
            camera = camera.resized(width, height)
            rgb = np.asarray(cv2.resize(rgb, (width, height), interpolation=cv2.INTER_AREA))
        return cls(frame.name, rgb, camera, frame.cloud, thinned(frame.cloud, most_points))

    @property
    def colourings(self) -> tuple[Colouring, ...]:
        """What the cloud can be coloured by."""
        return tuple(by for by in COLOURINGS if by != "reflectance" or self.cloud.intensity is not None)

    @property
    def legible(self) -> UInt8:
        """The picture, brightened where it is dark."""
        return brightened(self.rgb, display_gamma(self.rgb))

    def overlay(self, camera_from_lidar: Float, by: By = "range") -> UInt8:
        """Return (H, W, 3): the whole sweep at a pose (4, 4) over the darkened picture."""
        shown = by if by == "range" or self.cloud.intensity is not None else "range"
        return draw_sweep(self.rgb, self.cloud, self.camera, camera_from_lidar, shown)

    def seen(self, camera_from_lidar: Float) -> int:
        """Return how many points of the whole sweep are in the image at a pose."""
        uv = self.camera.project(se3.apply(camera_from_lidar, self.cloud.xyz))
        return int(self.camera.in_image(uv).sum())

    def colours(self, by: Colouring, camera_from_lidar: Float) -> UInt8:
        """Return a colour (N, 3) for each point of the thinned cloud; those of the image are of a pose (4, 4)."""
        if by == "image":
            return colours_of(self.legible, self.thinned, self.camera, camera_from_lidar)[0]
        return sweep_colours(self.thinned, by)

    @property
    def upward_view_rad(self) -> float:
        """Height of the view in radians, of a pinhole camera with the same focal length."""
        return 2 * float(np.arctan(self.camera.height / (2 * self.camera.focal_px)))


def thinned(cloud: Cloud, most: int) -> Cloud:
    """Return at most so many points of a sweep, every k-th of them."""
    if len(cloud) <= most:
        return cloud
    return cloud.select(np.linspace(0, len(cloud) - 1, most).astype(np.int64))
