"""A cost over poses as a function of six plain numbers: what solvers that need no residuals share."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import p2o
from p2o.arrays import Float
from p2o.problems.chart import left_from_chart, pose_at


class StepOptions(p2o.Options):
    """Steps of numeric derivatives, for problems that do not give a gradient."""

    step_deg: float = p2o.field(
        0.02, gt=0, le=5, help="Step of numeric derivatives in rotations; problems with a gradient need none."
    )
    step_m: float = p2o.field(0.005, gt=0, le=1, help="Step of numeric derivatives in translations.")


@dataclass(frozen=True, eq=False)
class ScalarCost:
    """The cost of a problem around `start` (4, 4), over x (6,) in units of `unit_deg` and `unit_m`; zero is the start.

    The gradient and the covariance of the problem are used where it tells them (`p2o.Objective`).
    """

    problem: p2o.Problem
    start: Float
    unit_deg: float
    unit_m: float

    @property
    def unit(self) -> Float:
        """Radians and metres (6,) of one unit of x."""
        return np.repeat([np.radians(self.unit_deg), self.unit_m], 3)

    def pose(self, x: Float) -> Float:
        """Return the poses (..., 4, 4) at x (..., 6)."""
        return pose_at(self.start, x * self.unit)

    def many(self, x: Float) -> Float:
        """Return the costs (B,) at x (B, 6), all asked for at once; infinite where they are not numbers."""
        costs = np.asarray(self.problem.cost(self.pose(x)), dtype=np.float64)
        return np.where(np.isnan(costs), np.inf, costs)

    def one(self, x: Float) -> float:
        """Return the cost at x (6,)."""
        return float(self.many(np.asarray(x)[None])[0])

    def gradient(self, x: Float, steps: StepOptions) -> Float:
        """Return the derivatives (6,) at x (6,): those of the problem, else central differences, all asked at once."""
        given: Any = getattr(self.problem, "gradient", None)
        if given is not None:
            return np.asarray(given(self.pose(x)) @ left_from_chart(x * self.unit) * self.unit)
        step = np.repeat([np.radians(steps.step_deg), steps.step_m], 3) / self.unit
        around = self.many(np.asarray(x) + np.concatenate([np.diag(step), -np.diag(step)]))
        with np.errstate(invalid="ignore"):
            slope = (around[:6] - around[6:]) / (2 * step)
        return np.where(np.isfinite(slope), slope, 0.0)

    def unsolvable(self) -> p2o.Solution | None:
        """Return the solution of a problem that there is nothing to solve in, or None."""
        if isinstance(self.problem, p2o.LeastSquares) and not len(self.problem):
            return p2o.Solution(self.start, 0.0, 0, p2o.SolverStatus.SINGULAR, None, "there are no pairs")
        if not np.isfinite(self.one(np.zeros(6))):
            reason = "the cost of the start is not finite"
            return p2o.Solution(self.start, np.inf, 0, p2o.SolverStatus.SINGULAR, None, reason)
        return None

    def solution(self, x: Float, iterations: int, *, converged: bool) -> p2o.Solution:
        """Return the solution at x (6,), with the covariance where the problem tells one."""
        pose = self.pose(x)
        told: Any = getattr(self.problem, "covariance", None)
        status = p2o.SolverStatus.CONVERGED if converged else p2o.SolverStatus.ITERATIONS_SPENT
        return p2o.Solution(pose, self.one(x), iterations, status, None if told is None else told(pose))
