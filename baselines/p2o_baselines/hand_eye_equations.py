"""Hand-eye calibration: the extrinsic X from how both sensors move, by A X = X B for each step.

A step is what moves points from the sensor's first frame to its second: A of the camera, B of the LiDAR, X is
camera_from_lidar. Rotation and translation part:

    R_A R = R R_B                     so that R turns the axis of B to the axis of A
    (R_A - I) t = R t_B - s t_A       with s = 1 where the camera's motion is metric, else one scale a step

First closed forms (`rotation_from`, `translation_from`), then least squares over all six parameters with the covariance
of each step (`solved`). Where the sensors move straight ahead, R t_B and t_A point the same way, so the directions of
motion count as pairs of axes too, the less the more a step turns: a drive on flat ground then leaves only the height
open. What the motion leaves open shows in the covariance (`HandEye.open_directions`).

After Tsai and Lenz 1989 and Horaud and Dornaika 1995; per-step scales as in Ishikawa et al. 2018. Pure functions; all
constants are ours.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import p2o
from p2o.arrays import Bool, Float

_LEVER_M = 0.5
"""How far apart the sensors may be, one sigma, as long as nothing is known of it."""
_LEAST_RAD, _LEAST_M = 1e-8, 1e-8
_FLOOR_RAD, _FLOOR_M = 1.0, 30.0
"""Deviations of what the motion does not determine at all: such a direction is open, but no system is singular."""
_CAUCHY = 2.4


@dataclass(frozen=True, eq=False)
class Steps:
    """Motions of both sensors over the same spans of time.

    `camera` and `lidar` (N, 4, 4) take points from the sensor's first frame to its second. `covariance` (N, 6, 6) is
    that of the camera's step as a left update (rad, m); where `metric` (N,) is False the translation has length 1 and
    no scale is known, and its covariance is that of the direction. `lidar_rad` and `lidar_m` (N,) are the deviations of
    the LiDAR's steps an axis.
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
        return _turns(self.camera)

    @property
    def lidar_turn(self) -> Float:
        """Rotation vectors (N, 3) of the LiDAR's steps."""
        return _turns(self.lidar)

    @property
    def travel_m(self) -> Float:
        """How far the LiDAR goes in each step (N,)."""
        return np.asarray(np.linalg.norm(self.lidar[:, :3, 3], axis=1))


@dataclass(frozen=True, eq=False)
class OpenDirection:
    """What the motion does not tell: the place of the camera along `axis` (3,) of the LiDAR frame, or a turn about it.

    `sigma` is its standard deviation in metres, of a turn in degrees.
    """

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

    `covariance` (6, 6) is of a left update in the camera frame (rad, m), `weight` (N,) how much each step counted, 0 to
    1, `length_m` (N,) how far the camera went in each, and `off_deg`, `off_m` the weighted root mean squares of what
    both sides of the equations differ by.
    """

    camera_from_lidar: Float
    covariance: Float
    weight: Float
    length_m: Float
    off_deg: float
    off_m: float

    @property
    def place_covariance(self) -> Float:
        """Covariance (3, 3) m^2 of the camera's place in the LiDAR frame."""
        rotation = self.camera_from_lidar[:3, :3]
        # The place is -R^T t: a left update moves it by the update's translation alone.
        return np.asarray(rotation.T @ self.covariance[3:, 3:] @ rotation)

    @property
    def turn_covariance(self) -> Float:
        """Covariance (3, 3) rad^2 of the camera's attitude, about the axes of the LiDAR frame."""
        rotation = self.camera_from_lidar[:3, :3]
        return np.asarray(rotation.T @ self.covariance[:3, :3] @ rotation)

    def open_directions(self, *, over_deg: float, over_m: float) -> tuple[OpenDirection, ...]:
        """Return what is known no better than this: turns first, the worst first."""
        found = []
        for turn, covariance, over in (
            (True, self.turn_covariance, np.radians(over_deg)),
            (False, self.place_covariance, over_m),
        ):
            values, axes = np.linalg.eigh(covariance)
            for value, axis in zip(values[::-1], axes.T[::-1], strict=True):
                if np.sqrt(value) > over:
                    sigma = float(np.sqrt(value))
                    found.append(OpenDirection(turn, axis, float(np.degrees(sigma)) if turn else sigma))
        return tuple(found)

    def filled(self, start: Float, open_directions: tuple[OpenDirection, ...]) -> HandEye:
        """Return the extrinsic with what is open taken from a start (4, 4); the rest follows as it is correlated.

        The covariance is that of the start being right along open directions.
        """
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
    """Return the rotation (3, 3) with a = R b for vectors (N, 3) of deviations (N,), and its information (3, 3).

    Wrong pairs are damped (Cauchy). The information is of a left rotation vector; zero about an axis that no pair
    tells.
    """
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


