"""BFGS on a scalar cost, within a box around the start: quick where the cost is smooth, and as local as its start.

SciPy's L-BFGS-B, which remembers ten steps and so the whole curvature of six unknowns. The box is what Koide et al.
call trust region (0.2 m and 2 deg); they run the BFGS of Ceres and refuse steps out of it.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import p2o
from p2o.arrays import Float

from p2o_plugins.solve.scalar_cost import ScalarCost, StepOptions


class BfgsOptions(StepOptions):
    """Options of `bfgs`."""

    box_deg: float = p2o.field(2.0, ge=0, le=90, help="Each rotation stays this near to the start; 0 is no bound.")
    box_m: float = p2o.field(0.2, ge=0, le=100, help="Each translation stays this near to the start; 0 is no bound.")
    unit_deg: float = p2o.field(0.5, gt=0, le=90, help="Rotation that is weighed like `unit_m` in the first step.")
    unit_m: float = p2o.field(0.02, gt=0, le=100, help="Translation that is weighed like `unit_deg` in the first step.")
    max_iterations: int = p2o.field(100, ge=1, help="Steps at most, over all restarts.")
    restarts: int = p2o.field(1, ge=0, help="Restarts with a forgotten curvature, as long as they lower the cost.")
    tolerance: float = p2o.field(1e-6, gt=0, help="Stops when a step lowers the cost by less than this share of it.")


def build(options: BfgsOptions) -> p2o.Solver:
    """Return the solver `(Problem, camera_from_lidar (4, 4)) -> Solution`."""
    # Imported here: every run lists this method, few use it.
    from scipy.optimize import minimize

    def solve(problem: p2o.Problem, camera_from_lidar: Float) -> p2o.Solution:
        start = np.asarray(camera_from_lidar, dtype=np.float64)
        cost = ScalarCost(problem, start, options.unit_deg, options.unit_m)
        hopeless = cost.unsolvable()
        if hopeless is not None:
            return hopeless
        # SciPy's tolerances are absolute for costs below one: costs are told in units of the one at the start.
        scale = max(abs(cost.one(np.zeros(6))), np.finfo(float).tiny)
        reach = np.repeat([options.box_deg / options.unit_deg, options.box_m / options.unit_m], 3)
        best, spent, converged = np.zeros(6), 0, False
        lowest = cost.one(best)
        for _ in range(options.restarts + 1):
            fit: Any = minimize(
                lambda x: cost.one(x) / scale,
                best,
                jac=lambda x: cost.gradient(x, options) / scale,
                method="L-BFGS-B",
                bounds=[(-r, r) if r else (None, None) for r in reach],
                options={"maxiter": max(options.max_iterations - spent, 1), "ftol": options.tolerance, "gtol": 1e-12},
            )
            spent += int(fit.nit)
            found = cost.one(fit.x)
            gained = lowest - found
            if gained > 0:
                best, lowest = fit.x, found
            # A line search that finds nothing better has come to where rounding, or the grid of a picture, ends it.
            converged = spent < options.max_iterations
            if not converged or gained <= options.tolerance * scale:
                break
        return cost.solution(best, spent, converged=converged)

    return solve


METHOD = p2o.Method(
    name="bfgs",
    build=build,
    options=BfgsOptions,
    summary="BFGS within a box around the start, on any scalar cost, with the problem's gradient or a numeric one.",
    needs={"objective"},
    cite="Byrd, Lu, Nocedal and Zhu, SIAM Journal on Scientific Computing 16, 1995",
)
