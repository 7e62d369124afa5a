"""Return the points of a sweep unchanged, `--extractor .../returns`: for methods that use depth alone."""

from __future__ import annotations

import p2o

from p2o_baselines.point_feature import raw_times, rows_in_range

_MAX_RANGE_M = 80.0  # drop points farther than this
_POINTS = 60_000  # largest number of points per sweep, evenly sampled


def extract(cloud: p2o.Cloud) -> p2o.CloudFeatures:
    """Return the points of a sweep, in the order of their places."""
    near = rows_in_range(cloud, _MAX_RANGE_M)
    strength = None if cloud.intensity is None else cloud.intensity[near]
    points = p2o.CloudPoints(cloud.xyz[near], strength, time_s=raw_times(cloud, near))
    return p2o.CloudFeatures(points=points.thinned(_POINTS))


METHOD = p2o.Method(
    name="returns",
    build=lambda options: extract,
    summary="The returns of the sweep, evenly sampled.",
    gives={"cloud-points"},
)
