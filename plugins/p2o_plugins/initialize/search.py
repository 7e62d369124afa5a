"""Initializer `search`: populations of poses on truncated directed distance maps, narrowed step by step."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from p2o import DirectedCost, Initializer, Method, Options, View, field, se3
from p2o.arrays import Float


class NarrowOptions(Options):
    """How a population of poses is narrowed; shared with `grid`."""

    population: int = field(400, ge=20, le=100_000, help="Poses evaluated in each generation.")
    generations: int = field(12, ge=1, le=200, help="How often the population is drawn anew.")
    elite: float = field(0.1, gt=0, lt=1, help="Share of the population that shapes the next generation.")
    sigma_deg: float = field(2.0, gt=0, le=60, help="Standard deviation of the first generation about each axis.")
    sigma_m: float = field(0.1, ge=0, le=5, help="Standard deviation of the first generation along each axis.")
    widest_px: float = field(40.0, gt=1, le=500, help="Truncation of the distances in the first generation.")
    narrowest_px: float = field(8.0, gt=1, le=500, help="Truncation of the distances in the last generation.")
    max_points: int = field(4000, ge=50, help="LiDAR edge points used, evenly thinned over all frames.")
    seed: int = field(0, ge=0, help="Seed of the random generator.")


class SearchOptions(NarrowOptions):
    """Options of the population search."""

    prior: float = field(
        10.0,
        ge=0,
        help="One sigma away from the start costs as much as this many LiDAR edges without an image edge; 0: off.",
    )
    restarts: int = field(3, ge=1, le=10, help="Searches from the start; each begins half as wide as the one before.")


def build(options: SearchOptions) -> Initializer:
    """Return an initializer that gives the poses at which the searches end, best first, then the given one.

    A wide truncation finds far starts but is blinded by clutter, a narrow one the other way round: so each restart
    begins with half the width of the one before, and the caller may choose among the basins.
    """

    def initialize(views: Sequence[View], camera_from_lidar: Float) -> list[Float]:
        rng = np.random.default_rng(options.seed)
        widths = [max(options.narrowest_px, options.widest_px / 2**number) for number in range(options.restarts)]
        maps = coarse_maps(views, camera_from_lidar, options)
        found = [narrow(maps, camera_from_lidar, options, rng, width, options.prior) for width in widths]
        judge = maps[_scale(options.narrowest_px)].truncated(options.narrowest_px)
        order = np.argsort(judge(np.stack(found)), kind="stable")
        return [*(found[i] for i in order), camera_from_lidar]

    return initialize


def coarse_maps(views: Sequence[View], around: Float, options: NarrowOptions) -> dict[int, DirectedCost]:
    """Return the directed cost at `widest_px` for every scale of maps that narrowing needs, by scale."""
    scales = sorted(
        {
            _scale(options.narrowest_px),
            *(2**n for n in range(8) if 2**n < _scale(options.widest_px)),
            _scale(options.widest_px),
        }
    )
    return {
        scale: DirectedCost.of(
            views, around, options.widest_px, scale=scale, max_points=options.max_points, smooth=False
        )
        for scale in scales
    }


def _scale(width_px: float) -> int:
    """Return how many pixels a cell of the maps covers: a power of two up to a tenth of the truncation."""
    return 2 ** int(np.log2(max(1.0, width_px / 10)))


def narrow(
    maps: dict[int, DirectedCost],
    start: Float,
    options: NarrowOptions,
    rng: np.random.Generator,
    widest_px: float,
    prior: float = 0.0,
) -> Float:
    """Return the pose (4, 4) at which a cross-entropy search around `start` ends.

    The tangent vector of a left update (rotation about the camera centre, then shift) is drawn from a Gaussian whose
    mean and covariance follow the best share of each generation, while the truncation of the distances shrinks from
    `widest_px` to the option `narrowest_px`. `maps` are those of `coarse_maps`. Where few edges tell anything, the
    lowest cost lies anywhere: `prior` edges missed for every squared deviation keep the pose near the start then.
    """
    unit = np.concatenate([np.full(3, np.radians(options.sigma_deg)), np.full(3, max(options.sigma_m, 1e-9))])
    widths = [float(w) for w in np.geomspace(widest_px, min(options.narrowest_px, widest_px), 4)]
    costs = [maps[_scale(width)].truncated(width) for width in widths]
    if not costs[0].points:
        return start
    keep = max(8, int(options.elite * options.population))
    mean, spread = np.zeros(6), np.eye(6)
    for generation in range(options.generations):
        cost = costs[min(len(costs) - 1, generation * len(costs) // options.generations)]
        draws = rng.multivariate_normal(mean, spread, options.population, method="eigh")
        draws[0] = mean
        values = cost(se3.exp(draws * unit) @ start)
        values = values + prior / cost.points * cost.truncate_px * np.square(draws).sum(axis=1)
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
