"""The motion of KITTI's car from one oxts packet (GPS and inertial unit)."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from p2o import InputError, se3
from p2o.arrays import Float

from p2o_plugins.data.input_file import read_text


def read_twist(path: Path, lidar_from_imu: Float) -> Float:
    """Return the velocity (6,) of the LiDAR in its own frame, rad/s then m/s, from one oxts file.

    Taken are roll, pitch, yaw, the velocities to the north, east and up, and the rates wf, wl, wu about the level
    axes forward, left, up. (The file's own vl is not used: in drive 2011_09_26/0005 it is positive to the right.)

    Raises InputError if the file is missing or does not hold the 30 numbers of a packet.
    """
    text = read_text(path, "oxts packet")
    try:
        values = np.array(text.split(), dtype=np.float64)
    except ValueError as problem:
        raise InputError("the oxts packet does not hold numbers", where=path, expected="30 numbers") from problem
    if values.size < 25 or not np.isfinite(values[:25]).all():
        raise InputError(
            "the oxts packet is truncated or not finite", where=path, expected="30 numbers", got=values.size
        )
    roll, pitch, yaw, north, east = values[3:8]
    level_from_imu = se3.exp(np.array([0, pitch, 0, 0, 0, 0.0])) @ se3.exp(np.array([roll, 0, 0, 0, 0, 0.0]))
    # Yaw 0 is east, counter-clockwise.
    forward = np.cos(yaw) * east + np.sin(yaw) * north
    left = -np.sin(yaw) * east + np.cos(yaw) * north
    imu_from_level = level_from_imu[:3, :3].T
    omega = lidar_from_imu[:3, :3] @ imu_from_level @ values[20:23]
    velocity = lidar_from_imu[:3, :3] @ imu_from_level @ np.array([forward, left, values[10]])
    # Adjoint: the LiDAR stands away from the unit and is swung around it.
    return np.concatenate([omega, velocity + np.cross(lidar_from_imu[:3, 3], omega)])
