"""Align depth discontinuities with the inverse distance transform of image edges, `--matcher idt`.

With `--extractor idt/ring-discontinuity --solver grid729 --init given`.

Levinson and Thrun, Automatic Online Calibration of Cameras and Lasers, RSS 2013.

- Image: E = the largest difference of a pixel to its eight neighbours; D = alpha E + (1 - alpha) max E gamma^distance
  with alpha = 1/3, gamma = 0.98 (theirs).
- Sweep: `ring-discontinuity`.
- Cost: minus the mean of X_i D(u_i) over all frames; the original uses about nine frames (`--joint`).
- Solver: `grid729`, the walk to the best of the 3^6 neighbours. `coordinate` and `nelder-mead` are possible as well.
- Miscalibration test: F is the share of the 3^6 neighbours that score worse (`share_of_worse`), and `probability_right`
  fuses F over frames by two Gaussians, of right and of wrong poses.

Departures: the original sums X_i D(u_i), which favours poses that project more points into the image. Dividing by the
number of points in view favours poses that lose the worst ones (on synthetic streets one of three initial errors of 1
deg diverged to 3.6 deg). Therefore a point outside the image scores the mean of D, and the sum is divided by the weight
of all points. At most 1000 points per frame are used, within 100 px of the image at the first pose of a round. The
likelihoods of the authors are not published; ours are estimated from synthetic frames (`RIGHT`, `WRONG`;
`benchmarks/idt_likelihoods.py` of the tag `experiments-0.2`). The original takes one step per frame indefinitely;
`grid729` ends if no neighbour is better. Raw sweeps are compensated for the motion that the pipeline predicts or
estimates.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product
from typing import NamedTuple

import numpy as np
import p2o
from p2o import Float
from p2o.solving import Problem, pose_from_chart

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


NEIGHBOURS = np.array([step for step in product((-1.0, 0.0, 1.0), repeat=6) if any(step)])
"""The 728 ways (728, 6) to change some of the six unknowns by one step."""


class Likelihood(NamedTuple):
    """A Gaussian of F over frames."""

    mean: float
    deviation: float

    def log(self, share: Float) -> Float:
        """Return the logarithm of the density, but for a constant that all share."""
        return np.asarray(-0.5 * ((share - self.mean) / self.deviation) ** 2 - np.log(self.deviation))


RIGHT, WRONG = Likelihood(0.984, 0.030), Likelihood(0.560, 0.140)
"""F of single simulated frames at the truth, and 1 deg and 0.1 m from it (`idt_likelihoods.py`)."""


def share_of_worse(problem: Problem, camera_from_lidar: Float, step_deg: float = 0.25, step_m: float = 0.025) -> float:
    """Return F, the share of the 728 neighbours of a pose (4, 4) that cost more than the pose; steps are ours."""
    around = pose_from_chart(camera_from_lidar, NEIGHBOURS * np.repeat([np.radians(step_deg), step_m], 3))
    own, costs = problem.cost(np.asarray(camera_from_lidar)[None])[0], problem.cost(around)
    return float(np.mean(costs > own))


def probability_right(shares: Sequence[float], prior: float = 0.5) -> float:
    """Return the probability that a pose is right, from F of frames metres apart, which are assumed independent."""
    share = np.asarray(shares, np.float64)
    odds = np.log(prior / (1 - prior)) + float((RIGHT.log(share) - WRONG.log(share)).sum())
    return float(1 / (1 + np.exp(np.clip(-odds, -700, 700))))


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
