"""What every solver must do, each on the same exact pairs."""

from __future__ import annotations

import sys
from dataclasses import replace

import numpy as np
import pytest
from p2o import InputError, Kind, Method, MethodUnavailable, Registry, Solver, se3
from p2o.host import guard
from p2o.solving import Objective, PointToLine
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


@every
@pytest.mark.parametrize("cameras", CAMERAS.values(), ids=CAMERAS.keys())
def test_exact_pairs_lead_back_to_the_truth(method: Method, cameras: tuple) -> None:
    assert apart(NEAR, TRUTH) == pytest.approx((1.0, 0.05), rel=0.01)
    solution = built(method)(pairs(cameras=cameras), NEAR)
    assert max(apart(solution.camera_from_lidar, TRUTH)) < 1e-6
    assert solution.cost < 1e-9


@every
def test_the_truth_of_exact_pairs_is_kept(method: Method) -> None:
    solution = built(method)(pairs(), TRUTH)
    assert max(apart(solution.camera_from_lidar, TRUTH)) < 1e-9


@every
@pytest.mark.parametrize("seed", [1, 2, 3])
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


def test_at_the_minimum_the_derivative_of_the_cost_vanishes() -> None:
    problem = pairs(noise_px=1.0, outliers=0.2)
    pose = built(lm.METHOD)(problem, NEAR).camera_from_lidar
    steps = 1e-6 * np.concatenate([np.eye(6), -np.eye(6)])
    ahead, behind = problem.cost(se3.exp(steps) @ pose).reshape(2, 6)
    start_ahead, start_behind = problem.cost(se3.exp(steps) @ NEAR).reshape(2, 6)
    assert np.abs(ahead - behind).max() < 1e-6 * np.abs(start_ahead - start_behind).max()


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
def test_the_order_of_the_pairs_does_not_matter(method: Method) -> None:
    problem = pairs(noise_px=1.0, outliers=0.1)
    shuffled = rows(problem, np.random.default_rng(3).permutation(len(problem)))
    solve = built(method)
    a, b = solve(problem, NEAR).camera_from_lidar, solve(shuffled, NEAR).camera_from_lidar
    assert np.abs(a - b).max() < (1e-10 if method.name == "lm" else 1e-7)


@least_squares
def test_doubling_every_weight_doubles_the_cost_and_moves_nothing(method: Method) -> None:
    problem = pairs(noise_px=1.0, outliers=0.1)
    solve = built(method)
    once, twice = solve(problem, NEAR), solve(replace(problem, weight=2 * problem.weight), NEAR)
    assert max(apart(once.camera_from_lidar, twice.camera_from_lidar)) < (1e-9 if method.name == "lm" else 1e-6)
    assert twice.cost == pytest.approx(2 * once.cost, rel=1e-9)
    assert twice.covariance == pytest.approx(once.covariance, rel=1e-6)


@least_squares
def test_a_pair_of_weight_two_is_two_pairs(method: Method) -> None:
    problem = pairs(noise_px=1.0, outliers=0.1)
    problem = replace(problem, weight=np.where(np.arange(len(problem)) % 2, 2.0, 1.0))
    repeated = rows(problem, np.repeat(np.arange(len(problem)), problem.weight.astype(int)))
    repeated = replace(repeated, weight=np.ones(len(repeated)))
    solve = built(method)
    assert max(apart(solve(problem, NEAR).camera_from_lidar, solve(repeated, NEAR).camera_from_lidar)) < 1e-6


@least_squares
def test_pairs_of_weight_zero_take_no_part(method: Method) -> None:
    problem = pairs(noise_px=1.0, outliers=0.3)
    keep = np.arange(len(problem)) % 3 > 0
    silenced = replace(problem, weight=np.where(keep, problem.weight, 0.0))
    solve = built(method)
    a, b = solve(rows(problem, keep), NEAR), solve(silenced, NEAR)
    assert max(apart(a.camera_from_lidar, b.camera_from_lidar)) < 1e-6


@least_squares
def test_points_behind_the_camera_are_left_out(method: Method) -> None:
    problem = pairs()
    behind = pairs(9)
    behind = replace(behind, xyz=se3.apply(se3.inverse(TRUTH), se3.apply(TRUTH, behind.xyz) * [1, 1, -1]))
    names = ("xyz", "centre", "normal", "weight", "side", "frame", "time_s", "sigma_px")
    both = replace(problem, **{n: np.concatenate([getattr(problem, n), getattr(behind, n)]) for n in names})
    solution = built(method)(both, NEAR)
    assert max(apart(solution.camera_from_lidar, TRUTH)) < 1e-6


@least_squares
def test_upright_lines_alone_do_not_determine_the_height(method: Method) -> None:
    problem = pairs(angles=(0.0,), spread=0.0, noise_px=0.5)
    solution = built(method)(problem, NEAR)
    assert solution.status == "singular"
    assert solution.reason == "the pairs do not determine translation up and down (camera y)"
    assert solution.covariance is None
    assert (solution.camera_from_lidar == NEAR).all()


@least_squares
def test_level_lines_alone_do_not_determine_the_sideways_shift(method: Method) -> None:
    solution = built(method)(pairs(angles=(np.pi / 2,), spread=0.0, noise_px=0.5), NEAR)
    assert solution.status == "singular"
    assert "translation sideways" in solution.reason
    assert "up and down" not in solution.reason


