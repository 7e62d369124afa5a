"""Velocity and pose of KITTI's vehicle from oxts packets (GPS and inertial unit)."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from p2o import Float, InputError, se3
from p2o.reading import read_text

_EARTH_RADIUS_M = 6378137.0
"""Radius of the raw development kit, so that poses agree with those of other software."""

_MAX_VALUES = np.array([89.0, 360.0, 1e5, *[10.0] * 3, *[1e3] * 5, *[1e4] * 6, *[1e3] * 6])
"""Latitude, longitude (deg), altitude (m), three angles (rad), five velocities, accelerations and rates (rad/s)."""


def read_packet(path: Path) -> Float:
    """Return the 30 numbers of one oxts file in the order of KITTI's dataformat.txt.

    Raises InputError if the file is missing, incomplete, or contains implausible positions or velocities.
    """
    words = read_text(path, "oxts packet").split()
    try:
        values = np.array(words, dtype=np.float64)
    except ValueError as problem:
        raise InputError("the oxts packet does not contain numbers", where=path, expected="30 numbers") from problem
    if values.size != 30 or not np.isfinite(values).all():
        fault = "the oxts packet is truncated or not finite"
        raise InputError(fault, where=path, expected="30 finite numbers", got=values.size)
    strange = np.flatnonzero(np.abs(values[: len(_MAX_VALUES)]) > _MAX_VALUES)
    if len(strange):
        fault = f"number {strange[0] + 1} of the oxts packet is implausible"
        got = f"{values[strange[0]]:g}"
        raise InputError(fault, where=path, expected=f"at most {_MAX_VALUES[strange[0]]:g}", got=got)
    return values


def twist_of(packet: Float, lidar_from_imu: Float) -> Float:
    """Return the velocity (6,) of the LiDAR in its own frame, in rad/s and m/s, from one packet.

    The inputs are roll, pitch, yaw, the velocities to the north, east and up, and the rates wf, wl, wu about the level
    axes forward, left, up. The file's velocity vl is not used: in drive 2011_09_26/0005 it is positive to the right.
    """
    roll, pitch, yaw, north, east = packet[3:8]
    # Yaw 0 is east, counter-clockwise.
    forward = np.cos(yaw) * east + np.sin(yaw) * north
    left = -np.sin(yaw) * east + np.cos(yaw) * north
    imu_from_level = _level_from_imu(roll, pitch)[:3, :3].T
    omega = lidar_from_imu[:3, :3] @ imu_from_level @ packet[20:23]
    velocity = lidar_from_imu[:3, :3] @ imu_from_level @ np.array([forward, left, packet[10]])
    # Adjoint: the lever arm from the unit to the LiDAR adds a velocity.
    return np.concatenate([omega, velocity + np.cross(lidar_from_imu[:3, 3], omega)])


def has_fix(packet: Float) -> bool:
    """Return whether a packet has a position: writers without one set latitude, longitude and altitude to 0."""
    return bool(packet[:3].any())


def lidar_pose(packet: Float, first: Float, lidar_from_imu: Float) -> Float:
    """Return the pose (4, 4) of the LiDAR at a packet in its frame at the packet `first`, in metres.

    As in the raw development kit, positions are a Mercator projection at the latitude of `first`, x east, y north,
    z up; rotations are Rz(yaw) Ry(pitch) Rx(roll).
    """
    ground_from_imu, ground_from_first = (_ground_from_imu(values, float(first[0])) for values in (packet, first))
    return lidar_from_imu @ se3.inverse(ground_from_first) @ ground_from_imu @ se3.inverse(lidar_from_imu)


def _ground_from_imu(packet: Float, scale_latitude_deg: float) -> Float:
    latitude_deg, longitude_deg, altitude_m, roll, pitch, yaw = packet[:6]
    scale_m = np.cos(np.radians(scale_latitude_deg)) * _EARTH_RADIUS_M
    east_m = scale_m * np.radians(longitude_deg)
    north_m = scale_m * np.log(np.tan(np.pi / 4 + np.radians(latitude_deg) / 2))
    turned = se3.exp(np.array([0, 0, yaw, 0, 0, 0.0])) @ _level_from_imu(roll, pitch)
    return se3.make(turned[:3, :3], [east_m, north_m, altitude_m])


def _level_from_imu(roll: float, pitch: float) -> Float:
    return se3.exp(np.array([0, pitch, 0, 0, 0, 0.0])) @ se3.exp(np.array([roll, 0, 0, 0, 0, 0.0]))
