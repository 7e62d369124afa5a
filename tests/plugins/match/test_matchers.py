"""Matching with and without directions, on edges drawn by hand and on the synthetic scene."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from p2o import CloudEdges, CloudFeatures, ImageEdges, ImageFeatures, Method, Side, View, se3
from p2o.problems.pairing import balanced, thinned
from p2o.solving import PointToLine
from p2o_baselines.edges import nearest
from p2o_plugins.match import ogm

from tests import edge_scene
from tests.plugins.match.edges import CAMERA, HERE, column, row, view

LEFT, RIGHT, UPPER, BOTTOM = range(4)
METHODS = {"ogm": ogm.METHOD, "nearest": nearest.METHOD}

both = pytest.mark.parametrize("method", METHODS.values(), ids=METHODS.keys())
NAMES = ("xyz", "centre", "normal", "weight", "frame")


def matched(method: Method, views: list[View] | View, reach_px: float = 20.0, pose: Any = HERE, **options: Any):
    match = method.build(method.options(**options))
    problem = match([views] if isinstance(views, View) else views, pose, reach_px)
    assert isinstance(problem, PointToLine)
    return problem


def scene(**changes: Any) -> View:
    return edge_scene.view(**changes)


@both
def test_a_point_beside_an_upright_edge_gets_its_line(method: Method) -> None:
    problem = matched(method, view([(column(200), LEFT)], [([(207.0, 120.3)], LEFT)]))
    assert problem.residuals(HERE) ** 2 == pytest.approx([49.0])
    assert problem.centre == pytest.approx(np.array([[200.0, 120.5]]))  # rows 117 to 124 are the eight nearest
    assert np.abs(problem.normal) == pytest.approx(np.array([[1.0, 0.0]]))


@both
def test_every_one_of_the_eight_must_lie_within_reach(method: Method) -> None:
    here = view([(column(200), LEFT)], [([(203.0, 120.0)], LEFT)])
    farthest = np.hypot(3, 4)  # rows 116 to 124 but one: the eighth lies four rows away
    assert len(matched(method, here, farthest - 0.01)) == 0
    assert len(matched(method, here, farthest)) == 1
    seven = view([(column(200, 117, 7), LEFT)], [([(203.0, 120.0)], LEFT)])
    assert len(matched(method, seven, 50.0)) == 0
    assert len(matched(method, seven, 50.0, neighbours=7)) == 1


@both
def test_a_point_beyond_the_end_of_an_edge_fails_the_angle_test(method: Method) -> None:
    # The nearest eight end at row 100; their centre is row 103.5, so 10 px above it is row 93.5.
    def sees(angle_deg: float, **options: float) -> int:
        angle = np.radians(angle_deg)
        point = (200 + 10 * np.cos(angle), 103.5 - 10 * np.sin(angle))
        return len(matched(method, view([(column(200), LEFT)], [([point], LEFT)]), **options))

    assert [sees(a) for a in (49, 51, 90)] == [1, 0, 0]
    assert [sees(a, max_angle_deg=60.0) for a in (49, 59, 61)] == [1, 1, 0]


@both
def test_a_point_on_its_edge_is_kept_however_the_pixels_fall(method: Method) -> None:
    here = view([(column(200), LEFT)], [([(200.0, 120.3)], LEFT)])
    assert len(matched(method, here)) == 1
    assert len(matched(method, here, angle_free_px=0.0)) == 0  # the paper's test alone: straight along the line


@both
def test_a_point_at_a_corner_of_the_edge_is_refused_unless_curves_are_welcome(method: Method) -> None:
    corner = np.concatenate([column(200, 100, 5), row(100, 201, 4)])
    here = view([(corner, LEFT)], [([(199.0, 99.0)], LEFT)])
    assert len(matched(method, here, max_angle_deg=90.0)) == 0
    assert len(matched(method, here, max_angle_deg=90.0, min_straightness=1.0)) == 1


def test_directions_choose_the_farther_edge_where_the_nearer_is_another() -> None:
    # A pole: its left edge at 200, its right edge at 206; a left point between them is nearer to the right edge.
    pole = view([(column(200), LEFT), (column(206), RIGHT)], [([(204.0, 120.0)], LEFT)])
    assert matched(ogm.METHOD, pole).centre[:, 0] == pytest.approx([200.0])
    assert matched(nearest.METHOD, pole, min_straightness=1.0).centre[0, 0] > 203


def test_without_edges_of_its_direction_a_point_stays_alone() -> None:
    swapped = view([(column(200), RIGHT)], [([(203.0, 120.0)], LEFT)])
    assert len(matched(ogm.METHOD, swapped)) == 0
    assert len(matched(nearest.METHOD, swapped)) == 1


@pytest.mark.parametrize("camera", [edge_scene.PINHOLE, edge_scene.FISHEYE, edge_scene.DISTORTED])
def test_at_the_true_pose_of_a_scene_the_residuals_nearly_vanish(camera: Any) -> None:
    problem = matched(ogm.METHOD, scene(camera=camera), 5.0, edge_scene.TRUTH)
    assert len(problem) > 300
    assert np.median(np.abs(problem.residuals(edge_scene.TRUTH))) < 0.02
    assert set(problem.side) == {0, 1, 2, 3}


def test_without_directions_pairs_have_none() -> None:
    problem = matched(nearest.METHOD, scene().without_sides(), 5.0, edge_scene.TRUTH)
    assert len(problem) > 300
    assert set(problem.side) == {Side.NONE}


def test_a_place_with_two_directions_counts_once_without_directions() -> None:
    once = view([(column(200), LEFT)], [([(203.0, 120.0)], LEFT)])
    twice = view([(column(200), LEFT), (column(200), UPPER)], [([(203.0, 120.0)], LEFT), ([(203.0, 120.0)], UPPER)])
    a, b = matched(nearest.METHOD, once), matched(nearest.METHOD, twice)
    assert len(a) == len(b) == 1
    assert (a.centre == b.centre).all()
    edges = nearest.undirected(CloudEdges(np.ones((3, 3)), [0, 2, 1], [0.2, 0.9, 0.4]))
    assert (edges.weight.tolist(), edges.side.tolist()) == ([0.9], [-1])


@both
def test_the_order_of_points_and_pixels_does_not_matter(method: Method) -> None:
    here, rng = scene(noise_px=0.5), np.random.default_rng(0)
    shuffled = replace(
        here,
        image=ImageFeatures(here.image_edges.select(rng.permutation(len(here.image_edges)))),
        cloud=CloudFeatures(here.cloud_edges.select(rng.permutation(len(here.cloud_edges)))),
    )
    for options in ({}, {"thin_px": 8.0}):
        a, b = (matched(method, v, 8.0, edge_scene.TRUTH, **options) for v in (here, shuffled))
        a_order, b_order = (np.lexsort((p.side, *p.xyz.T)) for p in (a, b))
        assert (a.xyz[a_order] == b.xyz[b_order]).all()
        assert a.centre[a_order] == pytest.approx(b.centre[b_order], abs=1e-9)
        assert a.weight[a_order] == pytest.approx(b.weight[b_order])


@both
def test_points_behind_the_camera_or_outside_the_image_take_no_part(method: Method) -> None:
    here = view([(column(2), LEFT)], [([(4.0, 120.0), (-4.0, 120.0)], LEFT)])
    assert len(matched(method, here)) == 1
    assert len(matched(method, here, margin_px=5.0)) == 2
    behind = se3.exp(np.array([0, np.pi, 0, 0, 0, 0.0]))
    assert len(matched(method, here, pose=behind)) == 0


@both
@pytest.mark.parametrize(
    "views",
    [
        [],
        [View("bare", CAMERA, ImageFeatures(), CloudFeatures())],
        [View("empty", CAMERA, ImageFeatures(ImageEdges.empty()), CloudFeatures(CloudEdges.empty()))],
        [view([], [([(203.0, 120.0)], LEFT)])],
        [view([(column(200), LEFT)], [])],
        [view([], [], camera=edge_scene.FISHEYE), view([(column(200), LEFT)], [], camera=edge_scene.DISTORTED)],
    ],
    ids=["no views", "no features", "no edges", "no image edges", "no cloud edges", "two cameras"],
)
def test_without_edges_there_is_a_problem_without_pairs(method: Method, views: list[View]) -> None:
    problem = matched(method, views)
    assert len(problem) == 0
    assert len(problem.cameras) == len(views)


@both
def test_views_of_different_cameras_are_one_problem(method: Method) -> None:
    views = [scene(camera=c, seed=i) for i, c in enumerate((edge_scene.PINHOLE, edge_scene.FISHEYE))]
    problem = matched(method, views, 5.0, edge_scene.TRUTH)
    singly = [matched(method, v, 5.0, edge_scene.TRUTH) for v in views]
    assert np.bincount(problem.frame).tolist() == [len(p) for p in singly]
    assert (problem.centre == np.concatenate([p.centre for p in singly])).all()
    assert problem.cameras == (edge_scene.PINHOLE, edge_scene.FISHEYE)


@both
def test_the_weight_is_that_of_the_point_times_the_mean_of_its_pixels(method: Method) -> None:
    strong = view([(column(200), LEFT)], [([(203.0, 120.0)], LEFT)], image_weight=0.5, weight=[0.8])
    weak = view([(column(200), LEFT)], [([(203.0, 120.0)], LEFT)], image_weight=0.1, weight=[1.0])
    weight = matched(method, [strong, weak]).weight
    assert weight[0] / weight[1] == pytest.approx(0.4 / 0.1)
    assert weight.mean() == pytest.approx(1.0)


@both
def test_a_point_of_larger_variance_in_the_image_weighs_less(method: Method) -> None:
    # 500 px x 0.04 m / 10 m = 2 px on top of 1 px: variances 1 and 5.
    points = [([(203.0, 120.0), (203.0, 125.0)], LEFT)]
    here = view([(column(200), LEFT)], points, sigma_m=[0.0, 0.04])
    sharp, blurred = matched(method, here).weight
    assert sharp / blurred == pytest.approx(5.0)
    sharp, blurred = matched(method, here, image_sigma_px=2.0).weight
    assert sharp / blurred == pytest.approx(2.0)
    assert matched(method, here, weigh_by_sigma=False).weight.tolist() == [1.0, 1.0]


@both
def test_weights_of_zero_everywhere_are_no_error(method: Method) -> None:
    problem = matched(method, view([(column(200), LEFT)], [([(203.0, 120.0)], LEFT)], weight=[0.0]), huber_px=2.5)
    assert problem.weight.tolist() == [0.0]
    assert problem.huber_px == 2.5, "the kernel is the one asked for"


def test_only_the_sides_asked_for_take_part() -> None:
    problem = matched(ogm.METHOD, scene(), 5.0, edge_scene.TRUTH, sides="LR")
    assert set(problem.side) == {LEFT, RIGHT}
    everything = matched(ogm.METHOD, scene(), 5.0, edge_scene.TRUTH)
    assert len(problem) == (everything.side <= RIGHT).sum()
    assert set(matched(ogm.METHOD, scene(), 5.0, edge_scene.TRUTH, sides="B").side) == {BOTTOM}


@pytest.mark.parametrize("sides", ["", "X", "lr", "L R"])
def test_sides_are_letters_of_the_four(sides: str) -> None:
    with pytest.raises(ValueError, match="sides"):
        ogm.OgmOptions(sides=sides)


def test_balanced_directions_have_equal_sums() -> None:
    plain = matched(ogm.METHOD, scene(), 5.0, edge_scene.TRUTH)
    problem = matched(ogm.METHOD, scene(), 5.0, edge_scene.TRUTH, balance_sides=True)
    sums = np.bincount(problem.side, weights=problem.weight)
    assert np.ptp(np.bincount(plain.side, weights=plain.weight)) > 1
    assert sums == pytest.approx(len(problem) / 4)
    assert balanced(np.array([1.0, 3.0, 0.0]), np.array([0, 0, 3], np.int8)).tolist() == [1.0, 3.0, 0.0]


def test_thinning_keeps_the_heaviest_of_each_cell_and_direction() -> None:
    uv = np.array([[1.0, 1.0], [7.0, 7.0], [9.0, 1.0], [2.0, 2.0], [4.1, 4.0], [-1.0, 1.0]])
    side = np.array([0, 0, 0, 1, 1, 0], np.int8)
    weight = np.array([0.5, 0.9, 0.1, 1.0, 1.0, 1.0])
    # Cell (0, 0): row 1 outweighs row 0, and of the equal rows 3 and 4 of the other direction 4 is more central.
    assert thinned(uv, side, weight, 8.0).tolist() == [1, 2, 4, 5]
    assert thinned(uv[:0], side[:0], weight[:0], 8.0).tolist() == []


@both
def test_thinned_pairs_are_some_of_all_pairs_at_most_one_a_cell(method: Method) -> None:
    everything, few = (matched(method, scene(), 5.0, edge_scene.TRUTH, thin_px=px) for px in (0.0, 8.0))
    assert 0 < len(few) < len(everything)
    whole = {tuple(p) for p in np.column_stack([everything.xyz, everything.side])}
    assert {tuple(p) for p in np.column_stack([few.xyz, few.side])} < whole
    uv = edge_scene.PINHOLE.project(se3.apply(edge_scene.TRUTH, few.xyz))
    cells = np.column_stack([np.floor(uv / 8), few.side])
    assert len(np.unique(cells, axis=0)) == len(few)
