"""Motion at constant velocity: transforms, and points with individual times."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from p2o.arrays import Float
from p2o.errors import InputError
from p2o.geometry import se3


def pose_at(twist: Float, time_s: float) -> Float:
    """Return exp(twist * time) (4, 4) of a velocity (6,) in rad/s and m/s."""
    return se3.exp(np.asarray(twist, np.float64) * time_s)


def moved(twist: Float, time_s: Float, xyz: Float, *, directions: bool = False) -> Float:
    """Return points (N, 3) after exp(twist * time), each at its own time (N,) in s; `directions` are rotated only.

    Uses Rodrigues' formula and the left Jacobian with the common axis of all points.
    """
    twist = np.asarray(twist, np.float64)
    omega, velocity = twist[:3], twist[3:]
    t = np.asarray(time_s, np.float64)[:, None]
    speed = float(np.linalg.norm(omega))
    if speed == 0.0:
        return xyz.copy() if directions else np.asarray(xyz + t * velocity)
    cross = se3.skew(omega / speed)
    angle = speed * t
    sine, versine = np.sin(angle), 1 - np.cos(angle)
    out = xyz + sine * (xyz @ cross.T) + versine * (xyz @ (cross @ cross).T)
    if directions:
        return np.asarray(out)
    push, twice = cross @ velocity, cross @ cross @ velocity
    return np.asarray(out + t * velocity + versine / speed * push + (t - sine / speed) * twice)


def adjoint(transform: Float, twist: Float) -> Float:
    """Return the velocity (6,) in frame b of one in frame a, for b_from_a (4, 4); rotation components first."""
    rotation, translation = transform[:3, :3], transform[:3, 3]
    omega = rotation @ twist[:3]
    return np.concatenate([omega, rotation @ twist[3:] + np.cross(translation, omega)])


def adjoint_matrix(transform: Float) -> Float:
    """Return the adjoint (6, 6) of b_from_a (4, 4): it maps velocities and left updates in frame a to those in frame b.

    exp(Ad d) @ b_from_a = b_from_a @ exp(d) (Barfoot, State Estimation for Robotics, 2017, section 7.1).
    """
    return np.stack([adjoint(transform, axis) for axis in np.eye(6)], axis=1)


@dataclass(frozen=True)
class EgoMotion:
    """Motion of the LiDAR during one sweep: `speed_m_s` along `forward`, and `turn_rad_s` about its own z axis.

    `forward` is a direction of any length in the LiDAR frame. Raises InputError for a zero vector and for values that
    are not finite.
    """

    speed_m_s: float = 0.0
    turn_rad_s: float = 0.0
    forward: tuple[float, float, float] = (1.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        values = (self.speed_m_s, self.turn_rad_s, *self.forward)
        if not np.isfinite(values).all() or not any(self.forward):
            expected = "finite numbers, and a direction of travel that is not zero"
            got = f"{self.speed_m_s:g} m/s along {self.forward}, turning {self.turn_rad_s:g} rad/s"
            raise InputError("the ego-motion is not valid", expected=expected, got=got)

    @property
    def twist(self) -> Float:
        """The velocity (6,) in rad/s and m/s, LiDAR frame, as for `Cloud.untwisted`."""
        return self.by_speed * self.speed_m_s + self.by_turn * self.turn_rad_s

    @property
    def by_speed(self) -> Float:
        """The twist (6,) of 1 m/s forward."""
        forward = np.asarray(self.forward, np.float64)
        return np.concatenate([np.zeros(3), forward / np.linalg.norm(forward)])

    @property
    def by_turn(self) -> Float:
        """The twist (6,) of turning by 1 rad/s to the left."""
        return np.array([0.0, 0.0, 1.0, 0.0, 0.0, 0.0])


_COMMON = 0.3
"""Share of the variance of the speed that is common to all sweeps of a joint calibration."""


@dataclass(frozen=True)
class MotionPrior:
    """Prior of the motion: `expected`, with standard deviations in m/s and rad/s."""

    expected: EgoMotion
    speed_sigma: float
    turn_sigma: float

    def __post_init__(self) -> None:
        if not (self.speed_sigma > 0 and self.turn_sigma > 0):
            text = "standard deviations of the motion prior are not positive"
            raise InputError(text, expected="> 0", got=f"{self.speed_sigma:g} m/s, {self.turn_sigma:g} rad/s")

    @property
    def covariance(self) -> Float:
        """The covariance (2, 2) of speed in m/s and turning in rad/s."""
        return np.diag([self.speed_sigma**2, self.turn_sigma**2])

    @property
    def common_variance(self) -> float:
        """The part of the variance of the speed that is common to all sweeps of a joint calibration."""
        return _COMMON * self.speed_sigma**2

    @property
    def own_variance(self) -> Float:
        """The variances (2,) of speed and turning of each sweep without the common part."""
        return np.diag(self.covariance) - [self.common_variance, 0.0]

    def covariance_of(self, sweeps: int) -> Float:
        """Return the covariance (2 N, 2 N) of speed and turning of N sweeps, sweep by sweep.

        Sweeps that are calibrated jointly are often of one drive at one speed: a share `_COMMON` of the variance of the
        speed is common to all of them, and does not average out.
        """
        common = np.diag([self.common_variance, 0.0])
        return np.kron(np.eye(sweeps), np.diag(self.own_variance)) + np.kron(np.ones((sweeps, sweeps)), common)
