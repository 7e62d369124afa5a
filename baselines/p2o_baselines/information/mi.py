"""Maximise mutual information of reflectance and grey value, `--matcher mi`, after Pandey et al. (AAAI 2012; JFR 2015).

All points projected into the image, of all frames, are counted in one joint histogram of 256 by 256 levels, which is
smoothed by a Gaussian kernel of Silverman's width on each axis (1.06 sigma n^(-1/5)) or, after the paper of 2015,
shrunk towards equal probabilities (`estimator=james-stein`). Intended for the paper's `--solver barzilai-borwein` with
`--set pipeline.rounds=1`; results have the Cramer-Rao bound as covariance.

`per_frame` counts each frame in a histogram of its own and averages their information, which is not in the paper: grey
values of images with different exposures and scenes do not mix. A frame has fewer points and needs fewer levels:
`bins=32` and `estimator=counts`. On KITTI's `train` frames it is more accurate than the joint histogram, and therefore
`--method mi` has it, with two other departures from the paper: reflectances ranked in each ring (`cloud.equalise=auto`)
and a search by `cma-es`, because the descent ends at local minima.

Departures: a grey value between two levels is divided between both, so that the cost has an analytic gradient
(numerical in the original); kernels are those of the pose at which the matcher is called; reflectances are scaled to
the levels between their 0.1 % and 99.9 % quantiles. As in the paper, occlusion is ignored and points outside the image
are not counted; over the last 10 px to the border their weight decreases, so that the cost has no steps.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Literal

import p2o
from p2o import Float, field
from p2o.solving import Objective

from p2o_baselines import examples
from p2o_baselines.information.histogram import MI, Linear, Plain, Shrunk, Smoothed
from p2o_baselines.information.information import SeenPoints, SmoothInformation, Span, counts_of, remembered, sightings

_BANDWIDTH = 1.06  # kernel width over sigma n^(-1/5); 1.06 is Silverman's
_POINTS = 20_000  # largest number of points per view


class MiOptions(p2o.Options):
    """Options of `mi`."""

    bins: int = field(256, ge=2, le=1024, help="Levels of grey, and of reflectance.")
    estimator: Literal["kernel", "james-stein", "counts"] = field(
        "kernel", help="Shares of levels: smoothed by a Gaussian kernel, shrunk towards equal shares, or as counted."
    )
    per_frame: bool = field(False, help="Average the information of one histogram a frame, instead of a joint one.")


def estimator_of(group: Sequence[SeenPoints], camera_from_lidar: Float, options: MiOptions) -> Plain:
    """Return the estimator of probabilities for the points of a histogram, with kernels for those at a pose (4, 4)."""
    if options.estimator == "kernel":
        return Smoothed.by_silverman(counts_of(group, camera_from_lidar[None])[0], _BANDWIDTH)
    return Shrunk() if options.estimator == "james-stein" else Plain()


def build(options: MiOptions) -> p2o.Matcher:
    """Return the matcher `(views, camera_from_lidar (4, 4), reach_px) -> Objective`: minus mutual information."""
    levels: Callable[[p2o.GreyMap], Linear] = remembered(
        lambda grey: Linear(grey.values * ((options.bins - 1) / 255), options.bins)
    )

    def match(views: Sequence[p2o.View], camera_from_lidar: Float, reach_px: float) -> Objective:
        all_sightings = list(sightings(views))
        span = Span.of([sighting.value for sighting in all_sightings])
        near = [sighting.near_image(camera_from_lidar, _POINTS) for sighting in all_sightings]
        seen = tuple(
            SeenPoints(s.camera, levels(s.grey), s.xyz, span.levels(s.value, options.bins), options.bins)
            for s in near
            if len(s.xyz)
        )
        groups = tuple((part,) for part in seen) if options.per_frame else (seen,) if seen else ()
        estimators = tuple(estimator_of(group, camera_from_lidar, options) for group in groups)
        return SmoothInformation(groups, estimators, MI).objective()

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
    example=examples.information(
        4, "barzilai-borwein", "pipeline.rounds=1", perturb="2deg 0.1m", within="0.15deg 0.02m"
    ),
)
