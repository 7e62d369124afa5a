"""Minimise a cost over six numbers: the parametrisation that solvers without residuals share."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import p2o
from p2o import Float
from p2o.solving import LeastSquares, Objective, Problem, left_from_chart, pose_from_chart

_STEP_DEG, _STEP_M = 0.02, 0.005  # steps of numerical derivatives, for problems without a gradient


@dataclass(frozen=True, eq=False)
class ScalarCost:
    """The cost of a problem around `start` (4, 4) over x (6,), in units of `unit_deg` and `unit_m`; start is at zero.

    Gradient and covariance of the problem are used if it has them (`p2o.solving.Objective`).
    """

    problem: Problem
    start: Float
    unit_deg: float
    unit_m: float

    @property
    def unit(self) -> Float:
        """Return the size (6,) of one unit of x, in rad and m."""
        return np.repeat([np.radians(self.unit_deg), self.unit_m], 3)

    def pose(self, x: Float) -> Float:
        """Return the poses (..., 4, 4) at x (..., 6)."""
        return pose_from_chart(self.start, x * self.unit)

    def many(self, x: Float) -> Float:
        """Return the costs (B,) at x (B, 6), evaluated in one call; infinite if they are NaN."""
        costs = np.asarray(self.problem.cost(self.pose(x)), dtype=np.float64)
        return np.where(np.isnan(costs), np.inf, costs)

    def one(self, x: Float) -> float:
        """Return the cost at x (6,)."""
        return float(self.many(np.asarray(x)[None])[0])

    def gradient(self, x: Float) -> Float:
        """Return the derivatives (6,) at x (6,): those of the problem, else central differences in one call."""
        if isinstance(self.problem, Objective) and self.problem.gradient is not None:
            by_left_update = self.problem.gradient(self.pose(x))
            return np.asarray(by_left_update @ left_from_chart(x * self.unit) * self.unit)
        return self.differences(x, _STEP_DEG, _STEP_M)

    def differences(self, x: Float, step_deg: float, step_m: float) -> Float:
        """Return derivatives (6,) at x (6,) by central differences over these steps, 0 where they are not finite."""
        step = np.repeat([np.radians(step_deg), step_m], 3) / self.unit
        around = self.many(np.asarray(x) + np.concatenate([np.diag(step), -np.diag(step)]))
        with np.errstate(invalid="ignore"):
            slope = (around[:6] - around[6:]) / (2 * step)
        return np.where(np.isfinite(slope), slope, 0.0)

    def solution(self, x: Float, iterations: int, *, converged: bool, covariance: bool = True) -> p2o.Solution:
        """Return the solution at x (6,), with the covariance of the problem if it has one and it is asked for."""
        pose = self.pose(x)
        of_problem = self.problem.covariance if covariance and isinstance(self.problem, Objective) else None
        by_problem = None if of_problem is None else of_problem(pose)
        return ended(self.start, pose, self.one(x), iterations, converged=converged, covariance=by_problem)


def ended(
    start: Float, pose: Float, cost: float, iterations: int, *, converged: bool, covariance: Float | None = None
) -> p2o.Solution:
    """Return the solution at a pose (4, 4), with the status that it did not move where it is the `start` (4, 4)."""
    status = p2o.SolverStatus.of(start, pose, converged=converged)
    reason = "no pose of lower cost was found" if status is p2o.SolverStatus.NOT_MOVED else ""
    return p2o.Solution(pose, cost, iterations, status, covariance, reason)


def unsolvable(problem: Problem, start: Float, cost: float) -> p2o.Solution | None:
    """Return the solution of a problem without pairs or without a finite `cost` at the start (4, 4); else None."""
    if isinstance(problem, LeastSquares) and not len(problem):
        return p2o.Solution(start, 0.0, 0, p2o.SolverStatus.SINGULAR, None, "there are no pairs")
    if not np.isfinite(cost):
        reason = "the cost of the start is not finite"
        return p2o.Solution(start, np.inf, 0, p2o.SolverStatus.SINGULAR, None, reason)
    return None


def scalar_solver(minimise: Callable[[ScalarCost], p2o.Solution], unit_deg: float, unit_m: float) -> p2o.Solver:
    """Return the solver `(Problem, camera_from_lidar (4, 4)) -> Solution` that minimises a scalar cost."""

    def solve(problem: Problem, camera_from_lidar: Float) -> p2o.Solution:
        start = np.asarray(camera_from_lidar, dtype=np.float64)
        cost = ScalarCost(problem, start, unit_deg, unit_m)
        return unsolvable(problem, start, cost.one(np.zeros(6))) or minimise(cost)

    return solve
