"""Poses in closed form: from directions and points, and from planes."""

from __future__ import annotations

import numpy as np
from p2o import se3
from p2o.arrays import Float


def turned(to: Float, of: Float, weight: Float | None = None) -> Float:
    """Return the rotation (3, 3) that takes directions `of` (N, 3) nearest to those `to` (N, 3); least squares."""
    weighted = to if weight is None else to * weight[:, None]
    u, _, vt = np.linalg.svd(weighted.T @ of)
    return np.asarray(u @ np.diag([1.0, 1.0, np.linalg.det(u @ vt)]) @ vt)


def from_planes(to_normal: Float, to_offset: Float, of_normal: Float, of_offset: Float) -> Float:
    """Return the pose (4, 4) that takes planes normal . x = offset onto planes: rotation first, then least squares.

    Normals (N, 3) of at least three planes, not all parallel to one line.
    """
    rotation = turned(to_normal, of_normal)
    # A point on the plane moves by t: n_to . (R x + t) = d_to, and n_to . R x is d_of where the normals agree.
    shift = np.linalg.lstsq(to_normal, to_offset - of_offset, rcond=None)[0]
    return se3.make(rotation, shift)


def from_middles(to: Float, of: Float, to_normal: Float, of_normal: Float, lever_m: float = 1.0) -> Float:
    """Return the pose (4, 4) that takes middles (N, 3) and normals (N, 3) onto others.

    A normal counts as a point `lever_m` off. One pair leaves the turn about its normal open.
    """
    a, b = to - to.mean(axis=0), of - of.mean(axis=0)
    rotation = turned(np.concatenate([a, lever_m * to_normal]), np.concatenate([b, lever_m * of_normal]))
    return se3.make(rotation, to.mean(axis=0) - rotation @ of.mean(axis=0))
