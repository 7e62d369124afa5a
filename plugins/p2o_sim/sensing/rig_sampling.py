"""Draw random rigs: camera model, image size, focal length, mounting and LiDAR."""

from __future__ import annotations

from typing import Any, Literal

import numpy as np
from p2o import Float, se3

from p2o_sim.sensing.lidar import Rosette
from p2o_sim.sensing.sensors import LIDARS

Model = Literal["pinhole", "opencv-distorted", "fisheye"]
SIZES_PX = (
    (640, 480), (752, 480), (848, 480), (960, 600), (1024, 768), (1226, 370), (1242, 375), (1280, 720), (1280, 960),
    (1440, 928), (1600, 900), (1600, 1200), (1920, 1020),
)  # fmt: skip
"""Common image sizes with at most two million pixels."""
FOCAL_PX = (400.0, 2200.0)
FIELD_DEG = (25.0, 120.0)
"""Bounds of focal lengths, and of the horizontal field of view."""
DRAWN_LIDARS = ("hdl-64e", "hdl-32e", "vlp-16", "os1-64", "os1-128", "pandar64", "mid-40")
"""LiDARs that random rigs may have; another one would change the rigs of all seeds."""
_MODELS: tuple[tuple[Model, float], ...] = (("pinhole", 0.5), ("opencv-distorted", 0.25), ("fisheye", 0.25))
_TO_THE_SIDE_DEG = (-55.0, 55.0, -110.0, 110.0, 180.0)
_LOWEST_M, _HIGHEST_M = (-0.4, -0.4, -0.3), (0.6, 0.4, 0.3)


def random_rig(rng: np.random.Generator, *, megapixels: float = 2.0, rings: bool = False) -> dict[str, Any]:
    """Draw the options camera, width_px, height_px, focal_px, mount and lidar; with `rings`, the LiDAR has rings.

    The focal length is log-uniform within FOCAL_PX and the bounds that FIELD_DEG gives for the image size; images of
    more than `megapixels` are reduced with their focal lengths. The yaw is arbitrary (with a rosette: ahead), the pitch
    at most 10 degrees, the roll small; one camera in ten is mounted sideways, one in ten upside down.
    """
    names = [name for name in DRAWN_LIDARS if not (rings and isinstance(LIDARS[name], Rosette))]
    lidar = str(rng.choice(names))
    camera = _camera(rng, megapixels)
    narrow = isinstance(LIDARS[lidar], Rosette)
    yaw = rng.uniform(-8.0, 8.0) if narrow else rng.uniform(-180.0, 180.0)
    pitch = rng.uniform(-4.0, 4.0) if narrow else rng.uniform(-10.0, 10.0)
    draw, side = rng.random(), rng.choice([-90.0, 90.0])
    roll = 3.0 * rng.normal() + (side if draw < 0.1 else 180.0 if draw < 0.2 else 0.0)
    return {**camera, "mount": _mount(rng, pitch, yaw, roll), "lidar": lidar}


def random_vehicle(rng: np.random.Generator, *, megapixels: float = 2.0) -> dict[str, Any]:
    """Draw the rig of a car or a robot on a road: a LiDAR with rings and one of its upright cameras.

    Six cameras in ten look ahead, the others to one of the directions of a rig of six. The camera is that of
    `random_rig`.
    """
    lidar = str(rng.choice([name for name in DRAWN_LIDARS if not isinstance(LIDARS[name], Rosette)]))
    camera = _camera(rng, megapixels)
    yaw = 2.0 * rng.normal() if rng.random() < 0.6 else rng.choice(_TO_THE_SIDE_DEG) + 8.0 * rng.normal()
    mount = _mount(rng, 3.0 * rng.normal(), float(yaw), 1.5 * rng.normal())
    return {**camera, "mount": mount, "lidar": lidar}


def _camera(rng: np.random.Generator, megapixels: float) -> dict[str, Any]:
    """Draw the model of a camera, its width, height and focal length in pixels, reduced to `megapixels`."""
    model = _MODELS[rng.choice(len(_MODELS), p=[share for _, share in _MODELS])][0]
    width, height = SIZES_PX[rng.integers(len(SIZES_PX))]
    low, high = (width * f for f in sorted(_focal_of_field(model, degrees) for degrees in FIELD_DEG))
    low, high = max(low, FOCAL_PX[0]), min(high, FOCAL_PX[1])
    focal_px = float(np.exp(rng.uniform(np.log(low), np.log(high))))
    scale = min(1.0, np.sqrt(megapixels * 1e6 / (width * height)))
    width, height = (max(64, round(side * scale)) for side in (width, height))
    return {"camera": model, "width_px": width, "height_px": height, "focal_px": focal_px * float(scale)}


def _mount(rng: np.random.Generator, pitch_deg: float, yaw_deg: float, roll_deg: float) -> tuple[float, ...]:
    """Draw the place of a camera and return its mounting."""
    place = rng.uniform(_LOWEST_M, _HIGHEST_M)
    turn = np.degrees(se3.rotation_vector(_turned(pitch_deg, yaw_deg, roll_deg)))
    return tuple(float(v) for v in (*place, *turn))


def _focal_of_field(model: Model, degrees: float) -> float:
    """Return the focal length, in image widths, for a horizontal field of view."""
    half = np.radians(degrees / 2)
    return float(0.5 / (half if model == "fisheye" else np.tan(half)))


def _turned(pitch_deg: float, yaw_deg: float, roll_deg: float) -> Float:
    """Return the rotation (3, 3) in camera axes: yaw about the downward axis first, then pitch, then roll."""
    out = np.eye(4)
    for axis, degrees in ((2, roll_deg), (0, pitch_deg), (1, yaw_deg)):
        out = out @ se3.exp(np.radians(degrees) * np.eye(6)[axis])
    return out[:3, :3]
