"""The directed distance is zero at the truth, counts pixels, and asks for the right direction."""

from __future__ import annotations

import weakref
from dataclasses import replace

import cv2
import numpy as np
import pytest
from p2o import CloudEdges, CloudFeatures, ImageEdges, ImageFeatures, Side, View, se3
from p2o.problems.directed_cost import CONFIDENCES, distance_maps
from p2o.solving import DirectedCost

from tests import edge_scene

CAMERAS = [edge_scene.PINHOLE, edge_scene.FISHEYE, edge_scene.DISTORTED]


@pytest.mark.parametrize("camera", CAMERAS, ids=lambda c: c.model)
def test_the_truth_costs_under_a_pixel_and_a_turn_costs_more(camera) -> None:
    view = edge_scene.view(camera)
    cost = DirectedCost.of([view], edge_scene.TRUTH, 20.0)
    turned = se3.exp(np.array([0.01, 0.01, 0.0, 0, 0, 0])) @ edge_scene.TRUTH
    values = cost(np.stack([edge_scene.TRUTH, turned]))
    # Image edges are rounded to whole pixels in the map: at most 0.7 px, plus points that leave the image.
    assert values[0] < 1.0
    assert values[1] > values[0] + 2.0


def one_edge(side_image: Side, side_cloud: Side) -> View:
    image = ImageEdges(np.array([[600.0, v] for v in range(100, 200)]), np.full(100, side_image))
    cloud = CloudEdges(np.array([[0.0, 0.0, 10.0]]), np.array([side_cloud]))
    return View("one", edge_scene.PINHOLE, ImageFeatures(image), CloudFeatures(cloud))


def test_the_cost_is_the_distance_in_pixels_to_edges_of_that_direction_up_to_the_truncation() -> None:
    cost = DirectedCost.of([one_edge(Side.LEFT, Side.LEFT)], np.eye(4), 20.0)
    shifts = np.array([0.0, 0.1, 0.2, 1.0])  # 7 px a decimetre at 10 m
    poses = np.stack([se3.make(translation=[s, 0, 0]) for s in shifts])
    np.testing.assert_allclose(cost(poses), [0, 7, 14, 20], atol=1e-3)
    cost = DirectedCost.of([one_edge(Side.RIGHT, Side.LEFT)], np.eye(4), 20.0)
    assert cost.at(np.eye(4)) == pytest.approx(20.0)


def test_a_point_outside_the_image_costs_what_a_random_place_costs_and_without_points_every_pose_is_infinite() -> None:
    view = one_edge(Side.LEFT, Side.LEFT)
    cost = DirectedCost.of([view], np.eye(4), 20.0)
    outside = se3.make(translation=[100.0, 0, 0])
    behind = se3.make(translation=[0, 0, -20.0])
    random = float(cost.parts[0].maps.mean())
    # The mean is taken from every fourth cell.
    np.testing.assert_allclose(cost(np.stack([outside, behind])), random, rtol=1e-2)
    view = View("empty", edge_scene.PINHOLE, ImageFeatures(ImageEdges.empty()), CloudFeatures(CloudEdges.empty()))
    assert DirectedCost.of([view], np.eye(4), 20.0).at(np.eye(4)) == np.inf


def test_coarse_quick_and_truncated_costs_agree_with_the_fine_smooth_one() -> None:
    view = edge_scene.view()
    poses = se3.exp(np.random.default_rng(0).normal(0, 0.02, (20, 6))) @ edge_scene.TRUTH

    def cost(truncate_px: float, **options: object) -> DirectedCost:
        return DirectedCost.of([view], edge_scene.TRUTH, truncate_px, **options)

    np.testing.assert_allclose(cost(40.0, scale=4)(poses), cost(40.0, scale=1)(poses), atol=2.0)
    # Half a cell and 2 % of 20 px.
    np.testing.assert_allclose(cost(20.0, smooth=False)(poses), cost(20.0, smooth=True)(poses), atol=0.9)
    np.testing.assert_allclose(cost(40.0).truncated(10.0)(poses), cost(10.0)(poses), rtol=1e-3)


