"""Points of a sweep with normal, reflectance and segment as a feature: what CalibAnything wants alike within a mask."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np
import p2o
from p2o.arrays import Float, Int, checked
from p2o.geometry.motion import moved
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

_SCORED = 4000  # points that planes are tried on
_TRIED = 300  # planes that are tried for each that is taken


@dataclass(frozen=True, eq=False)
class CloudSegments(p2o.CloudFeature):
    """Points `xyz` (N, 3) m with unit `normal` (N, 3), `strength` (N,) 0 to 1 and `segment` (N,), -1 for none.

    `time_s` (N,) is when a point of a raw sweep was measured, in seconds from the image.
    """

    word: ClassVar[str] = "cloud-segments"

    xyz: Float
    normal: Float
    strength: Float
    segment: Int
    time_s: Float | None = None

    def __post_init__(self) -> None:
        count = len(self.xyz)
        for name, shape, kind in (
            ("xyz", (count, 3), np.float64),
            ("normal", (count, 3), np.float64),
            ("strength", (count,), np.float64),
            ("segment", (count,), np.int64),
            ("time_s", (count,), np.float64),
        ):
            value = getattr(self, name)
            if value is not None:
                object.__setattr__(self, name, checked(f"{name} of the cloud segments", value, shape, kind))

    def __len__(self) -> int:
        return len(self.xyz)

    def select(self, keep: Any) -> CloudSegments:
        """Return the points of a mask or index."""
        time_s = None if self.time_s is None else self.time_s[keep]
        return CloudSegments(self.xyz[keep], self.normal[keep], self.strength[keep], self.segment[keep], time_s)

    def moved(self, b_from_lidar: Float) -> CloudSegments:
        """Return the points in another frame b, by a (4, 4) rigid transform."""
        normal = self.normal @ b_from_lidar[:3, :3].T
        return replace(self, xyz=p2o.se3.apply(b_from_lidar, self.xyz), normal=normal)

    def untwisted(self, twist: Float) -> CloudSegments:
        """Return the points as if measured at time 0 from a LiDAR that moves with constant `twist` (6,)."""
        if self.time_s is None:
            return self
        normal = moved(twist, self.time_s, self.normal, directions=True)
        return replace(self, xyz=moved(twist, self.time_s, self.xyz), normal=normal)

    @property
    def times_s(self) -> Float | None:
        """When each point of a raw sweep was measured."""
        return self.time_s

    @property
    def places(self) -> Float:
        """The points themselves."""
        return self.xyz


def one_a_voxel(xyz: Float, size_m: float) -> Int:
    """Return the index of one point in each cube of `size_m` that holds any of the points (N, 3), in their order."""
    cells = np.floor(xyz / size_m).astype(np.int64)
    cells -= cells.min(axis=0)
    span = cells.max(axis=0) + 1
    _, first = np.unique((cells[:, 0] * span[1] + cells[:, 1]) * span[2] + cells[:, 2], return_index=True)
    return np.asarray(np.sort(first))


def normals_of(xyz: Float, neighbours: int) -> Float:
    """Return unit normals (N, 3) of points (N, 3): across the flattest direction of the nearest ones, to the origin."""
    count = min(neighbours, len(xyz))
    _, near = cKDTree(xyz).query(xyz, k=count)
    near = near.reshape(len(xyz), count)
    mean, second = np.zeros((len(xyz), 3)), np.zeros((len(xyz), 3, 3))
    for column in near.T:
        step = xyz[column] - xyz
        mean += step / count
        second += step[:, :, None] * step[:, None, :] / count
    _, axes = np.linalg.eigh(second - mean[:, :, None] * mean[:, None, :])
    normal = axes[:, :, 0]
    away = np.einsum("ij,ij->i", normal, xyz) > 0
    return np.asarray(np.where(away[:, None], -normal, normal))


def planes_of(
    xyz: Float, normal: Float, rng: np.random.Generator, *, least: int, band_m: float, normal_weight: float
) -> Int:
    """Return the plane (N,) that each point lies on, -1 for none: the largest ones that hold `least` points or more.

    The distance of a point is weighted as in PCL: (1 - w) times its distance, plus w times the angle of its normal.
    """
    plane, left = np.full(len(xyz), -1), np.arange(len(xyz))
    number = 0
    while len(left) >= max(least, 3):
        sample = left[rng.integers(len(left), size=min(_SCORED, len(left)))]
        corners = xyz[left[rng.integers(len(left), size=(_TRIED, 3))]]
        across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        size = np.linalg.norm(across, axis=1)
        good = size > 1e-6
        if not good.any():
            break
        across, origin = across[good] / size[good, None], corners[good, 0]
        offset = np.sum(across * origin, axis=1)
        off = _distance(xyz[sample], normal[sample], across, offset, normal_weight)
        best = int(np.argmax(np.count_nonzero(off < band_m, axis=0)))
        held = _distance(xyz[left], normal[left], across[[best]], offset[[best]], normal_weight)[:, 0] < band_m
        if np.count_nonzero(held) < least:
            break
        plane[left[held]] = number
        left, number = left[~held], number + 1
    return plane


def _distance(xyz: Float, normal: Float, across: Float, offset: Float, weight: float) -> Float:
    """Return the weighted distances (N, P) of points from planes (P, 3) with offsets (P,)."""
    angle = np.arccos(np.clip(np.abs(normal @ across.T), 0.0, 1.0))
    return np.asarray((1 - weight) * np.abs(xyz @ across.T - offset) + weight * angle)


def clusters_of(xyz: Float, tolerance_m: float, least: int, most: int) -> Int:
    """Return the cluster (N,) of each point, -1 for none: points that steps of `tolerance_m` or less lead between.

    Clusters of fewer than `least` or more than `most` points are none.
    """
    if not len(xyz):
        return np.zeros(0, np.int64)
    pairs = cKDTree(xyz).query_pairs(tolerance_m, output_type="ndarray")
    graph = coo_array((np.ones(len(pairs), np.bool_), (pairs[:, 0], pairs[:, 1])), shape=(len(xyz), len(xyz)))
    _, label = connected_components(graph, directed=False)
    size = np.bincount(label)
    kept = (size >= least) & (size <= most)
    number = np.where(kept, np.cumsum(kept) - 1, -1)
    return np.asarray(number[label])
