"""Frames of one view count as one view: in the costs, the pairs, the pose, its covariance, and for costs of others."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import p2o
import pytest
from p2o import CloudFeatures, Side, View
from p2o.calibration.adjustment import Nuisance
from p2o.calibration.judge import SIGMA_PX, DirectedJudge
from p2o.geometry.perturb import wrong_start
from p2o.geometry.pose_error import pose_error
from p2o.host.guard import GuardedMatcher
from p2o.problems.distinct_views import distinct_views, evenly_chosen, scenes_of, view_weights, weighted
from p2o.problems.interval_likelihood import IntervalLikelihood
from p2o.problems.pairing import edge_pairs
from p2o.run.pipeline import Pipeline
from p2o.solving import DirectedCost, LeastSquares, PointToLine

from tests import edge_scene
from tests.edge_scene import TRUTH
from tests.sparse_scene import sparse_view

POSES = np.stack([TRUTH, *(wrong_start(TRUTH, 0.5, 0.05, np.random.default_rng(seed)) for seed in range(3))])


def places(count: int, *, sparse: bool = False) -> list[View]:
    """Return views of different places."""
    make = sparse_view if sparse else edge_scene.view
    return [replace(make(seed=seed), name=f"place {seed}") for seed in range(count)]


def biased(view: View) -> View:
    """Return a view whose level edges are wrong in the sweep: a truck whose edges the image does not show."""
    edges = view.cloud_edges
    level = np.isin(edges.side, (Side.UPPER, Side.BOTTOM))
    xyz = np.array(edges.xyz)
    xyz[level, 2] += 0.006 * np.linalg.norm(xyz[level], axis=1)
    return replace(view, cloud=CloudFeatures(replace(edges, xyz=xyz)))


def stop(view: View, count: int) -> list[View]:
    """Return `count` frames of one view, with noise of the sweep of their own."""
    rng, edges = np.random.default_rng(0), view.cloud_edges
    frames = []
    for number in range(count):
        xyz = edges.xyz * (1 + rng.normal(0, 0.001, (len(edges), 1)))
        frames.append(replace(view, name=f"stop {number}", cloud=CloudFeatures(replace(edges, xyz=xyz))))
    return frames


def test_weights_of_a_view_sum_to_one_and_frames_of_other_places_keep_theirs() -> None:
    views = weighted([*places(3), *stop(edge_scene.view(seed=9), 6)], TRUTH)
    assert [view.weight for view in views[:3]] == pytest.approx([1.0] * 3, abs=0.1)
    assert sum(view.weight for view in views[3:]) == pytest.approx(1.0, abs=0.1)
    assert len(set(scenes_of(views)[:3])) == 3
    assert len(set(scenes_of(views)[3:])) == 1
    assert view_weights(views).mean() == pytest.approx(1.0)


def test_copies_of_a_view_cost_what_the_view_costs() -> None:
    first, second = places(2)
    copies = weighted([first, *[second] * 20], TRUTH)
    two = weighted([first, second], TRUTH)
    costs = [DirectedCost.of(views, TRUTH, 5.0)(POSES) for views in (copies, two)]
    assert costs[0] == pytest.approx(costs[1], rel=1e-3)


def test_copies_of_a_view_have_its_likelihood_and_covariance_and_a_judge_is_led_by_the_same_edges() -> None:
    first, second = places(2, sparse=True)
    two, copies = (weighted(views, TRUTH) for views in ([first, second], [first, *[second] * 8]))
    of_two, of_copies = (IntervalLikelihood.of(views, TRUTH, SIGMA_PX) for views in (two, copies))
    assert of_copies(POSES) == pytest.approx(of_two(POSES), rel=1e-3)
    assert of_copies.covariance(TRUTH) == pytest.approx(of_two.covariance(TRUTH), rel=0.02, abs=1e-8)
    first, second = places(2)
    judges = [DirectedJudge.of(weighted(views, TRUTH), TRUTH, [TRUTH], 5.0) for views in ([first, second], [first] * 9)]
    leads = [judge.lead(*judge.costs(POSES[:2]))[0] for judge in judges]
    assert leads[1] < leads[0]


def test_copies_of_a_view_do_not_reduce_the_covariance_of_pairs() -> None:
    first, second = places(2)
    covariances = []
    for views in ([first, second], [first, *[second] * 8]):
        its = weighted(views, TRUTH)
        nuisance = Nuisance.expected(its, None)
        problem = edge_pairs(its, TRUTH, 5.0).weighted(view_weights(its))
        fit = nuisance.fit(problem, tuple(view.camera for view in its), TRUTH, fits_cameras=False)
        assert fit.covariance is not None
        covariances.append(fit.covariance)
    assert covariances[1] == pytest.approx(covariances[0], rel=0.05)


class Shifts(LeastSquares):
    """One residual for each frame, of a third party that computes its weights."""

    huber, frame = 1.0, np.arange(3)

    @property
    def weight(self) -> p2o.Float:  # type: ignore[override]
        return np.ones(3)

    def residuals(self, camera_from_lidar: p2o.Float) -> p2o.Float:
        return np.repeat(camera_from_lidar[..., :1, 3], 3, axis=-1)


def test_residuals_are_weighted_by_view_also_where_the_weights_are_a_property() -> None:
    problem = Shifts().weighted(np.array([2.0, 0.5, 0.5]))
    assert isinstance(problem, Shifts)
    np.testing.assert_allclose(problem.weight, [2.0, 0.5, 0.5])
    assert problem.cost(POSES) == pytest.approx(Shifts().cost(POSES)), "the weights of equal residuals"
    np.testing.assert_allclose(Shifts().weight, 1.0)


def _pipeline() -> Pipeline:
    plan = p2o.Recipe.of(extractor="depth/rings").resolve(p2o.Registry.load())
    pipeline = plan.assembly().calibrator
    assert isinstance(pipeline, Pipeline)
    return pipeline


@pytest.mark.parametrize("sparse", [False, True])
def test_a_wrong_view_moves_the_pose_no_further_when_it_is_repeated(sparse: bool) -> None:
    """The frames of a stop in front of a truck: one moves the pose a little, several not more than that."""
    pipeline, start = _pipeline(), wrong_start(TRUTH, 1.0, 0.08, np.random.default_rng(3))
    distinct, wrong = places(3, sparse=sparse), biased((sparse_view if sparse else edge_scene.view)(seed=9))
    alone, once, often = (
        pipeline.solve(views, start) for views in (distinct, [*distinct, wrong], [*distinct, *stop(wrong, 5)])
    )
    moved = pose_error(often.camera_from_lidar, alone.camera_from_lidar)
    by_one = pose_error(once.camera_from_lidar, alone.camera_from_lidar)
    assert moved.rotation_deg < 2 * by_one.rotation_deg + 0.03
    assert moved.rotation_deg < often.accuracy.rotation_deg_95
    assert moved.translation_m < often.accuracy.translation_m_95


def test_a_judge_and_costs_of_other_methods_see_one_frame_of_each_view() -> None:
    frames = weighted([*places(2), *stop(edge_scene.view(seed=9), 4)], TRUTH)
    received: list[int] = []

    def stage(views: Sequence[View], pose: np.ndarray, reach_px: float) -> PointToLine:
        received.append(len(views))
        return edge_pairs(views, pose, reach_px)

    registry = p2o.Registry.load()
    for name, count in (("idt", 3), ("ogm", 6)):
        [offer] = [each for each in registry.offers if each.name == name and each.kind.value == "matcher"]
        GuardedMatcher(offer, stage)(frames, TRUTH, 5.0)
        assert received.pop() == count


def test_a_subset_of_views_is_even_over_their_weight_and_frames_without_edges_have_one() -> None:
    assert evenly_chosen(np.ones(10), 5).tolist() == [0, 2, 4, 6, 8]
    chosen = evenly_chosen(np.r_[np.ones(10), np.full(90, 1 / 45)], 12)
    assert chosen[:10].tolist() == list(range(10))
    assert 11 <= len(chosen) <= 12
    nothing = np.zeros((0, 3)), np.zeros(0, np.int8), np.zeros(0, np.int64)
    weights, scenes = distinct_views(*nothing, 3)
    assert weights.tolist() == [1.0] * 3
    assert scenes.tolist() == [0, 1, 2]
