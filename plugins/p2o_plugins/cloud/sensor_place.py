"""Estimate the position of the sensor in the frame of a cloud from its rings: each is a cone with its apex there.

Drivers publish points in the sensor's own frame. Other sources publish them in the frame of the car (`base_link`),
where beams start one or two metres from the origin, or in the axes of a camera. Azimuth, elevation and range about the
origin are meaningless in such a frame, and so are the edges derived from them.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from p2o import Cloud, Float, Int, se3

from p2o_plugins.cloud.sweep import Sweep

_MOST_POINTS = 3000
_STEPS = 30
# No estimate is made if the scatter of the rings about cones with an apex near the origin is below this.
_USUAL_SCATTER = np.radians(0.1)
# An estimate is accepted if the scatter of the rings about its cones is at most this; smaller offsets are those of the
# sensor's own lasers.
_MOST_SCATTER, _MOST_SHARE = np.radians(0.35), 0.4
_LEAST_AWAY_M, _FARTHEST_M, _LEAST_TILT = 0.5, 10.0, np.radians(5)
# Maximum standard error of the position; errors of returns on one surface are correlated, equivalent to a tenth of
# their number.
_MOST_SIGMA_M, _INDEPENDENT = 0.1, 0.1
_FEWEST_POINTS, _FINEST = 200, np.radians(0.02)
# An axis within this angle of the cloud's own z axis is treated as parallel to it.
_UPRIGHT = np.cos(np.radians(60))


def sensor_place(sweep: Sweep) -> Float | None:
    """Return cloud_from_sensor (4, 4) if the beams of a sweep clearly do not start at the origin, or None.

    The frame assumes that beams start at the origin and rotate about the z axis. The rotation about the sensor's axis
    is unobservable and kept small. Least squares of the elevations of thinned points (Cauchy weights), each ring about
    its own mean, over the position (3) and the axis (2); from the three axes of the cloud as initial guesses.
    """
    if len(sweep) < _FEWEST_POINTS or sweep.ring[0] == sweep.ring[-1]:
        return None
    every = -(-len(sweep) // _MOST_POINTS)
    xyz, ring = sweep.cloud.select(sweep.point[::every]).as_measured(), sweep.ring[::every]
    flat = np.hypot(xyz[:, 0], xyz[:, 1])
    off = (xyz[:, 2] - sweep.slope[ring] * flat - sweep.offset[ring]) / np.maximum(np.linalg.norm(xyz, axis=1), 1e-6)
    if _scatter(off) < _USUAL_SCATTER:
        return None
    least = min(_MOST_SCATTER, _MOST_SHARE * _Cones.of(np.eye(4), xyz, ring).scatter)
    for start in _starts(xyz, ring):
        fit = _fitted(start, xyz, ring)
        if fit is None or fit.sigma_m > _MOST_SIGMA_M or fit.away_m > _FARTHEST_M:
            continue
        if fit.cones.scatter < least:
            break
        if start is _AXES[0] and fit.away_m < _LEAST_AWAY_M:
            # The sensor is at the origin: something other than its position bends the rings, such as motion.
            return None
    else:
        return None
    cloud_from_sensor = se3.inverse(_upright(fit))
    tilt = np.arccos(np.clip(cloud_from_sensor[2, 2], -1, 1))
    if np.linalg.norm(cloud_from_sensor[:3, 3]) < _LEAST_AWAY_M and tilt < _LEAST_TILT:
        return None
    return np.asarray(cloud_from_sensor)


def in_sensor_frame(cloud: Cloud, cloud_from_sensor: Float) -> Cloud:
    """Return the cloud in the frame of its sensor, with the twist transformed to that of the sensor."""
    sensor_from_cloud = se3.inverse(cloud_from_sensor)
    twist = cloud.twist
    if twist is not None:
        # X^-1 exp(twist t) X: the angular velocity is rotated, the velocity is that of the sensor's position.
        turning, place = twist[:3], cloud_from_sensor[:3, 3]
        velocity = twist[3:] + np.cross(turning, place)
        twist = (np.concatenate([turning, velocity]).reshape(2, 3) @ cloud_from_sensor[:3, :3]).ravel()
    return replace(cloud, xyz=se3.apply(sensor_from_cloud, cloud.xyz), twist=twist)


@dataclass(frozen=True, eq=False)
class _Cones:
    """Points (N, 3) as seen from a position: `off` (N,) rad are their elevations about the mean of their ring."""

    xyz: Float
    elevation: Float
    off: Float
    weight: Float
    scatter: float

    @classmethod
    def of(cls, sensor_from_cloud: Float, xyz: Float, ring: Int, weight: Float | None = None) -> _Cones:
        """Return the elevations as seen from a position; `weight` (N,) applies to the ring means, equal if omitted."""
        seen = se3.apply(sensor_from_cloud, xyz)
        flat = np.maximum(np.hypot(seen[:, 0], seen[:, 1]), 1e-6)
        elevation = np.arctan2(seen[:, 2], flat)
        weight = np.ones(len(xyz)) if weight is None else weight
        off = _about_mean(elevation, ring, weight)
        scatter = _scatter(off)
        # Cauchy weights with twice the scatter as scale.
        weight = 1 / (1 + np.square(off / (2 * scatter + 1e-6)))
        return cls(seen, elevation, off, weight, scatter)


def _scatter(off: Float) -> float:
    """Return the robust standard deviation of values about zero, from the median of their magnitudes."""
    return 1.4826 * float(np.median(np.abs(off)))


def _about_mean(values: Float, ring: Int, weight: Float) -> Float:
    """Return values (N,) minus the weighted mean of their ring."""
    count = int(ring.max()) + 1
    total, of_weights = (np.bincount(ring, w, minlength=count) for w in (weight * values, weight))
    return np.asarray(values - (total / np.maximum(of_weights, 1e-12))[ring])


_AXES = tuple(se3.make(np.roll(np.eye(3), 2 - axis, axis=0)) for axis in (2, 1, 0))
"""Transforms (4, 4) that map the axes z, y, x of the cloud to the sensor's z axis."""
_GRID_M = np.stack(np.meshgrid([0, -2, -1, 1, 2], [0, -1, 1], [0, 1, 2, 3, -1, -2], indexing="ij"), -1).reshape(-1, 3)
_PROMISING = 3


