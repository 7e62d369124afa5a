"""Perspective-n-point takes the centre of each line for a point: exact where it is one, held back where it is not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from p2o import InputError, se3
from p2o.solving import PointToLine
from p2o_plugins.solve import lm, pnp

from tests.edge_scene import PINHOLE, TRUTH
from tests.plugins.solve.exact_pairs import CAMERAS, NEAR, apart, pairs, rows


def solved(problem: object, start: np.ndarray = NEAR, **options: object) -> object:
    return pnp.build(pnp.PnpOptions(**options))(problem, start)  # type: ignore[arg-type]


def points(problem: PointToLine, noise_px: float = 0.0) -> PointToLine:
    """Return the pairs with their centres where their points are seen from TRUTH, give or take."""
    seen = se3.apply(TRUTH, problem.xyz)
    centre = np.stack([problem.cameras[f].project(p[None])[0] for f, p in zip(problem.frame, seen, strict=True)])
    return replace(problem, centre=centre + np.random.default_rng(5).normal(0, 1, centre.shape) * noise_px)


@pytest.mark.parametrize("cameras", CAMERAS.values(), ids=CAMERAS.keys())
def test_exact_points_give_the_pose_wherever_the_start_is(cameras: tuple) -> None:
    problem = points(pairs(cameras=cameras))
    for start in (NEAR, np.eye(4)):
        solution = solved(problem, start)
        assert solution.status == "converged"
        assert max(apart(solution.camera_from_lidar, TRUTH)) < 1e-6
        assert solution.cost < 1e-9


def test_wrong_pairs_have_no_say() -> None:
    problem, wrong = points(pairs()), np.arange(300) % 5 < 2
    jump = np.random.default_rng(1).uniform(20, 60, (300, 2)) * wrong[:, None]
    solution = solved(replace(problem, centre=problem.centre + jump))
    assert max(apart(solution.camera_from_lidar, TRUTH)) < 1e-6
    assert solution.covariance is not None


def test_noise_moves_the_pose_as_far_as_the_covariance_says() -> None:
    solution = solved(points(pairs(), noise_px=1.0))
    off = se3.log(solution.camera_from_lidar @ se3.inverse(TRUTH))
    # Chi squared with six degrees of freedom is above 33 once in a hundred thousand.
    assert off @ np.linalg.solve(solution.covariance, off) < 33
    assert np.sqrt(np.diag(solution.covariance)[3:]).max() < 0.05


def test_pairs_made_elsewhere_hold_the_pose_where_lines_let_it_slide() -> None:
    """Centres are the feet of what is seen from NEAR on exact lines: lm returns to the truth, points cannot."""
    problem = pairs(cameras=(PINHOLE,), count=400)
    along = np.column_stack([-problem.normal[:, 1], problem.normal[:, 0]])
    seen = PINHOLE.project(se3.apply(NEAR, problem.xyz))
    slid = ((seen - problem.centre) * along).sum(axis=1, keepdims=True) * along
    problem = replace(problem, centre=problem.centre + slid)
    by_lines = lm.build(lm.LmOptions())(problem, NEAR).camera_from_lidar
    by_points = solved(problem).camera_from_lidar
    assert apart(by_lines, TRUTH)[0] < 1e-6
    assert apart(by_points, TRUTH)[0] > 0.3


def test_pairs_without_weight_take_no_part() -> None:
    problem, silent = points(pairs(noise_px=1.0)), np.arange(300) % 2 == 0
    moved = replace(problem, centre=problem.centre + 5.0 * silent[:, None], weight=np.where(silent, 0.0, 1.0))
    assert max(apart(solved(moved).camera_from_lidar, solved(rows(moved, ~silent)).camera_from_lidar)) < 1e-9


@pytest.mark.parametrize(
    ("problem", "reason"),
    [
        (PointToLine.empty((PINHOLE,)), "0 pairs, at least 6 are needed"),
        (rows(pairs(), np.arange(5)), "5 pairs, at least 6 are needed"),
        (replace(pairs(), weight=np.zeros(300)), "0 pairs, at least 6 are needed"),
        (rows(pairs(), np.zeros(50, int)), "of 50 pairs agree on a pose within 10 px"),
        (points(pairs(depth_m=(1e7, 2e7))), "do not determine"),
    ],
    ids=["none", "five", "no weight", "one many times", "all far away"],
)
def test_pairs_that_tell_no_pose_leave_the_start_and_say_why(problem: PointToLine, reason: str) -> None:
    solution = solved(problem)
    assert solution.status == "singular"
    assert reason in solution.reason
    assert (solution.camera_from_lidar == NEAR).all()


def test_points_on_a_line_in_space_leave_the_start() -> None:
    problem = pairs(cameras=(PINHOLE,), count=60)
    seen = np.column_stack([np.linspace(-3, 3, 60), np.full(60, 0.5), np.linspace(8, 12, 60)])
    problem = points(replace(problem, xyz=se3.apply(se3.inverse(TRUTH), seen)))
    solution = solved(problem)
    assert solution.status == "singular"
    assert (solution.camera_from_lidar == NEAR).all()


def test_what_is_no_pairs_is_refused() -> None:
    with pytest.raises(InputError, match="solver pnp needs pairs"):
        solved(pairs().as_objective())
