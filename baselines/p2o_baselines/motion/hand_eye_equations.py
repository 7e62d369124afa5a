"""Hand-eye calibration: solve A X = X B for the extrinsic X from the steps of both sensors.

A step maps points from the sensor's first frame to its second: A of the camera, B of the LiDAR, X is camera_from_lidar.
Rotation and translation part:

    R_A R = R R_B                     so that R maps the axis of B to the axis of A
    (R_A - I) t = R t_B - s t_A       with s = 1 if the camera's motion is metric, else one scale per step

Closed forms (`rotation_from`, `translation_from`) are followed by least squares over all six parameters with the
covariance of each step (`solved`). If the sensors move straight ahead, R t_B and t_A are parallel, so directions of
motion are also used as pairs of axes, with a weight that decreases with the rotation of the step; on flat ground only
the height is then unobservable. Unobservable directions show in the covariance (`HandEye.open_directions`).

After Tsai and Lenz 1989 and Horaud and Dornaika 1995; scales per step as in Ishikawa et al. 2018. Pure functions; all
constants are ours.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import p2o
from p2o import Bool, Float

_LEVER_M = 0.5  # prior standard deviation of the distance between the sensors
_LEAST_RAD, _LEAST_M = 1e-8, 1e-8
_FLOOR = np.repeat([1 / 1.0**2, 1 / 30.0**2], 3)  # prior information of unobservable directions (rad, m)
_CAUCHY = 2.4


@dataclass(frozen=True, eq=False)
class Steps:
    """Motions of both sensors over the same intervals.

    `camera` and `lidar` (N, 4, 4) map points from the sensor's first frame to its second. `covariance` (N, 6, 6) is
    that of the camera's step as a left update (rad, m); where `metric` (N,) is False the translation has length 1 and
    unknown scale, and its covariance is that of the direction. `lidar_rad` and `lidar_m` (N,) are the standard
    deviations of the LiDAR's steps per axis.
    """

    camera: Float
    lidar: Float
    metric: Bool
    covariance: Float
    lidar_rad: Float
    lidar_m: Float

    def __len__(self) -> int:
        return len(self.camera)

    @property
    def camera_turn(self) -> Float:
        """Rotation vectors (N, 3) of the camera's steps."""
        return p2o.se3.rotation_vector(self.camera[:, :3, :3])

    @property
    def lidar_turn(self) -> Float:
        """Rotation vectors (N, 3) of the LiDAR's steps."""
        return p2o.se3.rotation_vector(self.lidar[:, :3, :3])


@dataclass(frozen=True, eq=False)
class OpenDirection:
    """An unobservable position along `axis` (3,) of the LiDAR frame, or rotation about it; `sigma` in m or deg."""

    turn: bool
    axis: Float
    sigma: float

    def __str__(self) -> str:
        strongest = int(np.argmax(np.abs(self.axis)))
        near = f"{'xyz'[strongest]} of the LiDAR" if abs(self.axis[strongest]) > 0.94 else "this axis of the LiDAR"
        x, y, z = self.axis * np.sign(self.axis[strongest])
        where = f"{near} ({x:.2f}, {y:.2f}, {z:.2f})"
        if self.turn:
            return f"the rotation about {where}, known to {self.sigma:.1f} deg only"
        return f"the place of the camera along {where}, known to {self.sigma:.2f} m only"


