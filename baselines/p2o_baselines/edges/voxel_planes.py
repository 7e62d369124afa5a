"""Extract edges where planes of a dense cloud meet, voxel by voxel, `--extractor canny-long/voxel-planes`.

Yuan et al., Pixel-level Extrinsic Self Calibration of High Resolution LiDAR and Camera in Targetless Environments, RA-L
2021: depth-continuous edges, because the edges of foreground objects are widened by the beam. Constants after
hku-mars/livox_camera_calib, outdoors:

- points downsampled to 0.02 m, voxels of 1 m with more than 50 points;
- planes by RANSAC, 0.015 m, at least 60 points, at most 5 per voxel;
- pairs of planes at 30 to 150 deg, their line cut at the border of the voxel and sampled;
- a sample is kept if one plane has a point within 0.03 m of it and the other within 0.06 m; more than 10 samples per
  line.

For clouds of 1e5 points per frame and more: static Livox units, or `--accumulate poses`. A single sweep of a spinning
LiDAR gives almost no edges, on KITTI none.

Departures: 200 samples of three points instead of 500; lines are sampled every 0.02 m instead of 0.005 m
(neighbours within a pixel are merged in their code); the two distance thresholds grow with the point spacing of the
voxel, since sweeps accumulated from a moving car are sparser and noisier than theirs.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import combinations

import numpy as np
import p2o
from p2o import Float, Int, field
from p2o.solving import one_per_voxel
from scipy.spatial import cKDTree

_MIN_POINTS = 50  # voxels with no more points than this are passed over
_SAMPLES = 200  # random samples of three points for each plane
_NEAR_M = 0.03  # farthest point of one plane from an edge, or the usual gap between its points; twice that of the other
_SAMPLE_M = 0.02  # distance between samples of an edge
_MIN_SAMPLES = 10  # drop edges with at most this many samples of 5 mm each
_THIN_M = 0.02  # cubes of this side keep one point
_MAX_RANGE_M = 60.0  # drop points farther than this


class VoxelPlanesOptions(p2o.Options):
    """Options of `voxel-planes`."""

    voxel_m: float = field(1.0, gt=0, le=20, help="Side of a voxel in metres (outdoors; indoors 0.5).")
    plane_m: float = field(0.015, gt=0, le=1, help="Points this near to a plane belong to it (indoors 0.02).")
    plane_points: int = field(60, ge=3, help="Least points of a plane (indoors 30).")
    max_planes: int = field(5, ge=2, le=50, help="Planes of a voxel at most (indoors 8).")
    min_angle_deg: float = field(30.0, ge=0, lt=90, help="Least angle between two planes (indoors 45).")


def extract(cloud: p2o.Cloud, options: VoxelPlanesOptions) -> p2o.CloudFeatures:
    """Return the edges where planes of a sweep meet."""
    parts = [xyz for xyz, _ in plane_edges(cloud.xyz, options)]
    xyz = np.concatenate(parts) if parts else np.zeros((0, 3))
    return p2o.CloudFeatures(p2o.CloudEdges(xyz, np.full(len(xyz), p2o.Side.NONE, np.int8)))


def plane_edges(
    xyz: Float, options: VoxelPlanesOptions, max_range_m: float = _MAX_RANGE_M
) -> Iterator[tuple[Float, Float]]:
    """Yield the samples (S, 3) m and the ends (2, 3) m of each edge where two planes of one voxel meet."""
    xyz = xyz[np.linalg.norm(xyz, axis=1) <= max_range_m]
    xyz = xyz[np.lexsort(xyz.T)]  # points in another order are the same cloud
    xyz = xyz[one_per_voxel(xyz, _THIN_M)] if len(xyz) else xyz
    cell = np.floor(xyz / options.voxel_m).astype(np.int64)
    order = np.lexsort(cell.T)
    new = np.flatnonzero((np.diff(cell[order], axis=0) != 0).any(axis=1)) + 1
    for rows in np.split(order, new):
        if len(rows) <= _MIN_POINTS:
            continue
        # Seed by position, so that other voxels do not change the random samples of this one.
        rng = np.random.default_rng([0, *(cell[rows[0]] & 0xFFFFFFFF).tolist()])
        planes = list(_planes(xyz[rows], rng, options))
        low = cell[rows[0]] * options.voxel_m
        for one, two in combinations(planes, 2):
            yield from _edge(one, two, low, options)


Plane = tuple[Float, float, Float]
"""Unit normal (3,), offset with normal . x = offset, and the plane's points (N, 3)."""


