"""A street in three surfaces whose depth is known in closed form: a road, a wall across it, and a board before it."""

from __future__ import annotations

import numpy as np
from p2o import Camera

CAMERA = Camera.pinhole(300.0, 300.0, 250.0, 80.0, 500, 200)
ROAD_M = 1.6
"""How far the road lies below the camera."""
WALL_M, BOARD_M = 30.0, 10.0
BOARD = (-2.0, 2.0, -0.5, 0.8)
"""Left, right, top and bottom of the board in the camera frame, x to the right and y down."""


def depth_m(*, sky: bool = False) -> np.ndarray:
    """Return depth (H, W) at the pixel centres; with `sky` there is no wall."""
    v, u = np.mgrid[: CAMERA.height, : CAMERA.width].astype(float)
    x, y = (u - 250.0) / 300.0, (v - 80.0) / 300.0
    with np.errstate(divide="ignore"):
        road = np.where(y > 0, ROAD_M / y, np.inf)
    depth = np.minimum(road, np.inf if sky else WALL_M)
    left, right, top, bottom = BOARD
    board = (x * BOARD_M >= left) & (x * BOARD_M <= right) & (y * BOARD_M >= top) & (y * BOARD_M <= bottom)
    return np.where(board, BOARD_M, depth)
