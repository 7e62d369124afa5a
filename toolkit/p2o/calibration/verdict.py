"""From what speaks for and against a pose to a verdict: agreement of edges, the rival pose, the camera."""

from __future__ import annotations

from collections.abc import Sequence

from p2o.arrays import Float
from p2o.calibration.agreement import agreement
from p2o.calibration.camera_check import doubt
from p2o.calibration.judge import Judge
from p2o.calibration.options import PipelineOptions
from p2o.calibration.rounds import End
from p2o.features.view import View
from p2o.geometry import se3
from p2o.results.accuracy import Accuracy
from p2o.results.evidence import Agreement, Rival
from p2o.results.result import CameraCheck
from p2o.results.verdict import Doubt, Reason, Verdict

_RIVAL_DEG, _RIVAL_M = 0.5, 0.3
_ENOUGH_PLACES = 12
"""Twice as many as unknowns: with fewer, errors of several degrees were seen at odds ratios above 20, and the scatter
of pairs did not show them.
"""


def rival_of(ends: Sequence[End], best: End, judge: Judge) -> Rival | None:
    """Return the next best end that is not the place of the best: how much worse it is, and how far away; or None."""
    steps = {id(end): se3.inverse(end.pose) @ best.pose for end in ends if end.solved}
    others = [
        end
        for end in ends
        if end.solved and (se3.angle_deg(steps[id(end)]) > _RIVAL_DEG or se3.distance_m(steps[id(end)]) > _RIVAL_M)
    ]
    if not others:
        return None
    cost_of_best, *costs = judge.costs([best.pose, *(end.pose for end in others)])
    cost, number = min((cost, i) for i, cost in enumerate(costs))
    step = steps[id(others[number])]
    return Rival(*judge.lead(cost_of_best, cost), se3.angle_deg(step), se3.distance_m(step))


def agreement_of(views: Sequence[View], camera_from_lidar: Float) -> Agreement | None:
    """Return how the edges of both sensors meet at a pose (4, 4), or None where there are none of one sensor."""
    if not any(view.count("image-edges") and view.count("cloud-edges") for view in views):
        return None
    return agreement(views, camera_from_lidar)


def verdict_of(
    agreed: Agreement | None,
    rival: Rival | None,
    cameras: Sequence[CameraCheck],
    options: PipelineOptions,
    accuracy: Accuracy | None = None,
    *,
    places: int | None = None,
) -> Verdict:
    """Return the verdict on a pose: doubtful where edges do not seem to belong together, or nothing can tell.

    Doubtful is, too, what may be far off by its own likely error (`accuracy`), whatever else speaks for it. `places` is
    from how many places of the pictures pairs come, None where that is not known.
    """
    reasons = [*_rivalry(rival, options.min_lead_edges), *meeting(agreed, options), *unsure(accuracy, options)]
    if places is not None and places < _ENOUGH_PLACES:
        text = (
            f"pairs come from {places} places of the picture alone, too few to tell how good the pose is; take more "
            "frames together"
        )
        reasons.append(Reason(Doubt.TOO_FEW_PLACES, text))
    return Verdict((*reasons, *filter(None, map(doubt, cameras))))


def _rivalry(rival: Rival | None, min_lead_edges: float) -> list[Reason]:
    """Return a reason where another pose fits as well; leads of other units than edges have no bound."""
    if rival is None or rival.unit != "edges" or rival.lead >= min_lead_edges:
        return []
    away = f"{rival.rotation_deg:.2f} deg and {rival.translation_m:.2f} m away"
    text = f"another pose, {away}, fits as well but for {rival.lead:.1f} edges; take more frames together, or a nearer"
    return [Reason(Doubt.RIVAL_POSE, f"{text} start")]


def meeting(agreed: Agreement | None, options: PipelineOptions) -> list[Reason]:
    """Return a reason where edges meet little more often than by chance, or there are none to tell."""
    if agreed is None:
        text = "nothing could check that image and sweep meet at this pose: there are no edges of both sensors"
        return [Reason(Doubt.NOT_CHECKED, text)]
    if agreed.odds_ratio >= options.min_odds_ratio and agreed.strength >= options.min_strength:
        return []
    return [
        Reason(
            Doubt.LITTLE_AGREEMENT,
            f"image and LiDAR edges meet little more often than by chance, or in too few places (odds ratio "
            f"{agreed.odds_ratio:.1f} in {agreed.places} places, strength {agreed.strength:.1f}; "
            f"{options.min_odds_ratio:g} and {options.min_strength:g} or more are usual at a right pose); look at the "
            "overlay, check that image and sweep belong to the same moment, or take more frames together",
        )
    ]


def unsure(accuracy: Accuracy | None, options: PipelineOptions) -> list[Reason]:
    """Return a reason where one of twenty such results is further off than may be."""
    if accuracy is None or (
        accuracy.rotation_deg_95 <= options.most_deg and accuracy.translation_m_95 <= options.most_m
    ):
        return []
    may = f"{accuracy.rotation_deg_95:.2f} deg or {accuracy.translation_m_95:.2f} m"
    text = f"one of twenty such results is {may} off, or more; take more frames together"
    return [Reason(Doubt.TOO_UNSURE, text)]
