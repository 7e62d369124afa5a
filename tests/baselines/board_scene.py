"""Boards of known poses: what both sensors find of them without noise, and frames that are drawn of them."""

from __future__ import annotations

import numpy as np
from p2o import Camera, Checkerboard, Cloud, Frame, Image, pose_error, se3
from p2o.arrays import Float
from p2o_baselines.boards.board_in_picture import BoardInPicture, refined
from p2o_baselines.boards.board_in_sweep import BoardInSweep
from p2o_baselines.boards.pairing import Pair
from p2o_baselines.target_method import Sight

BOARD = Checkerboard(7, 5, 0.1, 1.0, 0.8)
CAMERA = Camera.pinhole(700.0, 700.0, 499.5, 299.5, 1000, 600)
FISHEYE = Camera("OPENCV_FISHEYE", 1000, 600, (420.0, 420.0, 499.5, 299.5, -0.03, 0.01, 0.0, 0.0))
TRUTH = se3.exp(np.array([0.03, -0.02, 0.01, 0.0, 0.0, 0.0])) @ se3.make(
    np.array([[0.0, -1, 0], [0, 0, -1], [1, 0, 0]]), [0.1, -0.2, 0.05]
)
AWAY = se3.exp(np.array([0.06, -0.05, 0.04, 0.1, -0.1, 0.1])) @ TRUTH


def assert_near(camera_from_lidar: Float, angle_deg: float, distance_m: float, truth: Float = TRUTH) -> None:
    """Fail for a pose that is farther from the truth."""
    error = pose_error(camera_from_lidar, truth)
    assert error.rotation_deg < angle_deg
    assert error.translation_m < distance_m


def poses(count: int, seed: int = 0) -> list[Float]:
    """Return camera_from_board (4, 4) of boards 2 to 5 m ahead, turned, tilted and rolled by up to 35 deg."""
    rng = np.random.default_rng(seed)
    out = []
    for _ in range(count):
        turn = se3.exp(np.r_[np.radians(rng.uniform(-35, 35, 3)), 0, 0, 0])
        depth = rng.uniform(2, 5)
        out.append(se3.make(None, [*(rng.uniform(-0.3, 0.3, 2) * depth), depth]) @ turn)
    return out


def in_picture(
    camera_from_board: Float, camera: Camera = CAMERA, noise_px: float = 0.0, seed: int = 0
) -> BoardInPicture:
    """Return the board as the picture shows it, its corners off by noise."""
    uv = camera.project(se3.apply(camera_from_board, BOARD.corners))
    uv = uv + np.random.default_rng(seed).normal(0, 1, uv.shape) * noise_px
    board = refined(camera, BOARD, uv, camera_from_board)
    assert board is not None
    return board


def in_sweep(lidar_from_board: Float, noise_m: float = 0.0, seed: int = 0) -> BoardInSweep:
    """Return the board as a sweep shows it: a grid of points, five ends on each side, noise along the normal."""
    rng = np.random.default_rng(seed)
    half = np.array([BOARD.width_m, BOARD.height_m]) / 2
    x, y = np.meshgrid(np.linspace(-0.9, 0.9, 12) * half[0], np.linspace(-0.9, 0.9, 8) * half[1])
    grid = np.stack([x.ravel(), y.ravel(), np.zeros(x.size)], axis=1)
    at = np.linspace(-0.7, 0.7, 5)
    sides = [
        np.stack([at * half[0], np.full(5, -half[1])], axis=1),
        np.stack([np.full(5, half[0]), at * half[1]], axis=1),
        np.stack([at * half[0], np.full(5, half[1])], axis=1),
        np.stack([np.full(5, -half[0]), at * half[1]], axis=1),
    ]
    ends = np.column_stack([np.concatenate(sides), np.zeros(20)])
    grid[:, 2] += rng.normal(0, 1, len(grid)) * noise_m
    xyz = se3.apply(lidar_from_board, grid)
    middle = xyz.mean(axis=0)
    normal = np.linalg.svd(xyz - middle)[2][2]
    normal = -normal if normal @ middle > 0 else normal
    return BoardInSweep(
        (BOARD.width_m, BOARD.height_m),
        xyz,
        normal,
        float(normal @ middle),
        max(noise_m, 0.001),
        lidar_from_board,
        se3.apply(lidar_from_board, ends),
        np.repeat(np.arange(4), 5),
        np.full(20, 0.005),
        0.0,
    )


