"""CMA-ES in a box around the start, by Hansen's own package: every population is one call of the cost."""

from __future__ import annotations

import importlib
from typing import Any

import numpy as np
import p2o
from p2o.arrays import Float

from p2o_plugins.solve.scalar_cost import ScalarCost


class CmaEsOptions(p2o.Options):
    """Options of `cma-es`."""

    box_deg: float = p2o.field(3.0, gt=0, le=90, help="Each rotation is sought this near to the start.")
    box_m: float = p2o.field(0.3, gt=0, le=100, help="Each translation is sought this near to the start.")
    sigma: float = p2o.field(0.3, gt=0, le=1, help="First deviation of the population, as a share of the box.")
    population: int = p2o.field(24, ge=4, le=10_000, help="Candidates of a generation.")
    generations: int = p2o.field(150, ge=1, help="Generations at most.")
    tolerance: float = p2o.field(1e-4, gt=0, help="Stops when the population is this share of the box wide.")
    seed: int = p2o.field(0, ge=0, help="Seed of all draws.")


def build(options: CmaEsOptions) -> p2o.Solver:
    """Return the solver `(Problem, camera_from_lidar (4, 4)) -> Solution`; MethodUnavailable without cma."""
    try:
        cma: Any = importlib.import_module("cma")
    except ImportError as problem:
        raise p2o.MethodUnavailable(
            "solver cma-es needs cma, which is not installed", hint='pip install "p2o-calib[cma]"'
        ) from problem

    def solve(problem: p2o.Problem, camera_from_lidar: Float) -> p2o.Solution:
        start = np.asarray(camera_from_lidar, dtype=np.float64)
        cost = ScalarCost(problem, start, options.box_deg, options.box_m)
        hopeless = cost.unsolvable()
        if hopeless is not None:
            return hopeless
        rng = np.random.default_rng(options.seed)
        settings = {
            "bounds": [-1.0, 1.0],
            "popsize": options.population,
            "maxiter": options.generations,
            "tolx": options.tolerance,
            "tolfun": 0.0,
            "tolfunhist": 0.0,
            # Its own draws come from NumPy's global state; these do not.
            "randn": lambda *shape: rng.standard_normal(shape),
            "seed": np.nan,
            "verbose": -9,
            "verb_log": 0,
            "verb_disp": 0,
        }
        search: Any = cma.CMAEvolutionStrategy(np.zeros(6), options.sigma, settings)
        best, lowest = np.zeros(6), cost.one(np.zeros(6))
        while not search.stop():
            asked = np.asarray(search.ask())
            costs = cost.many(asked)
            search.tell(list(asked), np.where(np.isfinite(costs), costs, 1e30).tolist())
            if costs.min() < lowest:
                best, lowest = asked[np.argmin(costs)], float(costs.min())
        spent = int(search.countiter)
        return cost.solution(best, spent, converged=spent < options.generations)

    return solve


METHOD = p2o.Method(
    name="cma-es",
    build=build,
    options=CmaEsOptions,
    summary="CMA-ES in a box around the start, on any scalar cost; seeded.",
    needs={"objective"},
    cite="Hansen and Ostermeier, Evolutionary Computation 9, 2001; Hansen, Akimoto and Baudis, pycma, 2019",
    extra="cma",
)
