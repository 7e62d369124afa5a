"""CMA-ES in a box around the initial pose, by Hansen's package; every population is one call of the cost."""

from __future__ import annotations

from typing import Any

import numpy as np
import p2o

from p2o_plugins.solve.scalar_cost import ScalarCost, scalar_solver

_SIGMA = 0.3  # initial standard deviation of the population, as a share of the box
_TOLERANCE = 1e-4  # stop at this width of the population, as a share of the box


class CmaEsOptions(p2o.Options):
    """Options of `cma-es`."""

    box_deg: float = p2o.field(3.0, gt=0, le=90, help="Search range of each rotation around the initial pose.")
    box_m: float = p2o.field(0.3, gt=0, le=100, help="Search range of each translation around the initial pose.")
    population: int = p2o.field(24, ge=4, le=10_000, help="Candidates per generation.")
    generations: int = p2o.field(150, ge=1, help="Largest number of generations.")
    seed: int = p2o.field(0, ge=0, help="Random seed.")


def build(options: CmaEsOptions) -> p2o.Solver:
    """Return the solver `(Problem, camera_from_lidar (4, 4)) -> Solution`; ModuleNotFoundError without cma."""
    import cma

    def minimise(cost: ScalarCost) -> p2o.Solution:
        rng = np.random.default_rng(options.seed)
        settings = {
            "bounds": [-1.0, 1.0],
            "popsize": options.population,
            "maxiter": options.generations,
            "tolx": _TOLERANCE,
            "tolfun": 0.0,
            "tolfunhist": 0.0,
            # The package's own samples come from NumPy's global random state; these come from a seeded generator.
            "randn": lambda *shape: rng.standard_normal(shape),
            "seed": np.nan,
            "verbose": -9,
            "verb_log": 0,
            "verb_disp": 0,
        }
        search: Any = cma.CMAEvolutionStrategy(np.zeros(6), _SIGMA, settings)
        best, lowest = np.zeros(6), cost.one(np.zeros(6))
        while not search.stop():
            asked = np.asarray(search.ask())
            costs = cost.many(asked)
            search.tell(list(asked), np.where(np.isfinite(costs), costs, 1e30).tolist())
            if costs.min() < lowest:
                best, lowest = asked[np.argmin(costs)], float(costs.min())
        spent = int(search.countiter)
        return cost.solution(best, spent, converged=spent < options.generations)

    return scalar_solver(minimise, options.box_deg, options.box_m)


METHOD = p2o.Method(
    name="cma-es",
    build=build,
    options=CmaEsOptions,
    summary="CMA-ES in a box around the start, on any scalar cost; seeded.",
    needs={"objective"},
    cite="Hansen and Ostermeier, Evolutionary Computation 9, 2001; Hansen, Akimoto and Baudis, pycma, 2019",
    extra="cma",
)