def test_weights_count_views_add_up_and_of_many_views_an_even_subset_is_kept() -> None:
    view = edge_scene.view()
    edges = view.cloud_edges
    doubled = replace(view, cloud=CloudFeatures(replace(edges, weight=np.full(len(edges), 2.0))))
    pose = se3.exp(np.array([0.01, 0, 0, 0, 0, 0])) @ edge_scene.TRUTH
    single = DirectedCost.of([view], edge_scene.TRUTH, 20.0).at(pose)
    assert DirectedCost.of([doubled], edge_scene.TRUTH, 20.0).at(pose) == pytest.approx(single, rel=1e-5)
    assert DirectedCost.of([view, doubled], edge_scene.TRUTH, 20.0).at(pose) == pytest.approx(single, rel=1e-5)
    views = [one_edge(Side.LEFT, Side.LEFT)] * 3 + [one_edge(Side.RIGHT, Side.LEFT)] * 5
    cost = DirectedCost.of(views, np.eye(4), 20.0, max_views=4)
    assert [part.view for part in cost.parts] == [0, 2, 4, 6]
    assert cost.at(np.eye(4)) == pytest.approx(10.0)  # two of the four meet their edge
    everything = DirectedCost.of(views, np.eye(4), 20.0, max_views=8)
    assert everything.at(np.eye(4)) == DirectedCost.of(views, np.eye(4), 20.0).at(np.eye(4))


@pytest.mark.parametrize("distance_m", [5.0, 20.0])
def test_a_point_whose_uncertainty_spans_one_pixel_counts_half(distance_m: float) -> None:
    view, focal = one_edge(Side.LEFT, Side.LEFT), edge_scene.PINHOLE.focal_px
    matched, missed = [0.0, 0.0, distance_m], [7.0 * distance_m / focal, 0.0, distance_m]  # 0 px and 7 px
    one_pixel = np.linalg.norm(matched) / focal
    for sigma_px, weight in ((0.0, 1.0), (1.0, 1 / 2), (3.0, 1 / 10)):
        sigma_m = np.array([sigma_px * one_pixel, 0.0])
        edges = CloudEdges(np.array([matched, missed]), np.full(2, Side.LEFT), sigma_m=sigma_m)
        cost = DirectedCost.of([replace(view, cloud=CloudFeatures(edges))], np.eye(4), 20.0)
        assert cost.at(np.eye(4)) == pytest.approx(7.0 / (1 + weight), abs=1e-3)
        assert cost.edges == pytest.approx(1 + weight)


def test_exact_maps_are_the_same_bytes_wherever_they_lie_in_memory_and_on_any_number_of_threads() -> None:
    view = edge_scene.view()
    before, found, others = cv2.getNumThreads(), set(), []
    try:
        for turn in range(12):
            cv2.setNumThreads(1 + turn % 2)
            others.append(np.empty(1000 * turn + 16 * turn))
            found.add(distance_maps(view, [Side.LEFT], 100.0, 1).tobytes())
    finally:
        cv2.setNumThreads(before)
    assert len(found) == 1


@pytest.mark.parametrize("confidence", [0.1, 0.4, 0.9])
def test_an_edge_counts_at_every_level_below_its_confidence(confidence: float) -> None:
    view = one_edge(Side.LEFT, Side.LEFT)
    edges = view.image_edges
    image = ImageFeatures(replace(edges, weight=np.full(len(edges), confidence)))
    cost = DirectedCost.of([replace(view, image=image)], np.eye(4), 20.0).at(np.eye(4))
    missed = np.mean([level > confidence for level in CONFIDENCES])
    assert cost == pytest.approx(20.0 * missed, abs=1e-3)


