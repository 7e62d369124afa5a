"""Returns of a sweep as they are, `--extractor .../returns`: for methods that look at depth alone."""

from __future__ import annotations

import numpy as np
import p2o


class ReturnsOptions(p2o.Options):
    """Options of `returns`."""

    points: int = p2o.field(60_000, ge=100, le=10_000_000, help="Points of a sweep that are kept, spread evenly.")
    max_range_m: float = p2o.field(80.0, gt=1, le=1000, help="Points farther off are left out.")


def build(options: ReturnsOptions) -> p2o.CloudExtractor:
    """Return the extractor of the points of a sweep, in the order of their places."""

    def extract(cloud: p2o.Cloud) -> p2o.CloudFeatures:
        near = np.flatnonzero(np.linalg.norm(cloud.xyz, axis=1) <= options.max_range_m)
        # Sorted by place: points in another order are the same sweep.
        near = near[np.lexsort(cloud.xyz[near].T)]
        time_s = None if cloud.time_s is None or cloud.twist is not None else cloud.time_s[near]
        strength = None if cloud.intensity is None else cloud.intensity[near]
        found = p2o.CloudPoints(cloud.xyz[near], strength, time_s=time_s)
        return p2o.CloudFeatures(points=found.thinned(options.points))

    return extract


METHOD = p2o.Method(
    name="returns",
    build=build,
    options=ReturnsOptions,
    summary="The returns of the sweep, spread evenly.",
    gives={"cloud-points"},
)
