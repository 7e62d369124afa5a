"""Rounds without a search that end in a local minimum are not trusted: a pose near by fits better."""

from __future__ import annotations

import numpy as np
import p2o
import pytest
from p2o import se3
from p2o.calibration.judge import DirectedJudge
from p2o.geometry.pose_error import is_distinct, pose_error
from p2o.problems.rivals import rival_poses
from p2o.run.outcome import Run
from p2o.run.recipe import Recipe
from p2o.solving import Doubt

STREET = "synthetic:?scenes=6&seed=9&place=street&right=false&width_px=621&height_px=188"


@pytest.fixture(scope="module")
def run() -> Run:
    """Six frames without a search, from 4 deg and 40 cm: some end at the truth, others at minima far from it."""
    return p2o.calibrate(STREET, extractor="depth/rings", init="given", perturb="4deg 0.4m", seed=1)


def test_a_local_minimum_has_a_rival_and_is_not_trusted_while_results_at_the_truth_are(run: Run) -> None:
    wrong = [row for row in run.rows if row.error is not None and row.error.rotation_deg > 0.5]
    assert len(wrong) >= 2
    for row in wrong:
        assert not row.result.verdict.trusted
        assert Doubt.RIVAL_POSE in {reason.doubt for reason in row.result.verdict.reasons}
        assert row.result.rival.lead < 0
    right = [row for row in run.rows if row.error is not None and row.error.rotation_deg < 0.5]
    assert len(right) >= 3
    assert all(row.result.verdict.trusted and row.result.rival is None for row in right)


def test_rivals_of_a_displaced_pose_are_near_the_minimum_and_distinct() -> None:
    plan = Recipe.of(data=STREET, extractor="depth/rings").resolve(p2o.Registry.load())
    frame, pipeline = plan.dataset()[0], plan.assembly().calibrator
    truth = frame.camera_from_lidar
    views = pipeline.visible([pipeline.prepare(frame)], truth).corrected
    off = se3.exp(np.array([0.02, -0.02, 0.01, 0.1, 0.1, -0.1])) @ truth
    judge = DirectedJudge.of(views, truth, [off], 5.0)
    first, second = rival_poses(judge.cost, off, 2)
    assert judge.cost.at(first) < judge.cost.at(off)
    assert se3.angle_deg(first @ se3.inverse(truth)) < se3.angle_deg(off @ se3.inverse(truth)) / 2
    assert is_distinct(se3.inverse(second) @ first)
    assert is_distinct(se3.inverse(first) @ off)


def test_after_a_far_search_a_better_pose_near_a_local_minimum_is_the_result(run: Run) -> None:
    plan = Recipe.of(data=STREET, extractor="depth/rings", init="far").resolve(p2o.Registry.load())
    dataset, pipeline = plan.dataset(), plan.assembly().calibrator
    minima = 0
    for row in run.rows:
        frame = dataset[list(dataset.names).index(row.result.frames[0])]
        views, start = (
            [pipeline.prepare(frame)],
            se3.exp(np.array([0.12, 0, 0, 0, 0, 0])) @ row.result.camera_from_lidar,
        )
        refined = pipeline.refine(pipeline.visible(views, row.result.start), start, [row.result.camera_from_lidar])
        if pose_error(refined.best.pose, frame.camera_from_lidar).rotation_deg > 0.5:
            minima += 1
            after = pose_error(pipeline.refine_again(views, refined).best.pose, frame.camera_from_lidar)
            assert after.rotation_deg < 0.2
    assert minima
