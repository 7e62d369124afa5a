"""`grid729` and `coordinate`: searches on any scalar cost."""

from __future__ import annotations

import sys

import numpy as np
import pytest
from p2o import Method, SolverStatus
from p2o.solving import Objective
from p2o_plugins.solve import coordinate, grid729

from tests.edge_scene import TRUTH
from tests.plugins.solve.exact_pairs import NEAR, apart, off, pairs

every = pytest.mark.parametrize("method", [grid729.METHOD, coordinate.METHOD], ids=lambda m: m.name)


def bowl(shape: np.ndarray) -> Objective:
    """A quadratic of how far poses are from the truth, in rad and m."""

    return Objective(lambda poses: np.einsum("bi,ij,bj->b", off(poses), shape, off(poses)))


@every
def test_the_bottom_of_a_quadratic_is_found(method: Method) -> None:
    scale = np.diag([30.0, 30.0, 30.0, 1.0, 1.0, 1.0])
    mixed = np.eye(6) + 0.5 * np.roll(np.eye(6), 3, axis=1)
    problem = bowl(scale @ mixed @ mixed.T @ scale)
    found = method.build(method.options())(problem, NEAR)
    assert apart(found.camera_from_lidar, TRUTH)[0] < 0.02
    assert apart(found.camera_from_lidar, TRUTH)[1] < 0.01
    assert found.status is SolverStatus.CONVERGED


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
