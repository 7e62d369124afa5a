"""Edges that belong together meet more often than by chance; edges that do not, do not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from p2o import CloudEdges, CloudFeatures, ImageEdges, ImageFeatures, Side, View, se3
from p2o.problems.agreement import agreement, interval_agreement
from p2o.results.evidence import Agreement

from tests import edge_scene
from tests.edge_scene import TRUTH
from tests.sparse_scene import sparse_view


def test_views_of_other_places_are_further_evidence_and_the_same_view_again_is_none() -> None:
    views = [edge_scene.view(seed=seed) for seed in range(4)]
    once, again = agreement(views[:1], TRUTH), agreement(views[:1] * 5, TRUTH)
    assert again.odds_ratio == pytest.approx(once.odds_ratio)
    assert again.strength == pytest.approx(once.strength, rel=0.01)
    alone = float(np.mean([agreement([view], TRUTH).strength for view in views]))
    assert agreement(views, TRUTH).strength == pytest.approx(2.0 * alone, rel=0.15)


def test_at_the_truth_nearly_every_edge_meets_its_own_and_the_odds_fall_with_the_error_of_the_pose() -> None:
    view = edge_scene.view()
    turned = [se3.exp(np.array([a, a, 0.0, 0, 0, 0])) @ TRUTH for a in (0.0, 0.005, 0.01)]
    found = [agreement([view], pose) for pose in turned]
    assert found[0].near > 0.95
    assert found[0].odds_ratio > max(50, found[1].odds_ratio)
    assert found[1].odds_ratio > found[2].odds_ratio


def test_the_direction_whose_edges_do_not_correspond_is_named() -> None:
    view = edge_scene.view()
    edges = view.image_edges
    upper = edges.side == Side.UPPER
    uv = np.where(upper[:, None], edges.uv[::-1] * [1.0, 0.5] + [0.0, 150.0], edges.uv)
    other = replace(view, image=ImageFeatures(ImageEdges(uv, edges.side, edges.weight)))
    right, wrong = agreement([view], TRUTH), agreement([other], TRUTH)
    assert right.least_odds is not None
    assert wrong.least_odds is not None
    assert right.least_odds > 20
    assert wrong.least_odds < 2
    assert wrong.least_side == "U"
    assert wrong.odds_ratio > 5
    # A direction with few edges is not judged alone.
    few = view.cloud_edges.select(np.flatnonzero(view.cloud_edges.side == Side.UPPER)[:40])
    assert agreement([replace(view, cloud=CloudFeatures(few))], TRUTH).least_odds is None


def test_the_edges_and_intervals_of_another_place_meet_by_chance_and_without_points_there_is_no_answer() -> None:
    here, there = edge_scene.view(seed=0), edge_scene.view(seed=1)
    assert 0.4 < agreement([replace(here, cloud=there.cloud)], TRUTH).odds_ratio < 2.5
    here, there = sparse_view(0), sparse_view(1)
    assert 0.4 < interval_agreement([replace(here, cloud=there.cloud)], TRUTH).odds_ratio < 2.5
    view = View("empty", edge_scene.PINHOLE, ImageFeatures(ImageEdges.empty()), CloudFeatures(CloudEdges.empty()))
    assert np.isnan(agreement([view], TRUTH).odds_ratio)
    assert Agreement(1.0, 0.5, 10).odds_ratio > 1e5
    behind = se3.make(translation=[0, 0, -1000.0]) @ TRUTH
    assert interval_agreement([sparse_view(0)], behind).points == 0


def test_points_scattered_at_random_have_an_odds_ratio_of_one() -> None:
    rng = np.random.default_rng(0)
    image = edge_scene.view().image_edges.without_sides()
    pixels = rng.uniform([0, 0], [1241, 374], (20_000, 2))
    cloud = CloudEdges(edge_scene.PINHOLE.rays(pixels) * 10.0, np.full(20_000, -1))
    view = View("random", edge_scene.PINHOLE, ImageFeatures(image), CloudFeatures(cloud))
    found = agreement([view], np.eye(4))
    # The standard error of a share of about 0.3 over 20,000 points is 0.3 %.
    assert found.near == pytest.approx(found.chance, abs=0.015)
    assert found.odds_ratio == pytest.approx(1.0, abs=0.08)


def with_clutter(confidence: float) -> View:
    view, rng = edge_scene.view(), np.random.default_rng(0)
    edges = view.image_edges
    uv = np.concatenate([edges.uv, rng.uniform([0, 0], [1241, 374], (40_000, 2))])
    side = np.concatenate([edges.side, rng.integers(0, 4, 40_000).astype(np.int8)])
    weight = np.concatenate([np.full(len(edges), 0.9), np.full(40_000, confidence)])
    return replace(view, image=ImageFeatures(ImageEdges(uv, side, weight)))


def test_doubtful_edges_are_not_asked_while_there_are_sure_ones() -> None:
    clean = agreement([edge_scene.view()], TRUTH)
    assert agreement([with_clutter(0.1)], TRUTH) == clean
    assert agreement([with_clutter(0.9)], TRUTH).odds_ratio < 0.5 * clean.odds_ratio
    # An extractor that is never sure is asked all the same.
    view = edge_scene.view()
    weak = replace(view.image_edges, weight=np.full(len(view.image_edges), 0.1))
    assert agreement([replace(view, image=ImageFeatures(weak))], TRUTH) == clean


def test_intervals_between_far_rings_agree_where_their_middles_do_not() -> None:
    views = [sparse_view(seed) for seed in range(2)]
    by_middle, by_interval = agreement(views, TRUTH), interval_agreement(views, TRUTH)
    assert by_interval.near > 0.95
    assert by_interval.odds_ratio > 2 * by_middle.odds_ratio
    once, again = interval_agreement(views[:1], TRUTH), interval_agreement(views[:1] * 4, TRUTH)
    assert again.strength == pytest.approx(once.strength, rel=0.05), "the same view again is no further evidence"


def test_intervals_at_random_have_an_odds_ratio_of_one() -> None:
    rng = np.random.default_rng(0)
    view = sparse_view(0)
    pixels = rng.uniform([0, 0], [1241, 374], (len(view.cloud_edges), 2))
    edges = replace(view.cloud_edges, xyz=edge_scene.PINHOLE.rays(pixels) * 10.0)
    turned = edges.background @ TRUTH[:3, :3].T
    found = interval_agreement([replace(view, cloud=CloudFeatures(replace(edges, background=turned)))], np.eye(4))
    assert found.near == pytest.approx(found.chance, abs=0.03)
    assert found.odds_ratio == pytest.approx(1.0, abs=0.2)
