"""Scores of directed edges: closed forms, symmetries, and forecasters whose calibration is known."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from edge_matching import Pairs, matched_rows, pairs_within
from edge_scores import (
    EdgeTruth,
    Judged,
    against_lidar,
    edge_truth,
    judge_boundary,
    judge_sides,
    precision_recall,
    score,
    together,
    within,
)
from p2o import Camera, CloudEdges, CloudFeatures, ImageEdges, ImageFeatures, InputError, Side, View
from reliability import draw_reliability, reliability

from tests import edge_scene
from tests.edge_scene import TRUTH

WIDTH, HEIGHT = 200, 120
REACH_PX = 0.0075 * np.hypot(1242, 375)


def edges(uv: np.ndarray, side: int | np.ndarray, weight: float | np.ndarray = 1.0) -> ImageEdges:
    uv = np.asarray(uv, float).reshape(-1, 2)
    return ImageEdges(uv, np.broadcast_to(side, len(uv)), np.broadcast_to(np.asarray(weight, float), len(uv)))


def joined(*parts: ImageEdges) -> ImageEdges:
    return ImageEdges(*(np.concatenate([getattr(p, name) for p in parts]) for name in ("uv", "side", "weight")))


def box(left: int = 50, top: int = 30, width: int = 60, height: int = 40) -> ImageEdges:
    """The outline of a box at half pixels, as `edge_truth` has it."""
    x, y = np.arange(left, left + width), np.arange(top, top + height)
    right, bottom = left + width - 1, top + height - 1
    return joined(
        edges(np.column_stack([np.full(height, left - 0.5), y]), Side.LEFT),
        edges(np.column_stack([np.full(height, right + 0.5), y]), Side.RIGHT),
        edges(np.column_stack([x, np.full(width, top - 0.5)]), Side.UPPER),
        edges(np.column_stack([x, np.full(width, bottom + 0.5)]), Side.BOTTOM),
    )


def truth(true: ImageEdges, ignored: ImageEdges | None = None) -> EdgeTruth:
    return EdgeTruth(true, ImageEdges.empty() if ignored is None else ignored)


def shifted(found: ImageEdges, du: float, dv: float) -> ImageEdges:
    return replace(found, uv=found.uv + (du, dv))


def opposite(found: ImageEdges) -> ImageEdges:
    return replace(found, side=np.array([1, 0, 3, 2], np.int8)[found.side])


def mirrored(found: ImageEdges) -> ImageEdges:
    uv = np.column_stack([WIDTH - 1 - found.uv[:, 0], found.uv[:, 1]])
    return ImageEdges(uv, np.array([1, 0, 2, 3], np.int8)[found.side], found.weight)


def line(length: int = 50, u: float = 20.5, side: int = Side.RIGHT, weight: float = 1.0) -> ImageEdges:
    return edges(np.column_stack([np.full(length, u), np.arange(length)]), side, weight)


def all_sides(found: ImageEdges, true: EdgeTruth) -> Judged:
    return together(judge_sides(found, true).values())


# Matching


def brute_force(near: np.ndarray) -> int:
    """The size of a largest matching of a small graph, by trying everything."""
    if not len(near):
        return 0
    first, rest = near[0], near[1:]
    best = brute_force(rest)
    for column in np.flatnonzero(first):
        without = rest.copy()
        without[:, column] = False
        best = max(best, 1 + brute_force(without))
    return best


@pytest.mark.parametrize("seed", range(20))
def test_every_threshold_has_as_many_pairs_as_there_can_be(seed: int) -> None:
    rng = np.random.default_rng(seed)
    found, true = rng.uniform(0, 5, (7, 2)), rng.uniform(0, 5, (6, 2))
    pairs, group = pairs_within(found, true, 1.6), rng.integers(0, 4, 7)
    near = np.zeros((7, 6), bool)
    near[pairs.row, pairs.column] = True
    hit = matched_rows(pairs, group)
    for threshold in range(4):
        assert hit[group >= threshold].sum() == brute_force(near[group >= threshold])


@pytest.mark.parametrize("seed", range(3))
def test_a_large_matching_is_as_large_as_that_of_scipy(seed: int) -> None:
    from scipy.sparse import csr_array
    from scipy.sparse.csgraph import maximum_bipartite_matching

    rng = np.random.default_rng(seed)
    pairs = pairs_within(rng.uniform(0, 40, (600, 2)), rng.uniform(0, 40, (500, 2)), 1.2)
    graph = csr_array((np.ones(len(pairs.row)), (pairs.row, pairs.column)), shape=(600, 500))
    expected = (maximum_bipartite_matching(graph, perm_type="column") >= 0).sum()
    assert matched_rows(pairs, rng.integers(0, 10, 600)).sum() == expected


def test_a_chain_needs_every_pair_to_move() -> None:
    """Nearest first takes the middle pairs and leaves both ends alone; the largest matching shifts all of them."""
    count = 30
    row = np.concatenate([np.arange(count), np.arange(1, count)])
    column = np.concatenate([np.arange(count), np.arange(count - 1)])
    distance = np.concatenate([np.full(count, 2.0), np.full(count - 1, 1.0)])
    assert matched_rows(Pairs(count, count, row, column, distance), np.zeros(count, int)).all()


def test_points_at_the_same_place_are_pairs() -> None:
    assert len(pairs_within(np.zeros((1, 2)), np.zeros((1, 2)), 1.0).row) == 1


# Exact labels


def test_a_perfect_prediction_scores_one() -> None:
    true = box()
    plain, directed = judge_boundary(true, truth(true), REACH_PX)
    for figures in (
        score([plain]),
        score([directed], [plain]),
        score([directed]),
        score([all_sides(true, truth(true))]),
    ):
        assert (figures.ods, figures.ois, figures.ap) == pytest.approx((1, 1, 1))
        assert (figures.precision, figures.recall) == pytest.approx((1, 1))
    for judged in judge_sides(true, truth(true)).values():
        assert precision_recall(judged) == (1, 1)


def test_points_on_the_foreground_pixel_are_the_same_pixels_as_points_on_the_outline() -> None:
    true = box()
    inner = replace(true, uv=true.uv - 0.5 * np.array([Side(int(s)).background for s in true.side]))
    plain, directed = judge_boundary(inner, truth(true), 0.01)
    assert precision_recall(plain) == precision_recall(directed) == (1, 1)


def test_edges_a_pixel_off_are_found_within_two() -> None:
    true = box()
    for du, dv in ((1, 0), (-1, 0), (0, 1), (0, -1)):
        assert precision_recall(all_sides(shifted(true, du, dv), truth(true))) == (1, 1)


def test_edges_three_pixels_across_are_not_found_within_two() -> None:
    true = line()
    assert precision_recall(all_sides(shifted(true, 3, 0), truth(true))) == (0, 0)
    assert precision_recall(judge_boundary(shifted(true, 3, 0), truth(true), REACH_PX)[1]) == (1, 1)


def test_the_opposite_side_never_matches() -> None:
    true = box()
    assert precision_recall(all_sides(opposite(true), truth(true))) == (0, 0)
    plain, directed = judge_boundary(opposite(true), truth(true), REACH_PX)
    # Named the other way round, the pixel beyond the outline is the foreground: a frame one pixel larger all round.
    assert precision_recall(plain) == pytest.approx((196 / 200, 1))
    assert not directed.hit.any()


def test_the_opposite_side_does_not_match_across_a_thin_pole_either() -> None:
    pole = box(width=4, height=80, top=10)
    wrong = opposite(pole)
    wrong = wrong.select((wrong.side == Side.LEFT) | (wrong.side == Side.RIGHT))
    directed = judge_boundary(wrong, truth(pole), REACH_PX)[1]
    assert directed.hit.mean() < 0.1  # its ends, where U and B are near


def test_a_side_at_a_right_angle_agrees_within_the_papers_tolerance_only() -> None:
    true, found = line(side=Side.RIGHT), line(side=Side.UPPER)
    # The first pixel centre inside: an upper point is moved down, one at the right to the left.
    assert precision_recall(judge_boundary(shifted(found, -0.5, 0), truth(true), 2.0)[1]) == (1, 1)
    assert precision_recall(all_sides(found, truth(true))) == (0, 0)


def test_a_corner_pixel_points_both_ways() -> None:
    corner = joined(edges([[9.5, 10]], Side.LEFT), edges([[10, 9.5]], Side.UPPER))
    hits = {s.letter: bool(judge_boundary(edges([[10, 10]], s), truth(corner), 2.0)[1].hit[0]) for s in Side if s >= 0}
    # Up and left is 45 degrees from L and U, 135 degrees from R and B.
    assert hits == {"L": True, "R": False, "U": True, "B": False}


def test_a_true_edge_is_found_once() -> None:
    true = line(50)
    thick = joined(true, shifted(true, 1, 0), shifted(true, -1, 0))
    assert precision_recall(all_sides(thick, truth(true))) == pytest.approx((1 / 3, 1))
    assert precision_recall(judge_boundary(thick, truth(true), REACH_PX)[0]) == pytest.approx((1 / 3, 1))
    twice = joined(true, true)
    assert precision_recall(all_sides(twice, truth(true))) == (0.5, 1)
    assert precision_recall(judge_boundary(twice, truth(true), REACH_PX)[0]) == (1, 1)  # the same pixels


def test_nothing_found_scores_zero_and_nothing_true_has_no_score() -> None:
    empty, true = ImageEdges.empty(), box()
    figures = score([all_sides(empty, truth(true))])
    assert (figures.ods, figures.ois, figures.ap, figures.recall) == (0, 0, 0, 0)
    assert np.isnan(precision_recall(all_sides(empty, truth(true)))[0])
    assert np.isnan(score([all_sides(true, truth(empty))]).ods)
    assert precision_recall(all_sides(true, truth(empty)))[0] == 0


def test_directions_are_scored_each_for_itself() -> None:
    true = box()
    found = replace(true, side=np.where(true.side == Side.UPPER, Side.BOTTOM, true.side).astype(np.int8))
    judged = judge_sides(found, truth(true))
    assert precision_recall(judged[Side.LEFT]) == precision_recall(judged[Side.RIGHT]) == (1, 1)
    assert precision_recall(judged[Side.UPPER])[1] == 0
    assert precision_recall(judged[Side.BOTTOM]) == (0.5, 1)


def test_ignored_edges_are_neither_missed_nor_wrong() -> None:
    true, leaves = line(50), line(30, u=120.5)
    with_leaves = truth(true, leaves)
    assert precision_recall(all_sides(true, with_leaves)) == (1, 1)
    assert precision_recall(all_sides(joined(true, leaves), with_leaves)) == (1, 1)
    assert precision_recall(judge_boundary(joined(true, leaves), with_leaves, REACH_PX)[0]) == (1, 1)
    # Beside an ignored edge, but at a true one and with the wrong direction: wrong.
    near_leaves = truth(true, line(50, u=23.5, side=Side.LEFT))
    assert precision_recall(all_sides(replace(true, side=0 * true.side), near_leaves)) == (0, 0)
    assert precision_recall(judge_boundary(replace(true, side=0 * true.side), near_leaves, REACH_PX)[1])[0] == 0
    elsewhere = line(30, u=80.5)
    assert precision_recall(all_sides(joined(true, elsewhere), with_leaves)) == pytest.approx((50 / 80, 1))


def test_of_two_predictions_at_one_true_edge_the_one_without_an_ignored_edge_is_matched() -> None:
    true, leaf = edges([[20, 10]], Side.RIGHT), edges([[22.5, 10]], Side.RIGHT)
    found = edges([[21.5, 10], [18.5, 10]], Side.RIGHT)
    for order in ([0, 1], [1, 0]):
        judged = judge_sides(found.select(np.array(order)), truth(true, leaf))[Side.RIGHT]
        assert precision_recall(judged) == (1, 1)


def test_a_mirror_swaps_left_and_right_and_changes_nothing_else() -> None:
    rng = np.random.default_rng(3)
    true = joined(box(), box(130, 20, 9, 70), box(20, 10, 2, 60))
    found = replace(true, uv=true.uv + rng.normal(0, 1.5, true.uv.shape), weight=rng.uniform(0, 1, len(true)))
    found = found.select(rng.random(len(found)) < 0.8)
    there, back = judge_sides(found, truth(true)), judge_sides(mirrored(found), truth(mirrored(true)))
    for side in there:
        assert precision_recall(there[side], 0.3) == precision_recall(back[side.mirrored], 0.3)
    for one, other in zip(
        judge_boundary(found, truth(true), REACH_PX),
        judge_boundary(mirrored(found), truth(mirrored(true)), REACH_PX),
        strict=True,
    ):
        assert score([one]) == score([other])


# Figures over thresholds


def judged(weight: list[float], hit: list[bool], true: int) -> Judged:
    return Judged(np.array(weight), np.array(hit), np.ones(len(weight), bool), true)


def test_one_threshold_for_all_images_and_one_for_each() -> None:
    # Image A is perfect above 0.8 and has as many wrong ones below; image B is perfect above 0.2.
    a = judged([0.9] * 10 + [0.5] * 10, [True] * 10 + [False] * 10, 10)
    b = judged([0.3] * 10 + [0.1] * 10, [True] * 10 + [False] * 10, 10)
    figures = score([a, b])
    assert figures.ois == pytest.approx(1.0)
    # At 0.30: 20 of 30 right, all 20 found; any higher threshold up to 0.5 has 10 of 20, above it 10 of 10.
    assert figures.ods == pytest.approx(2 * (2 / 3) / (2 / 3 + 1))
    assert 0.1 < figures.threshold <= 0.3


def test_the_best_f_is_interpolated_between_thresholds() -> None:
    # At 0.50: P = 50 / 100, R = 1. At 0.51: P = 1, R = 40 / 50 ... the best lies between only if F is higher there.
    low_hits, high_hits = 10, 40
    part = judged([0.505] * (low_hits + 10) + [0.9] * high_hits, [True] * 10 + [False] * 10 + [True] * high_hits, 50)
    share = np.linspace(0, 1, 101)
    precision, recall = 50 / 60 + share * (1 - 50 / 60), 1 + share * (0.8 - 1)
    expected = (2 * precision * recall / (precision + recall)).max()
    at_thresholds = max(2 * (5 / 6) / (5 / 6 + 1), 2 * 0.8 / 1.8)
    assert expected > at_thresholds + 0.001
    assert score([part]).ods == pytest.approx(expected, abs=1e-6)


def test_average_precision_is_the_area_under_the_curve() -> None:
    # Half of the truth is found without a mistake, nothing else: precision 1 up to recall 0.5, then 0.
    assert score([judged([0.9] * 50, [True] * 50, 100)]).ap == pytest.approx(51 / 101)
    # A coin that is right half of the time at every threshold, and reaches everything.
    weight = np.repeat(np.arange(100) / 100 + 0.005, 2)
    coin = Judged(weight, np.arange(200) % 2 == 0, np.ones(200, bool), 99)
    assert score([coin]).ap == pytest.approx(0.5, abs=0.01)


def test_recall_may_be_that_of_any_direction() -> None:
    any_direction, directed = judged([0.9] * 10, [True] * 10, 10), judged([0.9] * 10, [True] * 5 + [False] * 5, 10)
    figures = score([directed], [any_direction])
    assert (figures.precision, figures.recall) == pytest.approx((0.5, 1))
    assert (score([directed]).precision, score([directed]).recall) == pytest.approx((0.5, 0.5))


# The truth of a depth map


def test_the_truth_lies_between_foreground_and_background_and_leaves_are_ignored() -> None:
    camera = Camera.pinhole(100, 100, 20, 15, 41, 31)
    depth, masked = np.full((31, 41), 10.0), np.zeros((31, 41), bool)
    depth[10:21, 5:16] = 5.0
    depth[10:21, 25:36] = 5.0
    masked[:, 25:36] = True
    found = edge_truth(depth, camera, masked=masked)
    for chosen, left, right in ((found.edges, 4.5, 15.5), (found.ignored, 24.5, 35.5)):
        places = {Side.LEFT: (0, left), Side.RIGHT: (0, right), Side.UPPER: (1, 9.5), Side.BOTTOM: (1, 20.5)}
        for side, (axis, place) in places.items():
            uv = chosen.uv[chosen.side == side]
            assert len(uv) == 11
            assert (uv[:, axis] == place).all()


def test_the_depth_extractor_agrees_with_its_own_truth_and_a_wrong_sign_shows() -> None:
    from p2o_plugins.image import depth
    from p2o_sim import Class, synthetic

    options = synthetic.SyntheticOptions(seed=5, width_px=621, height_px=188, right=False)
    view = synthetic.view(options, 0)
    image = view.frame.image
    true = edge_truth(image.depth_m, image.camera, normals=view.rendered.normals, masked=view.rendered.foliage)
    assert len(true.edges) > 500
    assert (view.rendered.classes == Class.FOLIAGE).any()
    found = depth.build(depth.DepthOptions())(image).edges
    reach = 0.0075 * np.hypot(621, 188)
    plain, directed = judge_boundary(found, true, reach)
    assert score([directed], [plain]).ods > 0.97
    assert score([all_sides(found, true)]).ods > 0.9
    wrong = opposite(found)
    # What is left are things so thin that their other side is within reach.
    thin = within(opposite(true.edges), true.edges).mean()
    assert thin < 0.4
    assert score([all_sides(wrong, true)]).recall < thin + 0.05
    assert score(judge_boundary(wrong, true, reach)[1:]).precision < 0.5


# Against a LiDAR


def returns_of(view: View) -> np.ndarray:
    """Returns everywhere: 20 m away through every fourth pixel."""
    from p2o import se3

    u, v = np.meshgrid(np.arange(0, view.camera.width, 4.0), np.arange(0, view.camera.height, 4.0))
    points = 20 * view.camera.rays(np.stack([u, v], -1).reshape(-1, 2))
    return se3.apply(se3.inverse(TRUTH), points)


def test_edges_of_one_scene_confirm_each_other() -> None:
    view = edge_scene.view(boxes=8, lidar_step_m=0.02)
    found = against_lidar(view, TRUTH, returns=returns_of(view))
    assert found.found.mean() > 0.97
    assert found.confirmed.mean() > 0.9
    for side in Side:
        if side >= 0:
            assert abs(np.nanmedian(found.of(side).offset_px)) < 0.2


def test_shifted_image_edges_show_in_the_signed_distances() -> None:
    view = edge_scene.view(boxes=8)
    moved = replace(view, image=ImageFeatures(shifted(view.image_edges, 1.5, -0.8)))
    found = against_lidar(moved, TRUTH, returns=returns_of(view))
    median = {side: float(np.nanmedian(found.of(side).offset_px)) for side in Side if side >= 0}
    assert median[Side.LEFT] == pytest.approx(-1.5, abs=0.2)
    assert median[Side.RIGHT] == pytest.approx(-1.5, abs=0.2)
    assert median[Side.UPPER] == pytest.approx(0.8, abs=0.2)
    assert median[Side.BOTTOM] == pytest.approx(0.8, abs=0.2)


def test_opposite_sides_confirm_nothing_but_by_chance() -> None:
    view = edge_scene.view(boxes=4)
    wrong = replace(view, image=ImageFeatures(opposite(view.image_edges)))
    found = against_lidar(wrong, TRUTH, returns=returns_of(view))
    assert found.found.mean() < 0.2
    blind = against_lidar(wrong.without_sides(), TRUTH, returns=returns_of(view))
    assert blind.found.mean() > 0.97


def test_only_image_edges_that_the_lidar_could_see_are_judged() -> None:
    camera = Camera.pinhole(100, 100, 100, 60, WIDTH, HEIGHT)
    u, v = np.meshgrid(np.arange(0.0, 101, 4), np.arange(0.0, HEIGHT, 4))
    left_half = 10 * camera.rays(np.stack([u, v], -1).reshape(-1, 2))
    image = joined(line(100, 40.5), line(100, 100.5, Side.LEFT), line(100, 100.5, Side.RIGHT), line(100, 150.5))
    view = View("half", camera, ImageFeatures(image), CloudFeatures(CloudEdges.empty(), left_half))
    found = against_lidar(view, np.eye(4))
    # At the border of what is seen, the background of a right edge is not.
    assert len(found.of(Side.RIGHT).confirmed) == len(found.of(Side.LEFT).confirmed) == 100
    assert not found.confirmed.any()


def test_without_returns_there_is_no_telling_what_the_lidar_could_see() -> None:
    view = View("none", edge_scene.PINHOLE, ImageFeatures(box()), CloudFeatures(CloudEdges.empty()))
    with pytest.raises(InputError, match="no LiDAR returns"):
        against_lidar(view, np.eye(4))


# Reliability


def test_a_calibrated_forecaster_has_no_error_and_a_biased_one_has_its_bias() -> None:
    rng = np.random.default_rng(0)
    confidence = rng.uniform(0, 1, 200_000)
    # The standard error of a bin's share is at most 0.5 / sqrt(20000) = 0.0035.
    good = reliability(confidence, rng.random(len(confidence)) < confidence)
    assert good.expected_error < 0.01
    np.testing.assert_allclose(good.share, np.arange(10) / 10 + 0.05, atol=0.015)
    too_sure = reliability(confidence, rng.random(len(confidence)) < confidence - 0.2)
    # max(c - 0.2, 0): the gap is c below 0.2 and 0.2 above, 0.18 on average.
    assert too_sure.expected_error == pytest.approx(0.18, abs=0.01)
    assert too_sure.share[9] == pytest.approx(0.75, abs=0.015)


def test_bins_hold_their_lower_bound_and_the_last_one_holds_one() -> None:
    table = reliability(np.array([0.0, 0.5, 1.0]), np.array([0, 1, 1]), bins=2)
    assert table.count.tolist() == [1, 2]
    assert table.share.tolist() == [0, 1]
    assert table.expected_error == pytest.approx(0.25 * 2 / 3)
    assert np.isnan(reliability(np.zeros(0), np.zeros(0)).expected_error)


@pytest.mark.parametrize("value", [-0.1, 1.1])
def test_a_confidence_is_between_zero_and_one(value: float) -> None:
    with pytest.raises(InputError, match="no share"):
        reliability(np.array([value]), np.array([1]))


def test_the_diagram_is_written(tmp_path: Path) -> None:
    table = reliability(np.linspace(0, 1, 50), np.ones(50))
    draw_reliability({"one": table, "two": table}, tmp_path / "a.png")
    assert (tmp_path / "a.png").read_bytes().startswith(b"\x89PNG")
    with pytest.raises(InputError, match="cannot write the file"):
        draw_reliability({}, tmp_path / "nowhere" / "a.png")
