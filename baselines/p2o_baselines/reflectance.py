"""Points of a sweep with their reflectance, `--extractor IMAGE/reflectance`, on demand with surface normals."""

from __future__ import annotations

import numpy as np
import p2o
from p2o.arrays import Float
from scipy.spatial import cKDTree

from p2o_baselines.rank import by_rank


class ReflectanceOptions(p2o.Options):
    """Options of `reflectance`."""

    min_range_m: float = p2o.field(1.5, ge=0, le=1000, help="Nearer points are left out: the own car.")
    max_range_m: float = p2o.field(80.0, gt=1, le=1000, help="Points farther off are left out.")
    points: int = p2o.field(
        400_000, ge=100, le=10_000_000, help="Points that are kept at most, spread evenly; joined sweeps have many."
    )
    equalise: bool = p2o.field(
        False,
        help="Replace intensities by their ranks, 0 to 1: all values are equally frequent then. Matchers that want "
        "equal shares equalise by themselves.",
    )
    normal_neighbours: int = p2o.field(
        0, ge=0, le=200, help="Find surface normals from so many neighbours (3 or more); 0 finds none."
    )


def build(options: ReflectanceOptions) -> p2o.CloudExtractor:
    """Return the extractor `Cloud -> CloudFeatures` with `cloud-points`."""

    def extract(cloud: p2o.Cloud) -> p2o.CloudFeatures:
        distance = np.linalg.norm(cloud.xyz, axis=1)
        near = np.flatnonzero((distance >= options.min_range_m) & (distance <= options.max_range_m))
        # In the order of their places: points in another order are the same sweep.
        near = near[np.lexsort(cloud.xyz[near].T)]
        xyz = cloud.xyz[near]
        normal = None
        if options.normal_neighbours and len(near) >= max(options.normal_neighbours, 3):
            normal = normals(xyz, max(options.normal_neighbours, 3))
        intensity = None if cloud.intensity is None else cloud.intensity[near]
        if intensity is not None and options.equalise:
            intensity = by_rank(intensity)
        time_s = None if cloud.time_s is None or cloud.twist is not None else cloud.time_s[near]
        found = p2o.CloudPoints(xyz, intensity, normal, time_s)
        return p2o.CloudFeatures(points=found.thinned(options.points))

    return extract


def normals(xyz: Float, neighbours: int) -> Float:
    """Return unit normals (N, 3) towards the LiDAR of points (N, 3), from planes through their nearest neighbours."""
    near = xyz[cKDTree(xyz).query(xyz, neighbours)[1]]
    apart = near - near.mean(axis=1, keepdims=True)
    normal = np.linalg.eigh(np.einsum("nki,nkj->nij", apart, apart))[1][:, :, 0]
    away = (normal * xyz).sum(axis=1) > 0
    return np.where(away[:, None], -normal, normal)


METHOD = p2o.Method(
    name="reflectance",
    build=build,
    options=ReflectanceOptions,
    summary="Points with their intensity within bounds of range, on demand with normals.",
    needs={"intensity"},
    gives={"cloud-points"},
    cite="Hoppe et al., Surface reconstruction from unorganized points, SIGGRAPH 1992 (normals)",
)
