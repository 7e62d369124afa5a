"""Normals, reflectance and segments of a sweep's points, `--extractor masks/attributes`, after CalibAnything.

Segments are planes by RANSAC (distance 0.2 m with the normals weighted by 0.2, as long as they hold `plane_points`)
and Euclidean clusters of what is left (50 to 10000 points).

Departures from the released code: planes are tried on 4000 points with 300 draws each, not on all with 3000; normals
look at the whole sweep's nearest 40 points after one point a voxel is taken, as theirs do with `is_down_sample`;
points beyond `max_range_m` are left out.
"""

from __future__ import annotations

import numpy as np
import p2o

from p2o_baselines.cloud_segments import CloudSegments, clusters_of, normals_of, one_a_voxel, planes_of


class AttributesOptions(p2o.Options):
    """Options of `attributes`; the defaults are those of CalibAnything where it names one."""

    voxel_m: float = p2o.field(0.1, gt=0, le=5, help="One point is kept in each cube of this size.")
    max_range_m: float = p2o.field(60.0, gt=1, le=1000, help="Points farther off are left out.")
    neighbours: int = p2o.field(40, ge=3, le=500, help="Nearest points that a normal is fitted to.")
    plane_points: int = p2o.field(2000, ge=10, help="Planes of fewer points are none.")
    plane_band_m: float = p2o.field(0.2, gt=0, le=5, help="Half thickness of a plane.")
    normal_weight: float = p2o.field(0.2, ge=0, lt=1, help="Weight of the normal's angle (rad) against the distance.")
    cluster_m: float = p2o.field(0.25, gt=0, le=5, help="Largest gap within a cluster.")
    cluster_least: int = p2o.field(50, ge=2, help="Clusters of fewer points are none.")
    cluster_most: int = p2o.field(10_000, ge=2, help="Clusters of more points are none.")
    points: int = p2o.field(40_000, ge=100, le=1_000_000, help="Points of a sweep that are kept, spread evenly.")
    seed: int = p2o.field(0, ge=0, help="Seed of the planes that are tried.")


def build(options: AttributesOptions) -> p2o.CloudExtractor:
    """Return the extractor of points with normal, reflectance (1 where there is none) and segment."""

    def extract(cloud: p2o.Cloud) -> p2o.CloudFeatures:
        near = np.flatnonzero(np.linalg.norm(cloud.xyz, axis=1) <= options.max_range_m)
        # Sorted by place: points in another order are the same sweep.
        near = near[np.lexsort(cloud.xyz[near].T)]
        if len(near):
            near = near[one_a_voxel(cloud.xyz[near], options.voxel_m)]
        if len(near) < options.neighbours:
            return p2o.CloudFeatures()
        xyz = cloud.xyz[near]
        normal = normals_of(xyz, options.neighbours)
        segment = planes_of(
            xyz,
            normal,
            np.random.default_rng(options.seed),
            least=options.plane_points,
            band_m=options.plane_band_m,
            normal_weight=options.normal_weight,
        )
        loose = segment < 0
        cluster = clusters_of(xyz[loose], options.cluster_m, options.cluster_least, options.cluster_most)
        segment[loose] = np.where(cluster >= 0, cluster + segment.max() + 1, -1)
        strength = np.ones(len(near)) if cloud.intensity is None else np.maximum(cloud.intensity[near], 0.0)
        time_s = None if cloud.time_s is None or cloud.twist is not None else cloud.time_s[near]
        # Scaled by the largest one, that of the code being at least 1.
        scaled = strength / max(float(strength.max()), 1e-9)
        found = CloudSegments(xyz, normal, scaled, segment, time_s)
        return p2o.CloudFeatures(features=[found.thinned(options.points)])

    return extract


METHOD = p2o.Method(
    name="attributes",
    build=build,
    options=AttributesOptions,
    summary="Points with their normal, reflectance, and the plane or cluster they belong to.",
    needs={"intensity"},
    gives={"cloud-segments"},
    cite="Luo et al., Calib-Anything: zero-training LiDAR-camera extrinsic calibration, arXiv 2306.02656, 2023",
)
