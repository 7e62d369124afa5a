"""Rigs as anybody might have them: camera model, picture, focal length, mounting and LiDAR, drawn at random."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from p2o.arrays import Float
from p2o.geometry import se3
from p2o.simulate.lidar import Rosette
from p2o.simulate.sensors import LIDARS

Model = Literal["pinhole", "opencv-distorted", "fisheye"]
SIZES_PX = (
    (640, 480), (752, 480), (848, 480), (960, 600), (1024, 768), (1226, 370), (1242, 375), (1280, 720), (1280, 960),
    (1440, 928), (1600, 900), (1600, 1200), (1920, 1020),
)  # fmt: skip
"""Common sizes of pictures, none of them over two million pixels."""
FOCAL_PX = (400.0, 2200.0)
FIELD_DEG = (25.0, 120.0)
"""Bounds of focal lengths, and of how much a picture shows from left to right."""
_MODELS: tuple[tuple[Model, float], ...] = (("pinhole", 0.5), ("opencv-distorted", 0.25), ("fisheye", 0.25))
_LOWEST_M, _HIGHEST_M = (-0.4, -0.4, -0.3), (0.6, 0.4, 0.3)


@dataclass(frozen=True)
class RandomRig:
    """A camera of a `model`, `width` x `height` px with a `focal_px`, mounted at `mount`, beside a named `lidar`.

    `mount` (6,) is x, y, z in metres in the LiDAR frame, then the rotation vector in degrees in camera axes that turns
    it from straight ahead.
    """

    model: Model
    width: int
    height: int
    focal_px: float
    mount: tuple[float, ...]
    lidar: str


def random_rig(rng: np.random.Generator, *, megapixels: float = 2.0, rings: bool = False) -> RandomRig:
    """Return a rig; with `rings` its LiDAR has some.

    The focal length is log-uniform within FOCAL_PX and what FIELD_DEG leaves of it for the size of the picture; a
    picture with more than `megapixels` is made smaller, and its focal length with it. The camera looks anywhere (with a
    rosette, that way), pitched by up to 10 degrees and rolled a little; one in ten lies on its side, one in ten hangs
    upside down.
    """
    names = [name for name, lidar in LIDARS.items() if not (rings and isinstance(lidar, Rosette))]
    lidar = str(rng.choice(names))
    model = _MODELS[rng.choice(len(_MODELS), p=[share for _, share in _MODELS])][0]
    width, height = SIZES_PX[rng.integers(len(SIZES_PX))]
    low, high = (width * f for f in sorted(_focal_of_field(model, degrees) for degrees in FIELD_DEG))
    low, high = max(low, FOCAL_PX[0]), min(high, FOCAL_PX[1])
    focal_px = float(np.exp(rng.uniform(np.log(low), np.log(high))))
    scale = min(1.0, np.sqrt(megapixels * 1e6 / (width * height)))
    narrow = isinstance(LIDARS[lidar], Rosette)
    yaw = rng.uniform(-8.0, 8.0) if narrow else rng.uniform(-180.0, 180.0)
    pitch = rng.uniform(-4.0, 4.0) if narrow else rng.uniform(-10.0, 10.0)
    draw, side = rng.random(), rng.choice([-90.0, 90.0])
    roll = 3.0 * rng.normal() + (side if draw < 0.1 else 180.0 if draw < 0.2 else 0.0)
    place = rng.uniform(_LOWEST_M, _HIGHEST_M)
    turn = np.degrees(se3.rotation_vector(_turned(pitch, yaw, roll)))
    return RandomRig(
        model,
        max(64, round(width * scale)),
        max(64, round(height * scale)),
        focal_px * float(scale),
        tuple(float(v) for v in (*place, *turn)),
        lidar,
    )


def _focal_of_field(model: Model, degrees: float) -> float:
    """Return the focal length, in widths of the picture, that shows so many degrees from left to right."""
    half = np.radians(degrees / 2)
    return float(0.5 / (half if model == "fisheye" else np.tan(half)))


def _turned(pitch_deg: float, yaw_deg: float, roll_deg: float) -> Float:
    """Return the rotation (3, 3) in camera axes: headed by yaw about down first, then pitched, then rolled."""
    axes = ((2, roll_deg), (0, pitch_deg), (1, yaw_deg))
    out = np.eye(4)
    for axis, degrees in axes:
        out = out @ se3.exp(np.radians(degrees) * np.eye(6)[axis])
    return out[:3, :3]
