"""Rigid transforms as (4, 4) float64 matrices: exponential, logarithm, inverse, distance.

A transform is named b_from_a, so that chains cancel by eye: camera_from_lidar @ lidar_from_world. Tangent
vectors are (6,): rotation vector in radians first, then the translational part in metres. Radians live here only.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from p2o.arrays import Float, checked
from p2o.errors import InputError

_FARTHEST_M = 1e9
"""Maximum coordinate in m: above geocentric coordinates, and products are finite."""
_TRANSPOSED = (
    "its last column is 0 0 0 1: transpose the matrix (row vectors, as T of MATLAB's rigid3d, or column order)"
)


def skew(vectors: Float) -> Float:
    """Return the skew-symmetric matrices (..., 3, 3) of the cross product a x b, for vectors a (..., 3)."""
    x, y, z = np.moveaxis(np.asarray(vectors, dtype=np.float64), -1, 0)
    zero = np.zeros_like(x)
    return np.stack([zero, -z, y, z, zero, -x, -y, x, zero], axis=-1).reshape(*x.shape, 3, 3)


def exp(tangent: Float) -> Float:
    """Return the transforms (..., 4, 4) of tangent vectors (..., 6); exact at zero, no small-angle seam.

    The translation is V @ tangent[3:] (left Jacobian of SO(3)), the full exponential of se(3).
    """
    tangent = np.asarray(tangent, dtype=np.float64)
    if tangent.shape == (6,):
        numbers = tangent.tolist()
        if all(abs(number) < _FARTHEST_M for number in numbers):
            return _exp_of_one(*numbers)
    x, y, z, u, v, w = np.ascontiguousarray(np.moveaxis(tangent, -1, 0))
    square = x * x + y * y + z * z
    angle = np.sqrt(square)
    # sinc forms stay accurate down to angle zero: sin(t)/t, (1-cos t)/t^2 = sinc(t/2)^2/2, (t-sin t)/t^3 by series.
    a = np.sinc(angle / np.pi)
    b = 0.5 * np.sinc(angle / (2 * np.pi)) ** 2
    small = angle < 1e-2
    safe = np.where(small, 1.0, angle)
    c = np.where(small, _series(square), (safe - np.sin(safe)) / safe**3)
    out = np.zeros((*tangent.shape[:-1], 4, 4))
    for i, row in enumerate(_rows(x, y, z, u, v, w, square, a, b, c)):
        for j, entry in enumerate(row):
            out[..., i, j] = entry
    out[..., 3, 3] = 1.0
    return out


def _exp_of_one(x: float, y: float, z: float, u: float, v: float, w: float) -> Float:
    """Return the transform (4, 4) of one tangent vector; arrays of three numbers cost ten times what they compute."""
    square = x * x + y * y + z * z
    angle = math.sqrt(square)
    half = 0.5 * angle
    a = math.sin(angle) / angle if angle else 1.0
    b = 0.5 * (math.sin(half) / half) ** 2 if half else 0.5
    c = _series(square) if angle < 1e-2 else (angle - math.sin(angle)) / (angle * square)
    out = np.empty((4, 4))
    out[0], out[1], out[2] = _rows(x, y, z, u, v, w, square, a, b, c)
    out[3] = 0.0, 0.0, 0.0, 1.0
    return out


def _series(square: Any) -> Any:
    """Return (t - sin t) / t^3 of small angles t from their squares."""
    return 1 / 6 - square / 120 + square * square / 5040


def _rows(x: Any, y: Any, z: Any, u: Any, v: Any, w: Any, square: Any, a: Any, b: Any, c: Any) -> Any:
    """Return three rows of a transform from its tangent, numbers or arrays: I + a cross + b cross^2, and V @ rho."""
    # The square of the cross product's matrix is the outer product of the vector less its square.
    xx, yy, zz, xy, xz, yz = x * x - square, y * y - square, z * z - square, x * y, x * z, y * z
    return (
        (1 + b * xx, b * xy - a * z, b * xz + a * y, u + b * (y * w - z * v) + c * (xx * u + xy * v + xz * w)),
        (b * xy + a * z, 1 + b * yy, b * yz - a * x, v + b * (z * u - x * w) + c * (xy * u + yy * v + yz * w)),
        (b * xz - a * y, b * yz + a * x, 1 + b * zz, w + b * (x * v - y * u) + c * (xz * u + yz * v + zz * w)),
    )


def log(transform: Float) -> Float:
    """Return the tangent vector (6,) of one transform (4, 4); the inverse of `exp` for angles below pi."""
    rotation = np.asarray(transform, dtype=np.float64)[:3, :3]
    omega = rotation_vector(rotation)
    angle = float(np.linalg.norm(omega))
    cross = skew(omega)
    c = 1 / 12 + angle**2 / 720 if angle < 1e-3 else 1 / angle**2 - 1 / (2 * angle * np.tan(angle / 2))
    inverse_v = np.eye(3) - 0.5 * cross + c * cross @ cross
    return np.concatenate([omega, inverse_v @ transform[:3, 3]])


def rotation_vector(rotation: Float) -> Float:
    """Return the rotation vector (3,) in radians of a rotation matrix (3, 3), angle in [0, pi]."""
    from scipy.spatial.transform import Rotation

    return np.asarray(Rotation.from_matrix(rotation).as_rotvec(), dtype=np.float64)


def inverse(transform: Float) -> Float:
    """Return a_from_b of b_from_a, shapes (..., 4, 4), using the transpose of the rotation."""
    transform = np.asarray(transform, dtype=np.float64)
    out = np.zeros_like(transform)
    transposed = np.swapaxes(transform[..., :3, :3], -1, -2)
    out[..., :3, :3] = transposed
    out[..., :3, 3] = -(transposed @ transform[..., :3, 3:])[..., 0]
    out[..., 3, 3] = 1.0
    return out


def apply(b_from_a: Float, xyz_a: Float) -> Float:
    """Return points (..., N, 3) in frame b of points (N, 3) in frame a, for transforms (..., 4, 4), in metres."""
    b_from_a = np.asarray(b_from_a, dtype=np.float64)
    return xyz_a @ np.swapaxes(b_from_a[..., :3, :3], -1, -2) + b_from_a[..., None, :3, 3]


def make(rotation: Any = None, translation: Any = None) -> Float:
    """Return a transform (4, 4) from a rotation (3, 3) and a translation (3,) in metres; identity by default."""
    out = np.eye(4)
    if rotation is not None:
        out[:3, :3] = rotation
    if translation is not None:
        out[:3, 3] = translation
    return out


def angle_deg(transform: Float) -> float:
    """Return the rotation angle of a transform (4, 4) in degrees, in [0, 180]."""
    (a, b, c), (d, e, f), (g, h, i) = np.asarray(transform, dtype=np.float64)[:3, :3].tolist()
    # Sine and cosine together are exact at all angles; either alone is not at some.
    return math.degrees(math.atan2(math.sqrt((h - f) ** 2 + (c - g) ** 2 + (d - b) ** 2), a + e + i - 1))


def distance_m(transform: Float) -> float:
    """Return the norm of the translation of a transform (4, 4) in metres."""
    return float(np.linalg.norm(transform[:3, 3]))


def check_rigid(name: str, value: Any, *, where: object = None, tolerance: float = 1e-4) -> Float:
    """Return `value` as a read-only (4, 4) rigid transform, its rotation projected onto SO(3).

    Raises InputError if the shape is wrong, the last row is not 0 0 0 1, the rotation is not orthonormal within
    `tolerance`, its determinant is -1 (a mirror image), or the translation reaches beyond all maps (1e9 m).
    """
    try:
        matrix = checked(name, value, (4, 4), np.float64)
    except InputError as problem:
        raise InputError(problem.what, where=where, expected=problem.expected, got=problem.got) from problem
    if not np.allclose(matrix[3], [0, 0, 0, 1], rtol=0, atol=1e-9):
        got = " ".join(f"{v:g}" for v in matrix[3])
        hint = _TRANSPOSED if np.allclose(matrix[:, 3], [0, 0, 0, 1], rtol=0, atol=1e-9) else None
        raise InputError(f"the last row of {name} is wrong", where=where, expected="0 0 0 1", got=got, hint=hint)
    farthest = float(np.abs(matrix[:3, 3]).max())
    if farthest > _FARTHEST_M:
        expected = f"at most {_FARTHEST_M:g} m along each axis"
        raise InputError(f"the translation of {name} is too long", where=where, expected=expected, got=f"{farthest:g}")
    rotation = matrix[:3, :3]
    # Before anything is multiplied: the product of what some files hold is infinite.
    if (largest := float(np.abs(rotation).max())) > 10:
        message = f"the rotation of {name} is not orthonormal"
        raise InputError(message, where=where, expected="numbers of -1 to 1", got=f"{largest:g}")
    if np.linalg.det(rotation) < 0:
        text, hint = f"the rotation of {name} mirrors space", "check for a swapped or negated axis"
        raise InputError(text, where=where, expected="determinant +1", got=f"{np.linalg.det(rotation):.3f}", hint=hint)
    deviation = float(np.abs(rotation.T @ rotation - np.eye(3)).max())
    if deviation > tolerance:
        text = f"the rotation of {name} is not orthonormal"
        raise InputError(text, where=where, expected=f"|R^T R - I| <= {tolerance:g}", got=f"{deviation:.3g}")
    u, _, vt = np.linalg.svd(rotation)
    clean = make(u @ vt, matrix[:3, 3])
    clean.flags.writeable = False
    return clean
