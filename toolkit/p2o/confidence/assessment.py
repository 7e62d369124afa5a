"""From the estimate of Algorithm 1 to a result: predicted errors, agreement, verdict."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from p2o.arrays import Float
from p2o.calibration.algorithm import Algorithm, Estimate
from p2o.calibration.judge import IntervalJudge
from p2o.calibration.options import PipelineOptions
from p2o.calibration.rounds import counts, mean_residuals_px
from p2o.confidence.accuracy import (
    ErrorBudget,
    accuracy_of,
    likely_accuracy,
    likely_covariance,
    or_other_cameras,
    or_rival,
    with_start,
)
from p2o.confidence.agreement import standing_still, view_count
from p2o.confidence.audit import Evidence, Rates, audit
from p2o.confidence.verdict import (
    MIN_INTERVAL_PLACES,
    MIN_PLACES,
    accuracy_doubts,
    agreement_doubts,
    agreement_of,
    at_full_size,
    checks_of,
    rival_of,
    verdict_of,
)
from p2o.features.sets import CloudRemarks
from p2o.features.view import View
from p2o.geometry import se3
from p2o.geometry.pose_error import pose_error
from p2o.results.check import CheckStatus
from p2o.results.evidence import Accuracy, Agreement, Judged, StartWeight
from p2o.results.result import DIRECTED, INTERVALS, Result, Round, Status
from p2o.results.verdict import Doubt, Reason, Verdict

StartSigma = tuple[float, float]
"""Standard deviation of an initial extrinsic about (deg) and along (m) each axis."""


def assess(
    estimate: Estimate, views: Sequence[View], options: PipelineOptions, start_sigma: StartSigma | None
) -> Result:
    """Return the result of an estimate from prepared views.

    The initial extrinsic is used as a prior where its standard deviation `start_sigma` is known. An estimate that does
    not cost less than the initial extrinsic is refused.
    """
    final, start, end, judge = estimate.final, estimate.start, estimate.final.end, estimate.refined.judge
    # Where the camera was corrected, other poses that fit the given camera better are no rivals.
    best = (end, final.judge) if final.cameras_corrected else (estimate.refined.best, judge)
    rival = rival_of([*estimate.refined.solved, *estimate.refined.rivals], *best)
    judged = judged_of(estimate, end.pose)
    if not judged.estimate < judged.start:
        return replace(refused(views, start, Status.NO_IMPROVEMENT, _no_improvement(judged), end.rounds), judged=judged)
    agreement = agreement_of(estimate.views, end.pose, intervals=isinstance(judge, IntervalJudge))
    places, min_places = None if judge.name not in (DIRECTED, INTERVALS) else final.places, MIN_PLACES
    pose, accuracy, weight, warnings = end.pose, None, None, remarks_of(views)
    if final.covariance is not None and agreement is not None and end.problem is not None:
        different = view_count(end.problem.xyz, end.problem.side, end.problem.frame)
        warnings = (*warnings, *standing_still(different, len(views)))
        budget = ErrorBudget.of(final.covariance, end.problem, end.pose, different)
        if isinstance(final.judge, IntervalJudge):
            places, min_places = agreement.places, MIN_INTERVAL_PLACES
            by_intervals = final.judge.likelihood.covariance(end.pose)
            budget = ErrorBudget.of_intervals(by_intervals * len(views) / max(different, 1.0), different)
        if final.intrinsics is not None:
            budget = replace(budget, cameras=final.intrinsics.covariance)
        accuracy = likely_accuracy(budget, end.pose, agreement)
        weighted = _with_prior(estimate, budget, agreement, accuracy, start_sigma)
        if weighted is not None:
            pose, accuracy, judged, weight = weighted
    covariance = final.covariance
    if covariance is None and end.solution is not None:
        covariance = end.solution.covariance
    cameras = checks_of(final, [view.camera for view in views])
    left_box = None if estimate.refined.within(pose) else estimate.refined.box
    if accuracy is not None:
        accuracy = or_other_cameras(accuracy, pose, final.intrinsics)
    return Result(
        frames=tuple(view.name for view in views),
        start=start,
        camera_from_lidar=pose,
        status=end.status,
        reason=end.reason,
        rounds=end.rounds,
        covariance=covariance,
        accuracy=None if accuracy is None else or_rival(accuracy, rival, options.min_lead_edges),
        matches={} if end.problem is None else counts(end.problem),
        residual_px={} if end.problem is None else mean_residuals_px(end.problem, pose),
        judged=judged,
        agreement=agreement,
        rival=rival,
        verdict=verdict_of(
            agreement, rival, cameras, options, accuracy, places=places, min_places=min_places, box=left_box
        ),
        cameras=at_full_size(cameras, views),
        motions=final.nuisance.sweep_motions(views),
        time=final.time,
        start_weight=weight,
        warnings=warnings,
    )


def refused(views: Sequence[View], start: Float, status: Status, reason: str, rounds: tuple[Round, ...] = ()) -> Result:
    """Return the result of a calibration without an estimate: its pose is the initial extrinsic (4, 4)."""
    names = tuple(view.name for view in views)
    return Result(names, start, start, status, reason, rounds, warnings=remarks_of(views))


def judged_of(estimate: Estimate, pose: Float) -> Judged:
    """Return the costs of the initial extrinsic and of a pose (4, 4), on the same points."""
    judge = estimate.refined.judge
    return Judged(judge.name, judge.unit, *estimate.final.judge.costs([estimate.start, pose]))


def remarks_of(views: Sequence[View]) -> tuple[str, ...]:
    """Return the remarks of the cloud extractors on the sweeps, each with the name of its frame."""
    remarks = ((view.name, view.get(CloudRemarks.word)) for view in views)
    return tuple(f"{name}: {text}" for name, its in remarks if its is not None for text in its.texts)


def _with_prior(
    estimate: Estimate, budget: ErrorBudget, agreement: Agreement, accuracy: Accuracy, start_sigma: StartSigma | None
) -> tuple[Float, Accuracy, Judged, StartWeight] | None:
    """Return pose, accuracy, costs and weight with the initial extrinsic as a prior, None if it is no valid prior."""
    if start_sigma is None:
        return None
    pose = estimate.final.end.pose
    likely = likely_covariance(budget, pose, agreement.odds_ratio)
    mean = with_start(pose, likely, estimate.start, start_sigma, budget.model)
    if mean is None:
        return None
    judged = judged_of(estimate, mean[0])
    if not judged.estimate < judged.start:
        return None
    step = se3.inverse(pose) @ mean[0]
    weight = StartWeight(*start_sigma, pose, accuracy, se3.angle_deg(step), se3.distance_m(step))
    return mean[0], accuracy_of(mean[1], agreement, budget.model), judged, weight


def _no_improvement(judged: Judged) -> str:
    what = "the directed edge distance" if judged.unit == "px" else "the cost"
    unit = f" {judged.unit}" if judged.unit == "px" else ""
    costs = f"({judged.estimate:.3f}{unit} against {judged.start:.3f}{unit})"
    return f"{what} did not fall below that of the initial guess {costs}, which is returned"


_LITTLE_DEG, _LITTLE_M = 0.3, 0.1
"""Errors of good results of other methods: edges may ask for such a correction without making a result doubtful."""


def witnessed(
    result: Result, views: Sequence[View], options: PipelineOptions, algorithm: Algorithm | None = None
) -> Result:
    """Return a result with the agreement of the edges of `views` at its pose, and the verdict that follows.

    The views are those of extractors that had no part in the calibration. The result is doubtful also if its method
    predicts a large error, or if the edges, by the stages of `algorithm`, ask for a significant correction of more than
    0.3 deg or 0.1 m. Results that are not solved, or already have an agreement, are returned unchanged.
    """
    if not result.status.solved or result.agreement is not None:
        return result
    pose = result.camera_from_lidar
    agreement = agreement_of([view.as_seen_from(pose).without_hidden(pose) for view in views], pose)
    kept = tuple(reason for reason in result.verdict.reasons if reason.doubt is not Doubt.NOT_CHECKED)
    known = {reason.doubt for reason in kept}
    own = [reason for reason in accuracy_doubts(result.accuracy, options) if reason.doubt not in known]
    verdict = Verdict((*kept, *agreement_doubts(agreement, options), *own))
    if verdict.trusted and algorithm is not None:
        verdict = Verdict((*verdict.reasons, *_position_doubts(result, views, algorithm)))
    return replace(result, agreement=agreement, verdict=verdict)


def _position_doubts(result: Result, views: Sequence[View], algorithm: Algorithm) -> list[Reason]:
    """Return a reason for doubt where edges ask for a large and significant correction of the pose."""
    check = audit(Evidence.of(views, result.camera_from_lidar, algorithm), algorithm.options, Rates())
    if check.holding is not CheckStatus.OFF or check.estimate is None:
        return []
    step = pose_error(result.camera_from_lidar, check.estimate)
    if step.rotation_deg <= _LITTLE_DEG and step.translation_m <= _LITTLE_M:
        return []
    distance = f"{step.rotation_deg:.2f} deg and {step.translation_m:.2f} m"
    text = f"edges of the independent check put the pose at a distance of {distance}: the result is {check.reason}"
    return [Reason(Doubt.LED_AWAY, text)]
