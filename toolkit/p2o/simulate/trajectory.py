"""A drive: where the LiDAR is at each frame of a recording, and how it moves meanwhile."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from p2o.arrays import Float
from p2o.geometry import se3
from p2o.geometry.motion import adjoint, pose_at

LIDAR_HEIGHT_M = 1.73
"""Height of KITTI's Velodyne above the road."""


@dataclass(frozen=True, eq=False)
class Moment:
    """One frame of a drive: `time_s` since its start, `world_from_lidar` (4, 4) then, and the LiDAR's `twist` (6,).

    The twist is the velocity in the LiDAR's own frame, rad/s and m/s.
    """

    time_s: float
    world_from_lidar: Float
    twist: Float


def drive(
    twist: Float,
    frames: int,
    rng: np.random.Generator,
    *,
    period_s: float = 0.1,
    height_m: float = LIDAR_HEIGHT_M,
    sway: float = 1.0,
) -> tuple[Moment, ...]:
    """Return the moments of a drive of `frames` frames at constant velocity `twist` (6,) of the car from the origin.

    The LiDAR rides `height_m` above the road. At each frame the car sits a little differently on its springs (pitch and
    yaw 0.3, roll 0.2 degrees, 2 cm up and down and 5 cm to the side, one sigma, times `sway`), and stays so while the
    sweep is taken.
    """
    shake = sway * rng.normal(size=(frames, 6)) * np.array([0.0035, 0.005, 0.005, 0.0, 0.05, 0.02])
    moments = []
    for number in range(frames):
        car_from_lidar = se3.exp(shake[number]) @ se3.make(translation=(0.0, 0.0, height_m))
        world_from_car = pose_at(twist, number * period_s)
        own = adjoint(se3.inverse(car_from_lidar), twist)
        moments.append(Moment(number * period_s, world_from_car @ car_from_lidar, own))
    return tuple(moments)
