"""Filling a sparse depth map so that it changes where a picture does: weighted total variation, many maps at once."""

from __future__ import annotations

import numpy as np
from p2o.arrays import Bool, Float


def gradient(values: Float) -> tuple[Float, Float]:
    """Return forward differences of maps (..., H, W) down and across, 0 in the last row and column."""
    down, across = np.zeros_like(values), np.zeros_like(values)
    np.subtract(values[..., 1:, :], values[..., :-1, :], out=down[..., :-1, :])
    np.subtract(values[..., :, 1:], values[..., :, :-1], out=across[..., :, :-1])
    return down, across


def divergence(down: Float, across: Float) -> Float:
    """Return minus the adjoint of `gradient`."""
    out = down + across
    out[..., 1:, :] -= down[..., :-1, :]
    out[..., :, 1:] -= across[..., :, :-1]
    return out


def variation(values: Float, weight: Float) -> Float:
    """Return the weighted total variation (...) of maps (..., H, W): 0 for constant ones."""
    down, across = gradient(values)
    return np.asarray(np.sum(weight * np.hypot(down, across), axis=(-2, -1)))


def filled(depth: Float, known: Bool, weight: Float, strength: float, iterations: int) -> Float:
    """Return the maps psi (..., H, W) that lower 1/2 |psi - depth|^2 over `known` + strength TV_weight(psi).

    The primal-dual algorithm of Chambolle and Pock (2011) with step sizes 1 / sqrt(8), begun from the mean of what is
    known; unknown pixels take what their neighbours have, the more so the smoother the picture is.
    """
    step = 1.0 / np.sqrt(8.0)
    many = np.maximum(known.sum(axis=(-2, -1), keepdims=True), 1)
    mean = np.where(known, depth, 0.0).sum(axis=(-2, -1), keepdims=True) / many
    psi = np.where(known, depth, mean)
    ahead, down, across = psi.copy(), np.zeros_like(psi), np.zeros_like(psi)
    pull, most = np.where(known, step, 0.0), strength * weight
    given = pull * np.where(known, depth, 0.0)
    for _ in range(iterations):
        steps = gradient(ahead)
        down += step * steps[0]
        across += step * steps[1]
        shrink = np.maximum(np.hypot(down, across) / np.maximum(most, 1e-12), 1.0)
        down /= shrink
        across /= shrink
        before = psi
        psi = (psi + step * divergence(down, across) + given) / (1.0 + pull)
        ahead = 2 * psi - before
    return psi
