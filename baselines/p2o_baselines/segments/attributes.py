"""Extract normals, reflectance and segments of points, `--extractor masks/attributes`, after CalibAnything.

Segments are planes by RANSAC (distance 0.2 m, normals weighted by 0.2, at least 2000 points) and Euclidean
clusters of the remaining points (50 to 10000 points).

Departures from the released code: planes are sampled from 4000 points with 300 trials each instead of all points with
3000; normals use the nearest 40 points of the sweep after voxel downsampling, as in the original with `is_down_sample`;
points beyond 60 m are dropped.
"""

from __future__ import annotations

import numpy as np
import p2o

from p2o_baselines.point_feature import raw_times, rows_in_range
from p2o_baselines.segments.cloud_segments import CloudSegments, clusters_of, normals_of, one_a_voxel, planes_of

_MAX_RANGE_M = 60.0  # drop points farther than this
_NEIGHBOURS = 40  # nearest neighbours for the fit of a normal
_PLANE_BAND_M = 0.2  # half thickness of a plane
_NORMAL_WEIGHT = 0.2  # weight of the normal's angle (rad) against the distance
_CLUSTER_LEAST = 50  # least number of points of a cluster
_CLUSTER_MOST = 10_000  # largest number of points of a cluster
_PLANE_POINTS = 2000  # least number of points of a plane
_CLUSTER_M = 0.25  # largest gap within a cluster
_POINTS = 40_000  # largest number of points per sweep, evenly sampled
_VOXEL_M = 0.1  # voxel size of downsampling


def extract(cloud: p2o.Cloud) -> p2o.CloudFeatures:
    """Return points of a sweep with normal, reflectance (1 without intensities) and segment."""
    near = rows_in_range(cloud, _MAX_RANGE_M)
    if len(near):
        near = near[one_a_voxel(cloud.xyz[near], _VOXEL_M)]
    if len(near) < _NEIGHBOURS:
        return p2o.CloudFeatures()
    xyz = cloud.xyz[near]
    normal = normals_of(xyz, _NEIGHBOURS)
    rng = np.random.default_rng(0)
    segment = planes_of(xyz, normal, rng, least=_PLANE_POINTS, band_m=_PLANE_BAND_M, normal_weight=_NORMAL_WEIGHT)
    loose = segment < 0
    cluster = clusters_of(xyz[loose], _CLUSTER_M, _CLUSTER_LEAST, _CLUSTER_MOST)
    segment[loose] = np.where(cluster >= 0, cluster + segment.max() + 1, -1)
    strength = np.ones(len(near)) if cloud.intensity is None else np.maximum(cloud.intensity[near], 0.0)
    # Scaled by the largest one, that of the code being at least 1.
    segments = CloudSegments(xyz, normal, strength / max(float(strength.max()), 1e-9), segment, raw_times(cloud, near))
    return p2o.CloudFeatures(features=[segments.thinned(_POINTS)])


METHOD = p2o.Method(
    name="attributes",
    build=lambda options: extract,
    summary="Points with their normal, reflectance, and the plane or cluster they belong to.",
    needs={"intensity"},
    gives={"cloud-segments"},
    cite="Luo et al., Calib-Anything: zero-training LiDAR-camera extrinsic calibration, arXiv 2306.02656, 2023",
)
