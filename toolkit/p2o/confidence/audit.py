"""Check a given extrinsic: estimate its local correction from edges alone, and test it against its predicted error."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TypeGuard

import numpy as np

from p2o.arrays import Bool, Float
from p2o.calibration.adjustment import Nuisance
from p2o.calibration.algorithm import Algorithm, missing_features
from p2o.calibration.interval_search import most_likely_pose
from p2o.calibration.judge import IntervalJudge, is_sparse
from p2o.calibration.nuisance import enough_pairs, motion_prior
from p2o.calibration.options import PipelineOptions
from p2o.calibration.rounds import REACH_AFTER_SEARCH_PX
from p2o.confidence.accuracy import DEFAULT_ERROR_MODEL, Z_67, ErrorBudget, ErrorModel, likely_covariance
from p2o.confidence.explanation import Explanation, explanations, single_axis_pose
from p2o.confidence.fusion import OWN_SHARE
from p2o.confidence.verdict import MIN_ODDS_RATIO, MIN_STRENGTH, little_agreement
from p2o.features.view import View
from p2o.geometry import se3
from p2o.geometry.pose_error import is_distinct, pose_error
from p2o.host.stages import Matcher
from p2o.problems.agreement import agreement_of
from p2o.problems.distinct_views import scenes_of, view_count, weighted
from p2o.problems.point_to_line import PointToLine
from p2o.problems.problem import Problem
from p2o.results.check import AxisCheck, Check, CheckStatus
from p2o.results.evidence import Agreement

REACH_PX = 15.0
"""Initial matching distance: an edge in KITTI's camera moves by 15 px for 1.2 deg; a search finds larger slips."""
_ROUNDS = 14
_STILL_PX = 0.05
_FARTHEST_DEG, _FARTHEST_M = 5.0, 1.0
_LEAST_VIEWS, _LEAST_DIFFERENT, _MANY_VIEWS = 4.0, 0.75, 12.0
"""Edges are intervals if there are 12 different views, or 4, and 75 % of the number of frames: if a static rig observes
the same few outlines, their position between two beams is a systematic error, which the scatter does not contain.
"""
_COMMON_DEG, _COMMON_M = 0.03, 0.006
"""Standard deviation of the error of an axis that all frames share (intrinsics, timing, outlines): more frames
do not lower it. The reference of a KITTI drive and the edges of its frames differ by 0.1 deg and 3 cm.
"""
_SPARSE_ERROR_MODEL = DEFAULT_ERROR_MODEL._replace(beams=1.1, rings=0.74)
"""Error model of edges in the middle between two distant beams: the default one was fitted without such sweeps."""
_TOO_FEW, _TOO_FAR = "too few pairs of edges are within reach", "edges converge far from the pose"
_NO_COVARIANCE = "edges meet in too few places to predict the error"
_AXES = np.array([2, 0, 1, 3, 4, 5])
"""Indices of roll, pitch, yaw, x, y, z in a vector of rotations about x, y, z and translations."""


@dataclass(frozen=True, eq=False)
class EdgeStep:
    """Estimate of the pose from edges, started from a given pose: `pose` (4, 4) is the estimate.

    `error` (6,) is the error of the given pose relative to the estimate: roll, pitch, yaw in deg and x, y, z in m
    (`p2o.geometry.pose_error`); `covariance` (6, 6) is its predicted covariance, in the same order and units.
    """

    pose: Float
    error: Float
    covariance: Float
    agreement: Agreement
    places: int

    @property
    def sigma(self) -> Float:
        """Return the standard deviations (6,) of the predicted errors."""
        return np.asarray(np.sqrt(np.diag(self.covariance)))


