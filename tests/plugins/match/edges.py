"""Views made by hand: a camera looking along +z of the LiDAR frame, edges given in pixels."""

from __future__ import annotations

import numpy as np
from p2o import Camera, CloudEdges, CloudFeatures, ImageEdges, ImageFeatures, View

CAMERA = Camera.pinhole(500.0, 500.0, 320.0, 240.0, 640, 480)
HERE = np.eye(4)


def column(u: float, first: float = 100.0, count: int = 40) -> np.ndarray:
    """Return `count` pixels below each other, from row `first`."""
    return np.column_stack([np.full(count, u), first + np.arange(count)])


def row(v: float, first: float = 100.0, count: int = 40) -> np.ndarray:
    """Return `count` pixels beside each other, from column `first`."""
    return column(v, first, count)[:, ::-1]


def view(
    image: list[tuple[np.ndarray, int]],
    cloud: list[tuple[list[tuple[float, float]], int]],
    *,
    depth_m: float = 10.0,
    camera: Camera = CAMERA,
    image_weight: float = 1.0,
    **rows: list[float],
) -> View:
    """Return a view of image edges and cloud edges, both as (pixels, side); cloud edges lie at `depth_m`."""
    uv = np.concatenate([np.zeros((0, 2)), *(pixels for pixels, _ in image)])
    seen = np.concatenate([np.zeros((0, 2)), *(np.array(pixels, float).reshape(-1, 2) for pixels, _ in cloud)])
    rays = camera.rays(seen)
    return View(
        "by hand",
        camera,
        ImageFeatures(
            ImageEdges(uv, np.concatenate([[], *([s] * len(p) for p, s in image)]), np.full(len(uv), image_weight))
        ),
        CloudFeatures(
            CloudEdges(rays / rays[:, 2:] * depth_m, np.concatenate([[], *([s] * len(p) for p, s in cloud)]), **rows)
        ),
    )
