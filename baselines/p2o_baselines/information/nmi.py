"""Maximise normalised mutual information, `--matcher nmi`, after Taylor and Nieto (ICRA 2013).

Grey value and reflectance of the points, or the steepness of their surfaces (`by=normals`, with `--set
cloud.normal_neighbours=20`), both equalised, are counted in a joint histogram for each frame; the cost is -(H(X) +
H(Y)) / H(X, Y), its mean over frames. Intended for the paper's `--solver particle-swarm` with `--set
pipeline.rounds=1`.

Ours, since the parameters of the paper are not known to us: 16 levels, the nearest pixel of each point, a weight that
decreases over the last 10 px to the border, and the angle of the normal to the z axis of the LiDAR as the quantity that
determines shading. With more levels than the points can fill, the measure increases when points leave the image.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Literal

import p2o
from p2o import Float, field
from p2o.solving import Objective

from p2o_baselines import examples
from p2o_baselines.information.histogram import NMI, Hard, Plain, ranked_levels
from p2o_baselines.information.information import Information, SeenPoints, remembered, sightings

_POINTS = 20_000  # largest number of points per view


class NmiOptions(p2o.Options):
    """Options of `nmi`."""

    by: Literal["reflectance", "normals"] = field("reflectance", help="Compare reflectance, or steepness of surfaces.")
    bins: int = field(16, ge=2, le=1024, help="Levels of grey, and of the points' values.")


def build(options: NmiOptions) -> p2o.Matcher:
    """Return the matcher `(views, camera_from_lidar (4, 4), reach_px) -> Objective`: minus their information."""
    levels: Callable[[p2o.GreyMap], Hard] = remembered(
        lambda grey: Hard(ranked_levels(grey.values, options.bins), options.bins)
    )

    def match(views: Sequence[p2o.View], camera_from_lidar: Float, reach_px: float) -> Objective:
        near = [s.near_image(camera_from_lidar, _POINTS) for s in sightings(views, options.by)]
        groups = tuple(
            (SeenPoints(s.camera, levels(s.grey), s.xyz, ranked_levels(s.value, options.bins), options.bins),)
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
    example=examples.information(2, "particle-swarm", "pipeline.rounds=1", perturb="3deg 0.2m", within="0.4deg 0.05m"),
)
