"""BFGS on a scalar cost, within a box around the initial pose: fast for smooth costs, and local.

SciPy's L-BFGS-B, which remembers ten steps and so the whole curvature of six unknowns. The box is the trust region of
Koide et al. (0.2 m and 2 deg), who use the BFGS of Ceres and reject steps outside of it.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import p2o

from p2o_plugins.solve.scalar_cost import ScalarCost, StepOptions, scalar_solver


class BfgsOptions(StepOptions):
    """Options of `bfgs`."""

    box_deg: float = p2o.field(2.0, ge=0, le=90, help="Bound of each rotation from the initial pose; 0 for no bound.")
    box_m: float = p2o.field(0.2, ge=0, le=100, help="Bound of each translation from the initial pose; 0 for no bound.")
    unit_deg: float = p2o.field(0.5, gt=0, le=90, help="Rotation equivalent to `unit_m` in the first step.")
    unit_m: float = p2o.field(0.02, gt=0, le=100, help="Translation equivalent to `unit_deg` in the first step.")
    max_iterations: int = p2o.field(100, ge=1, help="Largest number of steps over all restarts.")
    restarts: int = p2o.field(1, ge=0, help="Restarts without the previous curvature, as long as they lower the cost.")
    tolerance: float = p2o.field(1e-6, gt=0, help="Stop if a step lowers the cost by less than this share.")


def build(options: BfgsOptions) -> p2o.Solver:
    """Return the solver `(Problem, camera_from_lidar (4, 4)) -> Solution`."""
    # Imported here: every run lists this method, few use it.
    from scipy.optimize import minimize

    def minimise(cost: ScalarCost) -> p2o.Solution:
        # SciPy's tolerances are absolute for costs below one: costs are scaled by the cost at the initial pose.
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
            reached = cost.one(fit.x)
            gained = lowest - reached
            if gained > 0:
                best, lowest = fit.x, reached
            # A failed line search means that rounding errors or the sampling of an image limit further progress.
            converged = spent < options.max_iterations
            if not converged or gained <= options.tolerance * scale:
                break
        return cost.solution(best, spent, converged=converged)

    return scalar_solver(minimise, options.unit_deg, options.unit_m)


METHOD = p2o.Method(
    name="bfgs",
    build=build,
    options=BfgsOptions,
    summary="BFGS within a box around the start, on any scalar cost, with the problem's gradient or a numeric one.",
    needs={"objective"},
    cite="Byrd, Lu, Nocedal and Zhu, SIAM Journal on Scientific Computing 16, 1995",
)
