"""Initial errors for training: T_start = T_e T_true, with the error T_e in the camera frame, and their corrections."""

from __future__ import annotations

import numpy as np
from p2o import Float, se3

Reach = tuple[float, float]
"""Bounds of an initial error: degrees about each axis, metres along each."""

LCCNET: tuple[Reach, ...] = ((20.0, 1.5), (10.0, 1.0), (5.0, 0.5), (2.0, 0.2), (1.0, 0.1))
"""The five stages of LCCNet, and of RegNet before it, from the widest."""
CALIBNET: tuple[Reach, ...] = ((10.0, 0.25), (5.0, 0.2), (2.0, 0.1))
"""Range of CalibNet and its successors, and two smaller ranges for its iterations."""


def error(reach: Reach, rng: np.random.Generator) -> Float:
    """Return an error T_e (4, 4): Euler angles about fixed x, y, z and a shift, each uniform within the reach."""
    from scipy.spatial.transform import Rotation

    turn, shift = rng.uniform(-1, 1, size=(2, 3))
    return se3.make(Rotation.from_euler("xyz", turn * reach[0], degrees=True).as_matrix(), shift * reach[1])


def corrected(camera_from_lidar: Float, correction: Float) -> Float:
    """Return an initial extrinsic (4, 4) after a correction (4, 4); the inverse of its error gives the true one."""
    return np.asarray(correction @ camera_from_lidar)
