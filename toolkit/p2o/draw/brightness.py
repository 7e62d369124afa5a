"""Dark pictures made legible for display: a gamma that is told, and nothing that any method sees."""

from __future__ import annotations

import math

import numpy as np

from p2o.arrays import UInt8

_DARK, _LEGIBLE = 0.22, 0.4
"""Mean grey below which a picture is brightened, and the one that its gamma aims at; of black 0 and white 1."""
_LEAST_GAMMA = 0.35
_GREY = np.array([0.299, 0.587, 0.114], np.float32)


def display_gamma(rgb: UInt8) -> float:
    """Return the gamma to show a picture (H, W, 3) with: 1 for one that is not dark, or that is black all over."""
    mean = float((rgb[::4, ::4].astype(np.float32) @ _GREY).mean()) / 255 if rgb.size else 0.0
    if not 0 < mean < _DARK:
        return 1.0
    return max(_LEAST_GAMMA, round(math.log(_LEGIBLE) / math.log(mean), 2))


def brightened(rgb: UInt8, gamma: float) -> UInt8:
    """Return the picture with each value v of 0 to 1 as v ** gamma."""
    if gamma == 1:
        return rgb
    table = np.rint(255 * (np.arange(256) / 255) ** gamma).astype(np.uint8)
    return np.asarray(table[rgb])
