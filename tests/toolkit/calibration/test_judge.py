"""Judges: whatever is compared is judged on one set of points, and by the measure of the method."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from p2o import CloudFeatures, MatcherBase, Side, View, se3
from p2o.calibration.judge import DirectedJudge, IntervalJudge, ProblemJudge, judge_of
from p2o.geometry.motion import EgoMotion
from p2o.geometry.perturb import wrong_start
from p2o.reading import RadialError
from p2o.results.result import DIRECTED, INTERVALS
from p2o.solving import Objective, PointToLine

from tests import edge_scene
from tests.edge_scene import TRUTH
from tests.sparse_scene import sparse_view

EDGES = frozenset({"image-edges", "cloud-edges", "side"})


def far_start(seed: int = 0) -> np.ndarray:
    return wrong_start(TRUTH, 2.0, 0.15, np.random.default_rng(seed))


def many(view: View) -> View:
    """Return the view with edges far outside of the image, too: what a margin brings in or leaves out."""
    edges = view.cloud_edges
    turned = edges.moved(se3.exp(np.array([0.0, 0, 0.6, 0, 0, 0])))
    rows = (edges.xyz, turned.xyz), (edges.side, turned.side)
    xyz, side = (np.concatenate(values) for values in rows)
    return replace(view, cloud=CloudFeatures(type(edges)(xyz, side)))


def test_a_pose_costs_the_same_before_and_after_an_adjustment_that_changes_nothing() -> None:
    """The defect: views that were adjusted had a judge of another margin, so 0.92 px and 1.46 px were one pose."""
    view, start = many(edge_scene.view(noise_px=1.0)), far_start()
    judge = DirectedJudge.of([view], start, [TRUTH, wrong_start(TRUTH, 6, 0.1, np.random.default_rng(1))], 5.0)
    narrow = DirectedJudge.of([view], start, [TRUTH], 5.0)
    assert judge.cost.points > narrow.cost.points
    poses = [start, TRUTH, far_start(3)]
    assert judge.on([view]).costs(poses) == judge.costs(poses)
    assert judge.costs(poses) != narrow.costs(poses)


def test_an_adjusted_view_is_judged_by_the_same_points_with_the_same_weights() -> None:
    view, start = edge_scene.view(noise_px=0.5), far_start()
    times = replace(view.cloud_edges, time_s=np.linspace(-0.05, 0.05, len(view.cloud_edges)))
    view = replace(view, cloud=CloudFeatures(times))
    judge = DirectedJudge.of([view], start, [TRUTH], 5.0)
    moved = replace(view.untwisted(EgoMotion(10.0).twist), camera=RadialError(0.02, 0.01).corrected(view.camera))
    after = judge.on([moved])
    assert after.cost.points == judge.cost.points
    for before, then in zip(judge.cost.parts, after.cost.parts, strict=True):
        np.testing.assert_array_equal(before.weight, then.weight)
        np.testing.assert_array_equal(before.rows, then.rows)
        # To the last bits: there and back is one more product of matrices.
        np.testing.assert_allclose(se3.apply(se3.inverse(start), then.xyz), moved.cloud_edges.xyz[then.rows], atol=1e-9)
    assert after.costs([TRUTH]) != judge.costs([TRUTH])


def matcher(views, pose, reach_px):
    return Objective(lambda poses: np.zeros(len(poses)))


def test_the_judge_is_that_of_the_method() -> None:
    view, start = edge_scene.view(), far_start()
    said = {"truncate_px": 5.0, "reach_px": 5.0}
    assert judge_of(matcher, EDGES, [view], start, [start], **said).name == DIRECTED
    assert isinstance(judge_of(matcher, frozenset({"image-grey"}), [view], start, [start], **said), ProblemJudge)
    own = DirectedJudge.of([view], start, [start], 3.0)

    class Judging(MatcherBase):
        def __call__(self, views, pose, reach_px):
            return matcher(views, pose, reach_px)

        def judge(self, views, start, poses):
            return own

    assert judge_of(Judging(), EDGES, [view], start, [start], **said) is own


def test_no_pose_is_judged_by_its_own_problem_alone() -> None:
    """A matcher that makes whatever pose it is asked at look perfect: all poses cost the same then."""

    def flatterer(views, pose, reach_px):
        return Objective(lambda poses: np.linalg.norm((poses - pose).reshape(len(poses), -1), axis=1))

    first, second = far_start(0), far_start(1)
    judge = ProblemJudge(flatterer, (), 5.0)
    one, other = judge.costs([first, second])
    assert one == pytest.approx(other)
    assert one > 0


def test_costs_of_pairs_are_means_so_that_more_pairs_cost_no_more_and_none_say_nothing() -> None:
    camera = edge_scene.PINHOLE
    rng = np.random.default_rng(0)

    def pairs(count: int) -> PointToLine:
        rays = camera.rays(rng.uniform([100, 50], [1100, 300], (count, 2)))
        xyz = se3.apply(se3.inverse(TRUTH), rays / rays[:, 2:] * 10)
        uv = camera.project(se3.apply(TRUTH, xyz)) + [1.0, 0.0]
        sides = np.full(count, int(Side.LEFT), np.int8)
        normal = np.tile([1.0, 0.0], (count, 1))
        return PointToLine(xyz, uv, normal, np.ones(count), sides, np.zeros(count), (camera,), 2.0)

    few, more = (ProblemJudge(lambda *_, n=n: pairs(n), (), 5.0).costs([TRUTH])[0] for n in (10, 1000))
    assert few == pytest.approx(0.5)  # all residuals are 1 px, inside the kernel
    assert more == pytest.approx(0.5)
    empty = PointToLine.empty((camera,))
    assert ProblemJudge(lambda *_: empty, (), 5.0).costs([TRUTH]) == [float("inf")]


def test_sweeps_whose_rings_are_far_apart_are_judged_as_intervals() -> None:
    start = far_start()

    def judge(step_deg: float, interval_deg: float) -> str:
        limits = {"truncate_px": 5.0, "reach_px": 5.0, "interval_deg": interval_deg}
        return judge_of(matcher, EDGES, [sparse_view(0, step_deg)], start, [start], **limits).name

    assert judge(1.7, 0.75) == INTERVALS
    assert judge(0.4, 0.75) == DIRECTED
    assert judge(1.7, 90.0) == DIRECTED


def test_the_truth_is_judged_better_than_a_pitch_that_the_middle_of_intervals_does_not_reveal() -> None:
    views = [sparse_view(seed) for seed in range(4)]
    pitched = se3.exp(np.array([np.radians(0.7), 0, 0, 0, 0, 0])) @ TRUTH
    intervals = IntervalJudge.of(views, TRUTH, [TRUTH, pitched])
    right, wrong = intervals.costs([TRUTH, pitched])
    lead, unit = intervals.lead(right, wrong)
    assert unit == "edges"
    assert lead > 20
    assert intervals.on(views).costs([TRUTH, pitched]) == pytest.approx([right, wrong])
