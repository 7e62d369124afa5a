"""From the estimate of Algorithm 1 to a result: predicted errors, agreement, verdict."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from p2o.arrays import Float
from p2o.calibration.algorithm import Algorithm, Estimate, Refined
from p2o.calibration.options import PipelineOptions
from p2o.calibration.rounds import counts, mean_residuals_px
from p2o.confidence.accuracy import (
    MIN_LEAD_EDGES,
    ErrorBudget,
    ErrorModel,
    accuracy_of,
    fits_as_well,
    likely_accuracy,
    likely_covariance,
    or_rival,
    plus_known,
    predicted_covariance,
    with_start,
)
from p2o.confidence.verdict import (
    MIN_PLACES,
    accuracy_doubts,
    agreement_doubts,
    at_full_size,
    checks_of,
    rival_of,
    verdict_of,
)
from p2o.features.sets import CloudRemarks
from p2o.features.view import View
from p2o.geometry import se3
from p2o.geometry.pose_error import pose_error
from p2o.problems.agreement import agreement_of
from p2o.problems.distinct_views import scenes_of, view_count
from p2o.problems.normal_equations import own_covariance
from p2o.problems.pairing import edge_pairs
from p2o.results.evidence import Accuracy, Agreement, Judged, StartWeight
from p2o.results.result import Result, Round, Status
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
    final, start, end, judge = estimate.final, estimate.refined.start, estimate.final.end, estimate.refined.judge
    # Where the camera was corrected, other poses that fit the given camera better are no rivals.
    best = (end, final.judge) if final.cameras_corrected else (estimate.refined.best, judge)
    rival = rival_of([*estimate.refined.solved, *estimate.refined.rivals], *best)
    judged = judged_of(estimate, end.pose)
    if not judged.estimate < judged.start:
        return replace(refused(views, start, Status.NO_IMPROVEMENT, _no_improvement(judged), end.rounds), judged=judged)
    agreement = judge.agreement(estimate.views, end.pose)
    scatter = None if agreement is None else _Scatter.of(estimate, agreement, options)
    pose, accuracy, limited, weight, warnings = end.pose, None, None, None, remarks_of(views)
    covariance = final.covariance
    if covariance is None and end.solution is not None:
        covariance = end.solution.covariance
    if agreement is not None and scatter is not None and scatter.budget is not None:
        budget = scatter.budget
        warnings = (*warnings, *standing_still(budget.views, len(views)))
        likely = by_edges = likely_covariance(budget, pose, agreement)
        accuracy = likely_accuracy(budget, pose, agreement)
        weighted = _with_prior(estimate, likely, budget.model, accuracy, start_sigma)
        if weighted is not None:
            pose, likely, judged, weight = weighted
            accuracy = accuracy_of(likely, budget.model)
        narrow = accuracy
        if not final.cameras_corrected:
            rivals = _rival_covariance(estimate.refined)
            if weight is not None:
                by_edges = plus_known(by_edges, rivals, weight.camera_from_lidar, budget.model)
                weight = replace(weight, accuracy=accuracy_of(by_edges, budget.model))
            likely = plus_known(likely, rivals, pose, budget.model)
            accuracy = accuracy_of(likely, budget.model)
        # A pose that fits as well is a reason for doubt of its own.
        limited = narrow if rival is not None and fits_as_well(rival) else accuracy
        covariance = predicted_covariance(likely, pose, budget.model)
    cameras = checks_of(final, [view.camera for view in views])
    left_box = None if estimate.refined.within(pose) else estimate.refined.box
    places = {} if scatter is None else {"places": scatter.cells, "min_places": scatter.min_cells}
    return Result(
        frames=tuple(view.name for view in views),
        start=start,
        camera_from_lidar=pose,
        status=end.status,
        reason=end.reason,
        rounds=end.rounds,
        covariance=covariance,
        accuracy=None if accuracy is None else or_rival(accuracy, rival),
        matches={} if end.pairs is None else counts(end.pairs),
        residual_px={} if end.pairs is None else mean_residuals_px(end.pairs, pose),
        judged=judged,
        agreement=agreement,
        rival=rival,
        verdict=verdict_of(agreement, rival, cameras, options, limited, box=left_box, **places),
        cameras=at_full_size(cameras, views),
        motions=final.nuisance.sweep_motions(views),
        time=final.time,
        start_weight=weight,
        warnings=warnings,
    )


@dataclass(frozen=True)
class _Scatter:
    """The error budget of an estimate, None without a scatter, and the number of image cells that it uses."""

    budget: ErrorBudget | None
    cells: int
    min_cells: int

    @classmethod
    def of(cls, estimate: Estimate, agreement: Agreement, options: PipelineOptions) -> _Scatter | None:
        """Return the scatter by the judge, else by the pairs, else by the residuals or the cost of the matcher.

        None where none of them has one. Systematic errors by the beam spacing are those of the edges that pair at the
        pose.
        """
        final, end, judge = estimate.final, estimate.final.end, estimate.final.judge
        pairs = edge_pairs(estimate.views, end.pose, options.min_reach_px) if end.pairs is None else end.pairs
        scenes = len(np.unique(scenes_of(estimate.views)))
        # What moves in a scene makes edges of other views, and leaves the errors of the scene as they are.
        different = min(view_count(pairs.xyz, pairs.side, pairs.frame), scenes) if len(pairs) else 1.0
        by_judge, cells, min_cells = judge.covariance(end.pose), agreement.places, judge.min_cells
        if by_judge is not None:
            budget = ErrorBudget.of_intervals(by_judge * scenes / max(different, 1.0), pairs, end.pose, different)
        elif end.pairs is not None:
            cells, min_cells = final.places, MIN_PLACES
            if final.covariance is None:
                return cls(None, cells, min_cells)
            budget = ErrorBudget.of(final.covariance, pairs, end.pose, different)
        else:
            own = None if end.problem is None else own_covariance(end.problem, end.pose, agreement.places)
            if own is None:
                return None
            budget = ErrorBudget.of(own, pairs, end.pose, different)
        if final.intrinsics is not None:
            budget = replace(budget, cameras=final.intrinsics.covariance, absorbed=final.intrinsics.absorbed)
        return cls(budget, cells, min_cells)


def _rival_covariance(refined: Refined) -> Float:
    """Return the covariance (6, 6) of a left update by poses of about the same cost as the best one.

    Which of them has the lowest cost depends on the noise of the edges, and on the seed of the search. A pose that
    loses L edges has the probability exp(-L) of the best one; poses that lose `MIN_LEAD_EDGES` or more are left out.
    """
    ends = [end for end in (*refined.solved, *refined.rivals) if end.status.solved and end is not refined.best]
    cost_of_best, *costs = refined.judge.costs([refined.best.pose, *(end.pose for end in ends)])
    total, probability = np.zeros((6, 6)), 1.0
    for end, cost in zip(ends, costs, strict=True):
        lead, unit = refined.judge.lead(cost_of_best, cost)
        if unit == "edges" and lead < MIN_LEAD_EDGES:
            step = se3.log(end.pose @ se3.inverse(refined.best.pose))
            share = float(np.exp(-max(lead, 0.0)))
            total, probability = total + share * np.outer(step, step), probability + share
    return total / probability


_FEW = 0.5
"""Share of distinct views among the frames below which the user is warned."""


def standing_still(views: float, frames: int) -> tuple[str, ...]:
    """Return a warning if `frames` frames contain few distinct views, else an empty tuple."""
    if frames < 2 or views >= _FEW * frames:
        return ()
    text = f"{frames} frames show about {views:.1f} different views, and count as that number: the rig was static"
    return (f"{text}; frames of other places make the result surer, more of these do not",)


def refused(views: Sequence[View], start: Float, status: Status, reason: str, rounds: tuple[Round, ...] = ()) -> Result:
    """Return the result of a calibration without an estimate: its pose is the initial extrinsic (4, 4)."""
    names = tuple(view.name for view in views)
    return Result(names, start, start, status, reason, rounds, warnings=remarks_of(views))


def judged_of(estimate: Estimate, pose: Float) -> Judged:
    """Return the costs of the initial extrinsic and of a pose (4, 4), on the same points."""
    judge = estimate.refined.judge
    return Judged(judge.name, judge.unit, *estimate.final.judge.costs([estimate.refined.start, pose]))


def remarks_of(views: Sequence[View]) -> tuple[str, ...]:
    """Return the remarks of the cloud extractors on the sweeps, each with the name of its frame."""
    remarks = ((view.name, view.get(CloudRemarks.word)) for view in views)
    return tuple(f"{name}: {text}" for name, remark in remarks if remark is not None for text in remark.texts)


def _with_prior(
    estimate: Estimate, likely: Float, model: ErrorModel, accuracy: Accuracy, start_sigma: StartSigma | None
) -> tuple[Float, Float, Judged, StartWeight] | None:
    """Return pose, covariance, costs and weight with the initial extrinsic as a prior, None if it is no valid prior.

    `likely` (6, 6) and `accuracy` are those without it.
    """
    if start_sigma is None:
        return None
    pose = estimate.final.end.pose
    mean = with_start(pose, likely, estimate.refined.start, start_sigma, model)
    if mean is None:
        return None
    judged = judged_of(estimate, mean[0])
    if not judged.estimate < judged.start:
        return None
    step = se3.inverse(pose) @ mean[0]
    return *mean, judged, StartWeight(*start_sigma, pose, accuracy, se3.angle_deg(step), se3.distance_m(step))


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
    0.3 deg or 0.1 m. The agreement of the method's own edges, if any, is replaced together with the doubts that follow
    from it. Results that are not solved, and those with an own agreement where `views` have no edges, are unchanged.
    """
    if not result.status.solved:
        return result
    pose = result.camera_from_lidar
    agreement = agreement_of([view.as_seen_from(pose).without_hidden(pose) for view in views], pose)
    if agreement is None and result.agreement is not None:
        return result
    replaced = (Doubt.NOT_CHECKED, Doubt.LITTLE_AGREEMENT)
    reasons = tuple(reason for reason in result.verdict.reasons if reason.doubt not in replaced)
    known = {reason.doubt for reason in reasons}
    own = [reason for reason in accuracy_doubts(result.accuracy, options) if reason.doubt not in known]
    verdict = Verdict((*reasons, *agreement_doubts(agreement), *own))
    if verdict.trusted and algorithm is not None:
        verdict = Verdict((*verdict.reasons, *_position_doubts(result, views, algorithm)))
    return replace(result, agreement=agreement, verdict=verdict)


def _position_doubts(result: Result, views: Sequence[View], algorithm: Algorithm) -> list[Reason]:
    """Return a reason for doubt where edges ask for a large and significant correction of the pose."""
    from p2o.confidence.audit import Evidence, Rates, audit
    from p2o.results.check import CheckStatus

    check = audit(Evidence.of(views, result.camera_from_lidar, algorithm), Rates())
    if check.holding is not CheckStatus.OFF or check.estimate is None:
        return []
    step = pose_error(result.camera_from_lidar, check.estimate)
    if step.rotation_deg <= _LITTLE_DEG and step.translation_m <= _LITTLE_M:
        return []
    distance = f"{step.rotation_deg:.2f} deg and {step.translation_m:.2f} m"
    text = f"edges of the independent check put the pose at a distance of {distance}: the result is {check.reason}"
    return [Reason(Doubt.LED_AWAY, text)]
