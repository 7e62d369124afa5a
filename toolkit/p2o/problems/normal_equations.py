"""Robust normal equations of any least squares, and what they say about the solution: covariance, observability."""

from __future__ import annotations

import numpy as np

from p2o.arrays import Float
from p2o.errors import InputError
from p2o.problems.problem import LeastSquares, Objective, Problem
from p2o.results.result import Solution, SolverStatus

MIN_PAIRS = 6
"""Fewest pairs that can fix the six unknowns."""

LEVER_M = 30.0
"""A turn of 1 / LEVER_M rad (2 deg) and a shift of 1 m are equally large errors where all points are far."""

AXES = (
    "rotation about the camera's x axis (pitch)",
    "rotation about the camera's y axis (yaw)",
    "rotation about the optical axis (roll)",
    "translation sideways (camera x)",
    "translation up and down (camera y)",
    "translation along the optical axis",
)
"""The six unknowns in words, in the order of a tangent vector."""


def require_residuals(problem: Problem, method: str) -> LeastSquares:
    """Return the problem if it has residuals; raise InputError if it is only a scalar cost."""
    if isinstance(problem, LeastSquares):
        return problem
    expected = "a p2o.solving.LeastSquares, such as PointToLine"
    hint = "use a matcher that gives pairs or residuals, or the solver nelder-mead"
    raise InputError(f"solver {method} needs residuals", expected=expected, got=type(problem).__name__, hint=hint)


def linearise(problem: LeastSquares, camera_from_lidar: Float) -> tuple[Float, Float]:
    """Return residuals (K,) and derivatives (K, 6) as `LeastSquares.residuals_with_jacobian`, without NaN.

    Unseen measurements, and residuals beyond `far`, get the constant residual `far` of the cost and zero derivatives.
    """
    residuals, jacobian = problem.residuals_with_jacobian(camera_from_lidar)
    size = np.abs(residuals)
    if size.size and not size.max() < problem.far:  # also true where one is NaN
        far = ~(size < problem.far)
        residuals, jacobian = residuals.copy(), jacobian.copy(order="K")  # the arrays belong to the problem
        residuals[far] = np.copysign(problem.far, residuals[far])
        jacobian[far] = 0.0
    return residuals, jacobian


def normal_equations(
    problem: LeastSquares, residuals: Float, jacobian: Float, *, newton: bool = False
) -> tuple[Float, Float]:
    """Return Hessian (6, 6) and gradient (6,) of the robust sum for a left update, the projection taken as linear.

    Every pair is weighed down by its Huber factor, which bounds the cost from above: a safe step that approaches the
    minimum at a constant rate. With `newton` pairs beyond the kernel have slope but no curvature, which is exact and
    quick near the minimum, and may overshoot far from it.
    """
    width, rows = problem.huber, jacobian.T
    size = np.abs(residuals)
    curvature = (size <= width) * problem.weight if newton else problem.weight * (width / np.maximum(size, width))
    slope = np.clip(residuals, -width, width)
    slope *= problem.weight
    return (rows * curvature) @ rows.T, rows @ slope


def why_singular(
    problem: LeastSquares, camera_from_lidar: Float, residuals: Float, hessian: Float, max_condition: float
) -> str:
    """Return in words what the pairs cannot determine at a pose, or "" if they determine all six unknowns.

    Rotations are scaled by the mean depth of the pairs, at most `LEVER_M`, so that one unit of each unknown moves a
    point by about one metre; `max_condition` bounds the condition number of the Hessian.
    """
    used = int(((problem.weight > 0) & (np.abs(residuals) < problem.far)).sum())
    if used < MIN_PAIRS:
        return f"{used} pairs with a visible point, at least {MIN_PAIRS} are needed"
    scale = np.array([1 / min(problem.depth_m(camera_from_lidar), LEVER_M)] * 3 + [1.0] * 3)
    values, vectors = np.linalg.eigh(scale[:, None] * hessian * scale)
    weak = values <= values[-1] / max_condition
    if not weak.any():
        return ""
    return "the pairs do not determine " + " nor ".join(_in_words(v) for v in vectors.T[weak])


def _in_words(direction: Float) -> str:
    """Name a direction (6,): its largest component, and those at least half as large, which move with it."""
    size = np.abs(direction)
    order = [i for i in np.argsort(-size, kind="stable") if size[i] >= 0.5 * size.max()]
    return " with ".join(AXES[i] for i in order)


def covariance(problem: LeastSquares, residuals: Float, jacobian: Float) -> Float | None:
    """Return the covariance (6, 6) of a left update in rad and m, or None where it does not exist.

    s^2 (J^T W J)^-1 with the scale of a Huber estimate, s^2 = sum w psi(r)^2 / (K - 6) / m^2, m the share of pairs
    within the kernel (Huber and Ronchetti, Robust Statistics, 2009, Sec. 7.6). It takes pairs as independent, which
    neighbours along one edge are not.
    """
    weight, rows = problem.weight, jacobian.T
    inside = np.abs(residuals) <= problem.huber
    share = float(weight @ inside) / max(float(weight.sum()), np.finfo(float).tiny)
    if share == 0 or len(problem) <= MIN_PAIRS:
        return None
    psi = np.clip(residuals, -problem.huber, problem.huber)
    scale = float(weight @ psi**2) / (len(problem) - MIN_PAIRS) / share**2
    try:
        inverse = np.linalg.inv((rows * weight) @ rows.T)
    except np.linalg.LinAlgError:
        return None
    return np.asarray(0.5 * scale * (inverse + inverse.T))


def own_covariance(problem: Problem, camera_from_lidar: Float, cells: int) -> Float | None:
    """Return the covariance (6, 6) of a left update by the problem itself at its optimum (4, 4); None if it has none.

    Residuals of one of the `cells` independent cells of the image count as one: their errors are correlated.
    """
    if isinstance(problem, Objective):
        return None if problem.covariance is None else problem.covariance(camera_from_lidar)
    if not isinstance(problem, LeastSquares) or not len(problem) or not cells:
        return None
    scatter = covariance(problem, *linearise(problem, camera_from_lidar))
    return None if scatter is None else scatter * max(1.0, len(problem) / cells)


def checked_solution(
    problem: LeastSquares,
    start: Float,
    camera_from_lidar: Float,
    iterations: int,
    status: SolverStatus,
    max_condition: float,
) -> Solution:
    """Return the solution at a pose with its covariance; where the pairs cannot determine it, the start as singular."""
    residuals, jacobian = linearise(problem, camera_from_lidar)
    hessian, _ = normal_equations(problem, residuals, jacobian)
    reason = why_singular(problem, camera_from_lidar, residuals, hessian, max_condition)
    if reason:
        return Solution(
            start, float(problem.loss(problem.residuals(start))), iterations, SolverStatus.SINGULAR, None, reason
        )
    cost = float(problem.loss(residuals))
    if status is SolverStatus.CONVERGED:
        status = SolverStatus.of(start, camera_from_lidar, converged=True)
    return Solution(camera_from_lidar, cost, iterations, status, covariance(problem, residuals, jacobian))
