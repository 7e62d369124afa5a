"""BFGS on a scalar cost, within a box around the initial pose: fast for smooth costs, and local.

SciPy's L-BFGS-B, which remembers ten steps and so the whole curvature of six unknowns. The box is the trust region of
Koide et al. (0.2 m and 2 deg), who use the BFGS of Ceres and reject steps outside of it.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import p2o
from p2o import Float

from p2o_plugins.solve.scalar_cost import ScalarCost, scalar_solver

_HIGHEST = 1e3  # the scaled cost of poses without one, from which the line search can interpolate
_UNIT_DEG = 0.5  # rotation equivalent to `_UNIT_M` in the first step
_UNIT_M = 0.02  # translation equivalent to `_UNIT_DEG` in the first step
_MAX_ITERATIONS = 100  # largest number of steps over all restarts
_RESTARTS = 1  # restarts without the previous curvature, as long as they lower the cost
_TOLERANCE = 1e-9  # stop if a step lowers the cost by less than this share of the gain that the first slope predicts


class BfgsOptions(p2o.Options):
    """Options of `bfgs`."""

    box_deg: float = p2o.field(2.0, ge=0, le=90, help="Bound of each rotation from the initial pose; 0 for no bound.")
    box_m: float = p2o.field(0.2, ge=0, le=100, help="Bound of each translation from the initial pose; 0 for no bound.")


def build(options: BfgsOptions) -> p2o.Solver:
    """Return the solver `(Problem, camera_from_lidar (4, 4)) -> Solution`."""
    # Imported here: every run lists this method, few use it.
    from scipy.optimize import minimize

    reach = np.repeat([options.box_deg / _UNIT_DEG, options.box_m / _UNIT_M], 3)
    reach[reach == 0] = np.inf

    def minimise(cost: ScalarCost) -> p2o.Solution:
        best, spent, converged = np.zeros(6), 0, True
        for _ in range(_RESTARTS + 1):
            reached, steps, gained = descend(cost, best, max(_MAX_ITERATIONS - spent, 1))
            spent += steps
            if gained > 0:
                best = reached
            # A failed line search means that rounding errors or the sampling of an image limit further progress.
            converged = spent < _MAX_ITERATIONS
            if not converged or gained <= _TOLERANCE:
                break
        return cost.solution(best, spent, converged=converged)

    def descend(cost: ScalarCost, begin: Float, most: int) -> tuple[Float, int, float]:
        """Return where a descent of at most `most` steps ends, its steps, and the gain over that of one unit.

        The first step of L-BFGS-B in a box is the gradient, and its tolerance is absolute for costs below one. Costs
        are scaled so that the gradient is one: the first step is one unit, and the tolerance a share of its gain.
        """
        lowest, slope = cost.one(begin), cost.gradient(begin)
        scale = float(np.linalg.norm(slope[np.sign(slope) * begin > -reach]))  # without those that lead out of the box
        if not scale:
            return begin, 0, 0.0

        def scaled(x: Float) -> float:
            return min((cost.one(x) - lowest) / scale, _HIGHEST)

        search: Any = minimize  # its types know no method with a gradient of its own
        fit = search(
            scaled,
            begin,
            jac=lambda x: cost.gradient(x) / scale,
            method="L-BFGS-B",
            bounds=[(-r, r) for r in reach],
            options={"maxiter": most, "ftol": _TOLERANCE, "gtol": 1e-12},
        )
        return fit.x, int(fit.nit), -scaled(fit.x)

    return scalar_solver(minimise, _UNIT_DEG, _UNIT_M)


METHOD = p2o.Method(
    name="bfgs",
    build=build,
    options=BfgsOptions,
    summary="BFGS within a box around the start, on any scalar cost, with the problem's gradient or a numeric one.",
    needs={"objective"},
    cite="Byrd, Lu, Nocedal and Zhu, SIAM Journal on Scientific Computing 16, 1995",
)