@least_squares
def test_points_at_infinity_do_not_determine_the_translation(method: Method) -> None:
    problem = pairs(depth_m=(1e7, 2e7))
    solution = built(method)(problem, TRUTH)
    assert solution.status == "singular"
    for name in ("sideways", "up and down", "along the optical axis"):
        assert name in solution.reason


@every
def test_without_pairs_the_start_comes_back_as_singular(method: Method) -> None:
    solution = built(method)(PointToLine.empty((PINHOLE,)), NEAR)
    assert (solution.camera_from_lidar == NEAR).all()
    assert solution.status == "singular"
    assert solution.reason


@least_squares
@pytest.mark.parametrize(
    ("make", "seen"),
    [
        (lambda: rows(pairs(), np.arange(5)), 5),
        (lambda: replace(pairs(), weight=np.zeros(300)), 0),
        (lambda: replace(pairs(), xyz=pairs().xyz * [-1, 1, 1]), 0),
        (lambda: replace(pairs(), weight=np.arange(300) < 3.0), 3),
    ],
    ids=["five pairs", "no weight", "all behind", "three that count"],
)
def test_too_few_usable_pairs_are_a_status_and_no_error(method: Method, make: object, seen: int) -> None:
    solution = built(method)(make(), NEAR)  # type: ignore[operator]
    assert solution.status == "singular"
    assert solution.reason.startswith(f"{seen} pairs with a visible point")
    assert (solution.camera_from_lidar == NEAR).all()


@least_squares
def test_the_same_pair_many_times_is_one_pair(method: Method) -> None:
    solution = built(method)(rows(pairs(noise_px=1.0), np.zeros(50, int)), NEAR)
    assert solution.status == "singular"
    assert solution.reason.count("nor") == 4  # five directions out of six


@least_squares
def test_a_start_far_from_everything_is_survived(method: Method) -> None:
    away = se3.make(translation=[0, 0, -1000.0]) @ TRUTH
    solution = built(method)(pairs(), away)
    assert solution.status == "singular"
    assert (solution.camera_from_lidar == away).all()


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


@every
def test_inputs_stay_as_they_were(method: Method) -> None:
    problem, start = pairs(noise_px=1.0), NEAR.copy()
    before = problem.xyz.copy()
    built(method)(problem, start)
    assert (start == NEAR).all()
    assert (problem.xyz == before).all()


@every
def test_two_runs_give_the_same_bytes(method: Method) -> None:
    solve, problem = built(method), pairs(noise_px=1.0, outliers=0.2)
    assert solve(problem, NEAR).camera_from_lidar.tobytes() == solve(problem, NEAR).camera_from_lidar.tobytes()


def test_nelder_mead_minimises_any_scalar_cost() -> None:
    goal = TRUTH @ se3.exp(np.array([0.004, -0.003, 0.002, 0.02, 0.03, -0.04]))

    def cost(poses: np.ndarray) -> np.ndarray:
        return np.abs(poses - goal).sum(axis=(1, 2))

    solution = built(nelder_mead.METHOD)(Objective(cost), TRUTH)
    assert max(apart(solution.camera_from_lidar, goal)) < 1e-4


def test_nelder_mead_steps_around_poses_without_a_cost() -> None:
    def cost(poses: np.ndarray) -> np.ndarray:
        away = np.linalg.norm(poses[:, :3, 3] - TRUTH[:3, 3] - [0.02, 0.0, 0.0], axis=1)
        return np.where(poses[:, 0, 3] > TRUTH[0, 3] + 0.03, np.nan, away)

    solution = built(nelder_mead.METHOD)(Objective(cost), TRUTH)
    assert solution.cost < 1e-4


def test_nelder_mead_says_when_the_start_has_no_cost() -> None:
    solution = built(nelder_mead.METHOD)(Objective(lambda poses: np.full(len(poses), np.nan)), TRUTH)
    assert solution.status == "singular"
    assert solution.reason == "the cost of the start is not finite"


def test_without_pyceres_the_command_that_installs_it_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pyceres", None)
    with pytest.raises(MethodUnavailable, match=r'pyceres, which is not installed.*run: pip install "pyceres'):
        guard.build(Registry.load().find(Kind.SOLVER, "ceres"), ceres.METHOD.options())


@pytest.mark.parametrize("method", METHODS.values(), ids=METHODS.keys())
def test_every_option_is_described_and_bounded_options_refuse_nonsense(method: Method) -> None:
    assert Kind.SOLVER.hook == "p2o_solvers"
    for name, field in method.options.model_fields.items():
        assert field.description, name
        with pytest.raises(ValueError):
            method.options(**{name: -1})


def test_the_squares_that_ceres_sums_are_the_huber_cost_and_slope_with_it() -> None:
    residuals = np.array([-30.0, -2.5, -2.0, -0.3, 0.0, 1.9, 2.1, 400.0])
    roots, slope = ceres.robust_roots(residuals, 2.0)
    size = np.abs(residuals)
    np.testing.assert_allclose(roots**2 / 2, np.where(size > 2, 2 * (size - 1), size**2 / 2), rtol=1e-12)
    by_hand = (ceres.robust_roots(residuals + 1e-6, 2.0)[0] - ceres.robust_roots(residuals - 1e-6, 2.0)[0]) / 2e-6
    np.testing.assert_allclose(slope, by_hand, atol=1e-6)