def edge_step(
    views: Sequence[View],
    camera_from_lidar: Float,
    matcher: Matcher,
    options: PipelineOptions,
    *,
    around: Float | None = None,
    reach_px: float = REACH_PX,
) -> EdgeStep | str:
    """Estimate the pose from edges, starting at a given pose (4, 4); return the reason as a string if this fails.

    Matching within a decreasing distance and solving alternate until the pose converges; the motion during raw sweeps
    is estimated with the pose. The given pose is the initial guess and no prior; `around` (4, 4) replaces it. Edges of
    sweeps whose rings are far apart are evaluated as intervals between beams if there are several different views.
    """
    pose = begin = camera_from_lidar if around is None else around
    raw = weighted([view.as_seen_from(begin).without_hidden(begin) for view in views], begin)
    cameras = tuple(view.camera for view in raw)
    nuisance = Nuisance.expected(raw, motion_prior(raw, options))
    sparse = is_sparse(raw, options.interval_deg)
    if sparse and _are_different(matcher(nuisance.views(raw), begin, reach_px), len(raw)):
        return _interval_step(raw, nuisance, camera_from_lidar, begin, matcher, options)
    reach = reach_px
    for _ in range(_ROUNDS):
        problem = matcher(nuisance.views(raw), pose, reach)
        if not _enough(problem, options):
            return _TOO_FEW
        fit = nuisance.fit(problem, cameras, pose, fits_cameras=False)
        pose, nuisance = fit.camera_from_lidar, nuisance.after(fit)
        if _is_far(begin, pose):
            return _TOO_FAR
        if fit.step_px < _STILL_PX and reach <= options.min_reach_px:
            break
        reach = max(options.min_reach_px, reach * options.shrink)
    corrected = nuisance.views(raw)
    problem = matcher(corrected, pose, options.min_reach_px)
    if not _enough(problem, options):
        return _TOO_FEW
    last = nuisance.fit(problem, cameras, pose, fits_cameras=options.camera != "trust")
    agreed = agreement_of(corrected, pose)
    if last.covariance is None or agreed is None:
        return _NO_COVARIANCE
    different = view_count(problem.xyz, problem.side, problem.frame)
    budget = ErrorBudget.of(last.covariance, problem, pose, different)
    model = _SPARSE_ERROR_MODEL if sparse else budget.model
    return _step(camera_from_lidar, pose, budget, model, agreed, last.places)


def _are_different(problem: Problem, frames: int) -> bool:
    """Return whether the pairs of frames are of enough different views for an evaluation as intervals."""
    if not isinstance(problem, PointToLine):
        return False
    least = min(max(_LEAST_VIEWS, _LEAST_DIFFERENT * frames), _MANY_VIEWS)
    return view_count(problem.xyz, problem.side, problem.frame) >= least


def _interval_step(
    raw: Sequence[View], nuisance: Nuisance, given: Float, begin: Float, matcher: Matcher, options: PipelineOptions
) -> EdgeStep | str:
    """Estimate the pose of the highest interval likelihood, by a search around `begin` (4, 4)."""
    corrected = nuisance.views(raw)
    pose = most_likely_pose(corrected, begin, [begin])
    problem = matcher(corrected, pose, options.min_reach_px)
    if not _enough(problem, options):
        return _TOO_FEW
    if nuisance.prior is not None:
        fit = nuisance.fit(problem, tuple(view.camera for view in raw), pose, fits_cameras=False)
        corrected = nuisance.after(fit).views(raw)
    judge = IntervalJudge.of(corrected, begin, [begin, pose])
    pose = judge.maximised(pose)
    if _is_far(begin, pose):
        return _TOO_FAR
    agreed = judge.agreement(corrected, pose)
    if not judge.likelihood.points or agreed is None:
        return _NO_COVARIANCE
    different = view_count(problem.xyz, problem.side, problem.frame)
    scenes = len(np.unique(scenes_of(raw)))
    covariance = judge.covariance(pose) * max(1.0, scenes / max(different, 1.0))
    budget = ErrorBudget.of_intervals(covariance, problem, pose, different)
    return _step(given, pose, budget, budget.model, agreed, agreed.places)


