"""Roll, pitch, yaw about the fixed axes x, y, z as in ROS and URDF: R = Rz(yaw) Ry(pitch) Rx(roll), in radians."""

from __future__ import annotations

import math

import numpy as np

from p2o.arrays import Float


def rpy_of(rotation: Float) -> tuple[float, float, float]:
    """Return roll, pitch, yaw of a rotation matrix (3, 3), accurate to rounding also at a pitch of 90 deg.

    In this gimbal lock roll and yaw have the same axis. Yaw is computed from the rotation that remains after roll and
    pitch, so that it is consistent with any roll.
    """
    r = np.asarray(rotation, dtype=np.float64)
    roll = math.atan2(r[2, 1], r[2, 2])
    pitch = math.atan2(-r[2, 0], math.hypot(r[2, 1], r[2, 2]))
    s, c = math.sin(roll), math.cos(roll)
    yaw = math.atan2(s * r[0, 2] - c * r[0, 1], c * r[1, 1] - s * r[1, 2])
    return roll, pitch, yaw


def rotation_of(roll: float, pitch: float, yaw: float) -> Float:
    """Return the rotation matrix (3, 3) of roll, pitch, yaw."""
    (sr, cr), (sp, cp), (sy, cy) = ((math.sin(angle), math.cos(angle)) for angle in (roll, pitch, yaw))
    return np.array(
        [
            [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
            [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
            [-sp, cp * sr, cp * cr],
        ]
    )
