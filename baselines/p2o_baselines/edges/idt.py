"""Align depth discontinuities with the inverse distance transform of image edges, `--matcher idt`.

With `--extractor idt/ring-discontinuity --solver grid729 --init given`.

Levinson and Thrun, Automatic Online Calibration of Cameras and Lasers, RSS 2013.

- Image: E = the largest difference of a pixel to its eight neighbours; D = alpha E + (1 - alpha) max E gamma^distance
  with alpha = 1/3, gamma = 0.98 (theirs).
- Sweep: `ring-discontinuity`.
- Cost: minus the mean of X_i D(u_i) over all frames; the original uses about nine frames (`--joint`).
- Solver: `grid729`, the walk to the best of the 3^6 neighbours. `coordinate` and `nelder-mead` are possible as well.

Departures: the original sums X_i D(u_i), which favours poses that project more points into the image. Dividing by the
number of points in view favours poses that lose the worst ones (on synthetic streets one of three initial errors of 1
deg diverged to 3.6 deg). Therefore a point outside the image scores the mean of D, and the sum is divided by the weight
of all points. At most 1000 points per frame are used, within 100 px of the image at the first pose of a round. The
miscalibration test of the paper is not here. The original takes one step per frame indefinitely; `grid729` ends if no
neighbour is better. Raw sweeps are compensated for the motion that the pipeline predicts or estimates.
"""

from __future__ import annotations

import numpy as np
import p2o

from p2o_baselines import examples
from p2o_baselines.edges.inverse_distance import MapOptions, edge_strength, map_features, map_matcher


def extract(image: p2o.Image, options: MapOptions) -> p2o.ImageFeatures:
    """Return the inverse distance map of an image."""
    strength = edge_strength(image.grey)
    if image.masked is not None:
        strength = np.where(image.masked, 0.0, strength)
    return map_features(strength, options)


_MAX_POINTS = 1000  # largest number of cloud edges per frame


def build(options: p2o.Options) -> p2o.Matcher:
    """Return the matcher `(views, camera_from_lidar (4, 4), reach_px) -> Objective`."""
    return map_matcher(_MAX_POINTS)


IMAGE = p2o.Method(
    name="idt",
    build=lambda options: lambda image: extract(image, options),
    options=MapOptions,
    summary="Inverse distance transform of the largest grey-level difference to a neighbour.",
    gives={"image-idt"},
    cite="Levinson and Thrun, Automatic Online Calibration of Cameras and Lasers, RSS 2013",
)

METHOD = p2o.Method(
    name="idt",
    build=build,
    summary="Minus the mean of the inverse distance map at the weighted cloud edges.",
    needs={"image-idt", "cloud-edges"},
    gives={"objective"},
    cite="Levinson and Thrun, Automatic Online Calibration of Cameras and Lasers, RSS 2013",
    example=examples.streets(6, "idt/ring-discontinuity", "grid729", perturb="1deg 0.1m", within="0.2deg 0.06m"),
)
