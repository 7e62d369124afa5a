"""SciPy's trust-region least squares on the same robust cost: the reference for `lm`."""

from __future__ import annotations

from typing import Any

import numpy as np
import p2o
from p2o import Float, solving
from p2o.solving import LeastSquares, Problem, checked_solution, linearise, pose_from_chart, require_residuals

from p2o_plugins.solve.lm import MAX_CONDITION

_MAX_ITERATIONS = 100  # largest number of evaluations of the residuals
_TOLERANCE = 1e-14  # relative change of cost or unknowns at which to stop (ftol and xtol of SciPy)


def build(options: p2o.Options) -> p2o.Solver:
    """Return the solver `(LeastSquares, camera_from_lidar (4, 4)) -> Solution`."""
    # Imported here: every run lists this method, few use it.
    from scipy.optimize import least_squares

    def solve(problem: Problem, camera_from_lidar: Float) -> p2o.Solution:
        pairs = require_residuals(problem, "scipy")
        start = np.asarray(camera_from_lidar, dtype=np.float64)
        at_start = checked_solution(pairs, start, start, 0, p2o.SolverStatus.CONVERGED, MAX_CONDITION)
        if at_start.status == p2o.SolverStatus.SINGULAR:
            return at_start  # SciPy does not damp and would diverge along unobservable directions.

        def residuals(delta: Float) -> Float:
            return linearise(pairs, pose_from_chart(start, delta))[0]

        def jacobian(delta: Float) -> Float:
            return linearise(pairs, pose_from_chart(start, delta))[1] @ solving.left_from_chart(delta)

        # SciPy divides by zero singular values; `checked_solution` reports the unobservable directions.
        with np.errstate(all="ignore"):
            fit: Any = least_squares(
                residuals,
                np.zeros(6),
                jacobian,
                loss=_weighted_huber(pairs),
                x_scale="jac",
                ftol=_TOLERANCE,
                xtol=_TOLERANCE,
                gtol=None,
                max_nfev=_MAX_ITERATIONS,
            )
        status = p2o.SolverStatus.CONVERGED if fit.status > 0 else p2o.SolverStatus.ITERATIONS_SPENT
        pose = pose_from_chart(start, fit.x)
        return checked_solution(pairs, start, pose, int(fit.nfev), status, MAX_CONDITION)

    return solve


def _weighted_huber(problem: LeastSquares) -> Any:
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
    summary="SciPy's trust-region least squares with the same weighted Huber cost as lm.",
    needs={"residuals"},
    cite="Branch, Coleman and Li, SIAM Journal on Scientific Computing 21, 1999",
)
