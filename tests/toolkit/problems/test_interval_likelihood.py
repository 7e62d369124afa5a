"""The likelihood of intervals is flat while an image edge is inside, and falls at both ends as the error says."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from p2o import Camera, CloudEdges, CloudFeatures, ImageEdges, ImageFeatures, Side, View, pose_error, se3
from p2o.problems.interval_likelihood import IntervalLikelihood, ring_step_deg
from scipy.stats import norm

from tests import edge_scene
from tests.edge_scene import TRUTH
from tests.sparse_scene import sparse_view

DEPTH_M, SIGMA_PX = 10.0, 2.0
SIZE = (edge_scene.PINHOLE.width, edge_scene.PINHOLE.height)
DIRECTION = {Side.LEFT: (-1.0, 0, 0), Side.RIGHT: (1.0, 0, 0), Side.UPPER: (0, -1.0, 0), Side.BOTTOM: (0, 1.0, 0)}
CENTRE = np.array(edge_scene.PINHOLE.params[2:])
EXPECTED = 1 / 241 + 0.002
"""Density of one line across the window of the local density, with the smallest density."""


def one_interval(side: Side, half_px: float) -> View:
    """Return an interval around the principal point, and one line of image edges through it, across the interval."""
    along = 0 if side in (Side.LEFT, Side.RIGHT) else 1
    uv = np.empty((SIZE[1 - along], 2))
    uv[:, along], uv[:, 1 - along] = CENTRE[along], np.arange(len(uv))
    sigma_m = half_px / np.sqrt(3) * DEPTH_M / 700
    cloud = CloudEdges(np.array([[0.0, 0, DEPTH_M]]), [side], None, [sigma_m], np.array([DIRECTION[side]]))
    image = ImageEdges(uv, np.full(len(uv), side))
    return View("one", edge_scene.PINHOLE, ImageFeatures(image), CloudFeatures(cloud))


def shifted(side: Side, pixels: np.ndarray) -> np.ndarray:
    """Return the poses that move the interval by pixels towards its background."""
    steps = np.array(DIRECTION[side]) * np.asarray(pixels)[:, None] * DEPTH_M / 700
    return np.stack([se3.make(translation=step) for step in steps])


@pytest.mark.parametrize("side", DIRECTION)
def test_the_likelihood_is_flat_while_the_edge_is_inside_the_interval_and_falls_at_its_ends(side: Side) -> None:
    likelihood = IntervalLikelihood.of([one_interval(side, 20.0)], np.eye(4), SIGMA_PX)
    share, shifts = likelihood.shares[side], np.array([-40.0, -22, -20, -18, -10, 0, 10, 18, 20, 22, 40])
    inside = norm.cdf((shifts + 20) / SIGMA_PX) - norm.cdf((shifts - 20) / SIGMA_PX)
    expected = np.log(1 - share + share * inside / 40 / EXPECTED)
    values = likelihood(shifted(side, shifts))
    np.testing.assert_allclose(values, expected, atol=0.02)
    assert np.ptp(values[4:7]) < 1e-3
    assert values[0] == pytest.approx(np.log(1 - share), abs=1e-3)


def test_an_interval_without_length_has_the_likelihood_of_a_point_and_only_edges_of_the_same_side_count() -> None:
    likelihood = IntervalLikelihood.of([one_interval(Side.UPPER, 0.0)], np.eye(4), SIGMA_PX)
    share, shifts = likelihood.shares[Side.UPPER], np.linspace(-6, 6, 7)
    density = norm.pdf(shifts, scale=SIGMA_PX) / EXPECTED
    # The integral is linear between pixels, which makes the error wider by a few percent.
    np.testing.assert_allclose(likelihood(shifted(Side.UPPER, shifts)), np.log(1 - share + share * density), atol=0.12)
    view = one_interval(Side.UPPER, 20.0)
    other = replace(view.image_edges, side=np.full(len(view.image_edges), Side.BOTTOM, np.int8))
    for edges in (other, ImageEdges.empty()):
        likelihood = IntervalLikelihood.of([replace(view, image=ImageFeatures(edges))], np.eye(4), SIGMA_PX)
        assert likelihood.points == 0
        assert likelihood(np.eye(4)[None]) == [0.0]


def test_intervals_outside_of_the_image_or_among_edges_everywhere_count_as_randomly_aligned() -> None:
    likelihood = IntervalLikelihood.of([one_interval(Side.UPPER, 20.0)], np.eye(4), SIGMA_PX)
    sideways, behind = se3.make(translation=[100.0, 0, 0]), se3.make(translation=[0, 0, -30.0])
    above = shifted(Side.UPPER, np.array([240.0]))[0]
    np.testing.assert_allclose(likelihood(np.stack([sideways, behind, above])), 0.0, atol=1e-9)
    rows, columns = np.mgrid[: SIZE[1], : SIZE[0]]
    uv = np.column_stack([columns.ravel(), rows.ravel()]).astype(float)
    view = replace(one_interval(Side.UPPER, 20.0), image=ImageFeatures(ImageEdges(uv, np.full(len(uv), Side.UPPER))))
    likelihood = IntervalLikelihood.of([view], np.eye(4), SIGMA_PX)
    np.testing.assert_allclose(likelihood(shifted(Side.UPPER, np.arange(-50.0, 50, 10))), 0.0, atol=2e-3)


def test_edges_of_one_outline_count_as_the_root_of_their_number_and_moved_views_as_much_at_the_moved_pose() -> None:
    view = one_interval(Side.UPPER, 20.0)
    nine = replace(view, cloud=CloudFeatures(view.cloud_edges.select(np.zeros(9, int))))
    one, all_of_them = (IntervalLikelihood.of([its], np.eye(4), SIGMA_PX)(np.eye(4)[None]) for its in (view, nine))
    np.testing.assert_allclose(all_of_them, 3 * one)
    views = [sparse_view(0)]
    likelihood = IntervalLikelihood.of(views, TRUTH, SIGMA_PX)
    step = se3.exp(np.array([0.01, 0, 0, 0.1, 0, 0]))
    moved = likelihood.on([views[0].moved(step)])
    np.testing.assert_allclose(moved((TRUTH @ se3.inverse(step))[None]), likelihood(TRUTH[None]), rtol=1e-5)


@pytest.mark.parametrize("camera", [edge_scene.PINHOLE, edge_scene.FISHEYE], ids=lambda c: c.model)
def test_the_gradient_is_that_of_differences(camera: Camera) -> None:
    views = [sparse_view(seed, camera=camera) for seed in range(3)]
    likelihood = IntervalLikelihood.of(views, TRUTH, SIGMA_PX)
    step = np.array([1e-3, 1e-3, 1e-3, 1e-2, 1e-2, 1e-2])  # about half a pixel: the density is linear between pixels
    for seed in range(3):
        pose = se3.exp(np.random.default_rng(seed).normal(0, 3 * step)) @ TRUTH
        value, gradient = likelihood.with_gradient(pose)
        assert value == pytest.approx(float(likelihood(pose[None])[0]))
        around = likelihood(se3.exp(np.concatenate([np.diag(step), -np.diag(step)])) @ pose)
        differences = (around[:6] - around[6:]) / 2
        np.testing.assert_allclose(gradient * step, differences, atol=0.15 * np.abs(differences).max())


def test_the_step_between_rings_is_that_of_horizontal_edges() -> None:
    assert ring_step_deg([sparse_view(0)]) == pytest.approx(1.7, rel=0.01)
    assert ring_step_deg([sparse_view(0, 0.4)]) == pytest.approx(0.4, rel=0.01)
    assert ring_step_deg([sparse_view(0).without_sides()]) == 0.0
    assert ring_step_deg([]) == 0.0


def test_the_maximum_over_several_views_is_the_truth_although_rings_are_far_apart() -> None:
    views = [sparse_view(seed) for seed in range(6)]
    start = se3.exp(np.array([0.006, -0.004, 0.005, 0.02, 0.02, 0.0])) @ TRUTH
    likelihood = IntervalLikelihood.of(views, start, SIGMA_PX).fitted(start)
    pose = likelihood.fitted(likelihood.maximised(start)).maximised(start)
    error = pose_error(pose, TRUTH)
    assert error.rotation_deg < 0.1
    assert error.translation_m < 0.03
    covariance = likelihood.covariance(pose)
    step = se3.log(TRUTH @ se3.inverse(pose))
    # The scatter of outlines underestimates errors: twice as much holds 99.9 % of six Gaussian errors.
    assert step @ np.linalg.solve(4 * covariance, step) < 22
    assert np.sqrt(np.diag(covariance)[:3]).max() < np.radians(0.15)


def test_shares_fall_with_the_part_of_edges_that_have_a_counterpart() -> None:
    views = [sparse_view(seed, 0.6) for seed in range(3)]
    wrong = []
    for view in views:
        edges, rng = view.cloud_edges, np.random.default_rng(1)
        lost = rng.random(len(edges)) < 0.5
        elsewhere = se3.apply(se3.inverse(TRUTH), edge_scene.PINHOLE.rays(rng.uniform(0, SIZE, (len(edges), 2))) * 15.0)
        edges = replace(edges, xyz=np.where(lost[:, None], elsewhere, edges.xyz))
        wrong.append(replace(view, cloud=CloudFeatures(edges)))
    right, half = (IntervalLikelihood.of(its, TRUTH, SIGMA_PX).fitted(TRUTH).shares for its in (views, wrong))
    for side in DIRECTION:
        assert right[side] > 0.8
        assert 0.2 < half[side] < 0.7 * right[side]
