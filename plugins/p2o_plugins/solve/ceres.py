"""Ceres Solver, which the paper uses (Sec. IV-A.3), on the same Huber cost.

All pairs are one block, whose residuals include the Huber loss: cost and gradient are those of a block with a Huber
loss for each pair, without a call into Python for each. The approximate curvature beyond the kernel is smaller (down to
half of that of iterated reweighting), which changes the iterations and not the result.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import p2o
from p2o import Float, solving
from p2o.solving import Problem, checked_solution, import_keeping_signals, linearise, pose_from_chart, require_residuals

from p2o_plugins.solve.lm import MAX_CONDITION

_MAX_ITERATIONS = 100  # largest number of steps (max_num_iterations of Ceres)
_TOLERANCE = 1e-12  # relative change of cost or unknowns at which to stop (function and parameter tolerance)


def build(options: p2o.Options) -> p2o.Solver:
    """Return the solver `(LeastSquares, camera_from_lidar (4, 4)) -> Solution`; ModuleNotFoundError sans pyceres."""
    pyceres = import_keeping_signals("pyceres")

    class Pairs(pyceres.CostFunction):  # type: ignore[misc,name-defined]
        """All pairs as one block: a call from C++ into Python costs as much as the work on hundreds of pairs."""

        def __init__(self, pairs: solving.LeastSquares, start: Float) -> None:
            super().__init__()
            self.pairs, self.start, self.root_weight = pairs, start, np.sqrt(pairs.weight)
            self.set_num_residuals(len(pairs))
            self.set_parameter_block_sizes([6])

        def Evaluate(self, parameters: Any, residuals: Any, jacobians: Any) -> bool:  # noqa: N802 (named by Ceres)
            delta = np.array(parameters[0])
            raw, jacobian = linearise(self.pairs, pose_from_chart(self.start, delta))
            residuals[:], slope = robust_roots(raw, self.pairs.huber)
            residuals *= self.root_weight
            if jacobians is not None and jacobians[0] is not None:
                by_chart = jacobian @ solving.left_from_chart(delta)
                jacobians[0][:] = (by_chart * (slope * self.root_weight)[:, None]).ravel()
            return True

    def solve(problem: Problem, camera_from_lidar: Float) -> p2o.Solution:
        pairs = require_residuals(problem, "ceres")
        start = np.asarray(camera_from_lidar, dtype=np.float64)
        delta = np.zeros(6)
        if not pairs.weight.any():
            return checked_solution(pairs, start, start, 0, p2o.SolverStatus.CONVERGED, MAX_CONDITION)
        # Python must keep the block alive, since Ceres holds a plain pointer to it.
        block, ceres_problem = Pairs(pairs, start), pyceres.Problem()
        ceres_problem.add_residual_block(block, None, [delta])
        settings, summary = pyceres.SolverOptions(), pyceres.SolverSummary()
        settings.max_num_iterations = _MAX_ITERATIONS
        settings.function_tolerance = settings.parameter_tolerance = _TOLERANCE
        settings.gradient_tolerance = 0.0
        settings.linear_solver_type = pyceres.LinearSolverType.DENSE_NORMAL_CHOLESKY
        settings.num_threads = 1  # there is one block
        settings.logging_type = pyceres.LoggingType.SILENT
        pyceres.solve(settings, ceres_problem, summary)
        converged = summary.termination_type == pyceres.TerminationType.CONVERGENCE
        status = p2o.SolverStatus.CONVERGED if converged else p2o.SolverStatus.ITERATIONS_SPENT
        pose, steps = pose_from_chart(start, delta), int(summary.num_successful_steps + summary.num_unsuccessful_steps)
        return checked_solution(pairs, start, pose, steps, status, MAX_CONDITION)

    return solve


def robust_roots(residuals: Float, huber: float) -> tuple[Float, Float]:
    """Return residuals (K,) whose squares are twice the Huber cost, and their slopes (K,) by the plain ones.

    sign(r) sqrt(2 rho(r)), so that a sum of squares is the robust cost exactly, with its exact gradient.
    """
    size = np.abs(residuals)
    root = np.where(size > huber, np.sqrt(huber * (2 * np.maximum(size, huber) - huber)), size)
    slope = np.where(size > huber, huber / np.maximum(root, huber), 1.0)
    return np.copysign(root, residuals), slope


METHOD = p2o.Method(
    name="ceres",
    build=build,
    summary="Ceres Solver with a Huber loss per pair, as in the paper.",
    needs={"residuals"},
    cite="Agarwal, Mierle and others, Ceres Solver, 2022",
    extra="ceres",
)
