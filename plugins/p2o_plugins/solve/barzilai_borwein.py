"""Gradient descent with the steps of Barzilai and Borwein: the optimiser of Pandey et al. (AAAI 2012).

The step along the gradient g is gamma = (s.s) / (s.y), with s the last change of the unknowns and y that of the
gradient. Unlike theirs, unknowns are in units (degrees against metres) in one vector, a step is cut off at `longest`
units, a step that makes the cost worse is taken back and halved, and a negative gamma (the cost bends the other way) is
replaced by twice the last one. These are ours; the third-party code that is public steps rotation and translation by
turns.
"""

from __future__ import annotations

import numpy as np
import p2o
from p2o.arrays import Float

from p2o_plugins.solve.scalar_cost import ScalarCost, StepOptions


class BarzilaiBorweinOptions(StepOptions):
    """Options of `barzilai-borwein`."""

    unit_deg: float = p2o.field(0.5, gt=0, le=90, help="Rotation that is weighed like `unit_m`.")
    unit_m: float = p2o.field(0.03, gt=0, le=100, help="Translation that is weighed like `unit_deg`.")
    first: float = p2o.field(0.25, gt=0, help="Length of the first step, in units.")
    longest: float = p2o.field(1.0, gt=0, help="A step is cut off at this length, in units.")
    box_deg: float = p2o.field(0.0, ge=0, le=90, help="Each rotation stays this near to the start; 0 is no bound.")
    box_m: float = p2o.field(0.0, ge=0, le=100, help="Each translation stays this near to the start; 0 is no bound.")
    max_iterations: int = p2o.field(300, ge=1, help="Steps at most, those taken back included.")
    tolerance: float = p2o.field(1e-5, gt=0, help="Stops when a step is shorter than this, in units.")


def build(options: BarzilaiBorweinOptions) -> p2o.Solver:
    """Return the solver `(Problem, camera_from_lidar (4, 4)) -> Solution`."""
    reach = np.repeat([options.box_deg / options.unit_deg, options.box_m / options.unit_m], 3)
    reach[reach == 0] = np.inf

    def solve(problem: p2o.Problem, camera_from_lidar: Float) -> p2o.Solution:
        start = np.asarray(camera_from_lidar, dtype=np.float64)
        cost = ScalarCost(problem, start, options.unit_deg, options.unit_m)
        hopeless = cost.unsolvable()
        if hopeless is not None:
            return hopeless
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
            found = cost.one(trial)
            if not found < lowest:
                gamma *= 0.5
                continue
            ahead = cost.gradient(trial, options)
            bend = float(step @ (ahead - slope))
            gamma = float(step @ step) / bend if bend > 0 else 2 * gamma
            x, lowest, slope = trial, found, ahead
        return cost.solution(x, options.max_iterations, converged=False)

    return solve


METHOD = p2o.Method(
    name="barzilai-borwein",
    build=build,
    options=BarzilaiBorweinOptions,
    summary="Gradient descent with Barzilai and Borwein's step length on any scalar cost.",
    needs={"objective"},
    cite="Barzilai and Borwein, IMA Journal of Numerical Analysis 8, 1988; Pandey et al., AAAI 2012",
)
