"""A chart of the poses around a start, for solvers that want a vector of six unknowns instead of a pose."""

from __future__ import annotations

import numpy as np

from p2o.arrays import Float
from p2o.geometry import se3


def pose_at(start: Float, delta: Float) -> Float:
    """Return the poses (..., 4, 4) at delta (..., 6): `start` (4, 4) turned, then shifted, in the camera frame.

    delta holds a rotation vector in radians and a shift in metres; zero is the start itself.
    """
    delta = np.asarray(delta, dtype=np.float64)
    turn = delta.copy()
    turn[..., 3:] = 0.0
    pose = se3.exp(turn) @ start
    pose[..., :3, 3] += delta[..., 3:]
    return pose


def left_from_chart(delta: Float) -> Float:
    """Return the matrix (6, 6) that turns a small change of delta (6,) into the left update of the pose it makes.

    Derivatives by left updates (K, 6), times this matrix, are derivatives by delta.
    """
    # The translational part of the exponential is V times its argument, with V the left Jacobian of the rotation.
    unit = np.concatenate([np.tile(delta[:3], (3, 1)), np.eye(3)], axis=1)
    rotation = se3.exp(unit)[:, :3, 3].T
    out = np.eye(6)
    out[:3, :3] = rotation
    out[3:, :3] = se3.skew(delta[3:]) @ rotation
    return out
