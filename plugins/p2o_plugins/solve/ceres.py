"""Ceres Solver, which the paper uses (Sec. IV-A.3): one residual block with a Huber loss per pair."""

from __future__ import annotations

from typing import Any

import numpy as np
import p2o
from p2o.arrays import Float
from p2o.native import import_keeping_signals
from p2o.problems.chart import left_from_chart, pose_at
from p2o.problems.normal_equations import judged, linearise, require_residuals


class CeresOptions(p2o.Options):
    """Options of `ceres`."""

    max_iterations: int = p2o.field(100, ge=1, help="Steps at most (max_num_iterations of Ceres).")
    tolerance: float = p2o.field(
        1e-12, gt=0, help="Relative change of cost or unknowns at which to stop (function and parameter tolerance)."
    )
    max_condition: float = p2o.field(
        1e5, gt=1, help="Condition of the scaled Hessian beyond which a direction counts as not observable."
    )


def build(options: CeresOptions) -> p2o.Solver:
    """Return the solver `(LeastSquares, camera_from_lidar (4, 4)) -> Solution`; MethodUnavailable sans pyceres."""
    try:
        pyceres = import_keeping_signals("pyceres")
    except ImportError as problem:
        raise p2o.MethodUnavailable(
            "solver ceres needs pyceres, which is not installed", hint="run: pip install pyceres"
        ) from problem

    class Pair(pyceres.CostFunction):  # type: ignore[misc,name-defined]
        """One row of residuals and derivatives, which `Rows` computes for all pairs at once."""

        def __init__(self, rows: _Rows, row: int) -> None:
            super().__init__()
            self.rows, self.row = rows, row
            self.set_num_residuals(1)
            self.set_parameter_block_sizes([6])

        def Evaluate(self, parameters: Any, residuals: Any, jacobians: Any) -> bool:  # noqa: N802 (named by Ceres)
            values, derivatives = self.rows.at(parameters[0])
            residuals[0] = values[self.row]
            if jacobians is not None and jacobians[0] is not None:
                jacobians[0][:] = derivatives[self.row]
            return True

    def solve(problem: p2o.Problem, camera_from_lidar: Float) -> p2o.Solution:
        pairs = require_residuals(problem, "ceres")
        start = np.asarray(camera_from_lidar, dtype=np.float64)
        delta, root_weight = np.zeros(6), np.sqrt(pairs.weight)
        rows = _Rows(pairs, start, root_weight)
        ceres_problem = pyceres.Problem()
        # The root of the weight scales residual and kernel alike: Huber of width h sqrt(w) on sqrt(w) r is w Huber(r).
        # Python must keep the blocks alive, since Ceres holds plain pointers to them.
        blocks = [
            (Pair(rows, int(row)), pyceres.HuberLoss(pairs.huber * root_weight[row]))
            for row in np.flatnonzero(root_weight)
        ]
        for cost, loss in blocks:
            ceres_problem.add_residual_block(cost, loss, [delta])
        if not blocks:
            return judged(pairs, start, start, 0, p2o.SolverStatus.CONVERGED, options.max_condition)
        settings, summary = pyceres.SolverOptions(), pyceres.SolverSummary()
        settings.max_num_iterations = options.max_iterations
        settings.function_tolerance = settings.parameter_tolerance = options.tolerance
        settings.gradient_tolerance = 0.0
        settings.linear_solver_type = pyceres.LinearSolverType.DENSE_NORMAL_CHOLESKY
        settings.num_threads = 1  # every residual is computed by Python
        settings.logging_type = pyceres.LoggingType.SILENT
        pyceres.solve(settings, ceres_problem, summary)
        converged = summary.termination_type == pyceres.TerminationType.CONVERGENCE
        return judged(
            pairs,
            start,
            pose_at(start, delta),
            int(summary.num_successful_steps + summary.num_unsuccessful_steps),
            p2o.SolverStatus.CONVERGED if converged else p2o.SolverStatus.ITERATIONS_SPENT,
            options.max_condition,
        )

    return solve


class _Rows:
    """Weighted residuals and derivatives of all pairs, computed once for each point of the chart that Ceres visits."""

    def __init__(self, problem: p2o.LeastSquares, start: Float, root_weight: Float) -> None:
        self.problem, self.start, self.root_weight = problem, start, root_weight
        self.key: bytes = b""
        self.values: tuple[Any, Any] = ((), ())

    def at(self, delta: Float) -> tuple[Any, Any]:
        """Return residuals (K,) and derivatives (K, 6) by delta (6,), both times the root of the weight."""
        key = delta.tobytes()
        if key != self.key:
            residuals, jacobian = linearise(self.problem, pose_at(self.start, delta))
            residuals = residuals * self.root_weight
            jacobian = np.ascontiguousarray((jacobian @ left_from_chart(delta)) * self.root_weight[:, None])
            self.key, self.values = key, (residuals, jacobian)
        return self.values


METHOD = p2o.Method(
    name="ceres",
    build=build,
    options=CeresOptions,
    summary="Ceres Solver with a Huber loss per pair, as in the paper; much slower than lm when driven from Python.",
    needs={"residuals"},
    cite="Agarwal, Mierle and others, Ceres Solver, 2022",
    extra="ceres",
)
