"""A scene made of edges only: upright boxes whose outlines both sensors see exactly."""

from __future__ import annotations

import numpy as np
from p2o import Camera, CloudEdges, CloudFeatures, ImageEdges, ImageFeatures, Side, View, se3

PINHOLE = Camera.pinhole(700.0, 700.0, 600.0, 180.0, 1242, 375)
FISHEYE = Camera("OPENCV_FISHEYE", 1000, 800, (320.0, 320.0, 500.0, 400.0, 0.02, -0.005, 0.001, 0.0))
DISTORTED = Camera("OPENCV", 1242, 700, (700.0, 705.0, 610.0, 340.0, -0.18, 0.05, 0.001, -0.001))

# x forward, y left, z up to x right, y down, z forward, plus a small turn and the KITTI lever arm.
AXES = np.array([[0.0, -1, 0], [0, 0, -1], [1, 0, 0]])
TRUTH = se3.exp(np.array([0.01, -0.02, 0.015, 0, 0, 0])) @ se3.make(AXES, [0.02, -0.08, -0.27])

STEP = {Side.LEFT: (-1.0, 0.0), Side.RIGHT: (1.0, 0.0), Side.UPPER: (0.0, -1.0), Side.BOTTOM: (0.0, 1.0)}


def view(
    camera: Camera = PINHOLE,
    truth: np.ndarray = TRUTH,
    *,
    boxes: int = 25,
    seed: int = 0,
    noise_px: float = 0.0,
    lidar_step_m: float = 0.15,
    name: str = "synthetic",
) -> View:
    """Return the view of fronto-parallel rectangles at random places, true pose `truth` (camera_from_lidar)."""
    rng = np.random.default_rng(seed)
    lidar_from_camera = se3.inverse(truth)
    uv, image_side, xyz, cloud_side, background = [], [], [], [], []
    for _ in range(boxes):
        depth = rng.uniform(5, 40)
        centre = camera.rays(rng.uniform([0.1, 0.15], [0.9, 0.85]) * [camera.width, camera.height])
        x, y = centre[:2] / centre[2] * depth
        half_x, half_y = rng.uniform(0.2, 2.0), rng.uniform(0.3, 1.5)
        for side, (du, dv) in STEP.items():
            along = np.array([0.0, 1.0]) if du else np.array([1.0, 0.0])
            middle = np.array([x + du * half_x, y + dv * half_y])
            length = half_y if du else half_x
            for step, store, labels in ((0.3 * depth / 700, uv, image_side), (lidar_step_m, xyz, cloud_side)):
                t = np.arange(-length, length, step) + rng.uniform(0, step)
                points = np.column_stack([middle + t[:, None] * along, np.full(len(t), depth)])
                if store is uv:
                    pixels = camera.project(points)
                    store.append(pixels + rng.normal(0, noise_px, pixels.shape))
                else:
                    store.append(se3.apply(lidar_from_camera, points))
                    direction = lidar_from_camera[:3, :3] @ np.array([du, dv, 0.0])
                    background.append(np.tile(direction, (len(points), 1)))
                labels.append(np.full(len(points), side))
    pixels = np.concatenate(uv)
    inside = camera.in_image(pixels)
    image = ImageEdges(pixels[inside], np.concatenate(image_side)[inside])
    cloud = CloudEdges(np.concatenate(xyz), np.concatenate(cloud_side), background=np.concatenate(background))
    return View(name, camera, ImageFeatures(image), CloudFeatures(cloud))