def _step(
    given: Float, pose: Float, budget: ErrorBudget, model: ErrorModel, agreed: Agreement, places: int
) -> EdgeStep | str:
    """Return the step from the estimate `pose` (4, 4) to the given pose (4, 4) with its predicted error."""
    likely = (model.axis / Z_67) ** 2 * likely_covariance(budget, pose, agreed, model)
    units = np.repeat([np.degrees(1.0), 1.0], 3)
    covariance = (units[:, None] * likely * units)[np.ix_(_AXES, _AXES)]
    common = np.diag(np.repeat([_COMMON_DEG, _COMMON_M], 3) ** 2)
    if not np.isfinite(covariance).all():
        return "a direction is unobservable"
    error = np.array(list(pose_error(given, pose).per_axis.values()))
    return EdgeStep(pose, error, covariance + common, agreed, places)


def _is_far(begin: Float, pose: Float) -> bool:
    step = se3.inverse(begin) @ pose
    return se3.angle_deg(step) > _FARTHEST_DEG or se3.distance_m(step) > _FARTHEST_M


def _enough(problem: Problem, options: PipelineOptions) -> TypeGuard[PointToLine]:
    return enough_pairs(problem) and len(problem) >= options.min_matches


AXES = (("roll", "deg"), ("pitch", "deg"), ("yaw", "deg"), ("x", "m"), ("y", "m"), ("z", "m"))
"""Camera axes and their units, in the order of errors."""


DEGREES, LEAD_EDGES = 20.0, 6.0
"""Degrees of freedom of Student's t, the distribution of errors relative to the predicted deviations, and the number of
edges that another pose, which a search also finds for a correct one, has to match more. Fitted to steps at correct
extrinsics on simulated frames and KITTI's `train` (`python benchmarks/audit.py`).
"""
_UNCONFIRMED = 0.05
"""Share of correct extrinsics with an axis that differs too much to be confirmed, and too little to be off."""
_MOST_EXPLAINING, _MOST_ALTERNATIVES = 3, 3
"""More axes than this explain nothing: each of them must be off separately; more alternatives are not named."""
_SEARCHED = 3
"""Frames used by the search: a few frames suffice to detect a slip of degrees, and many would take long."""


@dataclass(frozen=True)
class Rates:
    """Requirements of a check: error rates and the smallest error that it must detect.

    `alarm` is the false alarm rate for a correct extrinsic, `power` the detection rate of an error equal to a limit.
    """

    alarm: float = 0.01
    power: float = 0.95
    notice_deg: float = 1.0
    notice_m: float = 0.3

    @property
    def noticed(self) -> float:
        """Return the alarm threshold of one axis in standard deviations; the axes share half of the alarm rate."""
        return _t(1 - self.alarm / 2 / (2 * len(AXES)))

    @property
    def limit(self) -> float:
        """Return the error of one axis, in standard deviations, that is detected at the rate `power`."""
        return self.noticed + _t(self.power)

    @property
    def confirmed(self) -> float:
        """Return the largest deviation, in standard deviations, at which an axis is confirmed to hold."""
        return _t(1 - _UNCONFIRMED / (2 * len(AXES)))

    def joint(self, degrees: int) -> float:
        """Return the alarm threshold of a chi-square with these degrees of freedom: six for all axes."""
        from scipy.stats import f

        return float(degrees * f.ppf(1 - self.alarm / 2, degrees, DEGREES)) if degrees else 0.0


