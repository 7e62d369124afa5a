"""Witnesses: results of methods that have no edges of their own, held against edges that had no part in them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import p2o
import pytest
from p2o import Result, Status, se3
from p2o.calibration.options import PipelineOptions
from p2o.confidence import verdict
from p2o.confidence.assessment import witnessed
from p2o.solving import Accuracy, Agreement, Doubt, Pipeline, Reason, Trust, Verdict

from tests import edge_scene
from tests.edge_scene import TRUTH

POOR = Agreement(0.05, 0.03, 500, 60)
OPTIONS = PipelineOptions()


def claimed(pose: np.ndarray, status: Status = Status.CONVERGED) -> Result:
    return Result(("a",), pose, pose, status, "it says so")


def test_a_witness_confirms_a_right_pose_and_doubts_a_wrong_or_an_unsure_one() -> None:
    views = [edge_scene.view(seed=i) for i in range(2)]
    right = witnessed(claimed(TRUTH), views, OPTIONS)
    wrong = witnessed(claimed(se3.exp(np.array([0.05, 0.05, 0.05, 0, 0, 0])) @ TRUTH), views, OPTIONS)
    assert right.verdict.trusted
    assert right.agreement.odds_ratio > 5 * wrong.agreement.odds_ratio
    assert wrong.verdict.trust is Trust.DOUBTFUL
    unsure = replace(claimed(TRUTH), accuracy=Accuracy(2.6, 0.3, 5.0, 0.6))
    assert [reason.doubt for reason in witnessed(unsure, views, OPTIONS).verdict.reasons] == [Doubt.TOO_UNSURE]
    told = replace(unsure, verdict=Verdict((Reason(Doubt.TOO_UNSURE, "own words"),)))
    assert [reason.text for reason in witnessed(told, views, OPTIONS).verdict.reasons] == ["own words"]


def test_without_witnesses_a_claim_is_doubtful_and_own_reasons_refusals_and_agreement_stay() -> None:
    own = replace(claimed(TRUTH), verdict=Verdict((Reason(Doubt.RIVAL_POSE, "two"),)))
    found = witnessed(own, [], OPTIONS)
    assert found.agreement is None
    assert [reason.doubt for reason in found.verdict.reasons] == [Doubt.RIVAL_POSE, Doubt.NOT_CHECKED]
    refused = claimed(TRUTH, Status.NOT_OBSERVABLE)
    own = replace(claimed(TRUTH), agreement=POOR, verdict=Verdict((Reason(Doubt.LITTLE_AGREEMENT, "own edges"),)))
    assert witnessed(refused, [edge_scene.view()], OPTIONS) is refused
    assert witnessed(own, [], OPTIONS) is own
    assert refused.verdict.trust is Trust.REFUSED


def test_directed_edges_overrule_the_agreement_of_own_edges_without_directions_and_nothing_else() -> None:
    views = [edge_scene.view(seed=i) for i in range(2)]
    rival, poor = Reason(Doubt.RIVAL_POSE, "two"), Reason(Doubt.LITTLE_AGREEMENT, "own edges")
    away = se3.exp(np.array([0.05, 0.05, 0.05, 0, 0, 0])) @ TRUTH
    for pose, own, doubts in (
        (TRUTH, (poor,), []),
        (TRUTH, (poor, rival), [Doubt.RIVAL_POSE]),
        (away, (), [Doubt.LITTLE_AGREEMENT]),
    ):
        result = witnessed(replace(claimed(pose), agreement=POOR, verdict=Verdict(own)), views, OPTIONS)
        assert [reason.doubt for reason in result.verdict.reasons] == doubts
        assert result.agreement != POOR


@pytest.mark.parametrize(
    ("words", "checked"),
    [
        ({}, False),
        ({"matcher": "nearest"}, True),
        ({"extractor": "canny/rings", "matcher": "nearest"}, True),
        ({"extractor": "canny/rings", "matcher": "nearest", "witness": "none"}, False),
    ],
)
def test_only_edges_matched_by_their_directions_check_their_own_result(words: dict[str, str], checked: bool) -> None:
    plan = p2o.Recipe.of(data="synthetic:", **words).resolve(p2o.Registry.load())
    assert ("witness" in plan.parts) == checked


@pytest.fixture(scope="module")
def pipeline() -> Pipeline:
    found = p2o.Recipe.of(data=None).resolve(p2o.Registry.load()).calibrator()
    assert isinstance(found, Pipeline)
    return found


@pytest.fixture(scope="module")
def views() -> list[p2o.View]:
    return [edge_scene.view(boxes=60, seed=seed, noise_px=0.3, name=f"{seed}") for seed in (1, 2)]


def test_a_pose_beside_a_better_one_is_doubtful(pipeline: Pipeline, views: list[p2o.View]) -> None:
    """Half a degree off in yaw, far more edges meet than by chance, though not left and right ones."""
    beside = claimed(se3.exp(np.array([0.0, np.radians(0.5), 0, 0, 0, 0])) @ TRUTH)
    [reason] = witnessed(beside, views, OPTIONS).verdict.reasons
    assert reason.doubt is Doubt.LITTLE_AGREEMENT
    assert "background left" in reason.text or "background right" in reason.text
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(verdict, "_MIN_SIDE_ODDS", 0.0)
        assert witnessed(beside, views, OPTIONS).verdict.trusted
        found = witnessed(beside, views, OPTIONS, pipeline).verdict
    assert (found.trust, [reason.doubt for reason in found.reasons]) == (Trust.DOUBTFUL, [Doubt.LED_AWAY])
    assert "is off by about" in found.why
    for deg in (0.0, 0.15):
        near = claimed(se3.exp(np.array([0.0, np.radians(deg), 0, 0, 0, 0])) @ TRUTH)
        assert witnessed(near, views, OPTIONS, pipeline).verdict.trusted


def test_the_default_witness_of_a_whole_method_tells_where_its_edges_lead() -> None:
    plan = p2o.Recipe.of(data="synthetic:", calibrator="csc").resolve(p2o.Registry.load())
    assert plan.assembly().witness is not None
    without = p2o.Recipe.of(data="synthetic:", calibrator="csc", witness="canny/rings").resolve(p2o.Registry.load())
    assert without.assembly().witness is None