def _starts(xyz: Float, ring: Int) -> Iterator[Float]:
    """Yield initial poses sensor_from_cloud (4, 4) of the fit: the origin, then positions around it, by axis."""
    yield from _AXES
    places = [axis @ se3.make(None, -place) for axis in _AXES for place in _GRID_M]
    scatter = [_Cones.of(place, xyz[::4], ring[::4]).scatter for place in places]
    yield from (places[number] for number in np.argsort(scatter, kind="stable")[:_PROMISING])


@dataclass(frozen=True, eq=False)
class _Fit:
    """A position: `sensor_from_cloud` (4, 4), the elevations from it, and its standard error in metres."""

    sensor_from_cloud: Float
    cones: _Cones
    sigma_m: float

    @property
    def away_m(self) -> float:
        """Return the distance of the position from the origin of the cloud in metres."""
        return float(np.linalg.norm(self.sensor_from_cloud[:3, 3]))


def _fitted(start: Float, xyz: Float, ring: Int) -> _Fit | None:
    """Return the least-squares position from an initial pose sensor_from_cloud (4, 4); None if singular."""
    pose, weight = start, None
    information = np.eye(5)
    for _ in range(_STEPS):
        cones = _Cones.of(pose, xyz, ring, weight)
        weight, q = cones.weight, cones.xyz
        flat, square = np.maximum(np.hypot(q[:, 0], q[:, 1]), 1e-6), np.maximum(np.square(q).sum(axis=1), 1e-12)
        by_place = np.column_stack([-q[:, 0] * q[:, 2] / flat, -q[:, 1] * q[:, 2] / flat, flat]) / square[:, None]
        by_turn = np.cross(q, by_place)[:, :2]
        slopes = np.column_stack([_about_mean(column, ring, weight) for column in (*by_turn.T, *by_place.T)])
        information = slopes.T @ (weight[:, None] * slopes)
        right = slopes.T @ (weight * _about_mean(cones.elevation, ring, weight))
        try:
            step = -np.linalg.solve(information + 1e-9 * np.diag(np.diag(information)), right)
        except np.linalg.LinAlgError:
            return None
        # Limit steps to one metre and half a radian.
        step /= max(1.0, float(np.linalg.norm(step[2:])), 2 * float(np.linalg.norm(step[:2])))
        pose = se3.exp(np.array([step[0], step[1], 0.0, *step[2:]])) @ pose
        if np.abs(step).max() < 1e-3:
            break
    cones = _Cones.of(pose, xyz, ring, weight)
    try:
        covariance = max(cones.scatter, _FINEST) ** 2 * np.linalg.inv(information) / _INDEPENDENT
    except np.linalg.LinAlgError:
        return None
    return _Fit(pose, cones, float(np.sqrt(max(np.trace(covariance[2:, 2:]), 0.0))))


def _upright(fit: _Fit) -> Float:
    """Return the transform with its axis up: towards z, towards -y (axes of a camera), or away from most returns."""
    _, y, z = fit.sensor_from_cloud[2, :3]
    down = z < 0 if abs(z) > _UPRIGHT else y > 0 if abs(y) > _UPRIGHT else float(np.median(fit.cones.elevation)) > 0
    over = np.diag([1.0, -1.0, -1.0, 1.0])
    return np.asarray(over @ fit.sensor_from_cloud if down else fit.sensor_from_cloud)
