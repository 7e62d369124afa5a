"""Initializer `search`: populations of poses on truncated directed distance maps, refined basin by basin."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from p2o import Float, Initializer, InitializerBase, Method, Options, View, field, se3
from p2o.solving import DirectedCost

_POPULATION = 400  # poses evaluated in each generation
_SIGMA_DEG, _SIGMA_M = 2.0, 0.1  # standard deviation of the first generation about and along each axis
MAX_POINTS = 4000  # LiDAR edge points used, evenly thinned over all frames
_GENERATIONS = 12  # number of generations
_ELITE = 0.1  # share of the population that shapes the next generation
_WIDEST_PX = 40.0  # truncation of the distances in the first generation
NARROWEST_PX = 8.0  # truncation of the distances in the last generation
_WIDTHS = tuple(np.geomspace(_WIDEST_PX, NARROWEST_PX, 4).tolist())  # truncations from generation to generation
_FINEST_PX = 4.0  # truncation of the distances at which basins end and are ranked
_SCATTER = 3000  # poses drawn around the start, to find further basins
_BASINS = 12  # number of them, the best and separate, that are narrowed
_PROPOSALS = 3  # best basins that are handed on


class SearchOptions(Options):
    """Options of the population search."""

    prior: float = field(
        10.0,
        ge=0,
        help="One sigma away from the start costs as much as this many LiDAR edges without an image edge; 0: off.",
    )
    seed: int = field(0, ge=0, help="Seed of the random generator.")


# A basin is refined by small populations with an initial width of about its own, in units of sigma.
_BASIN_SPREAD, _BASIN_POPULATION, _BASIN_GENERATIONS = 0.3, 80, 5
# Initial poses closer than this, in units of sigma, and final poses closer than this, in degrees, are one basin.
_SEPARATE_SIGMA, _SEPARATE_DEG = 0.5, 0.6
_DRAWS_AT_ONCE = 2_000
MOST_VIEWS = 64
"""Maximum number of views from which the points of a search come, which limits the memory of the maps."""


@dataclass(frozen=True)
class Search(InitializerBase):
    """Return the poses to which several searches converge, best first, then the given one.

    One search starts with distances truncated at 40 px: it handles large initial errors but is misled by clutter,
    whose edges are within that distance of any point. With a truncation of a few pixels the cost has its minimum at the
    true pose far more often, but only for small errors: many poses are sampled around the initial guess, and the best
    distinct ones start separate searches with narrow truncations. The scorer of the pipeline selects among the basins.
    """

    options: SearchOptions

    def __call__(self, views: Sequence[View], camera_from_lidar: Float) -> list[Float]:
        """Return initial poses (4, 4), best first, and the given one last."""
        options = self.options
        rng = np.random.default_rng(options.seed)
        maps = coarse_maps(views, camera_from_lidar)
        near = maps[_scale(NARROWEST_PX)]
        if not near.points:
            return [camera_from_lidar]
        poses = [narrow(maps, camera_from_lidar, _SIGMA_DEG, rng, options.prior)]
        poses += _scattered(near, camera_from_lidar, options.prior, rng)
        order = np.argsort(near.truncated(_FINEST_PX)(np.stack(poses)), kind="stable")
        apart: list[Float] = []
        for pose in (poses[i] for i in order):
            if all(se3.angle_deg(pose @ se3.inverse(other)) > _SEPARATE_DEG for other in apart):
                apart.append(pose)
        return [*apart[:_PROPOSALS], camera_from_lidar]

    @property
    def start_sigma(self) -> tuple[float, float]:
        """Standard deviation of the initial guesses in deg and m that are searched."""
        return _SIGMA_DEG, _SIGMA_M


def build(options: SearchOptions) -> Initializer:
    """Return the initializer."""
    return Search(options)


def _scattered(maps: DirectedCost, start: Float, prior: float, rng: np.random.Generator) -> list[Float]:
    """Return the poses to which narrow searches converge from the best of many poses sampled around `start`."""
    unit, coarse = _unit(_SIGMA_DEG), maps.truncated(NARROWEST_PX)
    draws = rng.standard_normal((_SCATTER, 6))
    draws[0] = 0.0
    parts = np.array_split(draws, -(-len(draws) // _DRAWS_AT_ONCE))
    values = np.concatenate([_value(coarse, part, unit, start, prior) for part in parts])
    rest = np.argsort(values, kind="stable")
    chosen: list[int] = []
    while len(rest) and len(chosen) < _BASINS:
        chosen.append(int(rest[0]))
        turned_away = np.linalg.norm(draws[rest, :3] - draws[rest[0], :3], axis=1)
        rest = rest[turned_away > _SEPARATE_SIGMA]
    widths = np.geomspace(NARROWEST_PX, _FINEST_PX, _BASIN_GENERATIONS)
    costs, keep = [maps.truncated(float(width)) for width in widths], _kept(_BASIN_POPULATION)
    # The result equals refining one basin after the other; all basins share each step, which needs fewer calls.
    normals = np.moveaxis(rng.standard_normal((len(chosen), len(costs), _BASIN_POPULATION, 6)), 1, 0)
    return list(_narrowed(costs, normals, start, unit, draws[chosen], _BASIN_SPREAD, keep, prior))


def coarse_maps(views: Sequence[View], around: Float) -> dict[int, DirectedCost]:
    """Return the directed cost at `_WIDEST_PX` for every scale of maps that the refinement needs, by scale."""
    scales = sorted({_scale(width) for width in _WIDTHS})
    cost = partial(
        DirectedCost.of, views, around, _WIDEST_PX, smooth=False, max_points=MAX_POINTS, max_views=MOST_VIEWS
    )
    return {scale: cost(scale=scale) for scale in scales}


def _scale(width_px: float) -> int:
    """Return the size in pixels of a cell of the maps: a power of two up to a quarter of the truncation."""
    return 1 << int(np.log2(max(1.0, width_px / 4)))


def narrow(
    maps: dict[int, DirectedCost],
    start: Float,
    sigma_deg: float,
    rng: np.random.Generator,
    prior: float = 0.0,
) -> Float:
    """Return the pose (4, 4) to which a cross-entropy search around `start` converges.

    The tangent vector of a left update (rotation about the camera centre, then translation) is drawn from a Gaussian
    whose mean and covariance follow the best fraction of each generation, while the truncation of the distances
    decreases from `_WIDEST_PX` to `NARROWEST_PX`. `maps` are those of `coarse_maps`. With few informative
    edges the minimum of the cost is arbitrary: a `prior` of N missed edges per squared deviation then keeps the pose
    near the initial guess.
    """
    costs = [maps[_scale(width)].truncated(width) for width in _WIDTHS]
    if not costs[0].points:
        return start
    costs = [costs[min(3, generation * 4 // _GENERATIONS)] for generation in range(_GENERATIONS)]
    keep = _kept(_POPULATION)
    normals = (rng.standard_normal((1, _POPULATION, 6)) for _ in costs)
    (end,) = _narrowed(costs, normals, start, _unit(sigma_deg), np.zeros((1, 6)), 1.0, keep, prior)
    return np.asarray(end)


def _narrowed(
    costs: Sequence[DirectedCost],
    normals: Iterable[Float],
    start: Float,
    unit: Float,
    mean: Float,
    deviation: float,
    keep: int,
    prior: float,
) -> Float:
    """Return the poses (K, 4, 4) to which K populations converge after one generation for each cost.

    Populations start at the tangents `mean` (K, 6), in units of `unit`, with a standard deviation along each axis.
    `normals` are standard normal numbers (K, N, 6) for each generation.
    """
    spread = np.tile(deviation**2 * np.eye(6), (len(mean), 1, 1))
    for cost, normal in zip(costs, normals, strict=True):
        variance, axes = np.linalg.eigh(spread)
        factor = axes * np.sqrt(variance)[:, None]
        draws = mean[:, None] + normal @ factor.transpose(0, 2, 1)
        draws[:, 0] = mean
        values = _value(cost, draws.reshape(-1, 6), unit, start, prior).reshape(draws.shape[:2])
        order = np.argsort(values, axis=1, kind="stable")[:, :keep]
        best = np.take_along_axis(draws, order[..., None], axis=1)
        mean = best.mean(axis=1)
        # A lower limit prevents the populations from collapsing before the truncation has become narrow.
        off = best - mean[:, None]
        spread = off.transpose(0, 2, 1) @ off / (keep - 1) + 1e-6 * np.eye(6)
    return np.asarray(se3.exp(mean * unit) @ start)


def _unit(sigma_deg: float) -> Float:
    """Return one sigma of each of the six parameters (6,), rad and m."""
    return np.repeat([np.radians(sigma_deg), _SIGMA_M], 3)


def _kept(population: int) -> int:
    return max(8, int(_ELITE * population))


def _value(cost: DirectedCost, draws: Float, unit: Float, start: Float, prior: float) -> Float:
    """Return the cost (N,) of tangents (N, 6) in units of `unit`, plus the prior on their distance from the start."""
    missed = prior / cost.points * cost.truncate_px
    return np.asarray(cost(se3.exp(draws * unit) @ start) + missed * np.square(draws).sum(axis=1))


METHOD = Method(
    name="search",
    build=build,
    options=SearchOptions,
    summary="Population search on truncated directed distance maps (default).",
    needs={"image-edges", "cloud-edges"},
    cite="cross-entropy method: Rubinstein, 1999",
)
