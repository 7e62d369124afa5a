"""Mutual information of reflectance and grey value, `--matcher mi`, after Pandey et al. (AAAI 2012; JFR 2015).

All points that fall into the picture, of all frames, are counted in one joint histogram of 256 by 256 levels, which is
smoothed by a Gaussian kernel of Silverman's width on each axis (1.06 sigma n^(-1/5)) or, after the paper of 2015,
shrunk towards equal shares (`estimator=james-stein`). Made for `--solver barzilai-borwein`, the paper's, with
`--set pipeline.rounds=1`; results carry the Cramer-Rao bound as covariance.

Departures, ours: a grey value between two levels is shared by both, so that the cost has a gradient (theirs is
numeric); kernels are those of the pose that the matcher is asked at; reflectances are spread over the levels from their
thousandth to their 999th thousandth part. As in the paper no point counts as hidden, and what leaves the picture is not
counted.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

import p2o
from p2o.arrays import Float

from p2o_baselines.boards_in_a_yard import boards_in_a_yard
from p2o_baselines.histogram import MI, Estimator, Shrunk, Smoothed
from p2o_baselines.information import SeenPoints, SmoothInformation, Span, counts_of, sightings
from p2o_baselines.picture_levels import Linear
from p2o_baselines.remembered import remembered


class MiOptions(p2o.Options):
    """Options of `mi`."""

    bins: int = p2o.field(256, ge=2, le=1024, help="Levels of grey, and of reflectance.")
    estimator: Literal["kernel", "james-stein"] = p2o.field(
        "kernel", help="Shares of levels: smoothed by a Gaussian kernel, or shrunk towards equal shares."
    )
    bandwidth: float = p2o.field(
        1.06, gt=0, le=10, help="Width of the kernel as a multiple of sigma n^(-1/5); 1.06 is Silverman's."
    )
    points: int = p2o.field(20_000, ge=100, le=10_000_000, help="Points of each view that count, at most.")


def build(options: MiOptions) -> p2o.Matcher:
    """Return the matcher `(views, camera_from_lidar (4, 4), reach_px) -> Objective`: minus mutual information."""

    def levels_of(grey: p2o.GreyMap) -> Linear:
        return Linear(grey.values * ((options.bins - 1) / 255), options.bins)

    levels = remembered(levels_of)

    def match(views: Sequence[p2o.View], camera_from_lidar: Float, reach_px: float) -> p2o.Objective:
        found = list(sightings(views))
        span = Span.of([sighting.value for sighting in found])
        near = [sighting.near_picture(camera_from_lidar, options.points) for sighting in found]
        group = tuple(
            SeenPoints(s.camera, levels(s.grey), s.xyz, span.levels(s.value, options.bins), options.bins)
            for s in near
            if len(s.xyz)
        )
        if not group:
            return SmoothInformation((), (), MI).objective()
        estimator: Estimator = Shrunk()
        if options.estimator == "kernel":
            counts = counts_of(group, camera_from_lidar[None])[0]
            estimator = Smoothed.by_silverman(counts, options.bandwidth)
        return SmoothInformation((group,), (estimator,), MI).objective()

    return match


METHOD = p2o.Method(
    name="mi",
    build=build,
    options=MiOptions,
    summary="Minus the mutual information of reflectance and grey value, all frames in one smoothed histogram.",
    needs={"image-grey", "cloud-points"},
    gives={"objective"},
    cite="Pandey, McBride, Savarese and Eustice, Automatic targetless extrinsic calibration of a 3D LiDAR and camera "
    "by maximizing mutual information, AAAI 2012; Journal of Field Robotics 32, 2015",
    example=boards_in_a_yard(4, "barzilai-borwein", "pipeline.rounds=1", perturb="2deg 0.1m", within="0.15deg 0.02m"),
)