@dataclass(frozen=True, eq=False)
class Evidence:
    """Edge evidence on a given pose (4, 4): the local step `near`, or why there is none; and `far`, a step to the best
    other pose that a search finds, if any, which matches `lead_edges` more edges.
    """

    frames: tuple[str, ...]
    camera_from_lidar: Float
    near: EdgeStep | str
    far: EdgeStep | None = None
    lead_edges: float = 0.0

    @classmethod
    def of(
        cls, views: Sequence[View], camera_from_lidar: Float, algorithm: Algorithm, *, search: bool = True
    ) -> Evidence:
        """Evaluate the edges of prepared views at a given pose.

        The local step has no prior and starts at the given pose, or at the pose that an error of one axis explains
        clearly better (`single_axis_pose`); `search` enables a global search for a better pose.
        """
        given, names = se3.check_rigid("the extrinsic", camera_from_lidar), tuple(view.name for view in views)
        missing = missing_features(views, given, algorithm.needs)
        if missing is not None:
            return cls(names, given, missing[1])
        near = _near(views, given, algorithm)
        return cls(names, given, near, *(_searched(views, given, near, algorithm) if search else ()))

    @property
    def led_away(self) -> bool:
        """Whether edges match clearly better at another pose."""
        return self.far is not None and self.lead_edges >= LEAD_EDGES


def audit(evidence: Evidence, rates: Rates) -> Check:
    """Decide by the edge evidence whether a given pose is correct."""
    step = evidence.far if evidence.led_away and evidence.far is not None else evidence.near
    undecided = Check(
        frames=evidence.frames,
        camera_from_lidar=evidence.camera_from_lidar,
        holding=CheckStatus.CANNOT_TELL,
        reason=step if isinstance(step, str) else "",
        axes=tuple(AxisCheck(axis, unit, CheckStatus.CANNOT_TELL) for axis, unit in AXES),
        alarm_rate=rates.alarm,
        power=rates.power,
        notice_deg=rates.notice_deg,
        notice_m=rates.notice_m,
    )
    if isinstance(step, str):
        return undecided
    met = step.agreement
    if met.odds_ratio < MIN_ODDS_RATIO or met.strength < MIN_STRENGTH:
        text = little_agreement(met)
        return replace(undecided, reason=f"{text}; take more frames", agreement=met)
    return _decided(undecided, evidence.led_away, step, rates)


def _decided(undecided: Check, far: bool, step: EdgeStep, rates: Rates) -> Check:
    """Decide on each axis by the edge step; a share of its predicted variance is uncorrelated between axes."""
    notice = np.repeat([rates.notice_deg, rates.notice_m], 3)
    limit, off = rates.limit * step.sigma, np.abs(step.error) > rates.noticed * step.sigma
    covariance = (1 - OWN_SHARE) * step.covariance + OWN_SHARE * np.diag(np.diag(step.covariance))
    chi_square = float(step.error @ np.linalg.solve(covariance, step.error))
    possible: tuple[Explanation, ...] = ()
    if off.any() or far or chi_square > rates.joint(len(AXES)):
        possible = explanations(step.error, covariance, rates.joint, rates.noticed**2)
    named = set.union(set(), *(each.axes for each in possible))
    common = set.intersection(named, *(each.axes for each in possible))
    doubtful = np.abs(step.error) > rates.confirmed * step.sigma
    axes = []
    for number, (axis, unit) in enumerate(AXES):
        holding = CheckStatus.HOLDS
        if number in common and (len(common) <= _MOST_EXPLAINING or off[number]):
            holding = CheckStatus.OFF
        elif number in named or doubtful[number] or limit[number] > notice[number]:
            holding = CheckStatus.CANNOT_TELL
        figures = (float(values[number]) for values in (step.error, step.sigma, limit))
        axes.append(AxisCheck(axis, unit, holding, *figures))
    holding, reason = _in_all(axes, possible, far, doubtful)
    return replace(
        undecided,
        holding=holding,
        reason=reason,
        axes=tuple(axes),
        estimate=step.pose,
        far=far,
        chi_square=chi_square,
        p_value=p_value(chi_square),
        agreement=step.agreement,
    )