def pairs(boards: list[Float], noise_px: float = 0.0, noise_m: float = 0.0) -> list[Pair]:
    """Return each board as both sensors find it."""
    lidar_from_camera = se3.inverse(TRUTH)
    return [
        Pair(
            number,
            in_picture(pose, noise_px=noise_px, seed=number),
            in_sweep(lidar_from_camera @ pose, noise_m, number),
            np.eye(4),
        )
        for number, pose in enumerate(boards)
    ]


def sights(boards: list[Float], noise_px: float = 0.0, noise_m: float = 0.0) -> list[Sight]:
    """Return a frame for each board."""
    found = pairs(boards, noise_px, noise_m)
    return [Sight(f"pose{pair.frame}", "a board", (pair.board,), (pair.patch,)) for pair in found]


def picture(camera: Camera, camera_from_board: Float | None) -> Image:
    """Return a picture of the board before grey, four rays a pixel; without a pose of grey alone."""
    v, u = np.mgrid[: camera.height, : camera.width].astype(np.float64)
    light = np.full(u.shape, 110.0)
    if camera_from_board is not None:
        total = np.zeros(u.shape)
        pose = camera_from_board
        for du, dv in ((-0.25, -0.25), (0.25, -0.25), (-0.25, 0.25), (0.25, 0.25)):
            rays = camera.rays(np.stack([u + du, v + dv], axis=-1))
            with np.errstate(divide="ignore", invalid="ignore"):
                depth = (pose[:3, 2] @ pose[:3, 3]) / (rays @ pose[:3, 2])
                x, y = np.moveaxis((rays * depth[..., None] - pose[:3, 3]) @ pose[:3, :2], -1, 0)
                square = np.floor(x / BOARD.square_m + 50) + np.floor(y / BOARD.square_m + 50)
                dark = (square % 2 == 0) & (np.abs(x) < (BOARD.columns + 1) / 2 * BOARD.square_m)
                dark &= np.abs(y) < (BOARD.rows + 1) / 2 * BOARD.square_m
                on = (np.abs(x) < BOARD.width_m / 2) & (np.abs(y) < BOARD.height_m / 2) & (depth > 0)
            total += np.where(on, np.where(dark, 20.0, 235.0), 110.0)
        light = total / 4
    grey = np.clip(np.rint(light), 0, 255).astype(np.uint8)
    return Image(np.repeat(grey[..., None], 3, axis=2), camera)


def beams(elevation_deg: Float, azimuth_deg: Float) -> tuple[Float, Float]:
    """Return the unit vectors (N, 3) of the beams of a sweep, ring after ring, and their rings (N,)."""
    up, turn = np.meshgrid(np.radians(elevation_deg), np.radians(azimuth_deg), indexing="ij")
    way = np.stack([np.cos(up) * np.cos(turn), np.cos(up) * np.sin(turn), np.sin(up)], axis=-1)
    return way.reshape(-1, 3), np.repeat(np.arange(len(elevation_deg)), len(azimuth_deg))


def sweep(camera_from_board: Float | None, noise_m: float, seed: int = 0, apex_m: float = 0.0) -> Cloud:
    """Return a sweep of 40 rings, 1 deg apart, of the board before a wall 9 m off and a post, from `apex_m` up."""
    rng = np.random.default_rng(seed)
    way, ring = beams(np.arange(-20.0, 20), np.arange(-50, 50, 0.2))
    start = np.array([0.0, 0.0, apex_m])
    distance = 9.0 / way[:, 0]
    post = np.abs(np.arctan2(way[:, 1], way[:, 0]) - 0.6) < 0.02
    distance[post] = 4.0
    if camera_from_board is not None:
        pose = se3.inverse(TRUTH) @ camera_from_board
        with np.errstate(divide="ignore"):
            hit = (pose[:3, 2] @ (pose[:3, 3] - start)) / (way @ pose[:3, 2])
        x, y = ((start + way * hit[:, None] - pose[:3, 3]) @ pose[:3, :2]).T
        on = (np.abs(x) < BOARD.width_m / 2) & (np.abs(y) < BOARD.height_m / 2) & (hit > 0)
        distance = np.where(on, hit, distance)
    distance = distance + rng.normal(0, 1, len(distance)) * noise_m
    return Cloud(start + way * distance[:, None], ring=ring)


def frame(number: int, camera_from_board: Float, noise_m: float = 0.015) -> Frame:
    """Return a frame that shows the board to both sensors."""
    return Frame(
        f"pose{number}",
        picture(CAMERA, camera_from_board),
        sweep(camera_from_board, noise_m, number),
        camera_from_lidar=TRUTH,
        targets=(BOARD,),
    )