def translation_from(rotation: Float, steps: Steps, weight: Float, *, near_m: float = _FLOOR_M) -> tuple[Float, Float]:
    """Return t (3,) of the extrinsic for its rotation (3, 3), and the length (N,) of each camera step, in closed form.

    It solves (R_A - I) t = R t_B - s t_A, each step with its `weight` (N,). Scales that are not known are eliminated:
    what lies across the camera's direction counts. `near_m` is how far t may be from zero, one sigma, where nothing
    says otherwise, against a deviation of 1 / sqrt(weight) of a step.
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
    """Return how far the camera goes in each step (N,): as measured, or what the LiDAR's motion makes it."""
    rotation, t = camera_from_lidar[:3, :3], camera_from_lidar[:3, 3]
    there = steps.lidar[:, :3, 3] @ rotation.T - (steps.camera[:, :3, :3] - np.eye(3)) @ t
    own = steps.camera[:, :3, 3]
    return np.where(steps.metric, np.linalg.norm(own, axis=1), np.maximum((own * there).sum(axis=1), 0.0))


def first_guess(steps: Steps) -> tuple[Float, Float]:
    """Return an extrinsic (4, 4) in closed form, and the information (3, 3) of its rotation (left update, rad^-2)."""
    turn_a, turn_b = steps.camera_turn, steps.lidar_turn
    sigma_turn = np.sqrt(np.trace(steps.covariance[:, :3, :3], axis1=1, axis2=2) / 3 + steps.lidar_rad**2)
    travel = np.maximum(steps.travel_m, _LEAST_M)
    length = np.linalg.norm(steps.camera[:, :3, 3], axis=1)
    moves = (length > _LEAST_M) & (steps.travel_m > _LEAST_M)
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
    """Return scales (6,) and a matrix (6, 6) between them, of ones on its diagonal, that is never quite singular.

    Turns are known to fractions of a milliradian where the height is open by metres: rounding alone loses it.
    """
    scale = 1.0 / np.sqrt(np.diagonal(matrix))
    return scale, matrix * scale[:, None] * scale + 1e-13 * np.eye(6)


def solved(steps: Steps, camera_from_lidar: Float, *, overlap: float = 1.0, iterations: int = 50) -> HandEye:
    """Return the extrinsic with the least squares over all steps, from a first one (4, 4).

    The differences of a step are those of A X and X B, weighted with the covariances of both motions; wrong steps are
    damped (Cauchy). How far steps differ from each other scales the covariances of rotations and translations apart,
    so that only their shapes and relations matter. `overlap` is how many times each stretch of the way is in a step.
    """
    pose = np.array(camera_from_lidar, np.float64)
    floor = np.diag(np.repeat([1 / _FLOOR_RAD**2, 1 / _FLOOR_M**2], 3))
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
    return HandEye(
        pose,
        0.5 * (covariance + covariance.T),
        weight,
        lengths(pose, steps),
        float(np.degrees(np.sqrt(square[:3].sum()))),
        float(np.sqrt(square[3:].sum())),
    )


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
        found = np.linalg.inv(covariances)
        # A scale that is not known takes what lies along the camera's way.
        way = np.concatenate([np.zeros((len(steps), 3)), own], axis=1)[..., None]
        pushed = found @ way
        share = np.swapaxes(way, 1, 2) @ pushed
        along = pushed @ np.swapaxes(pushed, 1, 2) / np.maximum(share, 1e-300)
        return np.where(steps.metric[:, None, None], found, found - along)

    # Rotations, then translations: how large they are beside what is expected, in the median.
    turn = np.einsum("ni,nij,nj->n", off[:, :3], np.linalg.inv(covariance[:, :3, :3]), off[:, :3])
    inverse = information(covariance)
    move = np.einsum("ni,nij,nj->n", off[:, 3:], inverse[:, 3:, 3:], off[:, 3:])
    free = np.where(steps.metric, 2.366, 1.386)
    scale = np.array([np.median(turn / 2.366), np.median(move / free)])
    scale = np.maximum(scale, 1e-12)
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


def _turns(transforms: Float) -> Float:
    from scipy.spatial.transform import Rotation

    return np.asarray(Rotation.from_matrix(transforms[:, :3, :3]).as_rotvec(), np.float64).reshape(-1, 3)
