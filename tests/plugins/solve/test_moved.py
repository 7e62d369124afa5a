"""Every solver of scalar costs leaves a start where the cost falls slowly, and states that it did not move."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np
import p2o
import pytest
from p2o.problems.problem import pose_from_chart
from p2o.solving import Objective
from p2o_plugins.solve import (
    barzilai_borwein,
    bfgs,
    ceres,
    cma_es,
    coordinate,
    grid729,
    lm,
    nelder_mead,
    particle_swarm,
    random_shrink,
    scipy_least_squares,
)

from tests.edge_scene import TRUTH
from tests.plugins.solve.exact_pairs import apart, off, pairs

SCALAR = [barzilai_borwein, bfgs, cma_es, coordinate, grid729, nelder_mead, particle_swarm, random_shrink]
RESIDUALS = [ceres, lm, scipy_least_squares]
UNIT = np.repeat([np.radians(0.5), 0.02], 3)
START = pose_from_chart(TRUTH, np.array([1.0, -0.8, 0.6, 0.7, 0.9, -0.5]) * UNIT)

scalar = pytest.mark.parametrize("method", [m.METHOD for m in SCALAR], ids=lambda m: m.name)
every = pytest.mark.parametrize("method", [m.METHOD for m in (*SCALAR, *RESIDUALS)], ids=lambda m: m.name)


def solver(method: p2o.Method) -> p2o.Solver:
    if method.extra:
        pytest.importorskip({"ceres": "pyceres"}.get(method.extra, method.extra))
    return method.build(method.options())


def slope(poses: np.ndarray, gradient: float, kind: str) -> np.ndarray:
    """Return costs (B,) near 1 whose largest derivative is `gradient` a unit of 0.5 deg and 2 cm."""
    square = ((off(poses) / UNIT) ** 2).sum(axis=1)
    return 1.0 + gradient * (0.5 * square if kind == "bowl" else -np.exp(-square / 8))


@scalar
@pytest.mark.parametrize(("kind", "gradient"), [("bowl", 1e-4), ("well", 1e-7)])
def test_a_cost_that_falls_slowly_leads_to_its_minimum(method: p2o.Method, gradient: float, kind: str) -> None:
    found = solver(method)(Objective(partial(slope, gradient=gradient, kind=kind)), START)
    angle, distance = apart(found.camera_from_lidar, TRUTH)
    assert angle < 0.1
    assert distance < 0.01
    assert found.status is p2o.SolverStatus.CONVERGED


@every
def test_pairs_of_little_weight_lead_to_the_same_pose(method: p2o.Method) -> None:
    problem = replace(pairs(), weight=1e-9 * pairs().weight)
    angle, distance = apart(solver(method)(problem, START).camera_from_lidar, TRUTH)
    assert angle < 0.1
    assert distance < 0.03


@every
def test_at_the_minimum_a_solver_stays_and_says_so(method: p2o.Method) -> None:
    found = solver(method)(pairs(), TRUTH)
    angle, distance = apart(found.camera_from_lidar, TRUTH)
    assert angle < 0.01
    assert distance < 0.005
    moved = angle >= 1e-3 or distance >= 1e-4
    assert found.status is (p2o.SolverStatus.CONVERGED if moved else p2o.SolverStatus.NOT_MOVED)


@scalar
def test_a_flat_cost_is_no_convergence(method: p2o.Method) -> None:
    found = solver(method)(Objective(lambda poses: np.ones(len(poses))), START)
    assert found.camera_from_lidar == pytest.approx(START, abs=1e-9)
    assert found.status is not p2o.SolverStatus.CONVERGED
    assert found.status is not p2o.SolverStatus.SINGULAR


@scalar
def test_a_start_without_a_cost_is_handed_back_and_other_such_poses_are_walked_around(method: p2o.Method) -> None:
    found = solver(method)(Objective(lambda poses: np.full(len(poses), np.nan)), START)
    assert (found.status, found.reason) == (p2o.SolverStatus.SINGULAR, "the cost of the start is not finite")
    assert np.array_equal(found.camera_from_lidar, START)

    def holed(poses: np.ndarray) -> np.ndarray:
        costs = slope(poses, 1.0, "bowl")
        return np.where(costs > 4 * slope(START[None], 1.0, "bowl"), np.nan, costs)

    angle, distance = apart(solver(method)(Objective(holed), START).camera_from_lidar, TRUTH)
    assert angle < 0.1
    assert distance < 0.01
