"""Value noise in space: texture that does not repeat, so that stereo matching finds its way on every surface."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from p2o.arrays import Float

_SIZE = 64
_LATTICE = np.random.default_rng(20260101).uniform(-1.0, 1.0, _SIZE**3).astype(np.float32)
# Cell sizes in metres and weights. No size is a multiple of another, so the lattice's period cannot be seen.
OCTAVES = ((2.9, 0.35), (1.1, 0.35), (0.37, 0.45), (0.13, 0.7), (0.047, 0.8), (0.017, 0.7))


def value_noise(xyz: Float, cell_m: float) -> NDArray[np.float32]:
    """Return smooth noise (N,) in [-1, 1] at points (N, 3) in metres, with one random value a cell."""
    place = xyz.T / cell_m
    base = np.floor(place)
    part = (place - base).astype(np.float32)
    part *= part * (3 - 2 * part)
    low = base.astype(np.int32) & (_SIZE - 1)
    high = (low + 1) & (_SIZE - 1)
    x, y, z = part
    corners = [low[0] * _SIZE**2, high[0] * _SIZE**2], [low[1] * _SIZE, high[1] * _SIZE], [low[2], high[2]]

    def between(pair: list[NDArray[np.float32]], share: NDArray[np.float32]) -> NDArray[np.float32]:
        a, b = pair
        b -= a
        b *= share
        b += a
        return b

    def line(y_row: Any, z_row: Any) -> NDArray[np.float32]:
        return between([_LATTICE.take(x_row + (y_row + z_row)) for x_row in corners[0]], x)

    return between([between([line(y_row, z_row) for y_row in corners[1]], y) for z_row in corners[2]], z)


def texture(xyz: Float, footprint_m: Float) -> Float:
    """Return noise (N,), about -1 to 1, of several sizes at points (N, 3); details below a pixel fade away.

    `footprint_m` (N,) is the size of a pixel on the surface; cells below twice that size would only alias.
    """
    total = np.zeros(len(xyz))
    for cell_m, weight in OCTAVES:
        seen = np.clip(cell_m / (2 * footprint_m) - 0.5, 0.0, 1.0)
        rows = np.flatnonzero(seen > 0)
        total[rows] += weight * seen[rows] * value_noise(xyz[rows], cell_m)
    return total
