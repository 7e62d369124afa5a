"""Levenberg-Marquardt on the robust point-to-line cost (paper Eq. 1), all frames at once."""

from __future__ import annotations

import numpy as np
import p2o
from p2o.arrays import Float
from p2o.problems.normal_equations import judged, linearise, normal_equations, require_residuals

LONGEST_STEP = 100.0
"""A step of so many radians or metres is an accident of a nearly singular system and refused unseen."""


class LmOptions(p2o.Options):
    """Options of `lm`."""

    max_iterations: int = p2o.field(100, ge=1, help="Steps tried at most, refused ones included.")
    tolerance: float = p2o.field(1e-10, gt=0, help="Stops when a step is smaller than this in radians and metres.")
    first_damping: float = p2o.field(1e-4, gt=0, help="Damping of the first step, relative to the Hessian's diagonal.")
    max_condition: float = p2o.field(
        1e5, gt=1, help="Condition of the scaled Hessian beyond which a direction counts as not observable."
    )


def build(options: LmOptions) -> p2o.Solver:
    """Return the solver `(LeastSquares, camera_from_lidar (4, 4)) -> Solution`; it never raises on poor pairs."""

    def solve(problem: p2o.Problem, camera_from_lidar: Float) -> p2o.Solution:
        problem = require_residuals(problem, "lm")
        start = np.asarray(camera_from_lidar, dtype=np.float64)
        pose, iterations, status = minimise(problem, start, options)
        return judged(problem, start, pose, iterations, status, options.max_condition)

    return solve


def minimise(problem: p2o.LeastSquares, start: Float, options: LmOptions) -> tuple[Float, int, p2o.SolverStatus]:
    """Return the pose (4, 4) of least robust cost near `start`, the number of steps tried, and how it ended.

    The damping follows the ratio of true to predicted gain (Nielsen, Damping parameter in Marquardt's method, 1999).
    Once a step moves the pairs by less than the Huber kernel, the exact curvature replaces the bounding one, until
    such a step is refused.
    """
    pose, damping, growth = start, options.first_damping, 2.0
    newton, newton_trusted = False, True
    residuals, jacobian = linearise(problem, pose)
    cost = float(problem.loss(residuals))
    total = max(float(problem.weight.sum()), np.finfo(float).tiny)
    hessian, gradient = normal_equations(problem, residuals, jacobian)
    for iteration in range(1, options.max_iterations + 1):
        diagonal = _scale(hessian)
        try:
            step = -np.linalg.solve(hessian + np.diag(damping * diagonal), gradient)
        except np.linalg.LinAlgError:
            return (
                pose,
                iteration,
                p2o.SolverStatus.CONVERGED,
            )  # nothing depends on the pose; `judged` says what is not determined
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
    return pose, options.max_iterations, p2o.SolverStatus.ITERATIONS_SPENT


def _scale(hessian: Float) -> Float:
    """Return the diagonal (6,) that damping is relative to: radians and metres differ, and none may be zero."""
    diagonal = np.diagonal(hessian).copy()
    floor = np.repeat(1e-6 * diagonal.reshape(2, 3).max(axis=1), 3)
    return np.asarray(np.maximum(diagonal, floor))


METHOD = p2o.Method(
    name="lm",
    build=build,
    options=LmOptions,
    summary="Levenberg-Marquardt with Huber weights, own code: quick, with covariance and a test of observability.",
    needs={"residuals"},
    cite="Wang et al., P2O-Calib, IROS 2023, Eq. 1 and 2",
)
