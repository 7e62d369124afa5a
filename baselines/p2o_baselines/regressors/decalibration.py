"""Wrong starts to learn from: T_start = T_e T_true, with the error T_e in the camera's frame, and what undoes it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from p2o import se3
from p2o.arrays import Float

Reach = tuple[float, float]
"""How wrong a start may be: degrees about each axis, metres along each."""

LCCNET: tuple[Reach, ...] = ((20.0, 1.5), (10.0, 1.0), (5.0, 0.5), (2.0, 0.2), (1.0, 0.1))
"""The five stages of LCCNet, and of RegNet before it, from the widest."""
CALIBNET: tuple[Reach, ...] = ((10.0, 0.25), (5.0, 0.2), (2.0, 0.1))
"""Starts of CalibNet and what follows it, and two nearer ranges for its iterations."""


def error(reach: Reach, rng: np.random.Generator) -> Float:
    """Return an error T_e (4, 4): Euler angles about fixed x, y, z and a shift, each uniform within the reach."""
    from scipy.spatial.transform import Rotation

    turn, shift = rng.uniform(-1, 1, size=(2, 3))
    return se3.make(Rotation.from_euler("xyz", turn * reach[0], degrees=True).as_matrix(), shift * reach[1])


def start(camera_from_lidar: Float, wrong: Float) -> Float:
    """Return the start (4, 4) that an error (4, 4) makes of the truth (4, 4)."""
    return np.asarray(wrong @ camera_from_lidar)


def corrected(camera_from_lidar: Float, correction: Float) -> Float:
    """Return a start (4, 4) after a correction (4, 4); that by the inverse of its error is the truth."""
    return np.asarray(correction @ camera_from_lidar)


def from_stage(stages: Sequence[Reach], first: int) -> list[Reach]:
    """Return the stages from the first one on that is to be used, counted from 1; the last one at least."""
    return list(stages[min(first, len(stages)) - 1 :])
