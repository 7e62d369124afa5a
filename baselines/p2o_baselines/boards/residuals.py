"""Residuals of boards: points of the sweep from the plane of the image, and centres of holes in both sensors."""

from __future__ import annotations

from typing import cast

import numpy as np
from p2o import Float, se3

from p2o_baselines.boards.adjustment import Block
from p2o_baselines.boards.holes_in_sweep import HoleBoardInSweep
from p2o_baselines.boards.pairing import Pair


def off_plane(pair: Pair, pose: Float, weight: float = 1.0) -> Block:
    """Return the distances of all points of a board from its plane in m, times a weight."""
    xyz, normal = se3.apply(pose, pair.patch.xyz), pair.board.normal
    rays = (pair.patch.xyz / np.linalg.norm(pair.patch.xyz, axis=1)[:, None]) @ pose[:3, :3].T
    return Block(
        weight * (xyz @ normal - pair.board.offset_m),
        weight * by_update_along(xyz, normal),
        weight * (rays @ normal),
        np.full(len(xyz), (weight * pair.patch.sigma_m) ** 2),
    )


def by_update_along(xyz: Float, direction: Float) -> Float:
    """Return how a left update of a pose moves points (N, 3) that it gave along a direction (3,), (N, 6)."""
    return np.concatenate([np.cross(xyz, direction), np.broadcast_to(direction, xyz.shape)], axis=1)


def joined(*blocks: Block) -> Block:
    """Return blocks of one board with independent residuals as one."""
    residuals, by_update, by_bias, variances = zip(*(block[:4] for block in blocks), strict=True)
    return Block(
        np.concatenate(residuals), np.concatenate(by_update), np.concatenate(by_bias), np.concatenate(variances)
    )


def in_sweep(pair: Pair) -> tuple[Float, Float]:
    """Return the centres (N, 3) m of the sweep in the image's order, and their covariance (3N, 3N)."""
    patch = cast(HoleBoardInSweep, pair.patch)
    centres = se3.apply(pair.lidar_from_board, patch.target.centres)
    by_update = moved(centres)
    return centres, by_update @ patch.covariance @ by_update.T


def in_picture(pair: Pair) -> Float:
    """Return the centres (N, 3) m by the image, in the camera frame."""
    return se3.apply(pair.board.camera_from_board, cast(HoleBoardInSweep, pair.patch).target.centres)


def moved(xyz: Float) -> Float:
    """Return how a left update of a pose moves points (N, 3) that it gave, (3N, 6)."""
    eye = np.broadcast_to(np.eye(3), (len(xyz), 3, 3))
    return np.concatenate([-se3.skew(xyz), eye], axis=2).reshape(-1, 6)


def bearings_by_point(xyz: Float) -> Float:
    """Return how x / z and y / z change with points (N, 3), as one matrix (2N, 3N)."""
    from scipy.linalg import block_diag

    return np.asarray(block_diag(*(np.array([[1 / z, 0, -x / z**2], [0, 1 / z, -y / z**2]]) for x, y, z in xyz)))


def off_centres(pair: Pair, pose: Float) -> Block:
    """Return the differences (3N,) in m between centres of the sweep and of the image, with equal weights."""
    centres, covariance = in_sweep(pair)
    seen = se3.apply(pose, centres)
    turn = np.kron(np.eye(len(centres)), pose[:3, :3])
    rays = centres / np.linalg.norm(centres, axis=1)[:, None]
    return Block((seen - in_picture(pair)).ravel(), moved(seen), turn @ rays.ravel(), turn @ covariance @ turn.T)
