"""The ground under a sweep as one plane, from points alone: for methods that look for what lies or stands on it."""

from __future__ import annotations

import numpy as np
from p2o.arrays import Float

_SCORED = 4000  # points that planes are tried on
_TRIED = 300  # planes that are tried
_POLISHED = 5  # least squares through the points of the plane


def ground_of(
    xyz: Float, rng: np.random.Generator, *, band_m: float = 0.2, max_tilt_deg: float = 20.0, reach_m: float = 40.0
) -> Float | None:
    """Return the plane (4,) n, d with |n| = 1 and n . x + d the height (m) above the ground, or None.

    `xyz` (N, 3) is in the LiDAR frame, z roughly up. The plane holds the most points within `band_m` of all that lean
    less than `max_tilt_deg` and run below the sensor; it is then fitted to them by least squares.
    """
    near = xyz[np.hypot(xyz[:, 0], xyz[:, 1]) < reach_m]
    if len(near) < 10:
        return None
    sample = near[rng.integers(len(near), size=min(_SCORED, len(near)))]
    corners = near[rng.integers(len(near), size=(_TRIED, 3))]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    size = np.linalg.norm(normal, axis=1)
    normal = normal / np.maximum(size, 1e-12)[:, None]
    normal = np.where(normal[:, 2:] < 0, -normal, normal)
    height = -np.sum(normal * corners[:, 0], axis=1)
    good = (size > 1e-3) & (normal[:, 2] > np.cos(np.radians(max_tilt_deg))) & (height > 0)
    if not good.any():
        return None
    normal, height = normal[good], height[good]
    held = np.count_nonzero(np.abs(sample @ normal.T + height) < band_m, axis=0)
    best = int(np.argmax(held))
    plane = np.append(normal[best], height[best])
    for _ in range(_POLISHED):
        inside = near[np.abs(near @ plane[:3] + plane[3]) < band_m]
        if len(inside) < 3:
            return None
        centre = inside.mean(axis=0)
        across = np.linalg.svd((inside - centre).T @ (inside - centre))[0][:, 2]
        across = -across if across[2] < 0 else across
        plane = np.append(across, -across @ centre)
    return plane
