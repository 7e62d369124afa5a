"""Gradient descent with the step length of Barzilai and Borwein: the optimiser of Pandey et al. (AAAI 2012).

The step along the gradient g is gamma = (s.s) / (s.y), with s the last change of the unknowns and y that of the
gradient. Unlike the original, the unknowns are in units (degrees against metres) in one vector, a step is limited to
`longest` units, a step that increases the cost is rejected and halved, and a negative gamma (negative curvature) is
replaced by twice the last one. Public third-party code steps rotation and translation alternately.
"""

from __future__ import annotations

import numpy as np
import p2o

from p2o_plugins.solve.scalar_cost import ScalarCost, StepOptions, scalar_solver


class BarzilaiBorweinOptions(StepOptions):
    """Options of `barzilai-borwein`."""

    unit_deg: float = p2o.field(0.5, gt=0, le=90, help="Rotation equivalent to `unit_m`.")
    unit_m: float = p2o.field(0.03, gt=0, le=100, help="Translation equivalent to `unit_deg`.")
    first: float = p2o.field(0.25, gt=0, help="Length of the first step, in units.")
    longest: float = p2o.field(1.0, gt=0, help="Largest length of a step, in units.")
    box_deg: float = p2o.field(0.0, ge=0, le=90, help="Bound of each rotation from the initial pose; 0 for no bound.")
    box_m: float = p2o.field(0.0, ge=0, le=100, help="Bound of each translation from the initial pose; 0 for no bound.")
    max_iterations: int = p2o.field(300, ge=1, help="Largest number of steps, including rejected ones.")
    tolerance: float = p2o.field(1e-5, gt=0, help="Stop if a step is shorter than this, in units.")


def build(options: BarzilaiBorweinOptions) -> p2o.Solver:
    """Return the solver `(Problem, camera_from_lidar (4, 4)) -> Solution`."""
    reach = np.repeat([options.box_deg / options.unit_deg, options.box_m / options.unit_m], 3)
    reach[reach == 0] = np.inf

    def minimise(cost: ScalarCost) -> p2o.Solution:
        x, lowest = np.zeros(6), cost.one(np.zeros(6))
        slope = cost.gradient(x, options)
        gamma = options.first / max(float(np.linalg.norm(slope)), np.finfo(float).tiny)
        for iteration in range(1, options.max_iterations + 1):
            step = -gamma * slope
            length = float(np.linalg.norm(step))
            step *= min(1.0, options.longest / max(length, np.finfo(float).tiny))
            trial = np.clip(x + step, -reach, reach)
            step = trial - x
            if np.linalg.norm(step) < options.tolerance:
                return cost.solution(x, iteration, converged=True)
            trial_cost = cost.one(trial)
            if not trial_cost < lowest:
                gamma *= 0.5
                continue
            ahead = cost.gradient(trial, options)
            bend = float(step @ (ahead - slope))
            gamma = float(step @ step) / bend if bend > 0 else 2 * gamma
            x, lowest, slope = trial, trial_cost, ahead
        return cost.solution(x, options.max_iterations, converged=False)

    return scalar_solver(minimise, options.unit_deg, options.unit_m)


METHOD = p2o.Method(
    name="barzilai-borwein",
    build=build,
    options=BarzilaiBorweinOptions,
    summary="Gradient descent with Barzilai and Borwein's step length on any scalar cost.",
    needs={"objective"},
    cite="Barzilai and Borwein, IMA Journal of Numerical Analysis 8, 1988; Pandey et al., AAAI 2012",
)
