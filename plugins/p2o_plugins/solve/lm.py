"""Levenberg-Marquardt on the robust point-to-line cost (paper Eq. 1), all frames at once."""

from __future__ import annotations

import numpy as np
import p2o
from p2o import Float
from p2o.solving import LeastSquares, Problem, checked_solution, linearise, normal_equations, require_residuals

LONGEST_STEP = 100.0
"""Longer steps, in radians or metres, are rejected without evaluation: the system is nearly singular."""
_FIRST_DAMPING = 1e-4  # damping of the first step, relative to the Hessian's diagonal
MAX_CONDITION = 1e5  # condition number of the scaled Hessian above which a direction is unobservable
_MAX_ITERATIONS = 100  # largest number of steps, including rejected ones


class LmOptions(p2o.Options):
    """Options of `lm`."""

    tolerance: float = p2o.field(1e-10, gt=0, help="Stop if a step is smaller than this in radians and metres.")


def build(options: LmOptions) -> p2o.Solver:
    """Return the solver `(LeastSquares, camera_from_lidar (4, 4)) -> Solution`; it never raises on poor pairs."""

    def solve(problem: Problem, camera_from_lidar: Float) -> p2o.Solution:
        problem = require_residuals(problem, "lm")
        start = np.asarray(camera_from_lidar, dtype=np.float64)
        pose, iterations, status = minimise(problem, start, options)
        return checked_solution(problem, start, pose, iterations, status, MAX_CONDITION)

    return solve


def minimise(problem: LeastSquares, start: Float, options: LmOptions) -> tuple[Float, int, p2o.SolverStatus]:
    """Return the pose (4, 4) of least robust cost near `start`, the number of steps, and the status.

    The damping follows the ratio of actual to predicted gain (Nielsen, Damping parameter in Marquardt's method, 1999).
    Once a step moves the pairs by less than the Huber kernel, the exact curvature replaces the bounding one, until such
    a step is rejected.
    """
    pose, damping, growth = start, _FIRST_DAMPING, 2.0
    newton, newton_trusted = False, True
    residuals, jacobian = linearise(problem, pose)
    cost = float(problem.loss(residuals))
    total = max(float(problem.weight.sum()), np.finfo(float).tiny)
    hessian, gradient = normal_equations(problem, residuals, jacobian)
    for iteration in range(1, _MAX_ITERATIONS + 1):
        diagonal = _scale(hessian)
        try:
            step: Float = np.asarray(-np.linalg.solve(hessian + np.diag(damping * diagonal), gradient))
        except np.linalg.LinAlgError:
            # No residual depends on the pose; `checked_solution` reports the unobservable directions.
            return pose, iteration, p2o.SolverStatus.CONVERGED
        if np.abs(step).max() < options.tolerance:
            return pose, iteration, p2o.SolverStatus.CONVERGED
        predicted = 0.5 * float(step @ (damping * diagonal * step - gradient))
        gain = -np.inf
        if np.abs(step).max() < LONGEST_STEP:
            trial = p2o.se3.exp(step) @ pose
            trial_residuals, trial_jacobian = linearise(problem, trial)
            trial_cost = float(problem.loss(trial_residuals))
            gain = cost - trial_cost
        if predicted <= np.finfo(float).eps * cost:
            return (trial if gain > 0 else pose), iteration, p2o.SolverStatus.CONVERGED
        if gain > 0:
            moved_px = np.sqrt(max(float(step @ hessian @ step), 0.0) / total)
            newton = newton_trusted and (newton or moved_px < problem.huber)
            pose, residuals, jacobian, cost = trial, trial_residuals, trial_jacobian, trial_cost
            hessian, gradient = normal_equations(problem, residuals, jacobian, newton=newton)
            damping *= max(1 / 3, 1 - (2 * gain / predicted - 1) ** 3)
            growth = 2.0
        elif newton:
            newton = newton_trusted = False
            hessian, gradient = normal_equations(problem, residuals, jacobian)
        else:
            damping *= growth
            growth *= 2.0
    return pose, _MAX_ITERATIONS, p2o.SolverStatus.ITERATIONS_SPENT


def _scale(hessian: Float) -> Float:
    """Return the diagonal (6,) that scales the damping: rotations and translations differ, and none may be zero."""
    diagonal = np.diagonal(hessian).copy()
    floor = np.repeat(1e-6 * diagonal.reshape(2, 3).max(axis=1), 3)
    return np.asarray(np.maximum(diagonal, floor))


METHOD = p2o.Method(
    name="lm",
    build=build,
    options=LmOptions,
    summary="Levenberg-Marquardt with Huber weights, covariance and a test of observability.",
    needs={"residuals"},
    cite="Wang et al., P2O-Calib, IROS 2023, Eq. 1 and 2",
)
