"""Minimise the normalised information distance of visible points, `--matcher nid`, after Koide et al. (ICRA 2023).

Reflectance and grey, both equalised, in 16 levels; every point is distributed over 4x4 pixels by cubic B-splines, each
of which counts in the level of its grey; the cost is (H(X, Y) - MI) / H(X, Y), its mean over frames, with analytic
derivatives. Occluded points (more than 0.1 m behind the nearest one of their pixel) are determined again in every
round. The paper descends by `--solver bfgs`, whose box of 2 deg and 0.2 m is the paper's, with `--set
pipeline.reach_px=5 --set pipeline.tolerance_deg=0.5 --set pipeline.tolerance_m=0.1`: its outer loop, at most ten
rounds. `--method nid` searches the same box by `cma-es` in one round, with reflectances ranked in each ring
(`cloud.equalise=auto`), because the descent ends at local minima, as in `mi`. The paper accumulates sweeps first: use
`--accumulate poses` for the frames of a drive.

Points that are outside the image at the pose of a round are left out of it, as in the code of the authors.

Departures: its initial guess from SuperGlue matches is left out (the licence of the weights is restricted); the weight
of a point decreases over the last 10 px to the border, so that the cost has no steps there; logarithms need no offset
of 1e-6, because empty cells do not contribute; the mean over frames replaces the sum; the extractor `grey` blurs by
1 px.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import p2o
from p2o import Float, field
from p2o.solving import Objective

from p2o_baselines import examples
from p2o_baselines.information.histogram import NID, Plain, Spline, ranked_levels
from p2o_baselines.information.information import SeenPoints, SmoothInformation, remembered, sightings

_CELL_PX = 1.0  # cell size of the occlusion test, in pixels
_SLACK_M = 0.1  # largest distance of a visible point behind the nearest one
_POINTS = 50_000  # largest number of points per view


class NidOptions(p2o.Options):
    """Options of `nid`."""

    bins: int = field(16, ge=2, le=256, help="Levels of grey, and of reflectance.")


def build(options: NidOptions) -> p2o.Matcher:
    """Return the matcher `(views, camera_from_lidar (4, 4), reach_px) -> Objective`: the information distance."""
    levels: Callable[[p2o.GreyMap], Spline] = remembered(
        lambda grey: Spline(ranked_levels(grey.values, options.bins).astype(np.uint8), options.bins)
    )

    def match(views: Sequence[p2o.View], camera_from_lidar: Float, reach_px: float) -> Objective:
        groups = []
        for sighting in sightings(views):
            seen = sighting.visible(camera_from_lidar, _CELL_PX, _SLACK_M)
            s = seen.near_image(camera_from_lidar, _POINTS, margin_deg=0.0)
            if len(s.xyz):
                row = ranked_levels(s.value, options.bins)
                groups.append((SeenPoints(s.camera, levels(s.grey), s.xyz, row, options.bins),))
        return SmoothInformation(tuple(groups), (Plain(),) * len(groups), NID).objective()

    return match


METHOD = p2o.Method(
    name="nid",
    build=build,
    options=NidOptions,
    summary="Normalised information distance of reflectance and grey at the points that the camera sees.",
    needs={"image-grey", "cloud-points"},
    gives={"objective"},
    cite="Koide, Oishi, Yokozuka and Banno, General, single-shot, target-less, and automatic LiDAR-camera extrinsic "
    "calibration toolbox, ICRA 2023",
    example=examples.information(
        4,
        "bfgs",
        "pipeline.reach_px=5",
        "pipeline.tolerance_deg=0.5",
        "pipeline.tolerance_m=0.1",
        perturb="2deg 0.1m",
        within="0.15deg 0.02m",
    ),
)
