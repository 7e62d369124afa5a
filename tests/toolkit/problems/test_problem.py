"""Least squares of any kind: derivatives by differences, the robust cost, and solvers that take them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import pytest
from p2o import SolverStatus, se3
from p2o.solving import LeastSquares, Objective, Problem
from p2o_plugins.solve import ceres, lm, scipy_least_squares

from tests.edge_scene import TRUTH
from tests.plugins.solve.exact_pairs import NEAR, pairs


@dataclass(frozen=True, eq=False)
class PointToPlane(LeastSquares):
    """Points of the sweep on planes in the camera frame: residuals in metres, no derivatives given."""

    unit: ClassVar[str] = "m"
    xyz: np.ndarray
    place: np.ndarray
    normal: np.ndarray
    weight: np.ndarray
    frame: np.ndarray

    @property
    def huber(self) -> float:
        return 0.05

    def residuals(self, camera_from_lidar: np.ndarray) -> np.ndarray:
        return ((se3.apply(camera_from_lidar, self.xyz) - self.place) * self.normal).sum(axis=-1)


def planes(count: int = 60, directions: int = 3) -> PointToPlane:
    rng = np.random.default_rng(1)
    xyz = rng.uniform(-10, 10, (count, 3))
    normal = np.eye(3)[rng.integers(0, directions, count)]
    place = se3.apply(TRUTH, xyz)
    return PointToPlane(xyz, place, normal, np.ones(count), np.zeros(count, np.int64))


def test_differences_agree_with_derivatives_of_pairs_and_residuals_that_leave_a_direction_open_are_singular() -> None:
    problem = pairs()
    residuals, jacobian = problem.residuals_with_jacobian(NEAR)
    same, by_differences = LeastSquares.residuals_with_jacobian(problem, NEAR)
    np.testing.assert_allclose(same, residuals, atol=1e-9)
    np.testing.assert_allclose(by_differences, jacobian, rtol=1e-5, atol=1e-4)
    solution = lm.METHOD.build(lm.METHOD.options())(planes(directions=2), NEAR)
    assert solution.status is SolverStatus.SINGULAR
    assert "along the optical axis" in solution.reason


@pytest.mark.parametrize("method", [lm, scipy_least_squares, ceres], ids=lambda m: m.METHOD.name)
def test_solvers_of_residuals_take_residuals_of_any_unit(method) -> None:
    solution = method.METHOD.build(method.METHOD.options())(planes(), NEAR)
    step = se3.inverse(solution.camera_from_lidar) @ TRUTH
    assert solution.status is SolverStatus.CONVERGED
    assert se3.angle_deg(step) < 1e-4
    assert se3.distance_m(step) < 1e-5
    assert solution.covariance.shape == (6, 6)


def test_the_cost_is_quadratic_inside_the_kernel_linear_beyond_and_bounded_by_far() -> None:
    problem = planes(1)
    values = problem.loss(np.array([[0.01], [0.05], [0.15], [1e9], [np.nan]]))
    most = 0.05 * problem.far - 0.05**2 / 2
    np.testing.assert_allclose(values, [0.01**2 / 2, 0.05**2 / 2, 0.05 * 0.15 - 0.05**2 / 2, most, most])
    np.testing.assert_allclose(problem.robust_weight(np.array([0.0, 0.05, -0.1])), [1.0, 1.0, 0.5])


def test_pairs_residuals_and_objectives_are_problems_and_a_subclass_that_says_nothing_is_told_so() -> None:
    assert all(isinstance(p, Problem) for p in (pairs(), planes(), Objective(lambda poses: np.zeros(len(poses)))))
    assert not isinstance(np.zeros(3), Problem)
    poses = np.stack([TRUTH, NEAR])
    np.testing.assert_array_equal(planes().as_objective().cost(poses), planes().cost(poses))
    assert planes().cost(poses)[0] < planes().cost(poses)[1]
    assert planes().cost(poses[:0]).shape == (0,)

    class Empty(LeastSquares):
        weight = np.ones(1)

    for ask in (lambda p: p.huber, lambda p: p.residuals(TRUTH)):
        with pytest.raises(TypeError, match=r"Empty .* define (huber|residuals)"):
            ask(Empty())