def _planes(xyz: Float, rng: np.random.Generator, options: VoxelPlanesOptions) -> Iterator[Plane]:
    left = xyz
    for _ in range(options.max_planes):
        if len(left) < options.plane_points:
            return
        inside = _most_inside(left, rng, options)
        if inside.sum() < options.plane_points:
            return
        points = left[inside]
        centre = points.mean(axis=0)
        normal = np.linalg.svd(points - centre, full_matrices=False)[2][2]
        yield normal, float(normal @ centre), points
        left = left[~inside]


def _most_inside(xyz: Float, rng: np.random.Generator, options: VoxelPlanesOptions) -> Int:
    """Return which points (N,) are near the plane through three of them that most are near to."""
    some = xyz if len(xyz) <= 400 else xyz[rng.choice(len(xyz), 400, replace=False)]
    corner = some[rng.integers(0, len(some), (_SAMPLES, 3))]
    normal = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    length = np.linalg.norm(normal, axis=1, keepdims=True)
    normal = np.divide(normal, length, out=np.zeros_like(normal), where=length > 1e-9)
    offset = (normal * corner[:, 0]).sum(axis=1)
    count = (np.abs(some @ normal.T - offset) <= options.plane_m).sum(axis=0) * (length[:, 0] > 1e-9)
    best = int(np.argmax(count))
    return np.asarray(np.abs(xyz @ normal[best] - offset[best]) <= options.plane_m)


def _edge(one: Plane, two: Plane, low: Float, options: VoxelPlanesOptions) -> Iterator[tuple[Float, Float]]:
    """Yield samples and ends of the line where two planes meet within the voxel with the corner `low` (3,), if any."""
    if abs(float(one[0] @ two[0])) > np.cos(np.radians(options.min_angle_deg)):
        return
    along = np.cross(one[0], two[0])
    along /= np.linalg.norm(along)
    middle = low + 0.5 * options.voxel_m
    # The point of both planes that is nearest to the middle of the voxel.
    point = np.linalg.solve(np.vstack([one[0], two[0], along]), np.array([one[1], two[1], along @ middle]))
    with np.errstate(divide="ignore", invalid="ignore"):
        reach = (np.stack([low, low + options.voxel_m]) - point) / along
    first, last = np.nanmax(reach.min(axis=0)), np.nanmin(reach.max(axis=0))
    if not first < last:
        return
    at = np.arange(first, last, _SAMPLE_M)
    xyz = point + at[:, None] * along
    nearest = []
    for _, _, points in (one, two):
        tree = cKDTree(points)
        gap = float(np.median(np.asarray(tree.query(points, k=2)[0])[:, 1]))
        limit = max(_NEAR_M, gap)
        nearest.append(np.asarray(tree.query(xyz)[0]) / limit)
    closer, farther = np.minimum(*nearest), np.maximum(*nearest)
    kept = xyz[(closer < 1.0) & (farther < 2.0)]
    # Their ten samples are 5 mm apart.
    if len(kept) and len(kept) * _SAMPLE_M > _MIN_SAMPLES * 0.005:
        yield kept, kept[[0, -1]]


METHOD = p2o.Method(
    name="voxel-planes",
    build=lambda options: lambda cloud: extract(cloud, options),
    options=VoxelPlanesOptions,
    summary="Intersections of two planes in a voxel of a dense cloud.",
    gives={"cloud-edges"},
    cite="Yuan et al., Pixel-level Extrinsic Self Calibration of High Resolution LiDAR and Camera, RA-L 2021",
    expected_failures=(
        ("cloud_edges_lie_on_outlines", "it extracts edges between planes, not occluding outlines"),
        ("cloud_edges_lie_on_surfaces", "no two planes of the stage intersect, so it has no edges"),
    ),
)
