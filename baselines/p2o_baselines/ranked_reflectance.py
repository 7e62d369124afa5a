"""Points of a sweep with the rank of their reflectance, `--extractor IMAGE/ranked-reflectance`, for `mi`.

The lasers of a LiDAR return different intensities for the same surface unless they are calibrated to each other. The
ranks within each ring do not depend on that, if all rings observe similar surfaces. Sweeps without observable rings,
such as those of a single laser, are ranked as a whole.
"""

from __future__ import annotations

import p2o
from p2o import field
from p2o.reading import RingsUnknownError

from p2o_baselines import reflectance


class RankedReflectanceOptions(p2o.Options):
    """Options of `ranked-reflectance`."""

    min_range_m: float = field(1.5, ge=0, le=1000, help="Drop points nearer than this, on the car itself.")
    max_range_m: float = field(80.0, gt=1, le=1000, help="Drop points farther than this.")
    points: int = field(400_000, ge=100, le=10_000_000, help="Largest number of points, evenly sampled.")


def extract(cloud: p2o.Cloud, options: RankedReflectanceOptions) -> p2o.CloudFeatures:
    """Return `cloud-points` with ranks between 0 and 1 as intensities."""
    settings = {name: getattr(options, name) for name in RankedReflectanceOptions.model_fields}
    try:
        return reflectance.extract(cloud, reflectance.ReflectanceOptions(equalise="ring", **settings))
    except RingsUnknownError:
        return reflectance.extract(cloud, reflectance.ReflectanceOptions(equalise="sweep", **settings))


METHOD = p2o.Method(
    name="ranked-reflectance",
    build=lambda options: lambda cloud: extract(cloud, options),
    options=RankedReflectanceOptions,
    summary="Points with the rank of their intensity in their ring, or in a sweep without observable rings.",
    needs={"intensity"},
    gives={"cloud-points"},
    cite="Levinson and Thrun, Unsupervised calibration for multi-beam lasers, ISER 2010 (lasers need calibration)",
)
