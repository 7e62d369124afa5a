"""Points of a sweep with their reflectance, `--extractor IMAGE/reflectance`, on demand with surface normals."""

from __future__ import annotations

from typing import Literal

import numpy as np
import p2o
from p2o import Float, Int, field
from p2o.reading import RingsUnknownError, told_rings
from scipy.spatial import cKDTree

from p2o_baselines.information.histogram import by_rank
from p2o_baselines.point_feature import raw_times, rows_in_range

_POINTS = 400_000  # largest number of points, evenly sampled


class ReflectanceOptions(p2o.Options):
    """Options of `reflectance`."""

    min_range_m: float = field(1.5, ge=0, le=1000, help="Drop points nearer than this, on the car itself.")
    max_range_m: float = field(80.0, gt=1, le=1000, help="Drop points farther than this.")
    equalise: Literal["none", "sweep", "ring", "auto"] = field(
        "none",
        help="Replace intensities by ranks in the sweep, which matchers that need that do themselves; or in each ring, "
        "for lasers that are not calibrated to each other; `auto`: ring, or sweep where rings are not observable.",
    )
    normal_neighbours: int = field(0, ge=0, le=200, help="Neighbours for surface normals (3 or more); 0: none.")


def extract(cloud: p2o.Cloud, options: ReflectanceOptions) -> p2o.CloudFeatures:
    """Return `cloud-points` of a sweep."""
    near = rows_in_range(cloud, options.max_range_m, options.min_range_m)
    xyz = cloud.xyz[near]
    normal = None
    if options.normal_neighbours and len(near) >= max(options.normal_neighbours, 3):
        normal = normals(xyz, max(options.normal_neighbours, 3))
    intensity = None if cloud.intensity is None else cloud.intensity[near]
    if intensity is not None and options.equalise != "none":
        ring = None if options.equalise == "sweep" else _known_rings(cloud, required=options.equalise == "ring")
        intensity = by_rank(intensity) if ring is None else ranked_by_ring(intensity, ring[near])
    points = p2o.CloudPoints(xyz, intensity, normal, raw_times(cloud, near))
    return p2o.CloudFeatures(points=points.thinned(_POINTS))


def rings(cloud: p2o.Cloud) -> Int:
    """Return the ring (N,) of each point; raises InputError if it is neither given nor observable."""
    if cloud.ring is not None:
        return cloud.ring
    x, y, z = cloud.xyz.T.astype(np.float32)
    azimuth = np.mod(np.arctan2(y, x), np.float32(2 * np.pi))
    return told_rings(azimuth, z / np.maximum(np.hypot(x, y), np.float32(1e-6)))[0]


def _known_rings(cloud: p2o.Cloud, required: bool) -> Int | None:
    """Return the rings of a cloud; None if they are unknown and not required."""
    try:
        return rings(cloud)
    except RingsUnknownError:
        if required:
            raise
        return None


def ranked_by_ring(values: Float, ring: Int) -> Float:
    """Return values (N,) replaced by their ranks in (0, 1) among those of the same ring (N,)."""
    out = np.empty(len(values))
    for number in np.unique(ring):
        out[ring == number] = by_rank(values[ring == number])
    return out


def normals(xyz: Float, neighbours: int) -> Float:
    """Return unit normals (N, 3) towards the LiDAR of points (N, 3), from planes through their nearest neighbours."""
    near = xyz[cKDTree(xyz).query(xyz, neighbours)[1]]
    apart = near - near.mean(axis=1, keepdims=True)
    normal = np.linalg.eigh(np.einsum("nki,nkj->nij", apart, apart))[1][:, :, 0]
    away = (normal * xyz).sum(axis=1) > 0
    return np.where(away[:, None], -normal, normal)


METHOD = p2o.Method(
    name="reflectance",
    build=lambda options: lambda cloud: extract(cloud, options),
    options=ReflectanceOptions,
    summary="Points with their intensity within bounds of range, on demand with normals.",
    needs={"intensity"},
    gives={"cloud-points"},
    cite="Hoppe et al., Surface reconstruction from unorganized points, SIGGRAPH 1992 (normals)",
)
