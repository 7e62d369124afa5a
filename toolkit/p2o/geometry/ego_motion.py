"""How the car moves while its LiDAR turns, where nothing but the edges tells it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from p2o.arrays import Float
from p2o.errors import InputError


@dataclass(frozen=True)
class EgoMotion:
    """Motion of the LiDAR during one sweep: `speed_m_s` along `forward`, and `turn_rad_s` about its own z axis.

    `forward` is a direction of any length in the LiDAR frame. Raises InputError for one of no length, and for values
    that are not finite.
    """

    speed_m_s: float = 0.0
    turn_rad_s: float = 0.0
    forward: tuple[float, float, float] = (1.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        values = (self.speed_m_s, self.turn_rad_s, *self.forward)
        if not np.isfinite(values).all() or not any(self.forward):
            raise InputError(
                "the motion of the car is not one",
                expected="finite numbers, and a direction of travel that is not zero",
                got=f"{self.speed_m_s:g} m/s along {self.forward}, turning {self.turn_rad_s:g} rad/s",
            )

    @property
    def twist(self) -> Float:
        """The velocity (6,) in rad/s and m/s, LiDAR frame, as `Cloud.untwisted` takes it."""
        return self.by_speed * self.speed_m_s + self.by_turn * self.turn_rad_s

    @property
    def by_speed(self) -> Float:
        """The twist (6,) of 1 m/s forward."""
        way = np.asarray(self.forward, np.float64)
        return np.concatenate([np.zeros(3), way / np.linalg.norm(way)])

    @property
    def by_turn(self) -> Float:
        """The twist (6,) of turning by 1 rad/s to the left."""
        return np.array([0.0, 0.0, 1.0, 0.0, 0.0, 0.0])


@dataclass(frozen=True)
class MotionPrior:
    """What is known of the motion before the edges are asked: `expected`, with its standard deviations."""

    expected: EgoMotion
    speed_sigma: float
    turn_sigma: float

    def __post_init__(self) -> None:
        if not (self.speed_sigma > 0 and self.turn_sigma > 0):
            raise InputError(
                "deviations of the expected motion are not positive",
                expected="> 0",
                got=f"{self.speed_sigma:g} m/s, {self.turn_sigma:g} rad/s",
            )

    @property
    def covariance(self) -> Float:
        """The covariance (2, 2) of speed in m/s and turning in rad/s."""
        return np.diag([self.speed_sigma**2, self.turn_sigma**2])
