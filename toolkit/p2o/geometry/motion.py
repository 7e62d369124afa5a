"""Motion at constant velocity: transforms and points at a time of their own each."""

from __future__ import annotations

import numpy as np

from p2o.arrays import Float
from p2o.geometry import se3


def pose_at(twist: Float, time_s: float) -> Float:
    """Return exp(twist * time) (4, 4) of a velocity (6,) in rad/s and m/s."""
    return se3.exp(np.asarray(twist, np.float64) * time_s)


def moved(twist: Float, time_s: Float, xyz: Float, *, directions: bool = False) -> Float:
    """Return points (N, 3) after exp(twist * time), each at its own time (N,) in seconds; `directions` only turn.

    Rodrigues' formula and the left Jacobian, written out because all share one axis.
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
    """Return the velocity (6,) in frame b of one given in frame a, for b_from_a (4, 4) and rotation parts first."""
    rotation, translation = transform[:3, :3], transform[:3, 3]
    omega = rotation @ twist[:3]
    return np.concatenate([omega, rotation @ twist[3:] + np.cross(translation, omega)])
