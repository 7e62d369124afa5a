"""What a network sees of a frame: the picture at the network's size, and points to be drawn at any pose."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import p2o
from p2o import se3
from p2o.arrays import Float, UInt8

from p2o_baselines.regressors.sweep_map import Channel, drawn

Size = tuple[int, int]
"""Height and width of what a network sees, in pixels."""


@dataclass(frozen=True)
class Window:
    """The part of a picture that a network sees, as (left, top, width, height) in pixels of the picture.

    The largest part of the network's proportions around the middle: a picture is cut, never stretched.
    """

    left: float
    top: float
    width: float
    height: float

    @classmethod
    def of(cls, camera: p2o.Camera, size: Size) -> Window:
        """Return the window of a camera for a network of `size` (h, w)."""
        scale = min(camera.width / size[1], camera.height / size[0])
        width, height = scale * size[1], scale * size[0]
        return cls((camera.width - width) / 2, (camera.height - height) / 2, width, height)

    def cells(self, uv: Float, size: Size) -> Float:
        """Return where pixels (N, 2) of the picture fall on the grid of `size`; centres at integers in both."""
        off = np.array([self.left, self.top]) - 0.5
        return np.asarray((uv - off) * [size[1] / self.width, size[0] / self.height] - 0.5)

    def seen(self, rgb: UInt8, size: Size) -> UInt8:
        """Return the picture (h, w, 3) of the window, each pixel the mean of those that it covers."""
        import cv2

        top, left = round(self.top), round(self.left)
        part = rgb[top : top + max(1, round(self.height)), left : left + max(1, round(self.width))]
        return np.asarray(cv2.resize(part, size[::-1], interpolation=cv2.INTER_AREA), dtype=np.uint8)


@dataclass(frozen=True, eq=False)
class Glance:
    """A frame as networks of one size see it: `rgb` (h, w, 3), points (N, 3) of the LiDAR's frame, their reflectance.

    `group` names the drive, where frames of one follow each other.
    """

    name: str
    group: str
    camera: p2o.Camera
    rgb: UInt8
    xyz: Float
    reflectance: Float

    def drawn(self, camera_from_lidar: Float, channels: Sequence[Channel] = ("nearness",)) -> Float:
        """Return the sweep (C, h, w) as the camera's own model shows it at a pose (4, 4)."""
        size = self.rgb.shape[:2]
        there = se3.apply(camera_from_lidar, self.xyz)
        cells = Window.of(self.camera, size).cells(self.camera.project(there), size)
        return drawn(cells, there[:, 2], size, channels, self.reflectance, self.xyz)


def reflectance_of(cloud: p2o.Cloud) -> Float:
    """Return the reflectance (N,) in 0..1; of sensors that count higher, as a share of the 99th of 100 parts."""
    if cloud.intensity is None:
        return np.zeros(len(cloud))
    bright = float(np.percentile(cloud.intensity, 99))
    return np.asarray(np.clip(cloud.intensity / (1.0 if bright <= 1.0 else bright), 0.0, 1.0))


def thinned(cloud: p2o.Cloud, most: int) -> p2o.Cloud:
    """Return at most so many points of a sweep, drawn by a fixed chance: every n-th would be a pattern."""
    if len(cloud) <= most:
        return cloud
    return cloud.select(np.sort(np.random.default_rng(0).permutation(len(cloud))[:most]))


def glance_of(frame: p2o.Frame, size: Size, most: int) -> Glance:
    """Return what a network of `size` (h, w) sees of a frame, `most` points of its sweep at least as dense as that."""
    rgb = Window.of(frame.camera, size).seen(frame.image.rgb, size)
    cloud = thinned(frame.cloud, most)
    group = frame.sequence or frame.name.rpartition("/")[0]
    return Glance(frame.name, group, frame.camera, rgb, cloud.xyz, reflectance_of(cloud))
