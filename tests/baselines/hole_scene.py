"""Boards with round holes of known poses: exact detections of both sensors, and frames that are drawn of them."""

from __future__ import annotations

import numpy as np
from p2o import Camera, Cloud, Frame, HoleBoard, Image, se3
from p2o.arrays import Float
from p2o_baselines.boards.board_in_picture import BoardInPicture
from p2o_baselines.boards.holes_in_sweep import HoleBoardInSweep
from p2o_baselines.target_method import Sight

from tests.baselines.board_scene import CAMERA, TRUTH, beams

HOLES = HoleBoard(1.2, 0.8, tuple((x, y, 0.12) for y in (-0.2, 0.2) for x in (-0.25, 0.25)))
SQUARE = HoleBoard(1.0, 1.0, tuple((x, y, 0.12) for y in (-0.25, 0.25) for x in (-0.25, 0.25)))


def in_picture(camera_from_board: Float, target: HoleBoard = HOLES) -> BoardInPicture:
    """Return the board as a picture without noise tells it."""
    covariance = np.diag([2e-3, 2e-3, 2e-3, 3e-3, 3e-3, 6e-3]) ** 2
    return BoardInPicture(target, np.zeros((0, 2)), camera_from_board, covariance, 0.1, 700.0)


def in_sweep(lidar_from_board: Float, target: HoleBoard = HOLES) -> HoleBoardInSweep:
    """Return the board as a sweep without noise tells it."""
    x, y = np.meshgrid(np.linspace(-0.55, 0.55, 12), np.linspace(-0.37, 0.37, 8))
    xyz = se3.apply(lidar_from_board, np.stack([x.ravel(), y.ravel(), np.zeros(x.size)], axis=1))
    normal = -lidar_from_board[:3, 2] * np.sign(lidar_from_board[:3, 2] @ lidar_from_board[:3, 3])
    return HoleBoardInSweep(
        (target.width_m, target.height_m),
        xyz,
        normal,
        float(normal @ xyz.mean(axis=0)),
        0.005,
        lidar_from_board,
        np.zeros((0, 3)),
        np.zeros(0, np.int64),
        np.zeros(0),
        0.0,
        target,
        np.diag([3e-3, 3e-3, 3e-3, 4e-3, 4e-3, 4e-3]) ** 2,
    )


def sights(boards: list[Float], target: HoleBoard = HOLES) -> list[Sight]:
    """Return a frame for each board."""
    away = se3.inverse(TRUTH)
    return [
        Sight(f"pose{number}", "a board", (in_picture(pose, target),), (in_sweep(away @ pose, target),))
        for number, pose in enumerate(boards)
    ]


def on_board(xy: Float, target: HoleBoard = HOLES) -> Float:
    """Return which points (..., 2) of the board's plane are board."""
    on = (np.abs(xy) < np.array([target.width_m, target.height_m]) / 2).all(axis=-1)
    for u, v, radius in target.holes:
        on &= np.hypot(xy[..., 0] - u, xy[..., 1] - v) > radius
    return np.asarray(on)


def picture(camera: Camera, camera_from_board: Float | None, target: HoleBoard = HOLES) -> Image:
    """Return a picture of a white board before grey, nine rays a pixel."""
    v, u = np.mgrid[: camera.height, : camera.width].astype(np.float64)
    grey = np.zeros(u.shape)
    parts = (np.arange(3) - 1.0) / 3
    for du in parts:
        for dv in parts:
            shade = np.full(u.shape, 90.0)
            if camera_from_board is not None:
                rays = np.nan_to_num(camera.rays(np.stack([u + du, v + dv], axis=-1)))
                normal, middle = camera_from_board[:3, 2], camera_from_board[:3, 3]
                with np.errstate(divide="ignore", invalid="ignore"):
                    hit = rays * (normal @ middle / (rays @ normal))[..., None]
                own = np.nan_to_num((hit - middle) @ camera_from_board[:3, :2], nan=99.0)
                shade[on_board(own, target)] = 200.0
            grey += shade / 9
    rgb = np.repeat(np.rint(grey).astype(np.uint8)[..., None], 3, axis=2)
    return Image(rgb, camera)


def sweep(lidar_from_board: Float, noise_m: float = 0.0, rings: int = 48, target: HoleBoard = HOLES) -> Cloud:
    """Return a sweep of the board before a wall 9 m off: rings 0.5 deg apart, points 0.2 deg."""
    rng = np.random.default_rng(0)
    way, ring = beams(0.5 * (np.arange(rings) - rings / 2), np.arange(-50, 50, 0.2))
    distance = 9.0 / way[:, 0]
    hit = (lidar_from_board[:3, 2] @ lidar_from_board[:3, 3]) / (way @ lidar_from_board[:3, 2])
    own = (way * hit[:, None] - lidar_from_board[:3, 3]) @ lidar_from_board[:3, :2]
    distance = np.where(on_board(own, target) & (hit > 0), hit, distance)
    distance = distance + rng.normal(0, 1, len(distance)) * noise_m
    return Cloud(way * distance[:, None], ring=ring)


def frame(number: int, camera_from_board: Float, noise_m: float = 0.01) -> Frame:
    """Return a frame that shows the board to both sensors."""
    return Frame(
        f"pose{number}",
        picture(CAMERA, camera_from_board),
        sweep(se3.inverse(TRUTH) @ camera_from_board, noise_m),
        camera_from_lidar=TRUTH,
        targets=(HOLES,),
    )
