"""Gradient descent with the step length of Barzilai and Borwein: the optimiser of Pandey et al. (AAAI 2012).

The step along the gradient g is gamma = (s.s) / (s.y), with s the last change of the unknowns and y that of the
gradient. Unlike the original, the unknowns are in units (degrees against metres) in one vector, a step is limited to
`_LONGEST` units, a step that increases the cost is rejected and halved, and a negative gamma (negative curvature) is
replaced by twice the last one. Public third-party code steps rotation and translation alternately.

Costs of projected points are rough: their derivative at a point leads to the next of many minima. Descents with
derivatives by differences over the steps of `_SCHEDULE`, from coarse to fine, precede the descent with the gradient.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np
import p2o
from p2o import Float

from p2o_plugins.solve.scalar_cost import ScalarCost, scalar_solver

_UNIT_DEG = 0.5  # rotation equivalent to `_UNIT_M`
_UNIT_M = 0.03  # translation equivalent to `_UNIT_DEG`
_FIRST = 0.25  # length of the first step, in units
_LONGEST = 1.0  # largest length of a step, in units
_MAX_ITERATIONS = 300  # largest number of steps of a descent, including rejected ones
_TOLERANCE = 1e-5  # stop if a step is shorter than this, in units
_SCHEDULE = ((1.0, 0.1), (0.5, 0.05), (0.25, 0.025))
"""Steps (deg, m) of derivatives by differences, with each of which a descent precedes that with the gradient."""


def build(options: p2o.Options) -> p2o.Solver:
    """Return the solver `(Problem, camera_from_lidar (4, 4)) -> Solution`."""

    def minimise(cost: ScalarCost) -> p2o.Solution:
        x, iterations, converged = np.zeros(6), 0, False
        for step in _SCHEDULE:
            x, spent, _ = descend(cost, x, partial(cost.differences, step_deg=step[0], step_m=step[1]))
            iterations += spent
        x, spent, converged = descend(cost, x, cost.gradient)
        return cost.solution(x, iterations + spent, converged=converged)

    def descend(cost: ScalarCost, x: Float, gradient: Callable[[Float], Float]) -> tuple[Float, int, bool]:
        """Return where a descent from x (6,) ends, the number of its steps, and whether it converged."""
        lowest, slope = cost.one(x), gradient(x)
        gamma = _FIRST / max(float(np.linalg.norm(slope)), np.finfo(float).tiny)
        for iteration in range(1, _MAX_ITERATIONS + 1):
            step = -gamma * slope
            length = float(np.linalg.norm(step))
            step *= min(1.0, _LONGEST / max(length, np.finfo(float).tiny))
            trial = x + step
            step = trial - x
            if np.linalg.norm(step) < _TOLERANCE:
                return x, iteration, True
            trial_cost = cost.one(trial)
            if not trial_cost < lowest:
                gamma *= 0.5
                continue
            ahead = gradient(trial)
            bend = float(step @ (ahead - slope))
            gamma = float(step @ step) / bend if bend > 0 else 2 * gamma
            x, lowest, slope = trial, trial_cost, ahead
        return x, _MAX_ITERATIONS, False

    return scalar_solver(minimise, _UNIT_DEG, _UNIT_M)


METHOD = p2o.Method(
    name="barzilai-borwein",
    build=build,
    summary="Gradient descent with Barzilai and Borwein's step length on any scalar cost.",
    needs={"objective"},
    cite="Barzilai and Borwein, IMA Journal of Numerical Analysis 8, 1988; Pandey et al., AAAI 2012",
)