@dataclass(frozen=True, eq=False)
class HandEye:
    """An extrinsic from motion.

    `covariance` (6, 6) is of a left update in the camera frame (rad, m), `weight` (N,) that of each step, 0 to 1, and
    `off_deg`, `off_m` the weighted root mean squares of the differences between both sides of the equations.
    """

    camera_from_lidar: Float
    covariance: Float
    weight: Float
    off_deg: float
    off_m: float

    def open_directions(self, *, over_deg: float, over_m: float) -> tuple[OpenDirection, ...]:
        """Return rotations, then positions (-R^T t, moved by the update's translation), of larger deviations."""
        rotation, directions = self.camera_from_lidar[:3, :3], []
        for turn, part, over in ((True, slice(0, 3), np.radians(over_deg)), (False, slice(3, 6), over_m)):
            values, axes = np.linalg.eigh(np.asarray(rotation.T @ self.covariance[part, part] @ rotation))
            for sigma, axis in zip(np.sqrt(values[::-1]).tolist(), axes.T[::-1], strict=True):
                if sigma > over:
                    directions.append(OpenDirection(turn, axis, float(np.degrees(sigma)) if turn else sigma))
        return tuple(directions)

    def filled(self, start: Float, open_directions: tuple[OpenDirection, ...]) -> HandEye:
        """Return the extrinsic with unobservable directions of an initial one, taken as exact, by correlation."""
        if not open_directions:
            return self
        pose, covariance, rotation = self.camera_from_lidar, self.covariance, self.camera_from_lidar[:3, :3]
        wanted = p2o.se3.log(start @ p2o.se3.inverse(pose))
        rows = np.zeros((len(open_directions), 6))
        for row, direction in zip(rows, open_directions, strict=True):
            row[slice(0, 3) if direction.turn else slice(3, 6)] = rotation @ direction.axis
        # Gauss's conditioning on exact values of the open parts.
        gain = covariance @ rows.T @ np.linalg.inv(rows @ covariance @ rows.T)
        update = gain @ (rows @ wanted)
        left = covariance - gain @ rows @ covariance
        return replace(self, camera_from_lidar=p2o.se3.exp(update) @ pose, covariance=0.5 * (left + left.T))


def rotation_from(a: Float, b: Float, sigma: Float) -> tuple[Float, Float]:
    """Return the rotation with a = R b for vectors (N, 3) of deviations (N,), damped, and its information (3, 3)."""
    rotation, weight = np.eye(3), np.ones(len(a))
    for _ in range(20):
        scaled = (weight / sigma**2)[:, None]
        u, _, vt = np.linalg.svd((scaled * a).T @ b)
        rotation = u @ np.diag([1.0, 1.0, np.linalg.det(u @ vt)]) @ vt
        off = np.linalg.norm(a - b @ rotation.T, axis=1) / sigma
        usual = max(float(np.median(off)) / 1.54, 1e-12)
        weight = 1.0 / (1.0 + (off / (usual * _CAUCHY)) ** 2)
    across = p2o.se3.skew(b @ rotation.T)
    information = np.einsum("n,nji,njk->ik", weight / (sigma * max(usual, 1.0)) ** 2, across, across)
    return np.asarray(rotation), np.asarray(information)


def translation_from(rotation: Float, steps: Steps, weight: Float, *, near_m: float = 30.0) -> tuple[Float, Float]:
    """Return t (3,) of the extrinsic for its rotation (3, 3), and the length (N,) of each camera step, in closed form.

    Solves (R_A - I) t = R t_B - s t_A, each step with its `weight` (N,). Unknown scales are eliminated by using only
    the components orthogonal to the direction of the camera. `near_m` is the standard deviation of a zero-mean prior of
    t, relative to 1 / sqrt(weight) of a step.
    """
    turned, right = steps.camera[:, :3, :3] - np.eye(3), steps.lidar[:, :3, 3] @ rotation.T
    own = steps.camera[:, :3, 3]
    across = np.eye(3) - np.einsum("ni,nj->nij", own, own)
    keep = np.where(steps.metric[:, None, None], np.eye(3), across)
    right = right - np.where(steps.metric[:, None], own, 0.0)
    normal = np.einsum("n,nji,njk,nkl->il", weight, turned, keep, turned) + np.eye(3) / near_m**2
    value = np.linalg.solve(normal, np.einsum("n,nji,njk,nk->i", weight, turned, keep, right))
    return np.asarray(value), lengths(p2o.se3.make(rotation, value), steps)


