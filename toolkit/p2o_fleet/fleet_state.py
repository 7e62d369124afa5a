"""The state of every extrinsic of a fleet, alarms with proposals, and systematic errors of vehicle types."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import StrEnum
from itertools import groupby
from typing import Any

import numpy as np
from p2o.arrays import Float
from p2o.confidence.audit import AXES, Rates
from p2o.confidence.explanation import corrected, explanations
from p2o.errors import InputError, P2OError
from p2o.geometry.perturb import parse_accuracy
from p2o_study.parallel import Workers

from p2o_fleet.checks import Checks
from p2o_fleet.evidence import Verdict
from p2o_fleet.noise import PairNoise, Samples, estimate_noise, sampled
from p2o_fleet.segments import Extrinsic, Pair, segments_of
from p2o_fleet.statistics import MeanError, conditional, discoveries, e_process, mean_error, onset, systematic
from p2o_fleet.store import Store

_RECENT = 5
"""Number of last checks of which one must have an estimate, or else the state is unknown."""
_MEAN_OF = 30
"""Number of last checks whose mean is the present error of an extrinsic without alarm."""
_PER_JOB = 20
"""Number of vehicles that a worker evaluates at a time."""
_LEAST_PART = 4.0
"""Smallest decrease of chi-square by an axis that explains an error, as in a check."""
_MIN_VEHICLES = 5
"""Minimum number of vehicles of one type for a systematic error."""
_SIGNIFICANT, _MIN_AFTER = 3.8, 2
"""Significant changes in deviations (99.9 % over six axes), and the minimum number of estimates after a change."""
_DAY_S = 86400.0
"""Tolerance of the clocks of vehicles."""
_HISTORY = 240
"""Maximum number of checks in the history of an extrinsic."""
_AXIS = {name: number for number, (name, _) in enumerate(AXES)}


class FleetStatus(StrEnum):
    """State of an extrinsic in use: SLIPPED changed at some time, WRONG was wrong from the first check on."""

    HOLDS = "holds"
    SLIPPED = "slipped"
    WRONG = "wrong"
    CANNOT_TELL = "cannot-tell"


@dataclass(frozen=True)
class FleetRules:
    """Requirements of the report on a fleet.

    `rate` is the false discovery rate of alarms. `tolerance` is the constant error that counts as correct,
    `type_tolerance` that of the mean of a vehicle type; `notice` is the error that must be observable, or else the
    state is unknown.
    """

    rate: float = 0.01
    tolerance: str = "0.2deg 3cm"
    type_tolerance: str = "0.03deg 1cm"
    notice: str = "0.5deg 5cm"

    def __post_init__(self) -> None:
        if not 0 < self.rate < 1:
            expected = "a share between 0 and 1"
            raise InputError("the false discovery rate is out of bounds", expected=expected, got=self.rate)
        for name in ("tolerance", "type_tolerance", "notice"):
            if (least := self.sizes(name).min()) <= 0:
                raise InputError(f"{name} is out of bounds", expected="more than zero, such as 0.1deg 2cm", got=least)

    def sizes(self, name: str) -> Float:
        """Return a size of the rules by axis (6,), in deg and m."""
        size = parse_accuracy(getattr(self, name), f"--{name.replace('_', '-')}")
        return np.repeat([size.angle_deg, size.distance_m], 3)


@dataclass(frozen=True)
class AxisError:
    """The error of one axis, in `unit`, with its 95 % interval (`low`, `high`)."""

    axis: str
    unit: str
    size: float
    low: float
    high: float


@dataclass(frozen=True, eq=False)
class Alarm:
    """An error of an extrinsic in use: axes, size, onset, and a proposal.

    `axes` are the fewest axes that explain the evidence; `alternatives` are other explanations that these checks cannot
    distinguish. The error began between `since_first` and `since_last` (95 %), most likely at `since` (s since 1970),
    and is the change since then if it began after the first check. `proposal` (4, 4) is the extrinsic without it,
    `present` the mean of all errors since then.
    `systematic` states that the vehicles of this type have the same error. `proof` are logs that show it.
    """

    axes: tuple[AxisError, ...]
    alternatives: tuple[tuple[AxisError, ...], ...]
    since: float
    since_first: float
    since_last: float
    proposal: Float
    checks: int
    frames: int
    proof: tuple[str, ...]
    present: MeanError
    systematic: bool = False


@dataclass(frozen=True, eq=False)
class History:
    """Checks of an extrinsic in order of time, at most 240 of them (N,), evenly spaced.

    `error` and `sigma` (N, 6) are errors and their deviations, NaN without an estimate; `log_e` (N,) is the log e-value
    after each check.
    """

    time: Float
    error: Float
    sigma: Float
    log_e: Float


@dataclass(frozen=True, kw_only=True, eq=False)
class ExtrinsicState(Extrinsic):
    """The state of one extrinsic of one vehicle, between two services, over all its checks.

    `current` is whether it is in use.
    """

    first: float
    last: float
    checks: int
    usable: int
    unreadable: int
    frames: int
    status: FleetStatus
    reason: str
    mean: MeanError | None
    alarm: Alarm | None
    history: History
    current: bool = False

    @property
    def total_log_e(self) -> float:
        """Return the log e-value of the whole extrinsic: the mean over the axes."""
        return float(self.history.log_e[-1])


@dataclass(frozen=True)
class TypeState:
    """Vehicles of one type with one pair of sensors: mean errors with intervals, `alarms` by axis, noise and trends.

    `noise_scale` (6) are the factors of predicted deviations. `trends` are texts of significant slopes.
    """

    vehicle_type: str
    camera: str
    lidar: str
    vehicles: int
    errors: tuple[AxisError, ...]
    alarms: tuple[AxisError, ...]
    log_e: tuple[float, ...]
    noise_scale: tuple[float, ...]
    trends: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class FleetState:
    """The state of a fleet: all extrinsics and types.

    `remarks` are checks, files and lines that were set aside, with the reason.
    """

    rules: FleetRules
    extrinsics: tuple[ExtrinsicState, ...]
    types: tuple[TypeState, ...]
    remarks: tuple[str, ...] = ()

    @property
    def checks(self) -> int:
        """Return the number of all checks."""
        return sum(state.checks for state in self.extrinsics)

    @property
    def until(self) -> float:
        """Return the time of the last check."""
        return max((state.last for state in self.extrinsics), default=0.0)

    @property
    def alarms(self) -> tuple[ExtrinsicState, ...]:
        """Return the extrinsics in use with an alarm, the strongest evidence first."""
        own = [state for state in self.extrinsics if state.alarm is not None and state.current]
        return tuple(sorted(own, key=lambda state: -state.total_log_e))

    @property
    def current(self) -> tuple[ExtrinsicState, ...]:
        """Return the extrinsics in use: that of each vehicle and pair of sensors with an alarm, or else the last."""
        return tuple(state for state in self.extrinsics if state.current)


def fleet_state(
    store: Store, rules: FleetRules | None = None, workers: Workers | None = None, now: float | None = None
) -> FleetState:
    """Compute the state of a fleet from its stored evidence; each worker has one vehicle at a time in memory.

    Times after `now` (s since 1970; default: a day from now) are errors of a clock. Raises InputError if nothing of the
    store can be read.
    """
    rules, now = rules or FleetRules(), time.time() + _DAY_S if now is None else now
    names = store.vehicles()
    jobs = [_VehiclesJob(store, names[n : n + _PER_JOB], rules, now) for n in range(0, len(names), _PER_JOB)]
    with (workers or Workers()).start() as run:
        with contextlib.closing(run(_sampled, jobs, _lost)) as samples:
            noise = estimate_noise(samples)
        jobs = [replace(job, noise=noise) for job in jobs]
        with contextlib.closing(run(_evaluated, jobs, _lost)) as results:
            every = sorted((one for own in results for one in own), key=lambda one: one[0])
    remarks = tuple(dict.fromkeys(text for _, _, texts in every for text in texts))
    states = _in_use(_with_alarms([state for _, own, _ in every for state in own], rules))
    if remarks and not states:
        raise InputError("no evidence of the store can be read", where=store.root, got=remarks[0])
    types = _types(states, noise, rules)
    states = [_attributed(state, types) for state in states]
    return FleetState(rules, tuple(states), types, remarks)


@dataclass(frozen=True, eq=False)
class _VehiclesJob:
    """Vehicles whose checks a worker evaluates, with the noise of their types once it is known."""

    store: Store
    vehicles: Sequence[str]
    rules: FleetRules
    now: float
    noise: Mapping[Pair, PairNoise] = field(default_factory=dict)


def _sampled(job: _VehiclesJob) -> Samples:
    return sampled(job.store, job.vehicles, job.now)


def _evaluated(job: _VehiclesJob) -> list[tuple[str, list[ExtrinsicState], list[str]]]:
    """Return states of each vehicle, each with the alarm that it has if its evidence is a discovery, and remarks."""
    out = []
    for checks in job.store.checks(job.vehicles):
        segments = list(segments_of(checks, job.now))
        remarks = list(checks.damaged)
        if future := int((checks.time > job.now).sum()):
            remarks.append(f"{checks.vehicle}: {future} checks have times in the future")
        if aside := len(checks) - sum(len(own) for _, own in segments):
            text = "have another extrinsic or service than those before: it counts from a second one on"
            remarks.append(f"{checks.vehicle}: {aside} single checks {text}")
        states = [_state(one, own, job.noise.get(one.pair, PairNoise()), job.rules, job.now) for one, own in segments]
        out.append((checks.vehicle, states, remarks))
    return out


def _lost(job: _VehiclesJob, problem: P2OError) -> Any:
    """Raise the problem of a worker that died: a report without one vehicle would be wrong."""
    raise problem


def _state(extrinsic: Extrinsic, checks: Checks, noise: PairNoise, rules: FleetRules, now: float) -> ExtrinsicState:
    """Return the state of an extrinsic before the false discovery rate of the fleet is known."""
    own = checks.take(np.flatnonzero(checks.usable))
    error, covariance = noise.without_trend(own), noise.covariance_of(own)
    logs = np.concatenate([np.zeros((1, len(AXES))), e_process(error, covariance, rules.sizes("tolerance"))])
    texts, recent = checks.texts, checks.usable[-_RECENT:]
    state = ExtrinsicState(
        **vars(extrinsic),
        first=float(checks.time[0]),
        last=float(checks.time[max(0, int((checks.time <= now).sum()) - 1)]),
        checks=len(checks),
        usable=len(own),
        unreadable=int((texts["verdict"] == Verdict.UNREADABLE.value).sum()),
        frames=int(checks.frame_count.sum()),
        status=FleetStatus.CANNOT_TELL,
        reason="" if recent.any() else f"no estimate in the last {len(recent)} checks: {texts['reason'][-1]}",
        mean=mean_error(error[-_MEAN_OF:], covariance[-_MEAN_OF:]) if len(own) else None,
        alarm=None,
        history=_history(checks, error, covariance, logs),
    )
    posed = np.flatnonzero(np.isfinite(checks.pose).all(axis=(1, 2)))
    # No e-value below 1 / rate is a discovery, whatever the others are.
    if not len(posed) or state.total_log_e < -np.log(rules.rate):
        return state
    alarm = _alarm(int(logs[-1].argmax()), own, error, covariance, checks.pose[posed[-1]], rules)
    status = FleetStatus.WRONG if alarm.since <= own.time[0] else FleetStatus.SLIPPED
    return replace(state, alarm=alarm, status=status)


def _history(checks: Checks, error: Float, covariance: Float, logs: Float) -> History:
    """Return the history of checks, of the errors (T, 6) of the usable ones, and of their log e-process (T + 1, 6)."""
    errors, sigmas = np.full((2, len(checks), len(AXES)), np.nan)
    errors[checks.usable], sigmas[checks.usable] = error, np.sqrt(np.einsum("tii->ti", covariance))
    total = np.logaddexp.reduce(logs[np.cumsum(checks.usable)], axis=1) - np.log(len(AXES))
    shown = np.unique(np.linspace(0, len(checks) - 1, min(len(checks), _HISTORY)).round().astype(int))
    return History(checks.time[shown], errors[shown], sigmas[shown], total[shown])


def _with_alarms(candidates: Sequence[ExtrinsicState], rules: FleetRules) -> list[ExtrinsicState]:
    """Return the states with the alarms that the false discovery rate of the rules permits."""
    rejected = discoveries(np.array([one.total_log_e for one in candidates]), rules.rate)
    notice = rules.sizes("notice")
    states = []
    for state, alarmed in zip(candidates, rejected.tolist(), strict=True):
        if alarmed and state.alarm is not None:
            states.append(replace(state, reason=describe(state.alarm, state.status), mean=state.alarm.present))
            continue
        unclear = [] if state.mean is None else np.flatnonzero(1.96 * state.mean.sigma > notice).tolist()
        status, reason = FleetStatus.HOLDS, f"no error beyond {rules.tolerance} in {state.usable} checks"
        if state.reason or unclear:
            names = ", ".join(AXES[axis][0] for axis in unclear)
            status = FleetStatus.CANNOT_TELL
            reason = state.reason or f"an error of {rules.notice} may stay undetected on {names}"
        states.append(replace(state, status=status, reason=reason, alarm=None))
    return states


def _in_use(states: Sequence[ExtrinsicState]) -> list[ExtrinsicState]:
    """Return the states with the extrinsic in use of each vehicle and pair of sensors marked as `current`.

    It is the last one, unless an earlier one has an alarm that nothing after it has ended: a new name of an extrinsic
    or service is no evidence that its error has gone.
    """
    out = []
    for _, group in groupby(states, key=lambda one: (one.vehicle, one.camera, one.lidar)):
        own, in_use = list(group), -1
        for number, one in enumerate(own):
            if one.alarm is not None and not any(_ended(one.alarm, later) for later in own[number + 1 :]):
                in_use = number
        own[in_use] = replace(own[in_use], current=True)
        out += own
    return out


def _ended(alarm: Alarm, later: ExtrinsicState) -> bool:
    """Return whether a later state has an alarm of its own, or the error of an axis of the alarm decreased (99.9 %)."""
    if later.alarm is not None:
        return True
    if later.mean is None or later.usable < _MIN_AFTER:
        return False
    undone = alarm.present.error - later.mean.error
    significant = _SIGNIFICANT * np.sqrt(later.mean.sigma**2 + alarm.present.sigma**2)
    return any(np.sign(one.size) * undone[_AXIS[one.axis]] > significant[_AXIS[one.axis]] for one in alarm.axes)


def _alarm(axis: int, own: Checks, error: Float, covariance: Float, pose: Float, rules: FleetRules) -> Alarm:
    """Return the alarm of the usable checks of an extrinsic, whose evidence is strongest on `axis`.

    `error` (T, 6) are their errors without trend, with their `covariance`; `pose` (4, 4) is the extrinsic in use.
    """
    began = onset(error[:, axis], np.sqrt(covariance[:, axis, axis]))
    alone, alone_sigma = conditional(error, covariance)
    if began.index == 0:  # the change may show only if the other axes are taken as constant
        began = onset(alone[:, axis], alone_sigma[:, axis])
    after = mean_error(error[began.index :], covariance[began.index :])
    change, spread = after.error, after.covariance
    if began.index:
        before = mean_error(error[: began.index], covariance[: began.index])
        change, spread = change - before.error, spread + before.covariance
    axes, *alternatives = _explained(axis, change, spread, rules)
    proposal = pose
    for part in axes:
        proposal = corrected(proposal, _AXIS[part.axis], np.array([part.size]))[0]
    data = own.texts["data"].tolist()
    proof = tuple(dict.fromkeys([*data[max(0, began.index - 1) : began.index], *data[-3:]]))
    return Alarm(
        axes=axes,
        alternatives=tuple(alternatives),
        since=float(own.time[began.index]),
        since_first=float(own.time[began.first]),
        since_last=float(own.time[began.last]),
        proposal=proposal,
        checks=len(own) - began.index,
        frames=int(own.frame_count[began.index :].sum()),
        proof=proof,
        present=after,
    )


def _explained(axis: int, change: Float, covariance: Float, rules: FleetRules) -> list[tuple[AxisError, ...]]:
    """Return the explanations of a change (6,) by the fewest axes; the first one contains `axis` if any does."""
    # Errors within a quarter of the tolerance are systematic errors of the edges: they need no explanation by an axis.
    wide = covariance + np.diag((rules.sizes("tolerance") / 4) ** 2)
    weight, sigma = np.linalg.inv(wide), np.sqrt(np.diag(covariance))
    if ((weight @ change) ** 2 / np.diag(weight) < _LEAST_PART).all():
        return [_axis_errors([axis], [change[axis]], sigma)]
    rates = Rates()
    possible = explanations(change, wide, rates.joint, rates.noticed**2)
    ordered = sorted(possible, key=lambda each: axis not in each.axes)
    return [_axis_errors(each.axes, each.sizes, sigma) for each in ordered]


def _axis_errors(axes: Sequence[int], sizes: Any, sigma: Float) -> tuple[AxisError, ...]:
    return tuple(
        AxisError(*AXES[axis], float(size), float(size - 1.96 * sigma[axis]), float(size + 1.96 * sigma[axis]))
        for axis, size in zip(axes, sizes, strict=True)
    )


def amount(error: AxisError) -> str:
    """Return an error with its interval as text: yaw +0.52 deg (+0.41 to +0.63)."""
    scale, unit, digits = (1, "deg", 2) if error.unit == "deg" else (100, "cm", 1)
    size, low, high = (f"{scale * value:+.{digits}f}" for value in (error.size, error.low, error.high))
    return f"{error.axis} {size} {unit} ({low} to {high})"


def describe(alarm: Alarm, status: FleetStatus) -> str:
    """Return the text of an alarm."""
    text = f"{'slipped' if status is FleetStatus.SLIPPED else 'wrong since the first check'}: "
    text += " or ".join(", ".join(map(amount, each)) for each in (alarm.axes, *alarm.alternatives))
    return text + (": not distinguishable with these checks" if alarm.alternatives else "")


def _types(
    states: Sequence[ExtrinsicState], noise: Mapping[Pair, PairNoise], rules: FleetRules
) -> tuple[TypeState, ...]:
    """Return the types of vehicles with their systematic errors."""
    groups: dict[Pair, list[MeanError]] = {}
    for state in states:
        if state.current and state.mean is not None:
            groups.setdefault(state.pair, []).append(state.mean)
    types = []
    for pair, means in sorted(groups.items(), key=lambda item: item[0]):
        own, errors, log_e = noise.get(pair, PairNoise()), tuple[AxisError, ...](), tuple[float, ...]()
        if len(means) >= _MIN_VEHICLES:
            error, sigma = (np.stack([getattr(mean, name) for mean in means]) for name in ("error", "sigma"))
            test = systematic(error, sigma, rules.sizes("type_tolerance"))
            errors, log_e = _axis_errors(range(len(AXES)), test.error, test.sigma), tuple(test.log_e.tolist())
        types.append(TypeState(*pair, len(means), errors, (), log_e, own.scale, tuple(own.trend_texts())))
    rejected = iter(discoveries(np.array([value for one in types for value in one.log_e]), rules.rate).tolist())
    return tuple(replace(one, alarms=tuple(error for error in one.errors if next(rejected))) for one in types)


def _attributed(state: ExtrinsicState, types: Sequence[TypeState]) -> ExtrinsicState:
    """Mark the alarm of an extrinsic as systematic if the errors of its axes are those of its type."""
    if state.alarm is None:
        return state
    own = [one for one in types if (one.vehicle_type, one.camera, one.lidar) == state.pair]
    common = {error.axis: error.size for one in own for error in one.alarms}
    same = all(part.axis in common and 0.5 < part.size / common[part.axis] < 2 for part in state.alarm.axes)
    return replace(state, alarm=replace(state.alarm, systematic=same))
