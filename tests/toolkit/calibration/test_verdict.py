"""Verdicts: what speaks against a pose, and witnesses for methods that have no edges of their own."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from p2o import Accuracy, Agreement, Doubt, Reason, Result, Rival, Status, Trust, Verdict, se3
from p2o.calibration.options import PipelineOptions
from p2o.calibration.verdict import verdict_of, witnessed

from tests import edge_scene
from tests.edge_scene import TRUTH

GOOD, POOR = Agreement(0.3, 0.03, 500, 60), Agreement(0.05, 0.03, 500, 60)
OPTIONS = PipelineOptions()


def rival(lead: float, unit: str = "edges") -> Rival:
    return Rival(lead, unit, 1.0, 0.1)


def test_the_worst_reason_decides_the_word() -> None:
    assert verdict_of(GOOD, None, (), OPTIONS).trust is Trust.TRUSTED
    assert verdict_of(GOOD, rival(1.0), (), OPTIONS).trust is Trust.AMBIGUOUS
    assert verdict_of(GOOD, rival(2.0), (), OPTIONS).trust is Trust.TRUSTED
    both = verdict_of(POOR, rival(1.0), (), OPTIONS)
    assert (both.trust, [r.doubt for r in both.reasons]) == (
        Trust.DOUBTFUL,
        [Doubt.RIVAL_POSE, Doubt.LITTLE_AGREEMENT],
    )
    assert Verdict((Reason(Doubt.CAMERA, "focal"),)).trusted
    assert Verdict().having(Reason(Doubt.NOT_SOLVED, "no")).trust is Trust.REFUSED


def test_pairs_from_too_few_places_are_not_trusted_however_well_edges_meet() -> None:
    for places in (0, 6, 11):
        verdict = verdict_of(GOOD, None, (), OPTIONS, places=places)
        assert (verdict.trust, verdict.reasons[0].doubt) == (Trust.DOUBTFUL, Doubt.TOO_FEW_PLACES)
    assert verdict_of(GOOD, None, (), OPTIONS, places=12).trusted


def test_without_edges_nothing_is_trusted() -> None:
    verdict = verdict_of(None, None, (), OPTIONS)
    assert (verdict.trust, verdict.reasons[0].doubt) == (Trust.DOUBTFUL, Doubt.NOT_CHECKED)


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
    fine = Accuracy(0.2, 0.05, 0.9, 0.25)
    assert verdict_of(GOOD, None, (), OPTIONS, fine).trusted
    for unsure in (replace(fine, rotation_deg_95=1.1), replace(fine, translation_m_95=0.31)):
        verdict = verdict_of(GOOD, None, (), OPTIONS, unsure)
        assert (verdict.trust, verdict.reasons[0].doubt) == (Trust.DOUBTFUL, Doubt.TOO_UNSURE)
        assert verdict_of(GOOD, None, (), PipelineOptions(most_deg=2, most_m=1), unsure).trusted


def test_leads_in_another_unit_than_edges_have_no_bound() -> None:
    assert verdict_of(GOOD, rival(0.0, "cost"), (), OPTIONS).trusted


def claimed(pose: np.ndarray, status: Status = Status.CONVERGED) -> Result:
    return Result(("a",), pose, pose, status, "it says so")


def test_a_witness_confirms_a_right_pose_and_doubts_a_wrong_one() -> None:
    views = [edge_scene.view(seed=i) for i in range(2)]
    right = witnessed(claimed(TRUTH), views, OPTIONS)
    wrong = witnessed(claimed(se3.exp(np.array([0.05, 0.05, 0.05, 0, 0, 0])) @ TRUTH), views, OPTIONS)
    assert right.verdict.trusted
    assert right.agreement.odds_ratio > 5 * wrong.agreement.odds_ratio
    assert wrong.verdict.trust is Trust.DOUBTFUL


def test_without_witnesses_a_claim_is_doubtful_and_its_own_reasons_stay() -> None:
    own = replace(claimed(TRUTH), verdict=Verdict((Reason(Doubt.RIVAL_POSE, "two"),)))
    found = witnessed(own, [], OPTIONS)
    assert found.agreement is None
    assert [reason.doubt for reason in found.verdict.reasons] == [Doubt.RIVAL_POSE, Doubt.NOT_CHECKED]


def test_a_method_that_says_itself_how_far_off_it_may_be_is_doubtful_whatever_the_witness_sees() -> None:
    views = [edge_scene.view(seed=i) for i in range(2)]
    unsure = replace(claimed(TRUTH), accuracy=Accuracy(2.6, 0.3, 5.0, 0.6))
    assert [reason.doubt for reason in witnessed(unsure, views, OPTIONS).verdict.reasons] == [Doubt.TOO_UNSURE]
    told = replace(unsure, verdict=Verdict((Reason(Doubt.TOO_UNSURE, "own words"),)))
    assert [reason.text for reason in witnessed(told, views, OPTIONS).verdict.reasons] == ["own words"]


def test_what_is_refused_or_has_its_own_agreement_is_left_alone() -> None:
    views = [edge_scene.view()]
    refused = claimed(TRUTH, Status.NOT_OBSERVABLE)
    own = replace(claimed(TRUTH), agreement=POOR)
    assert witnessed(refused, views, OPTIONS) is refused
    assert witnessed(own, views, OPTIONS) is own
    assert refused.verdict.trust is Trust.REFUSED
