"""Point-to-line pairs with a known pose: random points, lines through their true projections."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from p2o import Camera, se3
from p2o.solving import PointToLine

from tests.edge_scene import DISTORTED, FISHEYE, PINHOLE, TRUTH

CAMERAS = {
    "pinhole": (PINHOLE,),
    "fisheye": (FISHEYE,),
    "distorted": (DISTORTED,),
    "mixed": (PINHOLE, FISHEYE, PINHOLE),
}

NEAR = TRUTH @ se3.exp(np.array([0.0098, -0.0112, 0.0092, 0.03, -0.025, 0.031]))
"""A start one degree and five centimetres from the truth."""


def pairs(
    seed: int = 0,
    *,
    cameras: tuple[Camera, ...] = (PINHOLE, PINHOLE),
    count: int = 150,
    noise_px: float = 0.0,
    outliers: float = 0.0,
    angles: tuple[float, ...] = (0.0, np.pi / 2),
    spread: float = 0.2,
    depth_m: tuple[float, float] = (4.0, 40.0),
) -> PointToLine:
    """Return `count` pairs a camera, whose normals lie at `angles` give or take `spread` (rad).

    Noise and, for a share of `outliers`, up to 30 px more, shift the lines along their normals; the centre lies
    anywhere along the line. Without both, the residuals at TRUTH are zero.
    """
    rng = np.random.default_rng(seed)
    points, pixels = [], []
    for camera in cameras:
        uv = rng.uniform([0.2, 0.2], [0.8, 0.8], (count, 2)) * [camera.width, camera.height]
        rays = camera.rays(uv)
        seen = rays / rays[:, 2:] * rng.uniform(*depth_m, (count, 1))
        points.append(se3.apply(se3.inverse(TRUTH), seen))
        pixels.append(camera.project(seen))
    total = count * len(cameras)
    angle = rng.choice(angles, total) + rng.normal(0, spread, total)
    normal = np.column_stack([np.cos(angle), np.sin(angle)])
    shift = rng.normal(0, 1, total) * noise_px + (rng.random(total) < outliers) * rng.uniform(-30, 30, total)
    slide = rng.uniform(-3, 3, total)
    centre = np.concatenate(pixels) + shift[:, None] * normal
    centre += slide[:, None] * np.column_stack([-normal[:, 1], normal[:, 0]])
    return PointToLine(
        np.concatenate(points),
        centre,
        normal,
        rng.uniform(0.2, 2.0, total),
        rng.integers(0, 4, total),
        np.repeat(np.arange(len(cameras)), count),
        cameras,
    )


def rows(problem: PointToLine, order: np.ndarray) -> PointToLine:
    """Return the problem with its pairs selected and ordered by an index or mask."""
    names = ("xyz", "centre", "normal", "weight", "side", "frame", "time_s", "sigma_px")
    return replace(problem, **{name: getattr(problem, name)[order] for name in names})


def off(poses: np.ndarray) -> np.ndarray:
    """Return how far poses (B, 4, 4) are from TRUTH, (B, 6): radians (of small turns) and metres."""
    turn = poses[:, :3, :3] @ TRUTH[:3, :3].T
    axis = np.stack([turn[:, 2, 1] - turn[:, 1, 2], turn[:, 0, 2] - turn[:, 2, 0], turn[:, 1, 0] - turn[:, 0, 1]], 1)
    return np.concatenate([axis / 2, poses[:, :3, 3] - TRUTH[:3, 3]], axis=1)


def apart(a: np.ndarray, b: np.ndarray) -> tuple[float, float]:
    """Return angle in degrees and distance in metres between two poses."""
    difference = se3.inverse(a) @ b
    return se3.angle_deg(difference), se3.distance_m(difference)
