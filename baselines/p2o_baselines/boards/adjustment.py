"""Least squares on the residuals of boards, and the covariance of the pose: noise, scatter, and common errors."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import NamedTuple

import numpy as np
from p2o import Float, se3

from p2o_baselines.boards.pairing import Pair
from p2o_baselines.damped import descended

RANGE_BIAS_M = 0.01  # standard deviation of an error of all ranges, for the predicted error
CAMERA_PX = 0.5  # standard deviation of the intrinsics in px, for the predicted error
_LEAST_FREEDOM = 3  # least degrees of freedom from which the scatter of targets scales the covariance


class Block(NamedTuple):
    """Residuals (K,) of one board at a pose, and their derivatives.

    `by_update` (K, 6) is the derivative by a left update of camera_from_lidar (rad, m), `by_bias` (K,) that by an error
    in m common to all ranges, `covariance` (K, K) that of the residuals due to noise of the sweep alone, (K,) the
    variances where they are independent; with `whole` it includes the noise of the image, which acts like an error of
    the LiDAR's pose, independent for each board.
    """

    residuals: Float
    by_update: Float
    by_bias: Float
    covariance: Float
    whole: bool = False


Cost = Callable[[Pair, Float], Block]


def adjusted(pairs: Sequence[Pair], cost: Cost, pose: Float) -> Float:
    """Return the pose (4, 4) of the least sum of squares next to a given one."""

    def at(pose: Float) -> tuple[Float, list[Block]]:
        return pose, [cost(pair, pose) for pair in pairs]

    def step(state: tuple[Float, list[Block]], damping: float) -> tuple[Float, tuple[Float, list[Block]]]:
        pose, blocks = state
        hessian = sum(block.by_update.T @ block.by_update for block in blocks)
        slope = sum(block.by_update.T @ block.residuals for block in blocks)
        update = np.asarray(-np.linalg.solve(hessian + damping * np.diag(np.diag(hessian) + 1e-12), slope))
        return update, at(se3.exp(update) @ pose)

    return descended(at(pose), lambda state: _sum(state[1]), step, iterations=50, least_step=1e-9)[0]


def _sum(blocks: Sequence[Block]) -> float:
    return float(sum(block.residuals @ block.residuals for block in blocks))


def covariance_of(pairs: Sequence[Pair], cost: Cost, pose: Float) -> Float | None:
    """Return the covariance (6, 6) of a left update (rad, m): noise by scatter, common errors; None if undetermined."""
    blocks = [cost(pair, pose) for pair in pairs]
    hessian = np.asarray(sum(block.by_update.T @ block.by_update for block in blocks))
    if not is_determined(hessian):
        return None
    inverse = np.linalg.inv(hessian)
    noises = [_noise(pair, block) for pair, block in zip(pairs, blocks, strict=True)]
    covariance = inverse @ sum(noises, np.zeros((6, 6))) @ inverse
    gradients = (block.by_update.T @ block.residuals for block in blocks)
    covariance = covariance * max(1.0, variance_factor(zip(gradients, noises, strict=True)))
    bias = inverse @ np.asarray(sum(block.by_update.T @ block.by_bias for block in blocks))
    px_per_rad = float(np.median([pair.board.px_per_rad for pair in pairs]))
    distance_m = float(np.median([np.linalg.norm(pair.board.camera_from_board[:3, 3]) for pair in pairs]))
    return np.asarray(covariance + shared_errors(bias, px_per_rad, distance_m))


def shared_errors(bias: Float, px_per_rad: float, distance_m: float) -> Float:
    """Return the covariance (6, 6) of a left update by range bias (6,) per m and by intrinsics, common to targets."""
    # An offset of the principal point rotates the camera; a scale error of that size moves targets in depth.
    camera_rad = CAMERA_PX / px_per_rad
    camera = np.diag([camera_rad, camera_rad, camera_rad, 0, 0, camera_rad * distance_m]) ** 2
    return np.asarray(camera + RANGE_BIAS_M**2 * np.outer(bias, bias))


def is_determined(hessian: Float) -> bool:
    """Return whether a Gauss-Newton matrix (6, 6) of rotation in rad and translation in m determines the pose."""
    scale = np.repeat([1.0, 3.0], 3)  # one radian corresponds to 3 m, the typical distance of a target
    return bool(np.isfinite(hessian).all() and np.linalg.cond(hessian * np.outer(scale, scale)) <= 1e8)


def _noise(pair: Pair, block: Block) -> Float:
    """Return how noise of sweep and image spreads the slope (6,) that a board has at a pose, (6, 6)."""
    if block.covariance.ndim == 1:
        noise = (block.by_update.T * block.covariance) @ block.by_update
    else:
        noise = block.by_update.T @ block.covariance @ block.by_update
    if not block.whole:
        own = block.by_update.T @ block.by_update
        noise = noise + own @ pair.board.covariance @ own
    return np.asarray(noise)


def variance_factor(gradients: Iterable[tuple[Float, Float]]) -> float:
    """Return the reduced chi-square of gradients (6,) with covariances (6, 6); 1 with few degrees of freedom."""
    total, freedom = 0.0, -6
    for gradient, noise in gradients:
        scale = 1 / np.sqrt(np.maximum(np.diag(noise), 1e-30))
        values, vectors = np.linalg.eigh(noise * np.outer(scale, scale))
        observable = values > 1e-6 * values[-1]
        along = vectors[:, observable].T @ (scale * gradient)
        total += float(np.sum(along**2 / values[observable]))
        freedom += int(observable.sum())
    return total / freedom if freedom >= _LEAST_FREEDOM else 1.0
