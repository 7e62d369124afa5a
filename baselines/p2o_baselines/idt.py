"""Edges of the sweep on the inverse distance transform of image edges, `--matcher idt`.

With `--extractor idt/ring-discontinuity --solver grid729 --init given`.

Levinson and Thrun, Automatic Online Calibration of Cameras and Lasers, RSS 2013.

- Image: E = the largest difference of a pixel to its eight neighbours; D = alpha E + (1 - alpha) max E gamma^distance
  with alpha = 1/3, gamma = 0.98 (theirs).
- Sweep: `ring-discontinuity`.
- Cost: minus the mean of X_i D(u_i), of all frames together; they take about nine frames (`--joint`).
- Solver: `grid729`, the walk to the best of the 3^6 neighbours. `coordinate` and `nelder-mead` do as well.
- Is a calibration still right? F is the share of the 3^6 neighbours that score worse (`share_of_worse`), and
  `probability_right` fuses F over frames by two Gaussians, of right and of wrong poses.

Departures: they sum X_i D(u_i), which favours poses that push more points into the image. Dividing by the points in
view favours poses that push the worst ones out (on simulated streets one start of three from 1 deg ran to 3.6 deg). So
a point that leaves the image counts as the mean of D, and all are divided by the weight of all. Points are those within
100 px of the image at the pose that a round begins from, 1000 a frame at most. Their likelihoods are not to be had;
ours are learnt from simulated frames (`RIGHT`, `WRONG`; `python benchmarks/idt_likelihoods.py`). They walk one step a
frame and never end; `grid729` walks until no neighbour is better. Raw sweeps are compensated for the motion that
the pipeline expects or estimates.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product
from typing import NamedTuple

import numpy as np
import p2o
from p2o.arrays import Float
from p2o.problems.chart import pose_at

from p2o_baselines.inverse_distance import InverseDistanceMap, edge_strength, inverse_distance, mean_on_maps, on_maps


class ImageOptions(p2o.Options):
    """Options of the image extractor `idt`."""

    alpha: float = p2o.field(1 / 3, ge=0, le=1, help="Share of the edge image itself in the map.")
    gamma: float = p2o.field(0.98, gt=0.5, lt=1, help="What is left of an edge one pixel away from it.")


def build_image(options: ImageOptions) -> p2o.ImageExtractor:
    """Return the extractor of the inverse distance map."""

    def extract(image: p2o.Image) -> p2o.ImageFeatures:
        strength = edge_strength(image.grey)
        if image.masked is not None:
            strength = np.where(image.masked, 0.0, strength)
        return p2o.ImageFeatures(
            features=[InverseDistanceMap(inverse_distance(strength, options.alpha, options.gamma))]
        )

    return extract


class IdtOptions(p2o.Options):
    """Options of the matcher `idt`."""

    max_points: int = p2o.field(1000, ge=10, help="Cloud edges of a frame that are looked up, at most.")


def build(options: IdtOptions) -> p2o.Matcher:
    """Return the matcher `(views, camera_from_lidar (4, 4), reach_px) -> Objective`; it looks at views alone."""

    def match(views: Sequence[p2o.View], camera_from_lidar: Float, reach_px: float) -> p2o.Objective:
        parts = on_maps(views, camera_from_lidar, options.max_points)
        return p2o.Objective(lambda poses: -mean_on_maps(parts, poses), lasting=True)

    return match


NEIGHBOURS = np.array([step for step in product((-1.0, 0.0, 1.0), repeat=6) if any(step)])
"""The 728 ways (728, 6) to change some of the six unknowns by one step."""

STEP_DEG, STEP_M = 0.25, 0.025
"""Steps of the test; ours."""


class Likelihood(NamedTuple):
    """A Gaussian of F over frames."""

    mean: float
    deviation: float

    def log(self, share: Float) -> Float:
        """Return the logarithm of the density, but for a constant that all share."""
        return np.asarray(-0.5 * ((share - self.mean) / self.deviation) ** 2 - np.log(self.deviation))


RIGHT, WRONG = Likelihood(0.984, 0.030), Likelihood(0.560, 0.140)
"""F of single simulated frames at the truth, and 1 deg and 0.1 m from it (`python benchmarks/idt_likelihoods.py`)."""


def share_of_worse(
    problem: p2o.Problem, camera_from_lidar: Float, step_deg: float = STEP_DEG, step_m: float = STEP_M
) -> float:
    """Return F, the share of the 728 neighbours of a pose (4, 4) that cost more than the pose itself."""
    around = pose_at(camera_from_lidar, NEIGHBOURS * np.repeat([np.radians(step_deg), step_m], 3))
    own, costs = problem.cost(np.asarray(camera_from_lidar)[None])[0], problem.cost(around)
    return float(np.mean(costs > own))


def probability_right(shares: Sequence[float], prior: float = 0.5) -> float:
    """Return the probability that a pose is right, from F of each of several frames.

    Frames count as independent, which frames of one place are not: take some that are metres apart.
    """
    told = np.asarray(shares, np.float64)
    odds = np.log(prior / (1 - prior)) + float((RIGHT.log(told) - WRONG.log(told)).sum())
    return float(1 / (1 + np.exp(np.clip(-odds, -700, 700))))


IMAGE = p2o.Method(
    name="idt",
    build=build_image,
    options=ImageOptions,
    summary="Inverse distance transform of the largest grey-level difference to a neighbour.",
    gives={"image-idt"},
    cite="Levinson and Thrun, Automatic Online Calibration of Cameras and Lasers, RSS 2013",
)

METHOD = p2o.Method(
    name="idt",
    build=build,
    options=IdtOptions,
    summary="Minus the mean of the inverse distance map at the weighted cloud edges.",
    needs={"image-idt", "cloud-edges"},
    gives={"objective"},
    cite="Levinson and Thrun, Automatic Online Calibration of Cameras and Lasers, RSS 2013",
    example=p2o.Example(
        "synthetic:?scenes=6&place=street",
        perturb="1deg 0.1m",
        within="0.2deg 0.06m",
        joint=True,
        extractor="idt/ring-discontinuity",
        solver="grid729",
        init="given",
    ),
)
