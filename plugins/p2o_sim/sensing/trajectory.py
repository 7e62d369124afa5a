"""Drives: poses and velocities of the LiDAR at the frames of a recording, and the odometry of a sensor."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from p2o import Float, se3
from p2o.reading import adjoint, pose_at

LIDAR_HEIGHT_M = 1.73
"""Height of KITTI's Velodyne above the road."""


@dataclass(frozen=True, eq=False)
class Moment:
    """One frame of a drive: `time_s` since its start, pose `world_from_lidar` (4, 4), and velocity `twist` (6,).

    The velocity is in the LiDAR's own frame, in rad/s and m/s.
    """

    time_s: float
    world_from_lidar: Float
    twist: Float


SWING_M = 1.2
"""Largest lateral offset in a slalom."""
_PITCH_M, _ROLL_M = 13.0, 8.5
# Wavelengths of the ground that pitch and roll the vehicle: not multiples, so that all combinations occur.
_INSTANT_S = 1e-3


def drive(
    twist: Float,
    frames: int,
    rng: np.random.Generator,
    *,
    period_s: float = 0.1,
    height_m: float = LIDAR_HEIGHT_M,
    sway: float = 1.0,
    swing_deg: float = 0.0,
    tilt_deg: float = 0.0,
) -> tuple[Moment, ...]:
    """Return the moments of a drive of `frames` frames at constant vehicle velocity `twist` (6,) from the origin.

    The LiDAR is `height_m` above the road. At each frame the vehicle has another pose on its suspension (pitch and yaw
    0.3, roll 0.2 degrees, 2 cm vertically and 5 cm laterally, standard deviations times `sway`), constant during the
    sweep. A slalom adds a yaw of at most `swing_deg` to either side at a lateral offset of at most SWING_M, and uneven
    ground pitch and roll of at most `tilt_deg`; `twist` is then the velocity along the road.
    """
    shake = sway * rng.normal(size=(frames, 6)) * np.array([0.0035, 0.005, 0.005, 0.0, 0.05, 0.02])
    phases = rng.uniform(0.0, 2 * np.pi, 3)
    moments = []
    for number in range(frames):
        car_from_lidar = se3.exp(shake[number]) @ se3.make(translation=(0.0, 0.0, height_m))
        at = number * period_s
        world_from_car, car_twist = pose_at(twist, at), twist
        if swing_deg or tilt_deg:
            times = (at - _INSTANT_S, at, at + _INSTANT_S)
            before, world_from_car, after = (_swung(twist, swing_deg, tilt_deg, phases, time_s) for time_s in times)
            car_twist = se3.log(se3.inverse(before) @ after) / (2 * _INSTANT_S)
        own = adjoint(se3.inverse(car_from_lidar), car_twist)
        moments.append(Moment(at, world_from_car @ car_from_lidar, own))
    return tuple(moments)


def _swung(twist: Float, swing_deg: float, tilt_deg: float, phases: Float, time_s: float) -> Float:
    """Return world_from_car (4, 4) on a sine about the road, whose steepest slope is the largest yaw."""
    distance = float(twist[3]) * time_s
    slope = np.tan(np.radians(swing_deg))
    wave = slope / SWING_M
    aside = SWING_M * np.sin(wave * distance + phases[0]) if slope else 0.0
    yaw = np.arctan(slope * np.cos(wave * distance + phases[0]))
    tilt = np.radians(tilt_deg)
    pitch, roll = (
        tilt * np.sin(2 * np.pi * distance / length + phase)
        for length, phase in zip((_PITCH_M, _ROLL_M), phases[1:], strict=True)
    )
    out = pose_at(twist, time_s) @ se3.make(translation=(0.0, aside, 0.0))
    for axis, angle in ((2, yaw), (1, pitch), (0, roll)):
        out = out @ se3.exp(angle * np.eye(6)[axis])
    return out


def odometry(
    world_from_sensor: Sequence[Float], rng: np.random.Generator, *, noise_deg: float = 0.0, noise_m: float = 0.0
) -> tuple[Float, ...]:
    """Return the poses (4, 4) of a sensor relative to its first one, with odometry noise.

    The poses do not depend on the mounting of the sensor. Each step between frames has an error of `noise_deg` and
    `noise_m` (standard deviation per component); errors accumulate as in real odometry.
    """
    out = [np.eye(4)]
    sigma = np.concatenate([np.full(3, np.radians(noise_deg)), np.full(3, noise_m)])
    for before, after in pairwise(world_from_sensor):
        step = se3.inverse(before) @ after
        out.append(out[-1] @ step @ se3.exp(sigma * rng.standard_normal(6)))
    return tuple(out)
