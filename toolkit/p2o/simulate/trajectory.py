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


@dataclass(frozen=True)
class Swing:
    """How a car leaves the straight line of its road: slalom turns, and the slopes of uneven ground.

    It swings by `turn_deg` to either side, SWING_M off the middle of its way at most; `tilt_deg` is the most that it
    pitches and rolls.
    """

    turn_deg: float = 0.0
    tilt_deg: float = 0.0

    def __bool__(self) -> bool:
        return self.turn_deg != 0.0 or self.tilt_deg != 0.0


SWING_M = 1.2
"""How far to either side a swinging car goes."""
_PITCH_M, _ROLL_M = 13.0, 8.5
# Lengths of the waves of the ground that pitch and roll the car: not multiples, so that both come in all pairs.
_INSTANT_S = 1e-3


def drive(
    twist: Float,
    frames: int,
    rng: np.random.Generator,
    *,
    period_s: float = 0.1,
    height_m: float = LIDAR_HEIGHT_M,
    sway: float = 1.0,
    swing: Swing | None = None,
) -> tuple[Moment, ...]:
    """Return the moments of a drive of `frames` frames at constant velocity `twist` (6,) of the car from the origin.

    The LiDAR rides `height_m` above the road. At each frame the car sits a little differently on its springs (pitch and
    yaw 0.3, roll 0.2 degrees, 2 cm up and down and 5 cm to the side, one sigma, times `sway`), and stays so while the
    sweep is taken. A `swing` makes it turn and tilt on its way; `twist` is then the velocity of its road.
    """
    shake = sway * rng.normal(size=(frames, 6)) * np.array([0.0035, 0.005, 0.005, 0.0, 0.05, 0.02])
    phases = rng.uniform(0.0, 2 * np.pi, 3)
    moments = []
    for number in range(frames):
        car_from_lidar = se3.exp(shake[number]) @ se3.make(translation=(0.0, 0.0, height_m))
        world_from_car, car_twist = pose_at(twist, number * period_s), twist
        if swing:
            at = number * period_s
            before, world_from_car, after = (
                _swung(twist, swing, phases, when) for when in (at - _INSTANT_S, at, at + _INSTANT_S)
            )
            car_twist = se3.log(se3.inverse(before) @ after) / (2 * _INSTANT_S)
        own = adjoint(se3.inverse(car_from_lidar), car_twist)
        moments.append(Moment(number * period_s, world_from_car @ car_from_lidar, own))
    return tuple(moments)


def _swung(twist: Float, swing: Swing, phases: Float, time_s: float) -> Float:
    """Return world_from_car (4, 4) on a sine about the road, whose steepest slope is the largest turn."""
    way = float(twist[3]) * time_s
    slope = np.tan(np.radians(swing.turn_deg))
    wave = slope / SWING_M
    aside = SWING_M * np.sin(wave * way + phases[0]) if slope else 0.0
    yaw = np.arctan(slope * np.cos(wave * way + phases[0]))
    tilt = np.radians(swing.tilt_deg)
    pitch, roll = (
        tilt * np.sin(2 * np.pi * way / length + phase)
        for length, phase in zip((_PITCH_M, _ROLL_M), phases[1:], strict=True)
    )
    out = pose_at(twist, time_s) @ se3.make(translation=(0.0, aside, 0.0))
    for axis, angle in ((2, yaw), (1, pitch), (0, roll)):
        out = out @ se3.exp(angle * np.eye(6)[axis])
    return out
