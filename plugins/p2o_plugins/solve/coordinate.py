"""Search along the six axes with adaptive steps, for any scalar cost, without derivatives.

Hooke and Jeeves, Direct Search Solution of Numerical and Statistical Problems, JACM 8, 1961: each axis is evaluated one
step both ways; after a pass over all axes its total change is repeated, which follows valleys between the axes. Steps
grow on success and shrink otherwise, per axis, as in adaptive coordinate search; all parameters are ours.
"""

from __future__ import annotations

import numpy as np
import p2o

from p2o_plugins.solve.scalar_cost import ScalarCost, scalar_solver

_SHRINK = 0.6  # factor on the step of an axis if neither direction is better
_GROW = 1.3  # factor on the step of an axis if one direction is better, up to the first step
_TOLERANCE = 4e-3  # stop if all steps are below this share of the first ones
_MAX_SWEEPS = 300  # largest number of passes over all axes
_STEP_DEG = 0.2  # first step of the three rotations
_STEP_M = 0.02  # first step of the three translations


def build(options: p2o.Options) -> p2o.Solver:
    """Return the solver `(Problem, camera_from_lidar (4, 4)) -> Solution`, without covariance."""

    def minimise(cost: ScalarCost) -> p2o.Solution:
        here, steps, sweeps = np.zeros(6), np.ones(6), 0
        least = cost.one(here)
        while sweeps < _MAX_SWEEPS and steps.max() >= _TOLERANCE:
            before, sweeps = here.copy(), sweeps + 1
            for axis in range(6):
                both = here + np.outer((-steps[axis], steps[axis]), np.eye(6)[axis])
                costs = cost.many(both)
                best = int(np.argmin(costs))
                better = costs[best] < least
                if better:
                    here, least = both[best], float(costs[best])
                steps[axis] = min(steps[axis] * _GROW, 1.0) if better else steps[axis] * _SHRINK
            if (here != before).any():
                # Evaluate several step lengths along the same direction in one call.
                ahead = here + np.outer((1.0, 3.0, 9.0), here - before)
                costs = cost.many(ahead)
                best = int(np.argmin(costs))
                if costs[best] < least:
                    here, least = ahead[best], float(costs[best])
        converged = bool(steps.max() < _TOLERANCE)
        return cost.solution(here, sweeps, converged=converged, covariance=False)

    return scalar_solver(minimise, _STEP_DEG, _STEP_M)


METHOD = p2o.Method(
    name="coordinate",
    build=build,
    summary="Search along the six axes with adaptive steps, on any scalar cost.",
    needs={"objective"},
    cite="Hooke and Jeeves, Direct Search Solution of Numerical and Statistical Problems, JACM 8, 1961",
)
