"""Joint least squares of one pose and the unknowns of each body, and the covariance of the pose."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Protocol

import numpy as np
from p2o import Float, se3

from p2o_baselines.boards.adjustment import is_determined, shared_errors, variance_factor
from p2o_baselines.damped import descended

_STEP = 1e-6
_State = tuple[Float, list[Float]]
"""A pose (4, 4), and the unknowns of each body."""


class Body(Protocol):
    """Residuals of one body in standard deviations at a pose, which may depend on unknowns of its own.

    `camera_scale` are its distance from the camera in m and the pixels per radian of the image there, which determine
    the effect of common errors of the camera.
    """

    @property
    def camera_scale(self) -> tuple[float, float]: ...
    def residuals(self, camera_from_lidar: Float, own: Float, bias_m: float) -> Float:
        """Return residuals (K,), with own unknowns (U,), as if all ranges were too long by `bias_m`."""
        ...


@dataclass(frozen=True)
class Fit:
    """The least-squares pose (4, 4), the unknowns of each body, and the covariance (6, 6) if determined."""

    camera_from_lidar: Float
    own: tuple[Float, ...]
    covariance: Float | None


@dataclass(frozen=True)
class _Part:
    """Slope, hessian and slope by range bias (m) of a pose without a body's own unknowns, and their own step."""

    slope: Float
    hessian: Float
    bias: Float
    back: Float
    rest: Float


def adjusted(bodies: Sequence[Body], pose: Float, own: Sequence[Float]) -> Fit:
    """Return the fit next to a pose (4, 4) and unknowns; each body's unknowns are eliminated from the steps."""

    def step(state: _State, damping: float) -> tuple[Float, _State]:
        pose, places = state
        parts = [_part(body, pose, place, damping) for body, place in zip(bodies, places, strict=True)]
        hessian = np.asarray(sum(part.hessian for part in parts))
        slope = np.asarray(sum(part.slope for part in parts))
        damped = hessian + damping * np.diag(np.diag(hessian) + 1e-12)
        update = -np.linalg.lstsq(damped, slope, rcond=None)[0]
        moved = [place + part.rest - part.back @ update for place, part in zip(places, parts, strict=True)]
        return update, (se3.exp(update) @ pose, moved)

    start = (pose, [np.array(each, np.float64) for each in own])
    limits = {"least_step": 1e-8, "least_gain": 1e-9}
    pose, places = descended(start, lambda state: _cost(bodies, *state), step, iterations=40, **limits)
    covariance = _covariance(bodies, pose, places)
    return Fit(pose, tuple(places), covariance)


def _cost(bodies: Sequence[Body], pose: Float, own: Sequence[Float]) -> float:
    residuals = (body.residuals(pose, place, 0.0) for body, place in zip(bodies, own, strict=True))
    return float(sum(each @ each for each in residuals))


def _part(body: Body, pose: Float, own: Float, damping: float = 0.0) -> _Part:
    at, (plus, minus) = body.residuals(pose, own, 0.0), _nudges()
    forward = [body.residuals(up @ pose, own, 0.0) for up in plus]
    backward = [body.residuals(down @ pose, own, 0.0) for down in minus]
    by_pose = (np.stack(forward, axis=1) - np.stack(backward, axis=1)) / (2 * _STEP)
    by_bias = (body.residuals(pose, own, _STEP) - body.residuals(pose, own, -_STEP)) / (2 * _STEP)
    steps = _STEP * np.eye(len(own))
    both = [(body.residuals(pose, own + step, 0.0), body.residuals(pose, own - step, 0.0)) for step in steps]
    by_own = np.stack([(ahead - behind) / (2 * _STEP) for ahead, behind in both], axis=1)
    inner = by_own.T @ by_own
    inverse = np.linalg.pinv(inner + damping * np.diag(np.diag(inner)))
    through = by_pose.T @ by_own @ inverse
    return _Part(
        by_pose.T @ at - through @ (by_own.T @ at),
        by_pose.T @ by_pose - through @ (by_own.T @ by_pose),
        by_pose.T @ by_bias - through @ (by_own.T @ by_bias),
        inverse @ (by_own.T @ by_pose),
        -inverse @ (by_own.T @ at),
    )


@lru_cache(maxsize=1)
def _nudges() -> tuple[Float, Float]:
    """Return small steps (6, 4, 4) along each direction of a pose, and back."""
    steps = _STEP * np.eye(6)
    return np.array([se3.exp(step) for step in steps]), np.array([se3.exp(-step) for step in steps])


def _covariance(bodies: Sequence[Body], pose: Float, own: Sequence[Float]) -> Float | None:
    """Return the covariance of noise, scaled by the scatter of bodies, and of common errors of ranges and camera."""
    parts = [_part(body, pose, place) for body, place in zip(bodies, own, strict=True)]
    hessian = np.asarray(sum(part.hessian for part in parts))
    if not is_determined(hessian):
        return None
    inverse = np.linalg.inv(hessian)
    covariance = inverse * max(1.0, variance_factor((part.slope, part.hessian) for part in parts))
    bias = inverse @ np.asarray(sum(part.bias for part in parts))
    distance_m, px_per_rad = np.median([body.camera_scale for body in bodies], axis=0).tolist()
    return np.asarray(covariance + shared_errors(bias, px_per_rad, distance_m))