def _in_all(
    axes: Sequence[AxisCheck], possible: Sequence[Explanation], far: bool, doubtful: Bool
) -> tuple[CheckStatus, str]:
    """Return the status of all axes together, and the reason; `possible` are the explanations of an error, if any."""
    if possible:
        searched = ", and a search found that edges agree far better there" if far else ""
        if len(possible) > _MOST_ALTERNATIVES or not (
            len(possible) > 1 or any(a.holding is CheckStatus.OFF for a in axes)
        ):
            return CheckStatus.OFF, "off, on axes that cannot be distinguished on these frames" + searched
        amounts = [", ".join(map(_amount, each.axes, each.sizes.tolist())) for each in possible]
        which = ": not distinguishable on these frames" if len(possible) > 1 else ""
        return CheckStatus.OFF, "off by about " + " or ".join(amounts) + which + searched
    unclear = [a for a, is_doubtful in zip(axes, doubtful, strict=True) if is_doubtful]
    if unclear:
        text = ", ".join(f"{a.axis} differs by {abs((a.off or 0) / (a.sigma or 1)):.1f} sigma" for a in unclear)
        return CheckStatus.CANNOT_TELL, f"{text}, too much for holds and too little for off; take more frames"
    undecided = [a for a in axes if a.holding is CheckStatus.CANNOT_TELL]
    if undecided:
        names = ", ".join(a.axis for a in undecided)
        return CheckStatus.CANNOT_TELL, f"an error of {names} at the limit may not be detected; take more frames"
    return CheckStatus.HOLDS, "no axis is off by more than its limit"


def _amount(axis: int, size: float) -> str:
    """Format an error, in deg or m, of an axis of `AXES`."""
    name, unit = AXES[axis]
    return f"{name} {size:+.2f} deg" if unit == "deg" else f"{name} {100 * size:+.1f} cm"


def p_value(chi_square: float) -> float:
    """Return the probability that a correct extrinsic has at least this chi-square."""
    from scipy.stats import f

    return float(f.sf(chi_square / 6, 6, DEGREES))


def _near(views: Sequence[View], given: Float, algorithm: Algorithm) -> EdgeStep | str:
    """Return the step from the given pose (4, 4), or from a better one that differs from it on one axis."""
    matcher, options = algorithm.matcher, algorithm.options
    begin = single_axis_pose(algorithm.visible(_some(views), given).corrected, given) if algorithm.directed else given
    if begin is given:
        return edge_step(views, given, matcher, options)
    return edge_step(views, given, matcher, options, around=begin, reach_px=REACH_AFTER_SEARCH_PX)


def _some(views: Sequence[View]) -> list[View]:
    return [views[at] for at in np.unique(np.linspace(0, len(views) - 1, _SEARCHED).round().astype(int))]


def _searched(
    views: Sequence[View], given: Float, near: EdgeStep | str, algorithm: Algorithm
) -> tuple[EdgeStep | None, float]:
    """Search for the best other pose; return the step to it and by how many edges it matches more."""
    raw = [view.as_seen_from(given).without_hidden(given) for view in _some(views)]
    known = [given] if isinstance(near, str) else [given, near.pose]
    from_known = [se3.inverse(other) for other in known]
    poses = algorithm.initializer(raw, given)
    proposed = [pose for pose in poses if all(is_distinct(inverse @ pose) for inverse in from_known)]
    if not proposed:
        return None, 0.0
    options, judge = algorithm.options, algorithm.judge(raw, given, proposed)
    best = proposed[int(np.argmin(judge.costs(proposed)))]
    step = edge_step(views, given, algorithm.matcher, options, around=best, reach_px=REACH_AFTER_SEARCH_PX)
    if isinstance(step, str) or not all(is_distinct(inverse @ step.pose) for inverse in from_known):
        return None, 0.0
    *costs, cost = judge.costs([*known, step.pose])
    lead, unit = judge.lead(cost, min(costs))
    return (step, lead) if unit == "edges" else (None, 0.0)


def _t(share: float) -> float:
    from scipy.stats import t

    return float(t.ppf(share, DEGREES))
