"""Visibility of LiDAR points from the camera, whose position differs from that of the LiDAR."""

from __future__ import annotations

import numpy as np

from p2o.arrays import Bool, Float
from p2o.geometry import se3
from p2o.geometry.camera import Camera


def hidden(xyz: Float, surface: Float, camera: Camera, camera_from_lidar: Float, cell_px: float = 4.0) -> Bool:
    """Return which points (M, 3) are occluded by the surface samples `surface` (K, 3), both in the LiDAR frame, metres.

    A point is occluded if clearly nearer samples are within three cells to its left *and* to its right: a sweep is too
    sparse for a z-buffer, and a nearer object on one side only is an edge. Points outside the image are not occluded.
    The outcome depends much more on the position of the camera than on its orientation, so an approximate extrinsic is
    sufficient.
    """
    import cv2

    points = se3.apply(camera_from_lidar, xyz)
    samples = se3.apply(camera_from_lidar, surface)
    shape = (int(camera.height // cell_px) + 1, int(camera.width // cell_px) + 1)
    nearest = np.full(shape, np.inf)
    uv = camera.project(samples)
    visible = camera.in_image(uv)
    rows, columns = _cells(uv[visible], cell_px, shape)
    np.minimum.at(nearest, (rows, columns), np.linalg.norm(samples[visible], axis=1))
    # Windows of three cells to one side and three rows; the shift excludes the point's own cell.
    window = np.ones((3, 3), np.uint8)
    left, right = (
        cv2.erode(nearest, window, anchor=(column, 1), borderType=cv2.BORDER_CONSTANT, borderValue=np.inf)
        for column in (2, 0)
    )
    left = np.roll(left, 1, axis=1)
    right = np.roll(right, -1, axis=1)
    left[:, 0], right[:, -1] = np.inf, np.inf
    obstacle = np.maximum(left, right)
    uv = camera.project(points)
    out = camera.in_image(uv)
    rows, columns = _cells(uv[out], cell_px, shape)
    distance = np.linalg.norm(points[out], axis=1)
    out[out] = obstacle[rows, columns] < 0.95 * distance - 0.3
    return out


def _cells(uv: Float, cell_px: float, shape: tuple[int, int]) -> tuple[np.ndarray, np.ndarray]:
    index = np.clip(((uv + 0.5) // cell_px).astype(np.int64), 0, [shape[1] - 1, shape[0] - 1])
    return index[:, 1], index[:, 0]
