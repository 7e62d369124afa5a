"""What a shift of all edges alike does to a pose: only where beams leave edges open, and only to what these hold."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from p2o import Camera, Side
from p2o.confidence.accuracy import ErrorBudget, ring_gaps, shift_covariance
from p2o.problems.problem import LeastSquares
from p2o.solving import PointToLine

CAMERA = Camera.pinhole(500.0, 500.0, 320.0, 240.0, 640, 480)
POSE = np.eye(4)


def problem(*, sides: bool = True) -> PointToLine:
    """Pairs that fit exactly: upright outlines left and right, level ones above and below, near and far."""
    rng = np.random.default_rng(3)
    xyz = rng.uniform([-3, -2, 4], [3, 2, 20], (200, 3))
    side = np.tile(np.arange(4, dtype=np.int8), 50)
    normal = np.array([side_.background for side_ in Side if side_ >= 0], np.float64)[side]
    normal *= rng.choice([-1.0, 1.0], 200)[:, None]  # lines have no front
    side = side if sides else np.full(200, Side.NONE, np.int8)
    centre = CAMERA.project(xyz)
    return PointToLine(xyz, centre, normal, np.ones(200), side, np.zeros(200, np.int64), (CAMERA,), 2.0)


def solved(pairs: LeastSquares) -> np.ndarray:
    """The step (6,) of a left update that fits pairs best."""
    residuals, rows = pairs.residuals_with_jacobian(POSE)
    return -np.linalg.lstsq(rows, residuals, rcond=None)[0]


def test_it_is_what_least_squares_makes_of_edges_that_are_all_off_alike() -> None:
    pairs, sigma_px = problem(), np.random.default_rng(0).uniform(0.1, 0.5, 200)
    assert not shift_covariance(pairs, POSE, pairs.sigma_px).any(), "where beams leave nothing open"
    steps = []
    for side in range(4):
        off = np.where(pairs.side == side, sigma_px, 0.0)[:, None] * np.array(Side(side).background)
        steps.append(solved(replace(pairs, centre=pairs.centre + off)))
    expected = np.stack(steps).T @ np.stack(steps)
    found = shift_covariance(pairs, POSE, sigma_px)
    assert found == pytest.approx(expected, rel=1e-6, abs=1e-12)


@pytest.mark.parametrize("sides", [True, False])
def test_rows_far_apart_leave_pitch_open_and_not_yaw(sides: bool) -> None:
    pairs = problem(sides=sides)
    level = np.abs(pairs.normal[:, 1]) > 0.5
    deviation = np.sqrt(np.diag(shift_covariance(pairs, POSE, np.where(level, 3.0, 0.0))))
    pitch, yaw = deviation[:2]
    assert pitch > 5 * yaw


def test_more_pairs_of_the_same_rows_do_not_make_it_smaller_and_unseen_points_do_not_count() -> None:
    pairs = replace(problem(), sigma_px=np.full(200, 2.0))
    fields = ("xyz", "centre", "normal", "weight", "side", "frame", "time_s", "sigma_px")
    thrice = replace(pairs, **{name: np.concatenate([getattr(pairs, name)] * 3) for name in fields})
    of_all, of_one = (shift_covariance(its, POSE, its.sigma_px) for its in (thrice, pairs))
    assert of_all == pytest.approx(of_one)
    behind = np.array(pairs.xyz)
    behind[:20, 2] = -1.0
    found = shift_covariance(replace(pairs, xyz=behind), POSE, pairs.sigma_px)
    assert np.isfinite(found).all()


def test_outlines_that_are_wider_by_a_length_move_the_pose_as_least_squares_says() -> None:
    """All outlines of one direction are displaced by 1 mm in space: near ones by more pixels, in every view alike."""
    pairs, steps = problem(), []
    for side in range(4):
        off_m = np.where(pairs.side == side, 1e-3, 0.0)[:, None] * np.array([*Side(side).background, 0.0])
        steps.append(solved(replace(pairs, centre=CAMERA.project(pairs.xyz + off_m))))
    found = ErrorBudget.of(np.eye(6), pairs, POSE, 25.0).objects
    assert 1e-6 * found == pytest.approx(np.stack(steps).T @ np.stack(steps), rel=1e-6, abs=1e-15)


def test_gaps_between_rings_are_pitch_roll_and_height_however_little_they_weigh() -> None:
    pairs = problem()
    level = np.abs(pairs.normal[:, 1]) > 0.5
    pairs = replace(pairs, sigma_px=np.where(level, 5.0, 0.5), weight=np.where(level, 0.01, 1.0))
    pitch, yaw, roll, x, y, z = ring_gaps(pairs, POSE)
    assert (pitch, yaw, roll) == pytest.approx((0.01, 0.001, 0.01))
    depth_m = 1 / np.mean(1 / pairs.xyz[:, 2])
    assert (x, y, z) == pytest.approx((0.001 * depth_m, 0.01 * depth_m, 0.0))
    # A camera on its side has them in yaw.
    pitch, yaw, *_ = ring_gaps(replace(problem(), sigma_px=np.where(level, 0.5, 5.0)), POSE)
    assert (pitch, yaw) == pytest.approx((0.001, 0.01))


def test_gaps_of_rings_fall_with_the_root_of_the_views() -> None:
    pairs = replace(problem(), sigma_px=np.full(200, 2.0))
    one, four = (ErrorBudget.of(np.eye(6), pairs, POSE, views) for views in (1.0, 4.0))
    assert one.rings == pytest.approx(ring_gaps(pairs, POSE))
    assert four.rings == pytest.approx(0.5 * one.rings)
    assert four.beams == pytest.approx(one.beams)
