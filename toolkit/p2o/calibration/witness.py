"""The verdict on a result that its method could not check, from edges that had no part in it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from p2o.calibration.audit import Evidence, Rates, audit
from p2o.calibration.options import PipelineOptions
from p2o.calibration.pipeline import Pipeline
from p2o.calibration.verdict import agreement_of, meeting, unsure
from p2o.features.view import View
from p2o.geometry.pose_error import pose_error
from p2o.results.check import Holding
from p2o.results.result import Result
from p2o.results.verdict import Doubt, Reason, Verdict

_LITTLE_DEG, _LITTLE_M = 0.3, 0.1
"""Edges may move a pose by this without its being doubtful: good results of other methods are that far off."""


def witnessed(
    result: Result, views: Sequence[View], options: PipelineOptions, pipeline: Pipeline | None = None
) -> Result:
    """Return a result that its method could not check, with the agreement of the edges of `views` at its pose.

    It is doubtful, too, where its method's own likely error says that it may be far off; and where the edges, by the
    stages of `pipeline`, would move its pose by more than they are likely to be wrong (`p2o.calibration.audit`) and by
    more than 0.3 deg or 0.1 m. The views are those of extractors that had no part in the calibration: what
    a network or a hand-eye method claims is held against edges. Results that are not solved, or have an agreement, are
    returned as they are.
    """
    if not result.status.solved or result.agreement is not None:
        return result
    seen = [view.as_seen_from(result.camera_from_lidar).without_hidden(result.camera_from_lidar) for view in views]
    agreed = agreement_of(seen, result.camera_from_lidar)
    kept = tuple(reason for reason in result.verdict.reasons if reason.doubt is not Doubt.NOT_CHECKED)
    said = {reason.doubt for reason in kept}
    own = [reason for reason in unsure(result.accuracy, options) if reason.doubt not in said]
    verdict = Verdict((*kept, *meeting(agreed, options), *own))
    if verdict.trusted and pipeline is not None:
        verdict = Verdict((*verdict.reasons, *_led_away(result, views, pipeline)))
    return replace(result, agreement=agreed, verdict=verdict)


def _led_away(result: Result, views: Sequence[View], pipeline: Pipeline) -> list[Reason]:
    """Return a reason where edges lead to another pose than that of a result, and not only a little way."""
    found = audit(Evidence.of(views, result.camera_from_lidar, pipeline), pipeline.options, Rates())
    if found.holding is not Holding.OFF or found.found is None:
        return []
    step = pose_error(result.camera_from_lidar, found.found)
    if step.rotation_deg <= _LITTLE_DEG and step.translation_m <= _LITTLE_M:
        return []
    there = f"{step.rotation_deg:.2f} deg and {step.translation_m:.2f} m from here"
    text = f"edges that had no part in it put the pose {there}: it is {found.reason}"
    return [Reason(Doubt.LED_AWAY, text)]
