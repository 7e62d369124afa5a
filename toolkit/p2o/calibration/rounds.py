"""The loop of Algorithm 1: match within a shrinking cutting distance, solve, keep the pose where its cost falls."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from p2o.arrays import Float
from p2o.calibration.options import PipelineOptions
from p2o.features.side import Side
from p2o.features.view import View
from p2o.geometry import se3
from p2o.host.stages import JudgeBase, Matcher, Solver
from p2o.problems.normal_equations import MIN_PAIRS
from p2o.problems.point_to_line import PointToLine
from p2o.problems.problem import LeastSquares, Objective, Problem
from p2o.results.result import Round, Solution, SolverStatus, Status


@dataclass(frozen=True, eq=False)
class End:
    """Where the rounds from one pose ended; `problem` is the one at the pose, `solution` is the last one."""

    pose: Float
    status: Status
    reason: str
    rounds: tuple[Round, ...]
    problem: Problem | None = None
    solution: Solution | None = None

    @property
    def pairs(self) -> PointToLine | None:
        """The pairs at the pose, of a matcher that gives pairs."""
        return self.problem if isinstance(self.problem, PointToLine) and len(self.problem) else None


REACH_AFTER_SEARCH_PX = 12.0
"""First cutting distance from a pose that an initializer proposes."""
_LEAST_GAIN_EDGES = 0.3
"""Rounds end where one gains fewer edges: the judge then finds the minimum."""


@dataclass(frozen=True)
class Rounds:
    """Match-and-solve rounds with a matcher and a solver."""

    matcher: Matcher
    solver: Solver
    options: PipelineOptions

    def __call__(
        self, views: Sequence[View], start: Float, pose: Float, judge: JudgeBase, *, reach_px: float, found_by: str = ""
    ) -> End:
        """Run the rounds of Algorithm 1 from `pose` (4, 4): at most `options.rounds` (n_opt of the paper).

        Each round matches within the cutting distance (d_c, first `reach_px`), minimises the robust sum of residuals
        (Eq. 1) and shrinks the cutting distance. Unlike in the paper, a pose is kept only where the judge gives it a
        lower cost than the best one so far, and rounds end when a round does not change the pose, or when one within
        the smallest cutting distance gains less than `_LEAST_GAIN_EDGES`, where the judge counts edges. `found_by` is
        the stage that proposed the pose; empty where it is the `start` itself, which is refused where no round moves
        it.
        """
        options, rounds = self.options, []
        if found_by:
            rounds.append(_round_record(found_by, 0.0, None, start, pose, judge.costs([pose])[0], accepted=True))
        best, status, reason = pose, Status.ROUNDS_SPENT, "without rounds"
        solution, improved, moved, stopped, reach = None, False, False, None, reach_px
        for _ in range(options.rounds):
            problem = self.matcher(views, pose, reach)
            few = self._too_few(problem, reach)
            if few:
                stopped, reason = Status.TOO_FEW_MATCHES, few
                break
            solution = self.solver(problem, pose)
            if solution.status is SolverStatus.SINGULAR:
                stopped, reason = Status.NOT_OBSERVABLE, solution.reason
                break
            before, pose = pose, solution.camera_from_lidar
            moved = moved or _moved(start, pose)
            cost_of_best, cost = judge.costs([best, pose])
            better = cost < cost_of_best
            if better:
                best, improved = pose, True
            record = _round_record("refine", reach, problem, before, pose, cost, accepted=better)
            rounds.append(record)
            still = record.step_deg < options.tolerance_deg and record.step_m < options.tolerance_m
            independent = isinstance(problem, Objective) and problem.reach_independent
            if still and (reach <= options.min_reach_px or independent):
                status, reason = Status.CONVERGED, "the last round moved the pose by less than the tolerance"
                break
            gain, unit = judge.lead(cost, cost_of_best)
            if reach <= options.min_reach_px and unit == "edges" and gain < _LEAST_GAIN_EDGES:
                status, reason = Status.CONVERGED, "the last round matched no more edges"
                break
            step = f"{record.step_deg:.2g} deg and {record.step_m:.2g} m"
            reason = f"the last of {options.rounds} rounds moved the pose by {step}"
            reach = max(options.min_reach_px, reach * options.shrink)
        # A solver that only walked away from the initial guess is not rescued.
        refined = judge.maximised(best) if improved or found_by else best
        if refined is not best:
            cost_before, cost = judge.costs([best, refined])
            lower = cost < cost_before
            rounds.append(_round_record(judge.name, 0.0, None, best, refined, cost, accepted=lower))
            best, improved = refined if lower else best, improved or lower
        if solution is not None and stopped is None and not (found_by or moved or _moved(start, best)):
            reason = "the solver found no pose of lower cost than the initial guess"
            return End(start, Status.NO_IMPROVEMENT, reason, tuple(rounds))
        if stopped is not None and not improved:
            return End(start, stopped, reason, tuple(rounds))
        if found_by and not improved:
            reason += f"; no round improved on the pose of the stage {found_by}"
        last = self.matcher(views, best, options.min_reach_px)
        if stopped is not None:
            # A failed later round does not discard the pose of an earlier one, unless the pairs at that pose do not
            # determine it either: it is then an accident of wrong pairs.
            refusal = self._undetermined(last, best)
            if refusal is not None:
                return End(start, *refusal, tuple(rounds))
            reason = f"the rounds ended early: {reason}"
        return End(best, status, reason, tuple(rounds), last, solution)

    def _undetermined(self, problem: Problem, pose: Float) -> tuple[Status, str] | None:
        """Return why the problem at a pose (4, 4) does not determine it, or None."""
        few = self._too_few(problem, self.options.min_reach_px)
        if few:
            return Status.TOO_FEW_MATCHES, few
        solution = self.solver(problem, pose)
        return (Status.NOT_OBSERVABLE, solution.reason) if solution.status is SolverStatus.SINGULAR else None

    def _too_few(self, problem: Problem, reach_px: float) -> str:
        """Return why there are too few residuals to solve, or an empty text."""
        if not isinstance(problem, LeastSquares):
            return ""
        pairs = isinstance(problem, PointToLine)
        least, what = (self.options.min_matches, "pairs") if pairs else (MIN_PAIRS, "residuals")
        few = f"{len(problem)} {what} within {reach_px:.0f} px, at least {least} are needed"
        return few if len(problem) < least else ""


def _moved(start: Float, pose: Float) -> bool:
    return SolverStatus.of(start, pose, converged=True) is not SolverStatus.NOT_MOVED


def _round_record(
    stage: str, reach_px: float, problem: Problem | None, before: Float, after: Float, cost: float, *, accepted: bool
) -> Round:
    step = after @ se3.inverse(before)
    return Round(
        stage=stage,
        reach_px=reach_px,
        matches={} if problem is None else counts(problem),
        mean_residual=float("nan") if problem is None else _mean_residual(problem, after),
        cost=cost,
        step_deg=se3.angle_deg(step),
        step_m=se3.distance_m(step),
        accepted=accepted,
    )


def counts(problem: Problem) -> dict[str, int]:
    """Return how many pairs there are by the letter of their direction, or how many residuals; empty without any."""
    if isinstance(problem, PointToLine):
        return {Side(int(s)).letter: int(n) for s, n in zip(*np.unique(problem.side, return_counts=True), strict=True)}
    return {"residuals": len(problem)} if isinstance(problem, LeastSquares) else {}


def mean_residuals_px(problem: PointToLine, pose: Float) -> dict[str, float]:
    """Return the mean absolute residual in pixels by the letter of the direction."""
    residuals = np.abs(problem.residuals(pose))
    sides = np.unique(problem.side).tolist()
    return {Side(int(s)).letter: float(np.nanmean(residuals[problem.side == s])) for s in sides}


def _mean_residual(problem: Problem, pose: Float) -> float:
    if not isinstance(problem, LeastSquares) or not len(problem):
        return float("nan")
    residuals = np.abs(problem.residuals(pose))
    return float(np.nanmean(residuals)) if np.isfinite(residuals).any() else float("nan")
