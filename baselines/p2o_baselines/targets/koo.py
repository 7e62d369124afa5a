"""Align planes of checkerboards weighted by their covariances, `--calibrator koo`, after Koo, Kang, Jang and Doh 2020.

Both sensors observe each board as a plane with an analytic covariance: the image from the noise of corners through the
pose of the board, the sweep from the noise of ranges through the fit. The pose aligns the planes (two angles and a
distance per board), weighted by the inverse sum of both covariances, so that far, small or oblique boards have the
influence they deserve. At least three boards with different orientations are needed. The least squares starts from the
closed form of planes; weights are updated three times.

Departures: the noise of corners and ranges is that of each board's own fit, not a parameter of the sensor; distances
are evaluated at the centroid of the sweep's points, where angles and distance of a plane are uncorrelated. Boards are
detected and paired by the shared package `boards`.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import p2o
from p2o import Float, se3

from p2o_baselines import examples
from p2o_baselines.boards.adjustment import Block, Cost
from p2o_baselines.boards.board_method import BoardAlgorithm, BoardMethod
from p2o_baselines.boards.pairing import Pair, from_planes
from p2o_baselines.target_method import TargetOptions


def plane_noise(xyz: Float, normal: Float, sigma_m: float) -> tuple[Float, Float]:
    """Return directions (2, 3) in a plane, variances (3,) of its tilt about them and of its distance at the middle."""
    off = xyz - xyz.mean(axis=0)
    off = off - np.outer(off @ normal, normal)
    values, vectors = np.linalg.eigh(off.T @ off)
    return vectors[:, 1:].T, sigma_m**2 / np.array([values[1], values[2], len(xyz)])


def off_planes(pair: Pair, pose: Float) -> tuple[Float, Float, Float, Float]:
    """Return two tilts (rad) and the distance (m) of planes (3,), by a left update (3, 6), by range, and variances."""
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
    """Return the pose (4, 4) that takes the planes of sweeps onto those of images, all with one weight."""
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

    def residuals(pair: Pair, pose: Float) -> Block:
        residuals, by_update, by_bias, variances = off_planes(pair, pose)
        whitener = whiteners[id(pair)]
        noise = whitener @ np.diag(variances) @ whitener.T
        return Block(whitener @ residuals, whitener @ by_update, whitener @ by_bias, noise)

    return residuals


ALGORITHM = BoardAlgorithm(least=3, planes_only=True, closed=closed, cost=cost, rounds=3)


METHOD = p2o.Method(
    name="koo",
    build=lambda options: BoardMethod(options, ALGORITHM),
    options=TargetOptions,
    summary="Aligns planes of checkerboards, weighted by analytic covariances of both sensors.",
    needs=frozenset({"targets"}),
    cite="Koo, Kang, Jang and Doh, Analytic plane covariances construction for precise planarity-based extrinsic "
    "calibration of camera and LiDAR, ICRA 2020",
    example=examples.checkerboards("0.5deg 0.05m"),
)