def test_a_sure_edge_outweighs_a_doubtful_one_that_lies_nearer_where_there_are_levels_of_confidence() -> None:
    near, far = np.full((50, 2), 600.0), np.full((50, 2), 610.0)
    near[:, 1] = far[:, 1] = np.arange(150, 200)
    both = ImageEdges(np.concatenate([near, far]), np.full(100, Side.LEFT), np.repeat([0.1, 0.9], 50))
    view = replace(one_edge(Side.LEFT, Side.LEFT), image=ImageFeatures(both))
    maps = distance_maps(view, [Side.LEFT], 20.0, 1, confidences=CONFIDENCES)
    assert maps[0, 175, 610] < maps[0, 175, 600]
    # Without levels confidence does not count.
    view = one_edge(Side.LEFT, Side.LEFT)
    edges = view.image_edges
    for weight in (0.01, 1.0):
        image = ImageFeatures(replace(edges, weight=np.full(len(edges), weight)))
        plain = distance_maps(replace(view, image=image), [Side.LEFT], 20.0, 1)
        np.testing.assert_array_equal(plain, distance_maps(view, [Side.LEFT], 20.0, 1))


@pytest.mark.parametrize(("truncate_px", "scale"), [(5.0, 1), (4.3, 1), (20.0, 4), (12.0, 2)])
def test_few_edges_and_many_have_the_distances_of_a_brute_force_search(truncate_px: float, scale: int) -> None:
    rng = np.random.default_rng(4)
    camera = CAMERAS[0]
    height, width = camera.height, camera.width
    for count in (1, 30, 3000):
        uv = rng.uniform([0, 0], [width - 1, height - 1], (count, 2))
        edges = ImageEdges(uv, np.full(count, Side.LEFT, np.int8))
        view = View("edges", camera, ImageFeatures(edges), CloudFeatures(CloudEdges.empty()))
        found = distance_maps(view, [Side.LEFT], truncate_px, scale)[0]
        cells = np.rint(uv / scale).astype(int)
        cells = cells[(cells < [found.shape[1], found.shape[0]]).all(axis=1)]
        asked = rng.integers(0, [found.shape[1], found.shape[0]], (300, 2))
        nearest = np.linalg.norm(asked[:, None] - cells[None], axis=2).min(axis=1) * scale
        assert found[asked[:, 1], asked[:, 0]] == pytest.approx(np.minimum(nearest, truncate_px), abs=1e-5)


def test_costs_of_the_same_image_edges_share_their_maps_while_one_of_them_lives() -> None:
    view = edge_scene.view()
    near = se3.exp(np.array([0.05, 0, 0, 0, 0, 0])) @ edge_scene.TRUTH
    first = DirectedCost.of([view], edge_scene.TRUTH, 20.0)
    second = DirectedCost.of([view], near, 20.0)
    assert second.parts[0].maps is first.parts[0].maps
    assert DirectedCost.of([view], near, 19.0).parts[0].maps is not first.parts[0].maps
    alone = DirectedCost.of([edge_scene.view()], near, 20.0)
    assert alone.parts[0].maps is not first.parts[0].maps
    assert second.at(near) == alone.at(near)
    maps = weakref.ref(alone.parts[0].maps)
    del alone
    assert maps() is None


@pytest.mark.parametrize("camera", CAMERAS, ids=lambda c: c.model)
@pytest.mark.parametrize("smooth", [True, False])
def test_many_poses_cost_what_each_costs_alone(camera, smooth: bool) -> None:
    view = edge_scene.view(camera)
    draws = np.random.default_rng(0).normal(0, 0.05, (1201, 6))
    poses = se3.exp(draws) @ edge_scene.TRUTH
    cost = DirectedCost.of([view], edge_scene.TRUTH, 20.0, smooth=smooth)
    alone = [cost.at(pose) for pose in poses[::100]]
    np.testing.assert_allclose(cost(poses)[::100], alone, rtol=1e-5)


