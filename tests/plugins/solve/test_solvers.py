"""What every solver must do, each on the same exact pairs."""

from __future__ import annotations

import sys
from dataclasses import replace

import numpy as np
import pytest
from p2o import InputError, Kind, Method, MethodUnavailable, Registry, Solver, se3
from p2o.host import guard
from p2o.solving import PointToLine
from p2o_plugins.solve import ceres, lm, nelder_mead, scipy_least_squares

from tests.edge_scene import PINHOLE, TRUTH
from tests.plugins.solve.exact_pairs import CAMERAS, NEAR, apart, pairs, rows

LEAST_SQUARES = {m.METHOD.name: m.METHOD for m in (lm, ceres, scipy_least_squares)}
METHODS = {**LEAST_SQUARES, "nelder-mead": nelder_mead.METHOD}

every = pytest.mark.parametrize("method", METHODS.values(), ids=METHODS.keys())
least_squares = pytest.mark.parametrize("method", LEAST_SQUARES.values(), ids=LEAST_SQUARES.keys())


def built(method: Method) -> Solver:
    if method.extra:
        pytest.importorskip("pyceres")
    return method.build(method.options())


@least_squares
@pytest.mark.parametrize("cameras", CAMERAS.values(), ids=CAMERAS.keys())
def test_exact_pairs_lead_back_to_the_truth(method: Method, cameras: tuple) -> None:
    assert apart(NEAR, TRUTH) == pytest.approx((1.0, 0.05), rel=0.01)
    solution = built(method)(pairs(cameras=cameras), NEAR)
    assert max(apart(solution.camera_from_lidar, TRUTH)) < 1e-6
    assert solution.cost < 1e-9


@every
@pytest.mark.parametrize("seed", [1, 2])
def test_all_solvers_find_the_same_minimum_in_spite_of_outliers(method: Method, seed: int) -> None:
    problem = pairs(seed, count=300, noise_px=1.0, outliers=0.2)
    reference = built(lm.METHOD)(problem, NEAR)
    solution = built(method)(problem, NEAR)
    angle, distance = apart(reference.camera_from_lidar, solution.camera_from_lidar)
    assert solution.status == "converged"
    assert angle < 1e-4
    assert distance < 1e-4
    assert solution.cost == pytest.approx(problem.cost(solution.camera_from_lidar[None])[0], rel=1e-12)
    assert solution.cost == pytest.approx(reference.cost, rel=1e-8)
    assert solution.cost < problem.cost(TRUTH[None])[0] < problem.cost(NEAR[None])[0]


@least_squares
def test_a_moved_lidar_frame_moves_the_answer_with_it(method: Method) -> None:
    problem, b_from_lidar = pairs(noise_px=1.0, outliers=0.1), se3.exp(np.array([0.3, -1.0, 2.0, 4.0, 5.0, -6.0]))
    moved = replace(problem, xyz=se3.apply(b_from_lidar, problem.xyz))
    solve = built(method)
    here = solve(problem, NEAR).camera_from_lidar
    there = solve(moved, NEAR @ se3.inverse(b_from_lidar)).camera_from_lidar
    # Ceres and SciPy stop by the change of cost, which rounding disturbs; lm by the step.
    assert max(apart(here, there @ b_from_lidar)) < (1e-8 if method.name == "lm" else 1e-5)


@least_squares
def test_a_pair_of_weight_two_is_two_pairs_and_pairs_of_weight_zero_or_behind_the_camera_are_none(
    method: Method,
) -> None:
    problem = pairs(noise_px=1.0, outliers=0.1)
    times = np.arange(len(problem)) % 3
    behind = se3.apply(se3.inverse(TRUTH), se3.apply(TRUTH, problem.xyz[:20]) * [1, 1, -1])
    problem = replace(problem, weight=times.astype(float))
    repeated = rows(problem, np.repeat(np.arange(len(problem)), times))
    solve, first = built(method), rows(problem, np.r_[:20, : len(problem)])
    weighed = replace(first, xyz=np.concatenate([behind, problem.xyz]))
    repeated = replace(repeated, weight=np.ones(len(repeated)))
    assert max(apart(solve(weighed, NEAR).camera_from_lidar, solve(repeated, NEAR).camera_from_lidar)) < 1e-6


@least_squares
@pytest.mark.parametrize(
    ("problem", "reason"),
    [
        (pairs(angles=(0.0,), spread=0.0, noise_px=0.5), "translation up and down (camera y)"),
        (pairs(angles=(np.pi / 2,), spread=0.0, noise_px=0.5), "translation sideways (camera x)"),
        (pairs(depth_m=(1e7, 2e7)), "translation sideways"),
        (pairs(depth_m=(1e7, 2e7)), "along the optical axis"),
        (rows(pairs(noise_px=1.0), np.zeros(50, int)), "nor"),
    ],
    ids=["upright lines", "level lines", "at infinity", "at infinity, ahead", "one pair many times"],
)
def test_what_pairs_do_not_determine_is_named_and_the_start_comes_back(
    method: Method, problem: PointToLine, reason: str
) -> None:
    solution = built(method)(problem, NEAR)
    assert solution.status == "singular"
    if "camera" in reason:
        assert solution.reason == f"the pairs do not determine {reason}"
    assert reason in solution.reason
    assert solution.covariance is None
    assert (solution.camera_from_lidar == NEAR).all()


@least_squares
@pytest.mark.parametrize(
    ("make", "seen"),
    [
        (lambda: PointToLine.empty((PINHOLE,)), 0),
        (lambda: rows(pairs(), np.arange(5)), 5),
        (lambda: replace(pairs(), weight=np.zeros(300)), 0),
        (lambda: replace(pairs(), xyz=pairs().xyz * [-1, 1, 1]), 0),
        (lambda: replace(pairs(), weight=np.arange(300) < 3.0), 3),
    ],
    ids=["no pairs", "five pairs", "no weight", "all behind", "three that count"],
)
def test_too_few_usable_pairs_are_a_status_and_no_error(method: Method, make: object, seen: int) -> None:
    solution = built(method)(make(), NEAR)  # type: ignore[operator]
    assert solution.status == "singular"
    assert solution.reason.startswith(f"{seen} pairs with a visible point")
    assert (solution.camera_from_lidar == NEAR).all()


@least_squares
def test_a_scalar_cost_is_refused_in_words(method: Method) -> None:
    with pytest.raises(InputError, match=f"{method.name} needs residuals.*nelder-mead"):
        built(method)(pairs().as_objective(), NEAR)


@every
def test_iterations_are_limited(method: Method, monkeypatch: pytest.MonkeyPatch) -> None:
    problem = pairs(noise_px=1.0, outliers=0.2)
    lowest = built(lm.METHOD)(problem, NEAR).cost
    limit = "_MAX_EVALUATIONS" if method.name == "nelder-mead" else "_MAX_ITERATIONS"
    monkeypatch.setattr(sys.modules[method.build.__module__], limit, 2)
    solution = built(method)(problem, NEAR)
    assert solution.status == "iterations-spent"
    assert solution.cost > lowest


def test_without_pyceres_the_command_that_installs_it_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pyceres", None)
    with pytest.raises(MethodUnavailable, match=r'pyceres, which is not installed.*run: pip install "pyceres'):
        guard.build(Registry.load().find(Kind.SOLVER, "ceres"), ceres.METHOD.options())
