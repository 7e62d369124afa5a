"""Point-to-line pairs: residuals, derivatives and the one cost that all solvers minimise."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from p2o import Camera, InputError, se3
from p2o.solving import PointToLine

from tests.edge_scene import DISTORTED, FISHEYE, PINHOLE, TRUTH
from tests.plugins.solve.exact_pairs import CAMERAS, NEAR, pairs, rows

cameras = pytest.mark.parametrize("cameras", CAMERAS.values(), ids=CAMERAS.keys())


def one_pair(**changes: object) -> PointToLine:
    """A point 10 m ahead of an identity pose; fx 700 puts it on (600, 180); a vertical line 3 px to its left."""
    values = {"xyz": [[0.0, 0.0, 10.0]], "centre": [[597.0, 50.0]], "normal": [[1.0, 0.0]]}
    values |= {"weight": [2.0], "side": [0], "frame": [0], "cameras": (PINHOLE,)}
    return PointToLine(**{**values, **changes})  # type: ignore[arg-type]


def test_the_residual_is_the_signed_distance_to_the_line_and_the_cost_quadratic_within_the_kernel() -> None:
    assert one_pair().residuals(np.eye(4)) == pytest.approx([3.0])
    sideways = se3.make(translation=[0.1, 5.0, 0.0])  # 0.1 m at 10 m are 7 px; along the line nothing changes
    assert one_pair().residuals(sideways) == pytest.approx([10.0])
    assert one_pair(huber_px=5.0).cost(np.eye(4)[None]) == pytest.approx([2 * 9 / 2])
    assert one_pair(huber_px=1.0).cost(np.eye(4)[None]) == pytest.approx([2 * (3 - 0.5)])


@cameras
def test_the_jacobian_is_the_derivative_of_the_residuals_by_a_left_update(cameras: tuple[Camera, ...]) -> None:
    assert np.abs(pairs(cameras=cameras).residuals(TRUTH)).max() < 1e-9
    problem, step = pairs(cameras=cameras, noise_px=2.0), 1e-6
    residuals, jacobian = problem.residuals_with_jacobian(NEAR)
    assert residuals == pytest.approx(problem.residuals(NEAR), abs=1e-9)
    for axis, delta in enumerate(step * np.eye(6)):
        change = problem.residuals(se3.exp(delta) @ NEAR) - problem.residuals(se3.exp(-delta) @ NEAR)
        assert jacobian[:, axis] == pytest.approx(change / (2 * step), rel=1e-5, abs=1e-3)


@cameras
def test_many_poses_at_once_cost_what_they_cost_one_by_one(cameras: tuple[Camera, ...]) -> None:
    problem = pairs(cameras=cameras, noise_px=1.0, outliers=0.2)
    poses = TRUTH @ se3.exp(0.02 * np.random.default_rng(1).normal(size=(7, 6)))
    singly = [problem.cost(pose[None])[0] for pose in poses]
    assert problem.cost(poses) == pytest.approx(singly, rel=1e-12)
    assert problem.residuals(poses)[3] == pytest.approx(problem.residuals(poses[3]), abs=1e-9)


def test_a_point_behind_the_camera_costs_as_much_as_one_an_image_away() -> None:
    behind = se3.make(translation=[0, 0, -20.0])
    problem = one_pair()
    assert np.isnan(problem.residuals(behind)).all()
    assert np.isnan(problem.residuals_with_jacobian(behind)[1]).all()
    assert problem.cost(behind[None]) == pytest.approx([2 * (PINHOLE.width - 0.5)])
    on_image_plane = se3.make(translation=[0, 0, -10.0])
    assert np.isnan(problem.residuals_with_jacobian(on_image_plane)[0]).all()


@pytest.mark.parametrize("camera", [FISHEYE, DISTORTED], ids=["fisheye", "distorted"])
def test_points_behind_a_distorted_camera_are_unseen_too(camera: Camera) -> None:
    problem = pairs(cameras=(camera,), count=20)
    behind = se3.make(translation=[0, 0, -100.0]) @ TRUTH
    residuals, jacobian = problem.residuals_with_jacobian(behind)
    assert np.isnan(residuals).all()
    assert np.isnan(jacobian).all()
    assert problem.cost(behind[None]) == pytest.approx([problem.weight.sum() * (problem.far_px - 0.5)])


def test_moving_the_lidar_frame_and_the_pose_changes_nothing_and_many_poses_are_evaluated_in_parts() -> None:
    problem, b_from_lidar = pairs(noise_px=1.0), se3.exp(np.array([0.3, -1.0, 2.0, 4.0, 5.0, -6.0]))
    moved = replace(problem, xyz=se3.apply(b_from_lidar, problem.xyz))
    assert moved.residuals(NEAR @ se3.inverse(b_from_lidar)) == pytest.approx(problem.residuals(NEAR), abs=1e-8)
    problem = pairs(count=600)
    poses = TRUTH @ se3.exp(0.01 * np.random.default_rng(2).normal(size=(500, 6)))
    assert problem.cost(poses)[[0, 250, 499]] == pytest.approx(problem.cost(poses[[0, 250, 499]]), rel=1e-12)
    assert problem.cost(np.zeros((0, 4, 4))).shape == (0,)
    half = np.arange(len(problem)) < len(problem) // 2
    parts = rows(problem, half).cost(NEAR[None]) + rows(problem, ~half).cost(NEAR[None])
    assert parts == pytest.approx(problem.cost(NEAR[None]), rel=1e-12), "a sum over pairs"


def test_a_problem_without_pairs_costs_nothing_and_arrays_cannot_be_changed() -> None:
    problem = PointToLine.empty((PINHOLE,), huber_px=2.0)
    assert len(problem) == 0
    assert problem.cost(np.stack([TRUTH, NEAR])).tolist() == [0.0, 0.0]
    residuals, jacobian = problem.residuals_with_jacobian(TRUTH)
    assert residuals.shape == (0,)
    assert jacobian.shape == (0, 6)
    assert len(PointToLine.empty().residuals(TRUTH)) == 0
    with pytest.raises(ValueError, match="read-only"):
        pairs().xyz[0] = 0.0


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"normal": [[2.0, 0.0]]}, "not a unit vector; expected length 1; got 2"),
        ({"frame": [1]}, "a frame that is not there"),
        ({"weight": [-1.0]}, "negative"),
        ({"huber_px": 0.0}, "not positive"),
        ({"huber_px": float("nan")}, "not positive"),
        ({"centre": [[1.0, 2.0], [3.0, 4.0]]}, "wrong shape"),
        ({"xyz": [[0.0, np.nan, 1.0]]}, "not finite"),
    ],
)
def test_wrong_input_is_refused_in_words(changes: dict[str, object], text: str) -> None:
    with pytest.raises(InputError, match=text):
        one_pair(**changes)
