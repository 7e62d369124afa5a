"""Normalised information distance of what the camera sees, `--matcher nid`, after Koide et al. (ICRA 2023).

Reflectance and grey, both equalised, in 16 levels; every point is shared among 4x4 pixels by cubic B-splines, each of
which counts in the level of its grey; the cost is (H(X, Y) - MI) / H(X, Y), its mean over frames, with analytic
derivatives. Points that others hide (more than 0.1 m behind the nearest one of their pixel) are chosen anew in every
round. Made for `--solver bfgs`, whose box of 2 deg and 0.2 m is the paper's, with
`--set pipeline.reach_px=5 --set pipeline.tolerance_deg=0.5 --set pipeline.tolerance_m=0.1`: the paper's outer loop, ten
rounds at most. The paper joins sweeps first: use `--accumulate poses` where frames are of a drive.

Departures: its start from SuperGlue matches is left out (weights that may not be used freely); points that lie a little
out of the picture take part, since they may come in; logarithms need no offset of 1e-6, as empty cells count nothing;
the mean over frames is their sum.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import p2o
from p2o.arrays import Float

from p2o_baselines.boards_in_a_yard import boards_in_a_yard
from p2o_baselines.histogram import NID, Plain
from p2o_baselines.information import SeenPoints, SmoothInformation, sightings
from p2o_baselines.picture_levels import Spline
from p2o_baselines.rank import by_rank
from p2o_baselines.remembered import remembered


class NidOptions(p2o.Options):
    """Options of `nid`."""

    bins: int = p2o.field(16, ge=2, le=256, help="Levels of grey, and of reflectance.")
    cell_px: float = p2o.field(1.0, gt=0, le=64, help="Cells in which the nearest point hides others, in pixels.")
    slack_m: float = p2o.field(0.1, ge=0, le=100, help="Points are seen that are at most so far behind the nearest.")
    points: int = p2o.field(50_000, ge=100, le=10_000_000, help="Points of each view that count, at most.")


def build(options: NidOptions) -> p2o.Matcher:
    """Return the matcher `(views, camera_from_lidar (4, 4), reach_px) -> Objective`: the information distance."""

    def levels_of(grey: p2o.GreyMap) -> Spline:
        return Spline((by_rank(grey.values) * options.bins).astype(np.int64), options.bins)

    levels = remembered(levels_of)

    def match(views: Sequence[p2o.View], camera_from_lidar: Float, reach_px: float) -> p2o.Objective:
        groups = []
        for sighting in sightings(views):
            seen = sighting.visible(camera_from_lidar, options.cell_px, options.slack_m)
            s = seen.near_picture(camera_from_lidar, options.points)
            if len(s.xyz):
                row = (by_rank(s.value) * options.bins).astype(np.int64)
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
    example=boards_in_a_yard(
        4,
        "bfgs",
        "pipeline.reach_px=5",
        "pipeline.tolerance_deg=0.5",
        "pipeline.tolerance_m=0.1",
        perturb="2deg 0.1m",
        within="0.15deg 0.02m",
    ),
)
