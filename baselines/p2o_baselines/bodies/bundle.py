"""One pose with what is unknown of each body beside it: least squares, and how sure the pose is."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Protocol

import numpy as np
from p2o import se3
from p2o.arrays import Float

_STEPS, _STEP = 40, 1e-6
_LEAST_FREEDOM = 3
"""From so many degrees of freedom on the scatter of bodies widens the likely error; fewer say little."""


class Body(Protocol):
    """What one body says: `count` unknowns of its own, and residuals in deviations at a pose.

    `distance_m` from the camera and `px_per_rad` are for errors of the camera that all bodies share.
    """

    @property
    def count(self) -> int: ...
    @property
    def distance_m(self) -> float: ...
    @property
    def px_per_rad(self) -> float: ...
    def residuals(self, camera_from_lidar: Float, own: Float, bias_m: float) -> Float:
        """Return residuals (K,), with own unknowns (count,), as if all ranges were too long by `bias_m`."""
        ...


@dataclass(frozen=True)
class Fit:
    """The pose (4, 4) of the least sum of squares, the unknowns of each body, the covariance (6, 6) of a left update.

    `covariance` (rad, m) is None where the bodies leave the pose open.
    """

    camera_from_lidar: Float
    own: tuple[Float, ...]
    covariance: Float | None


@dataclass(frozen=True)
class _Part:
    """What is left of one body when its own unknowns are solved for, `slope` (6,) and `hessian` (6, 6) of the pose.

    `bias` (6,) is the slope by an error in m that all ranges share, `back` and `rest` give the unknowns' own step.
    """

    slope: Float
    hessian: Float
    bias: Float
    back: Float
    rest: Float


def adjusted(
    bodies: Sequence[Body], pose: Float, own: Sequence[Float], *, range_bias_m: float, camera_px: float
) -> Fit:
    """Return the fit next to a pose (4, 4) and unknowns: Levenberg and Marquardt, each body's unknowns eliminated."""
    places, damping = [np.array(each, np.float64) for each in own], 1e-6
    least = _cost(bodies, pose, places)
    for _ in range(_STEPS):
        parts = [_part(body, pose, place, damping) for body, place in zip(bodies, places, strict=True)]
        hessian = np.asarray(sum(part.hessian for part in parts))
        slope = np.asarray(sum(part.slope for part in parts))
        step = -np.linalg.lstsq(hessian + damping * np.diag(np.diag(hessian) + 1e-12), slope, rcond=None)[0]
        trial = se3.exp(step) @ pose
        tried = [place + part.rest - part.back @ step for place, part in zip(places, parts, strict=True)]
        total = _cost(bodies, trial, tried)
        if total <= least * (1 + 1e-12):
            done = np.abs(step).max() < 1e-8 or least - total <= 1e-9 * least
            pose, places, least, damping = trial, tried, total, max(damping / 10, 1e-12)
            if done:
                break
        else:
            damping *= 10
            if damping > 1e8:
                break
    covariance = _covariance(bodies, pose, places, range_bias_m, camera_px)
    return Fit(pose, tuple(places), covariance)


def _cost(bodies: Sequence[Body], pose: Float, own: Sequence[Float]) -> float:
    residuals = (body.residuals(pose, place, 0.0) for body, place in zip(bodies, own, strict=True))
    return float(sum(each @ each for each in residuals))


def _part(body: Body, pose: Float, own: Float, damping: float = 0.0) -> _Part:
    at = body.residuals(pose, own, 0.0)
    plus, minus = _nudges()
    by_pose = np.stack(
        [
            (body.residuals(up @ pose, own, 0.0) - body.residuals(down @ pose, own, 0.0)) / (2 * _STEP)
            for up, down in zip(plus, minus, strict=True)
        ],
        axis=1,
    )
    by_bias = (body.residuals(pose, own, _STEP) - body.residuals(pose, own, -_STEP)) / (2 * _STEP)
    if not body.count:
        return _Part(by_pose.T @ at, by_pose.T @ by_pose, by_pose.T @ by_bias, np.zeros((0, 6)), np.zeros(0))
    by_own = np.stack(
        [
            (body.residuals(pose, own + step, 0.0) - body.residuals(pose, own - step, 0.0)) / (2 * _STEP)
            for step in _STEP * np.eye(body.count)
        ],
        axis=1,
    )
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
    return np.array([se3.exp(step) for step in _STEP * np.eye(6)]), np.array(
        [se3.exp(-step) for step in _STEP * np.eye(6)]
    )


def _covariance(
    bodies: Sequence[Body], pose: Float, own: Sequence[Float], range_bias_m: float, camera_px: float
) -> Float | None:
    """Return noise, more of it where bodies disagree by more, and errors of ranges and camera that all share."""
    parts = [_part(body, pose, place) for body, place in zip(bodies, own, strict=True)]
    hessian = np.asarray(sum(part.hessian for part in parts))
    scale = np.repeat([1.0, 3.0], 3)  # a metre is as much as a third of a radian: bodies are some 3 m away
    if not np.isfinite(hessian).all() or np.linalg.cond(hessian * np.outer(scale, scale)) > 1e8:
        return None
    inverse = np.linalg.inv(hessian)
    covariance = inverse * max(1.0, _scatter(parts))
    bias = inverse @ np.asarray(sum(part.bias for part in parts))
    turn = camera_px / float(np.median([body.px_per_rad for body in bodies]))
    distance = float(np.median([body.distance_m for body in bodies]))
    # A shifted picture turns the camera; a wrong scale of the same size at its border moves bodies in depth.
    shared = np.diag([turn, turn, turn, 0, 0, turn * distance]) ** 2 + range_bias_m**2 * np.outer(bias, bias)
    return np.asarray(covariance + shared)


def _scatter(parts: Sequence[_Part]) -> float:
    """Return how much more bodies disagree with a pose than their noise says, as a factor of variances."""
    total, freedom = 0.0, -6
    for part in parts:
        size = 1 / np.sqrt(np.maximum(np.diag(part.hessian), 1e-30))
        values, vectors = np.linalg.eigh(part.hessian * np.outer(size, size))
        told = values > 1e-6 * values[-1]
        along = vectors[:, told].T @ (size * part.slope)
        total += float(np.sum(along**2 / values[told]))
        freedom += int(told.sum())
    return total / freedom if freedom >= _LEAST_FREEDOM else 1.0
