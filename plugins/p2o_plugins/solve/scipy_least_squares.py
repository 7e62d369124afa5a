"""SciPy's trust-region least squares on the same robust cost: the yardstick for `lm`."""

from __future__ import annotations

from typing import Any

import numpy as np
import p2o
from p2o.arrays import Float
from p2o.problems.chart import left_from_chart, pose_at
from p2o.problems.normal_equations import judged, linearise, require_residuals


class ScipyOptions(p2o.Options):
    """Options of `scipy`."""

    max_iterations: int = p2o.field(100, ge=1, help="Evaluations of the residuals at most.")
    tolerance: float = p2o.field(
        1e-14, gt=1e-15, help="Relative change of cost or unknowns at which to stop (ftol and xtol of SciPy)."
    )
    max_condition: float = p2o.field(
        1e5, gt=1, help="Condition of the scaled Hessian beyond which a direction counts as not observable."
    )


def build(options: ScipyOptions) -> p2o.Solver:
    """Return the solver `(LeastSquares, camera_from_lidar (4, 4)) -> Solution`."""
    # Imported here: every run lists this method, few use it.
    from scipy.optimize import least_squares

    def solve(problem: p2o.Problem, camera_from_lidar: Float) -> p2o.Solution:
        pairs = require_residuals(problem, "scipy")
        start = np.asarray(camera_from_lidar, dtype=np.float64)
        at_start = judged(pairs, start, start, 0, p2o.SolverStatus.CONVERGED, options.max_condition)
        if at_start.status == p2o.SolverStatus.SINGULAR:
            return at_start  # SciPy does not damp, and would wander off along what is not determined

        def residuals(delta: Float) -> Float:
            return linearise(pairs, pose_at(start, delta))[0]

        def jacobian(delta: Float) -> Float:
            return linearise(pairs, pose_at(start, delta))[1] @ left_from_chart(delta)

        with np.errstate(all="ignore"):  # SciPy divides by zero singular values; `judged` names what they mean
            fit: Any = least_squares(
                residuals,
                np.zeros(6),
                jacobian,
                loss=_weighted_huber(pairs),
                x_scale="jac",
                ftol=options.tolerance,
                xtol=options.tolerance,
                gtol=None,
                max_nfev=options.max_iterations,
            )
        status = p2o.SolverStatus.CONVERGED if fit.status > 0 else p2o.SolverStatus.ITERATIONS_SPENT
        return judged(pairs, start, pose_at(start, fit.x), int(fit.nfev), status, options.max_condition)

    return solve


def _weighted_huber(problem: p2o.LeastSquares) -> Any:
    """Return SciPy's loss of squared residuals z (K,): weight times Huber, so that the kernel acts in pixels.

    SciPy's own loss="huber" sees weighted residuals only, which would give each pair a kernel of another width.
    """
    weight, width = problem.weight, problem.huber

    def loss(z: Float) -> Float:
        inside = z <= width**2
        size = np.sqrt(np.where(inside, 1.0, z))
        value = np.where(inside, z, 2 * width * size - width**2)
        slope = np.where(inside, 1.0, width / size)
        return np.asarray(weight * np.stack([value, slope, np.where(inside, 0.0, -0.5 * width / size**3)]))

    return loss


METHOD = p2o.Method(
    name="scipy",
    build=build,
    options=ScipyOptions,
    summary="SciPy's trust-region least squares with the same weighted Huber cost as lm.",
    needs={"residuals"},
    cite="Branch, Coleman and Li, SIAM Journal on Scientific Computing 21, 1999",
)
