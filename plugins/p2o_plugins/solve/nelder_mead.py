"""Nelder-Mead on a scalar cost: needs no derivatives, takes any objective and any pairs."""

from __future__ import annotations

from typing import Any

import numpy as np
import p2o

from p2o_plugins.solve.scalar_cost import ScalarCost, scalar_solver

_LEAST_GAIN = 1e-9  # share of the whole decrease of the cost below which a restart is the last one


class NelderMeadOptions(p2o.Options):
    """Options of `nelder-mead`."""

    simplex_deg: float = p2o.field(0.5, gt=0, help="Initial edge of the simplex in the three rotations.")
    simplex_m: float = p2o.field(0.05, gt=0, help="Initial edge of the simplex in the three translations.")
    restarts: int = p2o.field(
        3, ge=0, help="Restarts around the best pose with a simplex ten times smaller, in case the last one collapsed."
    )
    max_evaluations: int = p2o.field(6000, ge=1, help="Largest number of evaluations over all restarts.")
    tolerance: float = p2o.field(1e-6, gt=0, help="Stop if the simplex is smaller than this share of its first edge.")


def build(options: NelderMeadOptions) -> p2o.Solver:
    """Return the solver `(Problem, camera_from_lidar (4, 4)) -> Solution`, without covariance."""
    corners = np.vstack([np.zeros(6), np.eye(6)])

    # Imported here, because every run lists this method and few use it.
    from scipy.optimize import minimize

    def minimise(cost: ScalarCost) -> p2o.Solution:
        best, spent, converged = np.zeros(6), 0, False
        first = lowest = cost.one(best)
        for restart in range(options.restarts + 1):
            fit: Any = minimize(
                cost.one,
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
            gained, lowest = lowest - float(fit.fun), float(fit.fun)
            if spent >= options.max_evaluations or gained <= _LEAST_GAIN * (first - lowest):
                break
        return cost.solution(best, spent, converged=converged, covariance=False)

    return scalar_solver(minimise, options.simplex_deg, options.simplex_m)


METHOD = p2o.Method(
    name="nelder-mead",
    build=build,
    options=NelderMeadOptions,
    summary="Downhill simplex in degrees and metres on any scalar cost, without derivatives.",
    needs={"objective"},
    cite="Nelder and Mead, Computer Journal 7, 1965; Gao and Han, Computational Optimization and Applications 51, 2012",
)
