"""Initializer `search`: a population of poses on truncated directed distance maps, narrowed generation by generation."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from p2o import DirectedCost, Initializer, Method, Options, View, field, se3
from p2o.arrays import Float


class SearchOptions(Options):
    """Options of the population search."""

    population: int = field(400, ge=20, le=100_000, help="Poses evaluated in each generation.")
    generations: int = field(12, ge=1, le=200, help="How often the population is drawn anew.")
    elite: float = field(0.1, gt=0, lt=1, help="Share of the population that shapes the next generation.")
    sigma_deg: float = field(2.0, gt=0, le=60, help="Standard deviation of the first generation about each axis.")
    sigma_m: float = field(0.1, ge=0, le=5, help="Standard deviation of the first generation along each axis.")
    widest_px: float = field(40.0, gt=1, le=500, help="Truncation of the distances in the first generation.")
    narrowest_px: float = field(8.0, gt=1, le=500, help="Truncation of the distances in the last generation.")
    max_points: int = field(4000, ge=50, help="LiDAR edge points used, evenly thinned over all frames.")
    seed: int = field(0, ge=0, help="Seed of the random generator.")


def build(options: SearchOptions) -> Initializer:
    """Return an initializer that gives the best pose of a cross-entropy search, then the given one."""

    def initialize(views: Sequence[View], camera_from_lidar: Float) -> list[Float]:
        rng = np.random.default_rng(options.seed)
        return [narrow(views, camera_from_lidar, options, rng), camera_from_lidar]

    return initialize


def narrow(views: Sequence[View], start: Float, options: SearchOptions, rng: np.random.Generator) -> Float:
    """Return the pose (4, 4) at which a cross-entropy search around `start` ends.

    The tangent vector of a left update (rotation about the camera centre, then shift) is drawn from a Gaussian whose
    mean and covariance follow the best share of each generation, while the truncation of the distances shrinks from
    `widest_px` to `narrowest_px`.
    """
    unit = np.concatenate([np.full(3, np.radians(options.sigma_deg)), np.full(3, max(options.sigma_m, 1e-9))])
    widths = np.geomspace(options.widest_px, min(options.narrowest_px, options.widest_px), 4)
    costs = [
        DirectedCost.of(
            views,
            start,
            float(width),
            scale=max(1, int(width // 10)),
            margin_px=0.0,
            max_points=options.max_points,
        )
        for width in widths
    ]
    if not costs[0].points:
        return start
    keep = max(8, int(options.elite * options.population))
    mean, spread = np.zeros(6), np.eye(6)
    for generation in range(options.generations):
        cost = costs[min(len(costs) - 1, generation * len(costs) // options.generations)]
        draws = rng.multivariate_normal(mean, spread, options.population, method="eigh")
        draws[0] = mean
        values = cost(se3.exp(draws * unit) @ start)
        best = draws[np.argsort(values, kind="stable")[:keep]]
        mean = best.mean(axis=0)
        # A floor keeps the population from freezing before the truncation has become narrow.
        spread = np.cov(best.T) + 1e-6 * np.eye(6)
    return np.asarray(se3.exp(mean * unit) @ start)


METHOD = Method(
    name="search",
    build=build,
    options=SearchOptions,
    summary="Population search on truncated directed distance maps (default).",
    needs={"image-edges", "cloud-edges"},
    cite="cross-entropy method: Rubinstein, 1999",
)
