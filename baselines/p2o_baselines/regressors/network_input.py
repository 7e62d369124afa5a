"""Input of a network: the image at the network's resolution, and points that can be projected at any pose."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
import p2o
from p2o import Float, UInt8, se3

Channel = Literal["nearness", "reflectance", "x", "y", "z"]
NEAREST_M, FARTHEST_M = 2.0, 80.0
"""Depths between which nearness falls from 1 to `FAINTEST`; LCCNet drops points beyond 80 m."""
FAINTEST = 0.05
_PLACE_M = 40.0  # unit of coordinates, so that networks see numbers of about 1


def nearness(depth_m: Float) -> Float:
    """Return 1 for depths up to 2 m, falling with their logarithm to 0.05 at 80 m and beyond; an empty cell is 0."""
    along = np.log(np.maximum(depth_m, NEAREST_M) / NEAREST_M) / np.log(FARTHEST_M / NEAREST_M)
    return np.asarray(np.maximum(1.0 - (1.0 - FAINTEST) * along, FAINTEST))


def drawn(
    uv: Float,
    depth_m: Float,
    size: tuple[int, int],
    channels: Sequence[Channel] = ("nearness",),
    reflectance: Float | None = None,
    xyz: Float | None = None,
) -> Float:
    """Render points at pixels (N, 2) of a grid of `size` (h, w) into a map (C, h, w) float32, the nearest in front.

    Points that are not projected (NaN), outside the grid, or farther than 80 m are dropped; empty cells are 0 in all
    channels. `xyz` (N, 3) is in the LiDAR frame.
    """
    height, width = size
    u, v = uv[:, 0], uv[:, 1]
    with np.errstate(invalid="ignore"):
        seen = (u >= -0.5) & (v >= -0.5) & (u < width - 0.5) & (v < height - 0.5) & (depth_m <= FARTHEST_M)
    rows = np.flatnonzero(seen)
    rows = rows[np.argsort(-depth_m[rows], kind="stable")]
    place = (v[rows] + 0.5).astype(np.int64) * width + (u[rows] + 0.5).astype(np.int64)
    out = np.zeros((len(channels), height * width), np.float32)
    for number, channel in enumerate(channels):
        if channel == "nearness":
            out[number, place] = nearness(depth_m[rows])
        elif channel == "reflectance":
            out[number, place] = 0.0 if reflectance is None else reflectance[rows]
        elif xyz is not None:
            out[number, place] = xyz[rows, "xyz".index(channel)] / _PLACE_M
    return np.asarray(out.reshape(len(channels), height, width))


Size = tuple[int, int]
"""Height and width of what a network sees, in pixels."""


@dataclass(frozen=True)
class Crop:
    """The part of an image that a network sees, (left, top, width, height) px: the largest of its proportions."""

    left: float
    top: float
    width: float
    height: float

    @classmethod
    def of(cls, camera: p2o.Camera, size: Size) -> Crop:
        """Return the window of a camera for a network of `size` (h, w)."""
        scale = min(camera.width / size[1], camera.height / size[0])
        width, height = scale * size[1], scale * size[0]
        return cls((camera.width - width) / 2, (camera.height - height) / 2, width, height)

    def cells(self, uv: Float, size: Size) -> Float:
        """Return the positions of pixels (N, 2) of the image on the grid of `size`; centres are at integers in both."""
        off = np.array([self.left, self.top]) - 0.5
        return np.asarray((uv - off) * [size[1] / self.width, size[0] / self.height] - 0.5)

    def seen(self, rgb: UInt8, size: Size) -> UInt8:
        """Return the image (h, w, 3) of the window, each pixel the mean of those that it covers."""
        import cv2

        top, left = round(self.top), round(self.left)
        part = rgb[top : top + max(1, round(self.height)), left : left + max(1, round(self.width))]
        return np.asarray(cv2.resize(part, size[::-1], interpolation=cv2.INTER_AREA), dtype=np.uint8)


@dataclass(frozen=True, eq=False)
class NetworkInput:
    """A frame as the input of networks of one size: `rgb` (h, w, 3), points (N, 3) of the LiDAR, and its drive."""

    name: str
    group: str
    camera: p2o.Camera
    rgb: UInt8
    xyz: Float
    reflectance: Float

    def drawn(self, camera_from_lidar: Float, channels: Sequence[Channel] = ("nearness",)) -> Float:
        """Return the sweep (C, h, w) as the camera's own model shows it at a pose (4, 4)."""
        size = self.rgb.shape[:2]
        in_camera = se3.apply(camera_from_lidar, self.xyz)
        cells = Crop.of(self.camera, size).cells(self.camera.project(in_camera), size)
        return drawn(cells, in_camera[:, 2], size, channels, self.reflectance, self.xyz)


def reflectance_of(cloud: p2o.Cloud) -> Float:
    """Return the reflectance (N,) in 0..1; of sensors that count higher, as a share of the 99th of 100 parts."""
    if cloud.intensity is None:
        return np.zeros(len(cloud))
    bright = float(np.percentile(cloud.intensity, 99))
    return np.asarray(np.clip(cloud.intensity / (1.0 if bright <= 1.0 else bright), 0.0, 1.0))


def thinned(cloud: p2o.Cloud, most: int) -> p2o.Cloud:
    """Return at most `most` points of a sweep, a random subset with a fixed seed: every n-th would be a pattern."""
    if len(cloud) <= most:
        return cloud
    return cloud.select(np.sort(np.random.default_rng(0).permutation(len(cloud))[:most]))


def network_input_of(frame: p2o.Frame, size: Size, most: int) -> NetworkInput:
    """Return what a network of `size` (h, w) sees of a frame, `most` points of its sweep at least as dense as that."""
    rgb = Crop.of(frame.camera, size).seen(frame.image.rgb, size)
    cloud = thinned(frame.cloud, most)
    group = frame.sequence or frame.name.rpartition("/")[0]
    return NetworkInput(frame.name, group, frame.camera, rgb, cloud.xyz, reflectance_of(cloud))