def lengths(camera_from_lidar: Float, steps: Steps) -> Float:
    """Return the length (N,) of each camera step, measured or predicted from the motion of the LiDAR."""
    rotation, t = camera_from_lidar[:3, :3], camera_from_lidar[:3, 3]
    predicted = steps.lidar[:, :3, 3] @ rotation.T - (steps.camera[:, :3, :3] - np.eye(3)) @ t
    own = steps.camera[:, :3, 3]
    return np.asarray(
        np.where(steps.metric, np.linalg.norm(own, axis=1), np.maximum((own * predicted).sum(axis=1), 0.0))
    )


def first_guess(steps: Steps) -> tuple[Float, Float]:
    """Return an extrinsic (4, 4) in closed form, and the information (3, 3) of its rotation (left update, rad^-2)."""
    turn_a, turn_b = steps.camera_turn, steps.lidar_turn
    sigma_turn = np.sqrt(np.trace(steps.covariance[:, :3, :3], axis1=1, axis2=2) / 3 + steps.lidar_rad**2)
    travel_m = np.linalg.norm(steps.lidar[:, :3, 3], axis=1)
    travel = np.maximum(travel_m, _LEAST_M)
    length = np.linalg.norm(steps.camera[:, :3, 3], axis=1)
    moves = (length > _LEAST_M) & (travel_m > _LEAST_M)
    own = np.trace(steps.covariance[:, 3:, 3:], axis1=1, axis2=2) / 3
    # Where the step turns, the sensors go different ways, as far as they are apart.
    aside = _LEVER_M * np.linalg.norm(turn_b, axis=1) / travel
    sigma_way = np.sqrt(own / np.where(steps.metric, travel, 1.0) ** 2 + (steps.lidar_m / travel) ** 2 + aside**2)
    ways = (steps.camera[moves, :3, 3] / length[moves, None], steps.lidar[moves, :3, 3] / travel[moves, None])
    rotation, information = rotation_from(
        np.concatenate([turn_a, ways[0]]),
        np.concatenate([turn_b, ways[1]]),
        np.concatenate([sigma_turn, np.maximum(sigma_way[moves], _LEAST_RAD)]),
    )
    off = np.linalg.norm(turn_a - turn_b @ rotation.T, axis=1) / sigma_turn
    weight = 1.0 / (1.0 + (off / max(_CAUCHY * float(np.median(off)), 1e-9)) ** 2)
    deviation = np.sqrt(own) * np.where(steps.metric, 1.0, travel) + steps.lidar_m
    t, _ = translation_from(rotation, steps, weight / np.maximum(deviation, _LEAST_M) ** 2, near_m=2 * _LEVER_M)
    return p2o.se3.make(rotation, t), information


def _scaled(matrix: Float) -> tuple[Float, Float]:
    """Return scales (6,) and the scaled matrix (6, 6) with unit diagonal, regularised: sizes differ widely."""
    scale = 1.0 / np.sqrt(np.diagonal(matrix))
    return scale, matrix * scale[:, None] * scale + 1e-13 * np.eye(6)


def solved(steps: Steps, camera_from_lidar: Float, *, overlap: float = 1.0, iterations: int = 50) -> HandEye:
    """Return the least-squares extrinsic over all steps, from an initial one (4, 4).

    Residuals of a step are those of A X and X B, weighted with the covariances of both motions; outliers are damped
    (Cauchy). The scatter of the steps scales the covariances of rotations and translations separately, so that only
    their shapes and correlations matter. `overlap` is the number of steps that contain each interval.
    """
    pose = np.array(camera_from_lidar, np.float64)
    floor = np.diag(_FLOOR)
    for _ in range(iterations):
        _, normal, gradient, _ = _normal_equations(steps, pose)
        # No floor here: nothing draws to the first pose, damping only holds what is open.
        scale, scaled = _scaled(normal + floor)
        update = -scale * np.linalg.solve(scaled, scale * gradient)
        size = np.abs(update)
        update = update * min(1.0, 0.3 / max(float(size[:3].max()), 1e-12), 1.0 / max(float(size[3:].max()), 1e-12))
        pose = p2o.se3.exp(update) @ pose
        if np.linalg.norm(update[:3]) < 1e-9 and np.linalg.norm(update[3:]) < 1e-8:
            break
    weight, normal, _, off = _normal_equations(steps, pose)
    freedom = max(float(weight.sum()) / max(overlap, 1.0) - 1.5, 0.5) / max(float(weight.sum()), 1e-9)
    scale, scaled = _scaled(normal * freedom + floor)
    covariance = scale[:, None] * np.linalg.inv(scaled) * scale
    total = max(float(weight.sum()), 1e-12)
    square = (weight[:, None] * off**2).sum(axis=0) / total
    off_deg, off_m = float(np.degrees(np.sqrt(square[:3].sum()))), float(np.sqrt(square[3:].sum()))
    return HandEye(pose, 0.5 * (covariance + covariance.T), weight, off_deg, off_m)


