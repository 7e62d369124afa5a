"""Boxes of known size in a sweep: three faces by RANSAC, a cuboid fitted to them, checked by the rays around it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import permutations, product

import numpy as np
import p2o
from p2o import Bool, Float, Int, se3

from p2o_baselines.boards.board_in_sweep import Rays, rays_of, standing

_EQUAL = 0.03  # sides that differ by less of the larger one are taken for equal


def symmetries(size_m: Float) -> list[Float]:
    """Return the rotations (4, 4) that map a box of `size_m` (3,) onto itself: four, eight, or 24 for a cube."""
    out = []
    for order in permutations(range(3)):
        if any(abs(size_m[a] - size_m[b]) > _EQUAL * max(size_m[a], size_m[b]) for a, b in enumerate(order)):
            continue
        for signs in product((1.0, -1.0), repeat=3):
            turn = np.eye(4)
            turn[:3, :3] = np.diag(signs) @ np.eye(3)[list(order)]
            if np.linalg.det(turn[:3, :3]) > 0:
                out.append(turn)
    return out


def near_corner(eye: Float, size_m: Float) -> int | None:
    """Return the corner of a box whose three faces are visible from `eye` (3,) in its frame; None if fewer are."""
    out = np.abs(eye) > size_m / 2
    return int(np.sum((eye > 0) * np.array([1, 2, 4]))) if out.all() else None


def around(corner: int) -> tuple[list[int], list[tuple[int, int]]]:
    """Return the six corners around a visible one, first, third and fifth those of x, y, z, and the three edges."""
    x, y, z = corner ^ 1, corner ^ 2, corner ^ 4
    return [x, corner ^ 3, y, corner ^ 6, z, corner ^ 5], [(corner, x), (corner, y), (corner, z)]


def enters(start: Float, direction: Float, half: Float) -> tuple[Float, Int, Bool]:
    """Return the distance along rays (N, 3) to a box of half sizes (3,) in its frame, the axis, and the hits."""
    with np.errstate(divide="ignore", invalid="ignore"):
        one, two = ((sign * half - start) / direction for sign in (-1.0, 1.0))
    low, high = np.fmin(one, two), np.fmax(one, two)
    enter, leave = low.max(axis=1), high.min(axis=1)
    return enter, low.argmax(axis=1), (enter < leave) & (leave > 0)


_LEAST_POINTS, _LEAST_FACE = 25, 6
_TRIPLES = 400
_SQUARE_COSINE = 0.3  # normals of two faces by RANSAC enclose 90 deg, give or take 17
_LEAST_HIT, _MOST_BESIDE = 0.88, 0.3  # of the rays towards the box that end on it, and of those beside it that do
_LEAST_OF_FACE = 0.6  # minimum fraction of all rays that intersect one face
_RIM_M = 0.03  # rays nearer to the outline than this are not asked
_ANGLE_RAD = 0.001  # deviation of a beam's direction
_FLOOR_M = 0.004


@dataclass(frozen=True)
class Face:
    """Points (N, 3) m of a face, its plane normal . x = offset towards the LiDAR, and how much ranges scatter."""

    xyz: Float
    normal: Float
    offset_m: float
    sigma_m: float


@dataclass(frozen=True)
class BoxInSweep:
    """A box in a sweep: its pose (4, 4) up to `symmetries`, covariance (6, 6) of a left update, faces."""

    size_m: tuple[float, float, float]
    lidar_from_box: Float
    covariance: Float
    sigma_m: float
    faces: tuple[Face, Face, Face]

    @property
    def points(self) -> int:
        """Return the number of returns on its faces."""
        return sum(len(face.xyz) for face in self.faces)


def boxes_in_sweep(
    cloud: p2o.Cloud, sizes_m: Sequence[tuple[float, float, float]], *, farthest_m: float, sigma_m: float
) -> tuple[BoxInSweep, ...]:
    """Return what may be boxes of some sizes that show three faces; `sigma_m` is how much ranges scatter at most."""
    rays = rays_of(cloud, farthest_m)
    detected: list[BoxInSweep] = []
    for size in dict.fromkeys(sizes_m):
        used = np.zeros(len(rays.xyz), np.bool_)
        diagonal = float(np.linalg.norm(size))
        for about in standing(rays, farthest_m, diagonal, used):
            box = _box(rays, about, np.array(size), sigma_m)
            if box is not None:
                detected.append(box)
                used |= np.linalg.norm(rays.xyz - box.lidar_from_box[:3, 3], axis=1) < 0.6 * diagonal
    return tuple(detected)


def corner_planes(xyz: Float, sigma_m: float, rng: np.random.Generator) -> tuple[Float, Float, list[Int]] | None:
    """Return normals (3, 3), offsets (3,) and points of three orthogonal faces, by RANSAC."""
    left = np.arange(len(xyz))
    normals: list[Float] = []
    offsets: list[float] = []
    members: list[Int] = []
    for _ in range(3):
        if len(left) < _LEAST_FACE:
            return None
        part = xyz[left]
        first = rng.integers(0, len(part), _TRIPLES)
        three = part[np.stack([first, *(rng.integers(0, len(part), _TRIPLES) for _ in range(2))], 1)]
        normal = np.cross(three[:, 1] - three[:, 0], three[:, 2] - three[:, 0])
        size = np.linalg.norm(normal, axis=1)
        good = size > 0.005
        if normals:
            good &= (np.abs(normal @ np.array(normals).T) < _SQUARE_COSINE * size[:, None]).all(axis=1)
        if not good.any():
            return None
        normal = normal[good] / size[good, None]
        offset = np.einsum("ni,ni->n", normal, three[good, 0])
        near = np.abs(part @ normal.T - offset) < 2 * sigma_m
        best = int(np.argmax(near.sum(axis=0)))
        on = near[:, best]
        if on.sum() < _LEAST_FACE:
            return None
        at, direction = part[on].mean(axis=0), np.linalg.svd(part[on] - part[on].mean(axis=0))[2][2]
        direction = -direction if direction @ at > 0 else direction
        normals.append(direction)
        offsets.append(float(direction @ at))
        members.append(left[on])
        left = left[~on]
    return np.array(normals), np.array(offsets), members


def _box(rays: Rays, about: Int, size: Float, sigma_m: float) -> BoxInSweep | None:
    """Return the box of a size that contains most of some points; None if rays contradict it."""
    if len(about) < _LEAST_POINTS:
        return None
    xyz = rays.xyz[about]
    planes = corner_planes(xyz, sigma_m, np.random.default_rng(len(xyz)))
    if planes is None:
        return None
    normals, offsets, members = planes
    u, _, vt = np.linalg.svd(normals * np.sqrt([[len(m)] for m in members]))
    square: Float = np.asarray(u @ vt)  # rows: the normals, made square to each other
    if (np.einsum("ki,ki->k", square, normals) < 0.9).any():
        return None
    corner = np.asarray(np.linalg.solve(normals, offsets))
    best: tuple[float, Float, float] | None = None
    for order in permutations(range(3)):
        start = _placed(square[list(order)], corner, size)
        fitted = _fitted(xyz, start, size, sigma_m)
        if fitted is None:
            continue
        hit, beside = _evidence(rays, fitted[0], size, max(4 * fitted[1], 0.03))
        if hit >= _LEAST_HIT and beside <= _MOST_BESIDE and (best is None or hit - beside > best[0]):
            best = (hit - beside, *fitted)
    return None if best is None else _with_faces(xyz, best[1], size, best[2])


def _placed(axes: Float, corner: Float, size: Float) -> Float:
    """Return the pose (4, 4) of a box with outward normals `axes` (3, 3) of its x, y, z faces that meet at a corner."""
    rotation = np.array(axes.T)
    middle = corner - rotation @ (size / 2)
    if np.linalg.det(rotation) < 0:
        rotation[:, 2] *= -1
    return se3.make(rotation, middle)


def _assigned(xyz: Float, pose: Float, size: Float, within_m: float) -> tuple[Float, Int]:
    """Return distances (N,) of points from the nearest visible face, and its number (N,), -1 beside all faces."""
    box_from_lidar = se3.inverse(pose)
    own, eye = se3.apply(box_from_lidar, xyz), box_from_lidar[:3, 3]
    off = own * np.sign(eye) - size / 2
    face = np.argmin(np.abs(off), axis=1)
    rows = np.arange(len(xyz))
    away = off[rows, face]
    inside = (np.abs(own) < size / 2 + 0.03).sum(axis=1) >= 3
    return away, np.where((np.abs(away) < within_m) & inside, face, -1)


def _rows(xyz: Float, pose: Float, face: Int) -> tuple[Float, Float]:
    """Return how distances from faces change by a left update (N, 6) of the pose, and cosines (N,) of incidence."""
    eye = se3.inverse(pose)[:3, 3]
    normal = (pose[:3, :3] * np.sign(eye)).T[face]
    facing = np.abs(np.einsum("ni,ni->n", normal, xyz)) / np.linalg.norm(xyz, axis=1)
    return -np.concatenate([np.cross(xyz, normal), normal], axis=1), facing


def _weights(xyz: Float, facing: Float, sigma_m: float) -> Float:
    """Return deviations (N,) of distances from faces: of ranges by the incidence, and of beams across it."""
    far = np.linalg.norm(xyz, axis=1)
    return np.asarray(np.hypot(sigma_m * facing, _ANGLE_RAD * far * np.sqrt(np.clip(1 - facing**2, 0, 1))))


def _fitted(xyz: Float, pose: Float, size: Float, sigma_m: float) -> tuple[Float, float] | None:
    """Return the pose of the box nearest to points, next to a given one, and how much ranges scatter."""
    if (np.abs(se3.inverse(pose)[:3, 3]) < size / 2).any():
        return None
    sigma = sigma_m
    for _ in range(12):
        away, face = _assigned(xyz, pose, size, max(3 * sigma, 2 * _FLOOR_M))
        on = face >= 0
        if on.sum() < _LEAST_POINTS or (np.bincount(face[on], minlength=3) < _LEAST_FACE).any():
            return None
        rows, facing = _rows(xyz[on], pose, face[on])
        spread = _weights(xyz[on], facing, sigma)
        step = np.asarray(np.linalg.lstsq(rows / spread[:, None], -away[on] / spread, rcond=None)[0])
        if np.linalg.norm(step) > 0.5:
            return None
        pose = se3.exp(step) @ pose
        freedom = max(int(on.sum()) - 6, 1)
        sigma = float(np.clip(sigma * np.sqrt(np.sum((away[on] / spread) ** 2) / freedom), _FLOOR_M, sigma_m))
    return pose, sigma


def _evidence(rays: Rays, pose: Float, size: Float, within_m: float) -> tuple[float, float]:
    """Return the share of rays towards a box that end on it, and of those just beside it that end near it."""
    start = rays.start
    near = np.linalg.norm(rays.xyz - start, axis=1)
    direction = (rays.xyz - start) / np.maximum(near, 1e-9)[:, None]
    to = pose[:3, 3] - start
    along = np.einsum("ni,ni->n", direction, to)
    miss = np.linalg.norm(to - along[:, None] * direction, axis=1)
    chosen = (along > 0) & (miss < 0.5 * float(np.linalg.norm(size)) + 0.25)
    start, direction, near = start[chosen], direction[chosen], near[chosen]
    box_from_lidar = se3.inverse(pose)
    begin, ahead = se3.apply(box_from_lidar, start), direction @ box_from_lidar[:3, :3].T
    expected, axis, _ = enters(begin, ahead, size / 2)
    inner, outer, further = (enters(begin, ahead, size / 2 + margin)[2] for margin in (-_RIM_M, _RIM_M, 0.15))
    hidden = inner & (near < expected - within_m - 0.05)
    asked = inner & ~hidden
    if asked.sum() < _LEAST_POINTS or hidden.sum() > 0.3 * inner.sum():
        return 0.0, 1.0
    on = np.abs(near - expected) < within_m
    hit = float(on[asked].mean())
    # A face that is nearly all behind something is a strip of two others.
    of_faces = (inner & (axis == face) for face in range(3))
    if any(on[face].mean() < _LEAST_OF_FACE for face in of_faces if face.any()):
        return 0.0, 1.0
    beside = further & ~outer
    ends = se3.apply(box_from_lidar, start[beside] + direction[beside] * near[beside, None])
    close = (np.abs(ends) < size / 2 + 0.2).all(axis=1)
    return hit, float(close.mean()) if beside.any() else 0.0


def _with_faces(xyz: Float, pose: Float, size: Float, sigma: float) -> BoxInSweep | None:
    """Return the box at a pose, with its faces and how sure it is."""
    _, face = _assigned(xyz, pose, size, max(3 * sigma, 2 * _FLOOR_M))
    on = face >= 0
    rows, facing = _rows(xyz[on], pose, face[on])
    rows = rows / _weights(xyz[on], facing, sigma)[:, None]
    faces: list[Face] = []
    for axis in range(3):
        points = xyz[face == axis]
        if len(points) < _LEAST_FACE:
            return None
        middle = points.mean(axis=0)
        normal = np.linalg.svd(points - middle)[2][2]
        normal = -normal if normal @ middle > 0 else normal
        faces.append(Face(points, normal, float(normal @ middle), sigma))
    width, height, depth = size.tolist()
    covariance = np.asarray(np.linalg.pinv(rows.T @ rows))
    return BoxInSweep((width, height, depth), pose, covariance, sigma, (faces[0], faces[1], faces[2]))
