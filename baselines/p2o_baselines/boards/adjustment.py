"""Least squares on what boards say, and how sure the pose is: noise, boards that scatter, errors that all share."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from p2o import se3
from p2o.arrays import Float

from p2o_baselines.boards.pairing import Pair

_STEPS, _DAMPING = 50, 1e-6
_LEAST_FREEDOM = 3
"""From so many degrees of freedom on the scatter of boards widens the likely error; fewer say little."""


class Block(NamedTuple):
    """What one board says at a pose: residuals (K,), and how these change.

    `by_update` (K, 6) is by a left update of camera_from_lidar (rad, m), `by_bias` (K,) by an error in m that all
    ranges share, `covariance` (K, K) what noise of the sweep alone makes of them; a pose of the board in the picture
    that is wrong acts as a wrong pose of the LiDAR does, but for this board alone. With `whole` the covariance holds
    the picture's noise already.
    """

    residuals: Float
    by_update: Float
    by_bias: Float
    covariance: Float
    whole: bool = False


Cost = Callable[[Pair, Float], Block]


@dataclass(frozen=True)
class Fit:
    """The pose (4, 4) of a least cost, the covariance (6, 6) of a left update of it (rad, m), and the cost's root."""

    camera_from_lidar: Float
    covariance: Float
    rms: float


def adjusted(pairs: Sequence[Pair], cost: Cost, pose: Float) -> Float:
    """Return the pose (4, 4) of the least sum of squares next to a given one: Levenberg and Marquardt."""
    damping = _DAMPING
    blocks = [cost(pair, pose) for pair in pairs]
    least = _sum(blocks)
    for _ in range(_STEPS):
        hessian = sum(block.by_update.T @ block.by_update for block in blocks)
        slope = sum(block.by_update.T @ block.residuals for block in blocks)
        step = -np.linalg.solve(hessian + damping * np.diag(np.diag(hessian) + 1e-12), slope)
        trial = se3.exp(step) @ pose
        tried = [cost(pair, trial) for pair in pairs]
        total = _sum(tried)
        if total <= least * (1 + 1e-12):
            done = np.abs(step).max() < 1e-9
            pose, blocks, least, damping = trial, tried, total, max(damping / 10, 1e-12)
            if done:
                break
        else:
            damping *= 10
            if damping > 1e8:
                break
    return pose


def _sum(blocks: Sequence[Block]) -> float:
    return float(sum(block.residuals @ block.residuals for block in blocks))


def information(pairs: Sequence[Pair], cost: Cost, pose: Float) -> Float:
    """Return the Gauss-Newton matrix (6, 6) of a cost."""
    blocks = [cost(pair, pose) for pair in pairs]
    return np.asarray(sum(block.by_update.T @ block.by_update for block in blocks))


def covariance_of(
    pairs: Sequence[Pair], cost: Cost, pose: Float, *, range_bias_m: float, camera_px: float
) -> Float | None:
    """Return the covariance (6, 6) of a left update of a pose (rad, m); None where boards leave it open.

    Its parts are the noise of sweeps and corners as every board has it by itself, more where boards disagree by
    more, and errors that all boards share: of ranges, and of the camera's calibration.
    """
    blocks = [cost(pair, pose) for pair in pairs]
    hessian = np.asarray(sum(block.by_update.T @ block.by_update for block in blocks))
    scale = np.repeat([1.0, 3.0], 3)  # a metre is as much as a third of a radian: boards are some 3 m away
    if np.linalg.cond(hessian * np.outer(scale, scale)) > 1e8:
        return None
    inverse = np.linalg.inv(hessian)
    noise = np.zeros((6, 6))
    for pair, block in zip(pairs, blocks, strict=True):
        noise += _noise(pair, block)
    covariance = inverse @ noise @ inverse
    covariance = covariance * max(1.0, _scatter(pairs, blocks))
    bias = inverse @ np.asarray(sum(block.by_update.T @ block.by_bias for block in blocks))
    shared = range_bias_m**2 * np.outer(bias, bias)
    turn = camera_px / float(np.median([pair.board.px_per_rad for pair in pairs]))
    distance = float(np.median([np.linalg.norm(pair.board.camera_from_board[:3, 3]) for pair in pairs]))
    # A shifted picture turns the camera; a wrong scale of the same size at its border moves boards in depth.
    shared += np.diag([turn, turn, turn, 0, 0, turn * distance]) ** 2
    return np.asarray(covariance + shared)


def _noise(pair: Pair, block: Block) -> Float:
    """Return how noise of sweep and picture spreads the slope (6,) that a board has at a pose, (6, 6)."""
    noise = block.by_update.T @ block.covariance @ block.by_update
    if not block.whole:
        own = block.by_update.T @ block.by_update
        noise = noise + own @ pair.board.covariance @ own
    return np.asarray(noise)


def _scatter(pairs: Sequence[Pair], blocks: Sequence[Block]) -> float:
    """Return how much more boards disagree with a pose than their noise says, as a factor of variances.

    What a board says of the pose is its slope there; noise of its sweep and of its pose in the picture spread that.
    """
    total, freedom = 0.0, -6
    for pair, block in zip(pairs, blocks, strict=True):
        slope = block.by_update.T @ block.residuals
        noise = _noise(pair, block)
        scale = 1 / np.sqrt(np.maximum(np.diag(noise), 1e-30))
        values, vectors = np.linalg.eigh(noise * np.outer(scale, scale))
        told = values > 1e-6 * values[-1]
        along = vectors[:, told].T @ (scale * slope)
        total += float(np.sum(along**2 / values[told]))
        freedom += int(told.sum())
    return total / freedom if freedom >= _LEAST_FREEDOM else 1.0
