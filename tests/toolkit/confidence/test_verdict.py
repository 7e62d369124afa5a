"""Verdicts: what speaks against a pose, and witnesses for methods that have no edges of their own."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import p2o
import pytest
from p2o.calibration.options import PipelineOptions
from p2o.calibration.search_box import SearchBox
from p2o.confidence.verdict import verdict_of
from p2o.geometry.camera import Camera
from p2o.results.result import CameraCheck
from p2o.solving import Accuracy, Agreement, Doubt, Reason, Rival, Trust, Verdict

GOOD, POOR = Agreement(0.3, 0.03, 500, 60), Agreement(0.05, 0.03, 500, 60)
OPTIONS = PipelineOptions()


def rival(lead: float, unit: str = "edges") -> Rival:
    return Rival(lead, unit, 1.0, 0.1)


def test_the_worst_reason_decides_the_word() -> None:
    assert verdict_of(GOOD, None, (), OPTIONS).trust is Trust.TRUSTED
    assert verdict_of(GOOD, rival(1.0), (), OPTIONS).trust is Trust.AMBIGUOUS
    assert verdict_of(GOOD, rival(2.0), (), OPTIONS).trust is Trust.TRUSTED
    both = verdict_of(POOR, rival(1.0), (), OPTIONS)
    assert (both.trust, [r.doubt for r in both.reasons]) == (Trust.DOUBTFUL, [Doubt.RIVAL_POSE, Doubt.LITTLE_AGREEMENT])
    assert Verdict((Reason(Doubt.CAMERA, "focal"),)).trust is Trust.DOUBTFUL
    assert Verdict().having(Reason(Doubt.NOT_SOLVED, "no")).trust is Trust.REFUSED
    unchecked = verdict_of(None, None, (), OPTIONS)
    assert (unchecked.trust, unchecked.reasons[0].doubt) == (Trust.DOUBTFUL, Doubt.NOT_CHECKED)
    # Leads in another unit than edges have no bound, and a reason that is given twice is stated once.
    assert verdict_of(GOOD, rival(0.0, "cost"), (), OPTIONS).trusted
    twice = Reason(Doubt.TOO_UNSURE, "yaw is not observable")
    assert Verdict((twice, twice)).having(twice).why == "yaw is not observable"


def test_pairs_from_too_few_places_or_with_a_direction_that_does_not_agree_are_not_trusted() -> None:
    for places in (0, 6, 11):
        verdict = verdict_of(GOOD, None, (), OPTIONS, places=places)
        assert (verdict.trust, verdict.reasons[0].doubt) == (Trust.DOUBTFUL, Doubt.TOO_FEW_PLACES)
    assert verdict_of(GOOD, None, (), OPTIONS, places=12).trusted
    verdict = verdict_of(replace(GOOD, least_odds=1.4, least_side="U"), None, (), OPTIONS)
    assert (verdict.trust, verdict.reasons[0].doubt) == (Trust.DOUBTFUL, Doubt.LITTLE_AGREEMENT)
    assert "background above" in verdict.why
    assert verdict_of(replace(GOOD, least_odds=2.4, least_side="U"), None, (), OPTIONS).trusted


def test_the_same_odds_are_worth_less_in_few_places() -> None:
    # Three places can be fitted to any odds; sixty cannot.
    few = replace(GOOD, places=3)
    assert few.odds_ratio == GOOD.odds_ratio
    assert few.strength < GOOD.strength
    verdict = verdict_of(few, None, (), OPTIONS)
    assert (verdict.trust, verdict.reasons[0].doubt) == (Trust.DOUBTFUL, Doubt.LITTLE_AGREEMENT)
    assert Agreement(0.03, 0.03, 500, 60).strength == 0.0
    # Nor do very many places make up for odds that are hardly better than chance.
    much_of_little = Agreement(0.045, 0.03, 90_000, 9000)
    assert much_of_little.strength > GOOD.strength
    assert not verdict_of(much_of_little, None, (), OPTIONS).trusted
    assert np.isnan(Agreement(0.0, 0.0, 0).strength)


def test_what_may_be_far_off_by_its_own_word_is_doubtful() -> None:
    fine = Accuracy(0.2, 0.05, 0.7, 0.25)
    assert verdict_of(GOOD, None, (), OPTIONS, fine).trusted
    for unsure in (replace(fine, rotation_deg_95=0.9), replace(fine, translation_m_95=0.31)):
        verdict = verdict_of(GOOD, None, (), OPTIONS, unsure)
        assert (verdict.trust, verdict.reasons[0].doubt) == (Trust.DOUBTFUL, Doubt.TOO_UNSURE)
        assert verdict_of(GOOD, None, (), PipelineOptions(most_deg=2, most_m=1), unsure).trusted


@pytest.mark.parametrize("limit", ["most_deg", "most_m"])
def test_the_predicted_error_of_a_result_is_the_one_that_is_limited(limit: str) -> None:
    def result(*options: str) -> p2o.Result:
        return p2o.calibrate("example:", perturb="2deg 0.15m", options=options).result

    accuracy = result().accuracy
    assert accuracy is not None
    bound = accuracy.rotation_deg_95 if limit == "most_deg" else accuracy.translation_m_95
    assert result(f"pipeline.{limit}={1.001 * bound}").verdict.trusted
    [reason] = result(f"pipeline.{limit}={0.999 * bound}").verdict.reasons
    assert reason.doubt is Doubt.TOO_UNSURE


CAMERA = Camera.pinhole(500, 500, 300, 100, 600, 200)
FIT = CameraCheck(3, CAMERA, CAMERA, 0.033, 0.003, 0.0, 0.01, 5.0, 1.0, False, evidence=10.5, wrong=("focal length",))


@pytest.mark.parametrize(
    ("lead", "edges"),
    [(-3.0, "no fewer edges"), (-0.04, "no fewer edges"), (0.04, "no fewer edges"), (1.2, "only 1.2 fewer edges")],
)
def test_every_reason_is_one_sentence_without_advice_or_negative_counts(lead: float, edges: str) -> None:
    """One reason is separated from the next by a semicolon, so none contains one."""
    unsure = Accuracy(2.0, 0.5, 4.0, 1.0)
    box = SearchBox(2.0, 0.1)
    verdicts = [
        verdict_of(POOR, rival(lead), (FIT,), OPTIONS, unsure, places=3, box=box),
        verdict_of(None, None, (), OPTIONS),
        verdict_of(Agreement(0.0, 0.0, 0), None, (), OPTIONS),
        verdict_of(replace(GOOD, least_odds=1.4, least_side="U"), None, (), OPTIONS),
    ]
    assert [len(verdict.reasons) for verdict in verdicts] == [6, 1, 1, 1]
    for reason in (reason for verdict in verdicts for reason in verdict.reasons):
        assert not set(";") & set(reason.text)
        assert not re.search(r"-\d|nan|start\b|strength|\bplaces\b|meet\b|take more|look at", reason.text)
        assert verdicts[0].why.count(reason.text) <= 1
    assert f"at a distance of 1.00 deg and 0.10 m matches {edges};" in verdicts[0].why
