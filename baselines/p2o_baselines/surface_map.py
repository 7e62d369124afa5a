"""The map of a LiDAR as small planes: sweeps of a drive in one world, in cubes, each with the plane of its points.

Cubes whose points are no plane (leaves, edges, too few) stay in the map without one: what lies next to them has no
surface near by. All constants are ours.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import p2o
from p2o.arrays import Bool, Float, Int
from scipy.spatial import cKDTree

_LEAST = 12
"""Points of a plane."""
_THICK_M = 0.05
_WIDE_M = 0.05
_FLATTER = 2.5
"""A plane is so many times wider than thick."""


@dataclass(frozen=True, eq=False)
class SurfaceMap:
    """Cubes of the world: `centre` (N, 3) m of their points, `normal` (N, 3), `thickness_m` (N,), and which are `flat`.

    `tree` finds the cubes by their centres.
    """

    centre: Float
    normal: Float
    thickness_m: Float
    flat: Bool
    tree: cKDTree

    def near(self, xyz: Float, reach_m: float) -> tuple[Bool, Int]:
        """Return which points (N, 3) have a plane next to them, not farther off than `reach_m`, and its cube (N,)."""
        away, cube = self.tree.query(xyz, distance_upper_bound=reach_m)
        found = np.isfinite(away)
        cube = np.where(found, cube, 0)
        return found & self.flat[cube], cube


def surface_map(
    sweeps: Sequence[Float], world_from_lidar: Float, *, cube_m: float = 0.5, near_m: float = 2.5, far_m: float = 60.0
) -> SurfaceMap | None:
    """Return the map of sweeps (N, 3) taken at poses (K, 4, 4); None where it would be empty.

    Points nearer than `near_m`, where the car itself is, and those farther than `far_m` are left out.
    """
    parts = []
    for xyz, pose in zip(sweeps, world_from_lidar, strict=True):
        distance = np.linalg.norm(xyz, axis=1)
        parts.append(p2o.se3.apply(pose, xyz[(distance > near_m) & (distance < far_m)]))
    points = np.concatenate(parts)
    if not len(points):
        return None
    cell = np.floor(points / cube_m).astype(np.int64)
    key = (cell - cell.min(axis=0)) @ np.array([1 << 40, 1 << 20, 1])
    _, cube, count = np.unique(key, return_inverse=True, return_counts=True)
    centre = np.stack([np.bincount(cube, points[:, axis]) / count for axis in range(3)], axis=1)
    off = points - centre[cube]
    spread = np.zeros((len(count), 3, 3))
    for one in range(3):
        for two in range(one, 3):
            spread[:, one, two] = spread[:, two, one] = np.bincount(cube, off[:, one] * off[:, two]) / count
    enough = count >= _LEAST
    if not enough.any():
        return None
    values, axes = np.linalg.eigh(spread[enough])
    sizes = np.sqrt(np.maximum(values, 0.0))
    flat = (sizes[:, 0] < _THICK_M) & (sizes[:, 1] > _WIDE_M) & (sizes[:, 1] > _FLATTER * sizes[:, 0])
    return SurfaceMap(centre[enough], axes[:, :, 0], sizes[:, 0], flat, cKDTree(centre[enough]))
