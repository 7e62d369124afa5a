"""Points on rays: residuals are angles in pixels, and what is left out tells how sure a pose is."""

from __future__ import annotations

import numpy as np
import pytest
from p2o import Camera, InputError, se3
from p2o.problems.points_on_rays import PointsOnRays, leave_one_out, px_per_rad, refined, shape, spread

PINHOLE = Camera.pinhole(700.0, 700.0, 600.0, 180.0, 1200, 360)
POSE = se3.exp(np.array([0.1, -0.2, 0.05, 0.3, -0.1, 0.2]))


def problem(count: int = 12, noise_px: float = 0.0, seed: int = 0) -> PointsOnRays:
    rng = np.random.default_rng(seed)
    uv = rng.uniform([10, 10], [1190, 350], (count, 2))
    xyz = se3.apply(se3.inverse(POSE), PINHOLE.rays(uv) * rng.uniform(3, 20, (count, 1)))
    uv = uv + rng.normal(0, noise_px, uv.shape)
    return PointsOnRays(xyz, PINHOLE.rays(uv), px_per_rad(PINHOLE, uv))


def test_points_on_rays_have_no_residuals_those_of_many_poses_are_those_of_each_and_derivatives_are_theirs() -> None:
    poses = se3.exp(np.random.default_rng(1).normal(0, 0.1, (3, 6))) @ POSE
    several = problem()
    assert np.abs(several.residuals(POSE)).max() < 1e-9
    np.testing.assert_allclose(several.residuals(poses), [several.residuals(pose) for pose in poses], atol=1e-12)
    some, pose = problem(), se3.exp(np.full(6, 0.02)) @ POSE
    _, analytic = some.residuals_with_jacobian(pose)
    _, numeric = super(PointsOnRays, some).residuals_with_jacobian(pose)
    np.testing.assert_allclose(analytic, numeric, rtol=1e-5, atol=1e-4)


def test_a_click_beside_its_place_is_so_many_pixels_off_and_a_point_behind_the_camera_never_near() -> None:
    """The geometric mean over directions: exact in the middle of the picture, a few percent beside it."""
    exact = problem()
    uv = PINHOLE.project(se3.apply(POSE, exact.xyz))
    for step in ([2.0, 0.0], [0.0, -2.0]):
        beside = PointsOnRays(exact.xyz, PINHOLE.rays(uv + step), px_per_rad(PINHOLE, uv + step))
        off = beside.off_px(POSE)
        middle = np.abs(uv[:, 0] - 600) < 150
        np.testing.assert_allclose(off[middle], 2.0, rtol=0.03)
        np.testing.assert_allclose(off, 2.0, rtol=0.3)
    ahead = PointsOnRays(np.array([[0.0, 0, 5], [0, 0, -5]]), np.array([[0.0, 0, 1], [0, 0, 1]]), np.full(2, 700.0))
    off = ahead.off_px(np.eye(4))
    assert off[0] == 0
    assert off[1] == pytest.approx(700)


def test_the_least_squares_pose_is_a_minimum_that_no_small_step_improves() -> None:
    noisy = problem(noise_px=2.0)
    best = refined(noisy, POSE)
    cost = float((noisy.residuals(best) ** 2).sum())
    for step in np.concatenate([np.eye(6), -np.eye(6)]) * 1e-5:
        assert float((noisy.residuals(se3.exp(step) @ best) ** 2).sum()) > cost


def test_the_spread_is_about_the_covariance_of_the_estimate() -> None:
    """Over many draws of the noise: the mean of what is told is within a factor of two of what happens."""
    exact = problem()
    assert np.abs(spread(leave_one_out(exact, POSE), POSE)).max() < 1e-20
    told, happened = [], []
    for seed in range(30):
        noisy = problem(20, noise_px=1.5, seed=seed)
        best = refined(noisy, POSE)
        told.append(np.diag(spread(leave_one_out(noisy, best), best)))
        happened.append(se3.log(best @ se3.inverse(POSE)) ** 2)
    ratio = np.sqrt(np.mean(told, axis=0) / np.mean(happened, axis=0))
    assert (ratio > 0.5).all()
    assert (ratio < 2.0).all()


def test_shape_tells_lines_and_planes_and_rays_that_are_not_unit_vectors_are_refused() -> None:
    rng = np.random.default_rng(0)
    along = rng.normal(size=(9, 1)) * [1.0, 2, 3]
    assert shape(along)[1] < 1e-12
    assert shape(np.c_[rng.normal(size=(9, 2)), np.ones(9)])[2] < 1e-12
    assert shape(np.array([[-1.0, 0, 0], [1, 0, 0]])) == pytest.approx([1, 0, 0])
    with pytest.raises(InputError, match="unit"):
        PointsOnRays(np.ones((1, 3)), np.array([[0.0, 0, 2]]), np.ones(1))
    with pytest.raises(InputError, match="finite"):
        PointsOnRays(np.ones((1, 3)), np.full((1, 3), np.nan), np.ones(1))
