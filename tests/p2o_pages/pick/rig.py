"""Cameras of three kinds and picks whose truth is known."""

from __future__ import annotations

import numpy as np
from p2o import Camera, se3
from p2o.arrays import Float
from p2o.problems.picked_pairs import PickedPairs
from p2o_pages.pick.session import PickSession
from p2o_testing import stage

CAMERAS = {
    "pinhole": Camera.pinhole(721.5, 721.5, 609.6, 172.9, 1242, 375),
    "distorted": Camera("OPENCV", 1242, 375, (721.5, 721.5, 609.6, 172.9, -0.1, 0.02, 1e-3, -1e-3)),
    "fisheye": Camera("OPENCV_FISHEYE", 1000, 800, (420, 420, 500, 400, 0.02, -0.01, 0, 0)),
}
TRUTH = se3.exp(np.array([0.02, 0.03, -0.01, 0, 0, 0])) @ se3.make(
    np.array([[0.0, -1, 0], [0, 0, -1], [1, 0, 0]]), np.array([0.06, -0.08, -0.27])
)


def picks(camera: Camera, count: int, seed: int = 0, noise_px: float = 0.0) -> PickedPairs:
    """Return so many pairs all over the picture at 4 to 25 m; clicks are off by `noise_px` an axis."""
    rng = np.random.default_rng(seed)
    uv = rng.uniform([60, 60], [camera.width - 60, camera.height - 60], (count, 2))
    xyz = se3.apply(se3.inverse(TRUTH), camera.rays(uv) * rng.uniform(4, 25, (count, 1)))
    return PickedPairs(uv + rng.normal(0, noise_px, uv.shape), xyz)


def moved(pairs: PickedPairs, rows: list[int], by_px: Float) -> PickedPairs:
    """Return the pairs with some clicks moved by pixels (K, 2)."""
    uv = pairs.uv.copy()
    uv[rows] += by_px
    return PickedPairs(uv, pairs.xyz)


def places(session: PickSession, count: int, seed: int = 2) -> list[tuple[Float, tuple[int, int]]]:
    """Return pixels of the image and of the range image that show the same points of the stage."""
    rows, columns = np.nonzero(session.ranges.index >= 0)
    camera, pose = stage.camera(), stage.camera_from_lidar()
    uv = camera.project(se3.apply(pose, session.ranges.xyz[session.ranges.index[rows, columns]]))
    seen = np.flatnonzero(camera.in_image(uv, -8))
    chosen = np.random.default_rng(seed).choice(seen, count, replace=False)
    return [(uv[i], (int(columns[i]), int(rows[i]))) for i in chosen]
