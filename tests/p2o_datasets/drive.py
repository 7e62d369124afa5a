"""A car that drives a bend, and the arithmetic by which the data sets themselves project points, written by hand."""

from __future__ import annotations

from typing import Any

import numpy as np
import PIL.Image
from p2o import Frame, se3
from scipy.linalg import expm
from scipy.spatial.transform import Rotation

SPEED_M_S, TURN_RAD_S = 9.0, 0.3
OPTICAL = np.array([[0, 0, 1], [-1, 0, 0], [0, -1, 0]])
"""Rotation of the optical frame of a camera that looks ahead, seen from the car: forward, left, up."""
START = np.array([[0.6, -0.8, 0, 411.0], [0.8, 0.6, 0, 1180.0], [0, 0, 1, 3.0], [0, 0, 0, 1]])


def car(seconds: float) -> Any:
    """Return world_from_car (4, 4): x forward, y left, z up; it goes ahead, climbs a little and turns left."""
    generator = np.zeros((4, 4))
    generator[0, 1], generator[1, 0] = -TURN_RAD_S, TURN_RAD_S
    generator[:3, 3] = SPEED_M_S, 0, 0.2
    return START @ expm(generator * seconds)


def mounted(rotation: Any, x: float, y: float, z: float) -> Any:
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = rotation, (x, y, z)
    return pose


def tilted(rpy_deg: tuple[float, float, float]) -> Any:
    return Rotation.from_euler("xyz", rpy_deg, degrees=True).as_matrix()


def wxyz(pose: Any) -> list[float]:
    x, y, z, w = Rotation.from_matrix(pose[:3, :3]).as_quat().tolist()
    return [w, x, y, z]


def through(pose: Any, points: Any) -> Any:
    """Return points (N, 3) after a transform (4, 4)."""
    return (pose @ np.column_stack([points, np.ones(len(points))]).T).T[:, :3]


def pixels(points: Any, fx: float, fy: float, cx: float, cy: float) -> Any:
    """Return where a pinhole sees points of its optical frame: NaN behind it."""
    z = np.where(points[:, 2] > 0.1, points[:, 2], np.nan)
    return np.column_stack([fx * points[:, 0] / z + cx, fy * points[:, 1] / z + cy])


def walls(count: int, seed: int = 0) -> Any:
    """Return points (N, 3) of the world around the start of the drive."""
    rng = np.random.default_rng(seed)
    return rng.uniform([-40, -40, 0], [60, 40, 8], (count, 3)) + START[:3, 3]


def picture(path: Any, width: int, height: int, grey: int) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    PIL.Image.fromarray(np.full((height, width, 3), grey, np.uint8)).save(path)


def check_projection(frame: Frame, expected: Any, least: int, most_px: float, chosen: Any = ...) -> None:
    """Check that a frame has its chosen points where they are expected, and at least a given number in the image."""
    seen = frame.camera.project(se3.apply(frame.camera_from_lidar, frame.cloud.xyz))[chosen]
    inside = frame.camera.in_image(expected)
    assert inside.sum() > least
    assert np.abs(seen - expected)[inside].max() < most_px
