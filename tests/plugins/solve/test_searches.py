"""`grid729` and `coordinate`: searches on any scalar cost."""

from __future__ import annotations

import sys

import numpy as np
import pytest
from p2o import Method, SolverStatus, se3
from p2o.solving import Objective
from p2o_plugins.solve import coordinate, grid729

from tests.edge_scene import TRUTH
from tests.plugins.solve.exact_pairs import NEAR, apart, pairs

every = pytest.mark.parametrize("method", [grid729.METHOD, coordinate.METHOD], ids=lambda m: m.name)


def bowl(shape: np.ndarray) -> Objective:
    """A quadratic of the left update (6,) in rad and m that leads from the truth to a pose."""

    def cost(poses: np.ndarray) -> np.ndarray:
        x = np.array([se3.log(pose @ se3.inverse(TRUTH)) for pose in poses])
        return np.einsum("bi,ij,bj->b", x, shape, x)

    return Objective(cost)


@every
def test_the_bottom_of_a_quadratic_is_found(method: Method) -> None:
    scale = np.diag([30.0, 30.0, 30.0, 1.0, 1.0, 1.0])
    mixed = np.eye(6) + 0.5 * np.roll(np.eye(6), 3, axis=1)
    problem = bowl(scale @ mixed @ mixed.T @ scale)
    found = method.build(method.options())(problem, NEAR)
    assert apart(found.camera_from_lidar, TRUTH)[0] < 0.02
    assert apart(found.camera_from_lidar, TRUTH)[1] < 0.01
    assert found.status is SolverStatus.CONVERGED


def test_grid729_stays_where_no_neighbour_is_better() -> None:
    solution = grid729.build(grid729.METHOD.options())(bowl(np.eye(6)), TRUTH)
    np.testing.assert_array_equal(solution.camera_from_lidar, TRUTH)
    assert solution.iterations == grid729._LEVELS


def test_grid729_asks_for_all_neighbours_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(grid729, "_LEVELS", 2)
    sizes = []
    problem = Objective(lambda poses: (sizes.append(len(poses)), np.ones(len(poses)))[1])
    grid729.build(grid729.METHOD.options())(problem, TRUTH)
    assert sizes == [1, 729, 729, 1]


@every
def test_searches_end_at_their_limit(method: Method, monkeypatch: pytest.MonkeyPatch) -> None:
    limit = {"grid729": "_MAX_MOVES", "coordinate": "_MAX_SWEEPS"}[method.name]
    monkeypatch.setattr(sys.modules[method.build.__module__], limit, 1)
    solution = method.build(method.options())(pairs().as_objective(), NEAR)
    assert solution.status is SolverStatus.ITERATIONS_SPENT


@every
def test_a_start_without_a_cost_is_refused(method: Method) -> None:
    nowhere = Objective(lambda poses: np.full(len(poses), np.nan))
    solution = method.build(method.options())(nowhere, NEAR)
    assert solution.status is SolverStatus.SINGULAR
    np.testing.assert_array_equal(solution.camera_from_lidar, NEAR)
