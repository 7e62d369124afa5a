"""Planes of checkerboards weighed by their covariances, `--calibrator koo`, after Koo, Kang, Jang and Doh 2020.

    p2o run --data folder:BOARDS --joint --calibrator koo

Both sensors give each board as a plane with an analytic covariance: the picture from the noise of corners through the
pose of the board, the sweep from the noise of ranges through the fit. The pose brings planes onto planes (two angles
and a distance a board), each weighed by the inverse of both covariances together, so that a far, small or oblique
board says as much as it knows. At least three boards that face different ways are needed. The start of the least
squares is the closed form of planes; weights are taken anew at its end, three times.

Departures: the noise of corners and ranges is that of each board's own fit, not a figure of the sensor; distances
count at the middle of the sweep's points, where angles and distance of a plane are independent. Boards are found and
paired by the shared room `boards`.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import p2o
from p2o import se3
from p2o.arrays import Float

from p2o_baselines.boards.adjustment import Block, Cost
from p2o_baselines.boards.board_method import BoardMethod, Way
from p2o_baselines.boards.closed_form import from_planes
from p2o_baselines.boards.pairing import Pair
from p2o_baselines.boards.sight import BoardOptions


def plane_noise(xyz: Float, normal: Float, sigma_m: float) -> tuple[Float, Float]:
    """Return two directions (2, 3) in a plane and the variances (3,) of its tilt about them and of its distance.

    A plane through points (N, 3) that scatter by `sigma_m` tilts by sigma / sqrt(N) over their spread; its distance is
    that at their middle, where it is independent of the tilt.
    """
    off = xyz - xyz.mean(axis=0)
    off = off - np.outer(off @ normal, normal)
    values, vectors = np.linalg.eigh(off.T @ off)
    return vectors[:, 1:].T, sigma_m**2 / np.array([values[1], values[2], len(xyz)])


def off_planes(pair: Pair, pose: Float) -> tuple[Float, Float, Float, Float]:
    """Return residuals (3,), their derivative (3, 6) by a left update, (3,) by range, and variances (3,) by the sweep.

    Residuals are two tilts in rad and the distance in m of the sweep's plane from that of the picture.
    """
    normal, middle = pair.board.normal, pair.patch.middle
    ways, variances = plane_noise(pair.patch.xyz, pair.patch.normal, pair.patch.sigma_m)
    ways = ways @ pose[:3, :3].T
    at = se3.apply(pose, middle[None])[0]
    residuals = np.r_[ways @ normal, at @ normal - pair.board.offset_m]
    by_update = np.zeros((3, 6))
    by_update[:2, :3] = np.cross(ways, normal)
    by_update[2] = np.r_[np.cross(at, normal), normal]
    ray = pose[:3, :3] @ middle / np.linalg.norm(middle)
    return residuals, by_update, np.r_[0.0, 0.0, ray @ normal], variances


def closed(pairs: Sequence[Pair], rough: Float) -> Float:
    """Return the pose (4, 4) that takes the planes of sweeps onto those of pictures, all with one weight."""
    del rough
    return from_planes(
        np.array([pair.board.normal for pair in pairs]),
        np.array([pair.board.offset_m for pair in pairs]),
        np.array([pair.patch.normal for pair in pairs]),
        np.array([pair.patch.offset_m for pair in pairs]),
    )


def cost(pairs: Sequence[Pair], pose: Float) -> Cost:
    """Return the cost, weighed as the covariances are at a pose."""
    whiteners = {}
    for pair in pairs:
        _, by_update, _, variances = off_planes(pair, pose)
        whole = np.diag(variances) + by_update @ pair.board.covariance @ by_update.T
        whiteners[id(pair)] = np.linalg.inv(np.linalg.cholesky(whole))

    def misfits(pair: Pair, pose: Float) -> Block:
        residuals, by_update, by_bias, variances = off_planes(pair, pose)
        whitener = whiteners[id(pair)]
        noise = whitener @ np.diag(variances) @ whitener.T
        return Block(whitener @ residuals, whitener @ by_update, whitener @ by_bias, noise)

    return misfits


WAY = Way(least=3, planes_only=True, closed=closed, cost=cost, rounds=3)


def build(options: BoardOptions) -> p2o.Calibrator:
    """Return the calibrator."""
    return BoardMethod(options, WAY)


_BOARDS = "targets=checkerboard&place=yard&frames_per_scene=5&width_px=621&height_px=350&right=false&lidar=hdl-64e"
METHOD = p2o.Method(
    name="koo",
    build=build,
    options=BoardOptions,
    summary="Planes of checkerboards onto planes, weighed by analytic covariances of both sensors.",
    needs=frozenset({"targets"}),
    cite="Koo, Kang, Jang and Doh, Analytic plane covariances construction for precise planarity-based extrinsic "
    "calibration of camera and LiDAR, ICRA 2020",
    example=p2o.Example(f"synthetic:?{_BOARDS}", "10deg 0.3m", "0.5deg 0.05m", joint=True),
)
