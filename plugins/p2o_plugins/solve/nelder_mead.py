"""Nelder-Mead on a scalar cost: needs no derivatives, takes any objective and any pairs."""

from __future__ import annotations

from typing import Any

import numpy as np
import p2o
from p2o.arrays import Float
from p2o.problems.chart import pose_at


class NelderMeadOptions(p2o.Options):
    """Options of `nelder-mead`."""

    simplex_deg: float = p2o.field(0.5, gt=0, help="Edge of the first simplex in the three rotations.")
    simplex_m: float = p2o.field(0.05, gt=0, help="Edge of the first simplex in the three translations.")
    restarts: int = p2o.field(
        3, ge=0, help="Fresh simplices around the best pose, each smaller by ten; they free a collapsed simplex."
    )
    max_evaluations: int = p2o.field(6000, ge=1, help="Evaluations of the cost at most, over all restarts.")
    tolerance: float = p2o.field(
        1e-6, gt=0, help="Stops when the simplex is smaller than this share of its first edge."
    )


def build(options: NelderMeadOptions) -> p2o.Solver:
    """Return the solver `(Problem, camera_from_lidar (4, 4)) -> Solution`, without covariance."""
    unit = np.repeat([np.radians(options.simplex_deg), options.simplex_m], 3)
    corners = np.vstack([np.zeros(6), np.eye(6)])

    # Imported here: every run lists this method, few use it.
    from scipy.optimize import minimize

    def solve(problem: p2o.Problem, camera_from_lidar: Float) -> p2o.Solution:
        start = np.asarray(camera_from_lidar, dtype=np.float64)

        def cost(x: Float) -> float:
            value = float(problem.cost(pose_at(start, x * unit)[None])[0])
            return value if np.isfinite(value) else np.inf

        best, spent, converged = np.zeros(6), 0, False
        if not np.isfinite(cost(best)):
            return p2o.Solution(
                start, np.inf, 0, p2o.SolverStatus.SINGULAR, None, "the cost of the start is not finite"
            )
        if isinstance(problem, p2o.LeastSquares) and not len(problem):
            return p2o.Solution(start, 0.0, 0, p2o.SolverStatus.SINGULAR, None, "there are no pairs")
        for restart in range(options.restarts + 1):
            fit: Any = minimize(
                cost,
                best,
                method="Nelder-Mead",
                options={
                    "initial_simplex": best + corners * 0.1**restart,
                    "xatol": options.tolerance,
                    "fatol": np.inf,
                    "maxfev": max(options.max_evaluations - spent, 1),
                    "adaptive": True,
                },
            )
            best, spent, converged = fit.x, spent + int(fit.nfev), bool(fit.success)
            if spent >= options.max_evaluations:
                break
        status = p2o.SolverStatus.CONVERGED if converged else p2o.SolverStatus.ITERATIONS_SPENT
        return p2o.Solution(pose_at(start, best * unit), cost(best), spent, status)

    return solve


METHOD = p2o.Method(
    name="nelder-mead",
    build=build,
    options=NelderMeadOptions,
    summary="Downhill simplex in degrees and metres on any scalar cost, without derivatives.",
    needs={"objective"},
    cite="Nelder and Mead, Computer Journal 7, 1965; Gao and Han, Computational Optimization and Applications 51, 2012",
)
