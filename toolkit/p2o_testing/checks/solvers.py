"""What solvers promise, on problems of the stage whose solution is known exactly."""

from __future__ import annotations

from typing import Any

import numpy as np
from p2o.host.method import Kind
from p2o.problems.point_to_line import PointToLine
from p2o.results.result import SolverStatus

from p2o_testing import stage
from p2o_testing.exact import around, pairs, planes, require_near
from p2o_testing.same import Call
from p2o_testing.subject import Checks, Subject, but, needs, require

CHECKS = Checks(Kind.SOLVER)

_of_residuals = needs("pairs", "residuals")


def _problem(subject: Subject) -> Any:
    """Return exact pairs, as a mere cost for solvers that need no more."""
    return pairs() if {"pairs", "residuals"} & subject.needs else pairs().as_objective()


def _near(subject: Subject) -> tuple[float, float]:
    """Return the tolerance of a solver in deg and m: residuals contain more information than a cost."""
    return (0.02, 0.01) if {"pairs", "residuals"} & subject.needs else (0.1, 0.03)


def _solved(subject: Subject) -> Call:
    """Return the solution of exact pairs from 1 deg and 5 cm, which serves several checks."""
    return Call.of(subject, _problem(subject), around(stage.camera_from_lidar(), 1.0, 0.05)[0])


@CHECKS.of()
def solver_stays_at_the_truth(subject: Subject) -> None:
    """On exact pairs, a solver that begins at the truth stays there: 0.01 deg and 5 mm."""
    truth = stage.camera_from_lidar()
    require_near(subject.built()(_problem(subject), truth).camera_from_lidar, truth, 0.01, 0.005)


@CHECKS.of()
def solver_returns_to_the_truth(subject: Subject) -> None:
    """On exact pairs, a solver returns from 1 deg and 5 cm: to 0.02 deg, 1 cm by residuals, to 0.1 deg, 3 cm else."""
    truth = stage.camera_from_lidar()
    other = subject.built()(_problem(subject), around(truth, 1.0, 0.05)[1])
    for solution in (subject.once(_solved).answer, other):
        require_near(solution.camera_from_lidar, truth, *_near(subject))


@CHECKS.of(but(needs("pairs")))
def solver_solves_problems_in_metres(subject: Subject) -> None:
    """Distances of points to planes, in metres and without any pixel, are solved as pairs are."""
    truth, problem = stage.camera_from_lidar(), planes()
    given = problem if "residuals" in subject.needs else problem.as_objective()
    solution = subject.built()(given, around(truth, 1.0, 0.05)[0])
    require_near(solution.camera_from_lidar, truth, *_near(subject))


@CHECKS.of()
def solver_never_makes_it_worse(subject: Subject) -> None:
    """The cost at the solution is at most that at the start, and `Solution.cost` is finite."""
    problem, start = _problem(subject), around(stage.camera_from_lidar(), 1.5, 0.1)[0]
    solution = subject.built()(problem, start)
    before, after = problem.cost(np.stack([start, solution.camera_from_lidar]))
    require(after <= before * (1 + 1e-9) + 1e-9, f"cost rose from {before:.4g} to {after:.4g}")
    require(np.isfinite(solution.cost), f"Solution.cost is {solution.cost}")


@CHECKS.of()
def solutions_say_how_they_ended(subject: Subject) -> None:
    """On exact pairs the status is not "singular", and `Solution.cost` is the problem's cost at the solution."""
    problem, solution = _problem(subject), subject.once(_solved).answer
    singular = solution.status is SolverStatus.SINGULAR
    require(not singular, f"pairs that determine the pose are called singular: {solution.reason}")
    cost = float(problem.cost(solution.camera_from_lidar[None])[0])
    same = np.isclose(solution.cost, cost, rtol=1e-4, atol=1e-6)
    require(same, f"Solution.cost is {solution.cost:.6g}, that of the pose is {cost:.6g}")
    require(solution.iterations >= 0, f"{solution.iterations} iterations")


@CHECKS.of(_of_residuals)
def solver_says_when_nothing_is_determined(subject: Subject) -> None:
    """Without any pairs a solver of residuals returns its start with status "singular", and does not raise."""
    truth = stage.camera_from_lidar()
    solution = subject.built()(PointToLine.empty((stage.camera(),)), truth)
    require(solution.status is SolverStatus.SINGULAR, f"status is {solution.status.value!r} without any pairs")
    require_near(solution.camera_from_lidar, truth, 1e-6, 1e-6)


@CHECKS.of()
def covariance_is_one(subject: Subject) -> None:
    """A covariance is (6, 6), symmetric and has no negative variance."""
    covariance = subject.once(_solved).answer.covariance
    if covariance is None:
        return
    require(covariance.shape == (6, 6), f"shape {covariance.shape}")
    require(np.allclose(covariance, covariance.T, atol=1e-9 * np.abs(covariance).max()), "not symmetric")
    require(np.linalg.eigvalsh(covariance).min() >= -1e-9 * np.abs(covariance).max(), "a negative variance")


@CHECKS.of()
def solutions_repeat(subject: Subject) -> None:
    """The same problem and start give the same pose, bit for bit; the problem is not written to."""
    call = subject.once(_solved)
    call.require_unwritten()
    again = subject.built()(*call.given)
    require(np.array_equal(call.answer.camera_from_lidar, again.camera_from_lidar), "the poses of two runs differ")
