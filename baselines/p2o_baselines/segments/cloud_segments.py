"""Segments of a sweep: points with normal, reflectance and segment as a feature, planes, clusters, and the ground."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from p2o import Float, Int
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from p2o_baselines.point_feature import PointFeature

_SCORED = 4000  # points that planes are tried on
_TRIED = 300  # planes that are tried for each that is taken
_POLISHED = 5  # least squares through the points of the ground


@dataclass(frozen=True, eq=False)
class CloudSegments(PointFeature):
    """Points (N, 3) m with unit normals (N, 3), strength 0 to 1, segment or -1, and time (s) in a raw sweep, (N,)."""

    word: ClassVar[str] = "cloud-segments"

    xyz: Float
    normal: Float
    strength: Float
    segment: Int
    time_s: Float | None = None


def one_a_voxel(xyz: Float, size_m: float) -> Int:
    """Return the index of one point per occupied cube of `size_m`, in the order of the points (N, 3)."""
    cells = np.floor(xyz / size_m).astype(np.int64)
    cells -= cells.min(axis=0)
    span = cells.max(axis=0) + 1
    _, first = np.unique((cells[:, 0] * span[1] + cells[:, 1]) * span[2] + cells[:, 2], return_index=True)
    return np.asarray(np.sort(first))


def normals_of(xyz: Float, neighbours: int) -> Float:
    """Return unit normals (N, 3) of points (N, 3): across the flattest direction of the nearest ones, to the origin."""
    count = min(neighbours, len(xyz))
    near = cKDTree(xyz).query(xyz, k=count)[1].reshape(len(xyz), count)
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
    """Return the plane (N,) of each point, -1 for none, by PCL's weighted distances: at least `least` points each."""
    plane, left, number = np.full(len(xyz), -1), np.arange(len(xyz)), 0
    while len(left) >= max(least, 3):
        sample = left[rng.integers(len(left), size=min(_SCORED, len(left)))]
        across, size, corners = _through_triples(xyz[left], rng)
        good = size > 1e-6
        if not good.any():
            break
        across, origin = across[good] / size[good, None], corners[good, 0]
        offset = np.sum(across * origin, axis=1)
        off = _distance(xyz[sample], normal[sample], across, offset, normal_weight)
        best = int(np.argmax(np.count_nonzero(off < band_m, axis=0)))
        inside = _distance(xyz[left], normal[left], across[[best]], offset[[best]], normal_weight)[:, 0] < band_m
        if np.count_nonzero(inside) < least:
            break
        plane[left[inside]] = number
        left, number = left[~inside], number + 1
    return plane


def _through_triples(xyz: Float, rng: np.random.Generator) -> tuple[Float, Float, Float]:
    """Return normals (P, 3) of planes through random triples of points (N, 3), their lengths (P,), and the triples."""
    corners = xyz[rng.integers(len(xyz), size=(_TRIED, 3))]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    return normal, np.linalg.norm(normal, axis=1), corners


def ground_of(
    xyz: Float, rng: np.random.Generator, *, band_m: float = 0.2, max_tilt_deg: float = 20.0, reach_m: float = 40.0
) -> Float | None:
    """Return the plane (4,) n, d with |n| = 1 and n . x + d the height (m) above the ground, or None.

    `xyz` (N, 3) is in the LiDAR frame, z roughly up. The plane has the most points within `band_m` of all that are
    tilted by less than `max_tilt_deg` and lie below the sensor; it is then fitted by least squares.
    """
    near = xyz[np.hypot(xyz[:, 0], xyz[:, 1]) < reach_m]
    if len(near) < 10:
        return None
    sample = near[rng.integers(len(near), size=min(_SCORED, len(near)))]
    normal, size, corners = _through_triples(near, rng)
    normal = normal / np.maximum(size, 1e-12)[:, None]
    normal = np.where(normal[:, 2:] < 0, -normal, normal)
    height = -np.sum(normal * corners[:, 0], axis=1)
    good = (size > 1e-3) & (normal[:, 2] > np.cos(np.radians(max_tilt_deg))) & (height > 0)
    if not good.any():
        return None
    normal, height = normal[good], height[good]
    best = int(np.argmax(np.count_nonzero(np.abs(sample @ normal.T + height) < band_m, axis=0)))
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


def _distance(xyz: Float, normal: Float, across: Float, offset: Float, weight: float) -> Float:
    """Return the weighted distances (N, P) of points from planes (P, 3) with offsets (P,)."""
    angle = np.arccos(np.clip(np.abs(normal @ across.T), 0.0, 1.0))
    return np.asarray((1 - weight) * np.abs(xyz @ across.T - offset) + weight * angle)


def clusters_of(xyz: Float, tolerance_m: float, least: int, most: int) -> Int:
    """Return the Euclidean cluster (N,) of each point, -1 for none and for clusters with too few or too many points."""
    if not len(xyz):
        return np.zeros(0, np.int64)
    pairs = cKDTree(xyz).query_pairs(tolerance_m, output_type="ndarray")
    graph = coo_array((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(len(xyz), len(xyz)))
    _, label = connected_components(graph, directed=False)
    size = np.bincount(label)
    kept = (size >= least) & (size <= most)
    number = np.where(kept, np.cumsum(kept) - 1, -1)
    return np.asarray(number[label])
