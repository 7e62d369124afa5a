"""Normalised mutual information, `--matcher nmi`, after Taylor and Nieto (ICRA 2013).

Grey value and reflectance of the points, or how steep their surfaces are (`by=normals`, with
`--set cloud.normal_neighbours=20`), both equalised, are counted in a joint histogram for each frame; the cost is
-(H(X) + H(Y)) / H(X, Y), its mean over frames. Made for `--solver particle-swarm`, the paper's, with
`--set pipeline.rounds=1`.

Ours, since the paper's figures are not known to us: 64 levels, 6,000 points a view, the nearest pixel of each, and the
normal's angle to the z axis of the LiDAR as what shading depends on.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

import numpy as np
import p2o
from p2o.arrays import Float

from p2o_baselines.boards_in_a_yard import boards_in_a_yard
from p2o_baselines.histogram import NMI, Plain
from p2o_baselines.information import Information, SeenPoints, sightings
from p2o_baselines.picture_levels import Hard
from p2o_baselines.rank import by_rank
from p2o_baselines.remembered import remembered


class NmiOptions(p2o.Options):
    """Options of `nmi`."""

    by: Literal["reflectance", "normals"] = p2o.field(
        "reflectance", help="What of the points goes with grey: reflectance, or the steepness of their surfaces."
    )
    bins: int = p2o.field(64, ge=2, le=1024, help="Levels of grey, and of the points' values.")
    points: int = p2o.field(6_000, ge=100, le=10_000_000, help="Points of each view that count, at most.")


def build(options: NmiOptions) -> p2o.Matcher:
    """Return the matcher `(views, camera_from_lidar (4, 4), reach_px) -> Objective`: minus their information."""

    def levels_of(grey: p2o.GreyMap) -> Hard:
        return Hard((by_rank(grey.values) * options.bins).astype(np.int64), options.bins)

    levels = remembered(levels_of)

    def match(views: Sequence[p2o.View], camera_from_lidar: Float, reach_px: float) -> p2o.Objective:
        near = [s.near_picture(camera_from_lidar, options.points) for s in sightings(views, options.by)]
        groups = tuple(
            (
                SeenPoints(
                    s.camera,
                    levels(s.grey),
                    s.xyz,
                    (by_rank(s.value) * options.bins).astype(np.int64),
                    options.bins,
                ),
            )
            for s in near
            if len(s.xyz)
        )
        return Information(groups, (Plain(),) * len(groups), NMI).objective()

    return match


METHOD = p2o.Method(
    name="nmi",
    build=build,
    options=NmiOptions,
    summary="Minus the normalised mutual information of grey with reflectance or with the steepness of surfaces.",
    needs={"image-grey", "cloud-points"},
    gives={"objective"},
    cite="Taylor and Nieto, Automatic calibration of lidar and camera images using normalized mutual information, ICRA "
    "2013",
    example=boards_in_a_yard(2, "particle-swarm", "pipeline.rounds=1", perturb="3deg 0.2m", within="0.4deg 0.05m"),
)