@pytest.mark.parametrize("camera", CAMERAS, ids=lambda c: c.model)
@pytest.mark.parametrize("scale", [1, 4])
def test_the_quick_cost_is_the_mean_of_the_nearest_cells_and_of_the_random_place_outside(camera, scale: int) -> None:
    view = edge_scene.view(camera)
    far = np.random.default_rng(1).normal(0, [0.3, 0.3, 0.3, 1, 1, 20], (40, 6))  # some look away, some are beyond
    poses = se3.exp(far) @ edge_scene.TRUTH
    cost = DirectedCost.of([view], edge_scene.TRUTH, 20.0, scale=scale, smooth=False)
    (part,) = cost.parts
    last = np.array(part.maps.shape[:0:-1]) - 1.001
    expected, outside = [], 0
    for pose in poses @ cost.lidar_from_around:
        cell = camera.project(se3.apply(pose, part.xyz)) / scale
        inside = ((cell >= 0) & (cell <= last)).all(axis=1)
        column, row = np.rint(np.where(inside[:, None], cell, 0)).astype(int).T
        met = np.where(inside, part.maps[part.side_index, row, column], part.neutral[part.side_index])
        expected.append(np.average(np.minimum(met, 20.0), weights=part.weight))
        outside += np.count_nonzero(~inside)
    assert outside > 1000
    # A point whose pixel is half way between two cells may take either: single precision.
    np.testing.assert_allclose(cost(poses), expected, atol=5e-3)


@pytest.mark.parametrize("smooth", [True, False])
def test_a_point_half_a_pixel_outside_is_outside(smooth: bool) -> None:
    camera = edge_scene.PINHOLE
    image = ImageEdges(np.array([[0.0, 100.0]]), np.array([Side.LEFT]))
    for u, inside in ((-0.3, False), (0.3, True)):
        xyz = 10.0 * camera.rays(np.array([[u, 100.0]]))
        # A second point holds the view: a cost is made of points that are in the image.
        cloud = CloudEdges(np.concatenate([xyz, [[0.0, 0.0, 10.0]]]), np.array([Side.LEFT, Side.LEFT]))
        view = View("border", camera, ImageFeatures(image), CloudFeatures(cloud))
        cost = DirectedCost.of([view], np.eye(4), 20.0, margin_px=1.0, smooth=smooth)
        # The second one meets nothing within 20 px, and a random place costs nearly as much.
        assert (cost.at(np.eye(4)) < 10.5) == inside


@pytest.mark.parametrize("poses", [1, 2, 2001])
def test_many_points_of_one_direction_cost_what_one_does(poses: int) -> None:
    # OpenCV looks up fewer than 32,768 at a time.
    view, count = one_edge(Side.LEFT, Side.LEFT), 40_000 if poses < 3 else 50
    edges = CloudEdges(np.tile([[0.0, 0.0, 10.0]], (count, 1)), np.full(count, Side.LEFT))
    cost = DirectedCost.of([replace(view, cloud=CloudFeatures(edges))], np.eye(4), 20.0, smooth=False)
    shifted = np.stack([se3.make(translation=[0.1, 0, 0])] * poses)  # 7 px
    np.testing.assert_allclose(cost(shifted), np.full(poses, 7.0), rtol=0.02)


@pytest.mark.parametrize("scale", [1, 2])
def test_the_slopes_are_central_differences_of_the_distances(scale: int) -> None:
    view = edge_scene.view()
    cost = DirectedCost.of([view], edge_scene.TRUTH, 8.0, scale=scale)
    low, high = [-3.0, -3.0], [view.camera.width + 2.0, view.camera.height + 2.0]
    for seed in range(5):
        uv = np.random.default_rng(seed).uniform(low, high, (cost.points, 2))
        uv[::7], uv[1::7, 0], uv[2::7, 1] = np.nan, np.rint(uv[1::7, 0]), uv[2::7, 1] % 5 - 2
        slopes = [(cost.sampled(0, uv + step) - cost.sampled(0, uv - step)) / (2 * scale) for step in scale * np.eye(2)]
        cells = uv / scale
        inner = ((cells >= 1) & (cells < np.array(cost.parts[0].maps.shape[:0:-1]) - 2)).all(axis=1)
        np.testing.assert_allclose(cost.slopes(0, uv), np.where(inner, slopes, 0.0), atol=2e-3)
