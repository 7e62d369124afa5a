"""Nelder-Mead on a scalar cost: needs no derivatives, takes any objective and any pairs."""

from __future__ import annotations

from typing import Any

import numpy as np
import p2o

from p2o_plugins.solve.scalar_cost import ScalarCost, scalar_solver

_LEAST_GAIN = 1e-9  # share of the whole decrease of the cost below which a restart is the last one
_RESTARTS = 3  # restarts around the best pose with a simplex ten times smaller, in case the last one collapsed
_MAX_EVALUATIONS = 6000  # largest number of evaluations over all restarts
_TOLERANCE = 1e-6  # stop if the simplex is smaller than this share of its first edge
_SIMPLEX_DEG = 0.5  # initial edge of the simplex in the three rotations
_SIMPLEX_M = 0.05  # initial edge of the simplex in the three translations


def build(options: p2o.Options) -> p2o.Solver:
    """Return the solver `(Problem, camera_from_lidar (4, 4)) -> Solution`, without covariance."""
    corners = np.vstack([np.zeros(6), np.eye(6)])

    # Imported here, because every run lists this method and few use it.
    from scipy.optimize import minimize

    def minimise(cost: ScalarCost) -> p2o.Solution:
        best, spent, converged = np.zeros(6), 0, False
        first = lowest = cost.one(best)
        for restart in range(_RESTARTS + 1):
            fit: Any = minimize(
                cost.one,
                best,
                method="Nelder-Mead",
                options={
                    "initial_simplex": best + corners * 0.1**restart,
                    "xatol": _TOLERANCE,
                    "fatol": np.inf,
                    "maxfev": max(_MAX_EVALUATIONS - spent, 1),
                    "adaptive": True,
                },
            )
            best, spent, converged = fit.x, spent + int(fit.nfev), bool(fit.success)
            gained, lowest = lowest - float(fit.fun), float(fit.fun)
            if spent >= _MAX_EVALUATIONS or gained <= _LEAST_GAIN * (first - lowest):
                break
        return cost.solution(best, spent, converged=converged, covariance=False)

    return scalar_solver(minimise, _SIMPLEX_DEG, _SIMPLEX_M)


METHOD = p2o.Method(
    name="nelder-mead",
    build=build,
    summary="Downhill simplex in degrees and metres on any scalar cost, without derivatives.",
    needs={"objective"},
    cite="Nelder and Mead, Computer Journal 7, 1965; Gao and Han, Computational Optimization and Applications 51, 2012",
)