def _normal_equations(steps: Steps, pose: Float) -> tuple[Float, Float, Float, Float]:
    """Return weights (N,), normal matrix (6, 6), gradient (6,), and differences (N, 6)."""
    camera = steps.camera.copy()
    length = lengths(pose, steps)
    own = camera[:, :3, 3].copy()
    camera[:, :3, 3] = np.where(steps.metric[:, None], own, own * length[:, None])
    moved = camera @ pose @ p2o.se3.inverse(steps.lidar) @ p2o.se3.inverse(pose)
    off = np.array([p2o.se3.log(each) for each in moved])
    jacobian = adjoint(camera) - adjoint(moved)
    covariance = steps.covariance.copy()
    stretch = np.where(steps.metric, 1.0, np.maximum(length, _LEAST_M))
    covariance[:, 3:, :] *= stretch[:, None, None]
    covariance[:, :, 3:] *= stretch[:, None, None]
    lidar = np.zeros((len(steps), 6, 6))
    lidar[:, range(3), range(3)] = steps.lidar_rad[:, None] ** 2
    lidar[:, range(3, 6), range(3, 6)] = steps.lidar_m[:, None] ** 2
    carried = adjoint(pose[None])[0]
    covariance = covariance + carried @ lidar @ carried.T

    def information(covariances: Float) -> Float:
        weights = np.linalg.inv(covariances)
        # A scale that is not known takes what lies along the camera's way.
        by_own = np.concatenate([np.zeros((len(steps), 3)), own], axis=1)[..., None]
        pushed = weights @ by_own
        share = np.swapaxes(by_own, 1, 2) @ pushed
        along = pushed @ np.swapaxes(pushed, 1, 2) / np.maximum(share, 1e-300)
        return np.where(steps.metric[:, None, None], weights, weights - along)

    # Rotations, then translations: how large they are beside what is expected, in the median.
    turn = np.einsum("ni,nij,nj->n", off[:, :3], np.linalg.inv(covariance[:, :3, :3]), off[:, :3])
    inverse = information(covariance)
    move = np.einsum("ni,nij,nj->n", off[:, 3:], inverse[:, 3:, 3:], off[:, 3:])
    free = np.where(steps.metric, 2.366, 1.386)
    scale = np.maximum(np.array([np.median(turn / 2.366), np.median(move / free)]), 1e-12)
    parts = np.repeat(np.sqrt(scale), 3)
    whole = information(covariance * np.outer(parts, parts))
    distance = np.einsum("ni,nij,nj->n", off, whole, off) / np.where(steps.metric, 6.0, 5.0)
    weight = 1.0 / (1.0 + distance / _CAUCHY**2)
    normal = np.einsum("n,nji,njk,nkl->il", weight, jacobian, whole, jacobian)
    gradient = np.einsum("n,nji,njk,nk->i", weight, jacobian, whole, off)
    return weight, normal, gradient, off


def adjoint(transforms: Float) -> Float:
    """Return the matrices (N, 6, 6) that carry left updates (rotation, translation) through transforms (N, 4, 4)."""
    rotation = transforms[:, :3, :3]
    out = np.zeros((len(transforms), 6, 6))
    out[:, :3, :3] = out[:, 3:, 3:] = rotation
    out[:, 3:, :3] = p2o.se3.skew(transforms[:, :3, 3]) @ rotation
    return out
