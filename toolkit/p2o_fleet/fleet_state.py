"""The state of every extrinsic of a fleet, alarms with proposals, and systematic errors of vehicle types."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from itertools import pairwise
from typing import Any

import numpy as np
from p2o.arrays import Float
from p2o.confidence.audit import AXES, Rates
from p2o.confidence.explanation import corrected, explanations
from p2o.errors import InputError, P2OError
from p2o.geometry.perturb import parse_accuracy
from p2o_study.parallel import Workers

from p2o_fleet.evidence import Verdict
from p2o_fleet.noise import PairNoise, estimate_noise
from p2o_fleet.schema import Checks
from p2o_fleet.segments import Pair, Segment, segments_of
from p2o_fleet.statistics import (
    MeanError,
    NoiseModel,
    Systematic,
    conditional,
    discoveries,
    e_process,
    mean_error,
    onset,
    systematic,
)
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
_HISTORY = 240
"""Maximum number of points of the history of an extrinsic."""


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
    state is unknown. `trends` enables the covariates temperature and time of day.
    """

    rate: float = 0.01
    tolerance: str = "0.2deg 3cm"
    type_tolerance: str = "0.03deg 1cm"
    notice: str = "0.5deg 5cm"
    trends: bool = True

    def __post_init__(self) -> None:
        if not 0 < self.rate < 1:
            raise InputError(
                "the false discovery rate is out of bounds", expected="a share between 0 and 1", got=self.rate
            )
        for name in ("tolerance", "type_tolerance", "notice"):
            if min(sizes := _sizes(getattr(self, name), f"--{name.replace('_', '-')}")) <= 0:
                raise InputError(
                    f"{name} is out of bounds", expected="more than zero, such as 0.1deg 2cm", got=sizes[0]
                )


def _sizes(text: str, where: str) -> tuple[float, ...]:
    size = parse_accuracy(text, where)
    return (size.angle_deg,) * 3 + (size.distance_m,) * 3


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
    and is the change since then if it began after the first check. `proposal` (4, 4) is the extrinsic without it.
    `systematic` states that the vehicles of this type have the same error. `proof` are logs that show it.
    """

    axes: tuple[AxisError, ...]
    alternatives: tuple[tuple[AxisError, ...], ...]
    since: float
    since_first: float
    since_last: float
    log_e: float
    proposal: Float
    checks: int
    frames: int
    proof: tuple[str, ...]
    systematic: bool = False


@dataclass(frozen=True)
class HistoryPoint:
    """One check in the history: its time, verdict, errors (6) and deviations (6), and the log e-value after it."""

    time: float
    verdict: str
    error: tuple[float, ...] | None
    sigma: tuple[float, ...] | None
    log_e: float


@dataclass(frozen=True, eq=False)
class ExtrinsicState:
    """The state of one extrinsic of one vehicle, between two services, over all its checks."""

    vehicle: str
    vehicle_type: str
    camera: str
    lidar: str
    extrinsic: str
    digest: str
    service: str
    current: bool
    first: float
    last: float
    checks: int
    usable: int
    unreadable: int
    frames: int
    status: FleetStatus
    reason: str
    log_e: Float
    mean: MeanError | None
    alarm: Alarm | None
    history: tuple[HistoryPoint, ...]

    @property
    def pair(self) -> Pair:
        """Return vehicle type, camera and LiDAR."""
        return self.vehicle_type, self.camera, self.lidar

    @property
    def total_log_e(self) -> float:
        """Return the log e-value of the whole extrinsic: the mean over the axes."""
        return float(np.logaddexp.reduce(self.log_e) - np.log(len(AXES))) if len(self.log_e) else 0.0


@dataclass(frozen=True)
class ServiceChange:
    """The change of the error of an extrinsic at a service: errors after minus before, of significant axes only."""

    vehicle: str
    camera: str
    lidar: str
    service: str
    time: float
    axes: tuple[AxisError, ...]


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
    """The state of a fleet: all extrinsics, types, and changes at services."""

    rules: FleetRules
    extrinsics: tuple[ExtrinsicState, ...]
    types: tuple[TypeState, ...]
    services: tuple[ServiceChange, ...]
    checks: int
    until: float

    @property
    def alarms(self) -> tuple[ExtrinsicState, ...]:
        """Return the extrinsics in use with an alarm, the strongest evidence first."""
        own = [state for state in self.extrinsics if state.alarm is not None and state.current]
        return tuple(sorted(own, key=lambda state: -state.total_log_e))

    @property
    def current(self) -> tuple[ExtrinsicState, ...]:
        """Return the extrinsics in use: the last one of each vehicle and pair of sensors."""
        return tuple(state for state in self.extrinsics if state.current)


def fleet_state(store: Store, rules: FleetRules | None = None, workers: Workers | None = None) -> FleetState:
    """Compute the state of a fleet from its stored evidence; each worker has one vehicle at a time in memory."""
    rules = rules or FleetRules()
    noise = estimate_noise(store, _sizes(rules.tolerance, "--tolerance"), trends=rules.trends)
    names = store.vehicles()
    jobs = [_VehiclesJob(store, names[n : n + _PER_JOB], noise, rules) for n in range(0, len(names), _PER_JOB)]
    with (workers or Workers()).start() as run, contextlib.closing(run(_segments, jobs, _lost)) as results:
        segments = sorted((one for own in results for one in own), key=lambda one: one.state.vehicle)
    states = _with_alarms(segments, rules)
    until = max((state.last for state in states), default=0.0)
    types = _types(states, noise, rules)
    states = [_attributed(state, types) for state in states]
    services = tuple(_service_changes(states))
    return FleetState(rules, tuple(states), types, services, sum(state.checks for state in states), until)


@dataclass(frozen=True, eq=False)
class _Judged:
    """A segment with its usable checks, errors without trend, and the log e-process (T, 6)."""

    state: ExtrinsicState
    times: Float
    error: Float
    covariance: Float
    frames: Any
    data: Any
    pose: Float | None


@dataclass(frozen=True, eq=False)
class _VehiclesJob:
    """Vehicles whose checks a worker evaluates."""

    store: Store
    vehicles: Sequence[str]
    noise: Mapping[Pair, PairNoise]
    rules: FleetRules


def _segments(job: _VehiclesJob) -> list[_Judged]:
    """Return the segments of the vehicles with their e-processes."""
    tolerance = _sizes(job.rules.tolerance, "--tolerance")
    checks = job.store.checks(job.vehicles)
    return [_judged(one, job.noise, tolerance) for own in checks for one in segments_of(own)]


def _lost(job: _VehiclesJob, problem: P2OError) -> list[_Judged]:
    """Raise the problem of a worker that died: a report without one vehicle would be wrong."""
    raise problem


def _judged(segment: Segment, noise: Mapping[Pair, PairNoise], tolerance: tuple[float, ...]) -> _Judged:
    """Return a segment with its e-process, as a state without alarms."""
    checks = segment.checks
    rows = np.flatnonzero(checks.usable)
    own = checks.take(rows)
    own_noise = noise.get(segment.pair) or PairNoise(NoiseModel(tolerance=tolerance))
    error = own_noise.without_trend(own)
    logs = e_process(error, own.covariance, own_noise.model)
    covariance = own.covariance * own_noise.model.inflation
    total = np.logaddexp.reduce(logs, axis=1) - np.log(len(AXES)) if len(own) else np.zeros(0)
    posed = np.flatnonzero(np.isfinite(checks.pose).all(axis=(1, 2)))
    texts = checks.texts
    unreadable = int((texts["verdict"] == Verdict.UNREADABLE.value).sum())
    state = ExtrinsicState(
        vehicle=checks.vehicle,
        vehicle_type=segment.vehicle_type,
        camera=segment.camera,
        lidar=segment.lidar,
        extrinsic=str(texts["extrinsic"][-1]),
        digest=segment.digest,
        service=segment.service,
        current=segment.current,
        first=float(checks.time[0]),
        last=float(checks.time[-1]),
        checks=len(checks),
        usable=len(own),
        unreadable=unreadable,
        frames=int(checks.frame_count.sum()),
        status=FleetStatus.CANNOT_TELL,
        reason=_last_reason(checks),
        log_e=logs[-1] if len(own) else np.zeros(len(AXES)),
        mean=mean_error(error[-_MEAN_OF:], covariance[-_MEAN_OF:]) if len(own) else None,
        alarm=None,
        history=_history(checks, rows, error, covariance, total),
    )
    pose = checks.pose[posed[-1]] if len(posed) else None
    return _Judged(state, own.time, error, covariance, own.frame_count, own.texts["data"], pose)


def _last_reason(checks: Checks) -> str:
    recent = checks.usable[-_RECENT:]
    return "" if recent.any() else f"no estimate in the last {len(recent)} checks: {checks.texts['reason'][-1]}"


def _history(checks: Checks, rows: Any, error: Float, covariance: Float, total: Float) -> tuple[HistoryPoint, ...]:
    """Return the checks, at most `_HISTORY` of them evenly spaced, as points of the history."""
    place = np.full(len(checks), -1)
    place[rows] = np.arange(len(rows))
    points = []
    level = 0.0
    for number in np.unique(np.linspace(0, len(checks) - 1, min(len(checks), _HISTORY)).round().astype(int)):
        at = int(place[number])
        level = float(total[at]) if at >= 0 else level
        size, sigma = (None, None) if at < 0 else (error[at], np.sqrt(np.diag(covariance[at])))
        points.append(
            HistoryPoint(
                float(checks.time[number]),
                str(checks.texts["verdict"][number]),
                None if size is None else tuple(map(float, size)),
                None if sigma is None else tuple(map(float, sigma)),
                level,
            )
        )
    return tuple(points)


def _with_alarms(segments: Sequence[_Judged], rules: FleetRules) -> list[ExtrinsicState]:
    """Return the states with alarms at the false discovery rate of the rules."""
    rejected = discoveries(np.array([one.state.total_log_e for one in segments]), rules.rate)
    notice = np.array(_sizes(rules.notice, "--notice"))
    states = []
    for one, alarmed in zip(segments, rejected.tolist(), strict=True):
        state = one.state
        if alarmed and one.pose is not None:
            alarm = _alarm(one, rules)
            status = FleetStatus.WRONG if alarm.since <= one.times[0] else FleetStatus.SLIPPED
            states.append(replace(state, status=status, alarm=alarm, reason=describe(alarm, status)))
            continue
        status, reason = FleetStatus.HOLDS, f"no error beyond {rules.tolerance} in {state.usable} checks"
        if state.reason:
            status, reason = FleetStatus.CANNOT_TELL, state.reason
        elif state.mean is not None and (unclear := 1.96 * state.mean.sigma > notice).any():
            names = ", ".join(AXES[n][0] for n in np.flatnonzero(unclear))
            status, reason = (
                FleetStatus.CANNOT_TELL,
                f"an error of {rules.notice} may stay undetected on {names}",
            )
        states.append(replace(state, status=status, reason=reason))
    return states


def _alarm(one: _Judged, rules: FleetRules) -> Alarm:
    """Return the alarm of a segment whose e-value is a discovery."""
    axis = int(one.state.log_e.argmax())
    began = onset(one.error[:, axis], np.sqrt(one.covariance[:, axis, axis]))
    alone, alone_sigma = conditional(one.error, one.covariance)
    if began.index == 0:  # the change may show only if the other axes are taken as constant
        began = onset(alone[:, axis], alone_sigma[:, axis])
    after = mean_error(one.error[began.index :], one.covariance[began.index :])
    change, covariance = after.error, after.covariance
    if began.index:
        before = mean_error(one.error[: began.index], one.covariance[: began.index])
        change, covariance = change - before.error, covariance + before.covariance
    axes, *alternatives = _explained(axis, change, covariance, rules)
    assert one.pose is not None
    proposal = one.pose
    index = {name: number for number, (name, _) in enumerate(AXES)}
    for part in axes:
        proposal = corrected(proposal, index[part.axis], np.array([part.size]))[0]
    last = one.data[-3:].tolist() if len(one.data) else []
    proof = tuple(dict.fromkeys([*(one.data[began.index - 1 : began.index].tolist() if began.index else []), *last]))
    return Alarm(
        axes,
        tuple(alternatives),
        float(one.times[began.index]),
        float(one.times[began.first]),
        float(one.times[began.last]),
        one.state.total_log_e,
        proposal,
        len(one.times) - began.index,
        int(one.frames[began.index :].sum()),
        proof,
    )


def _explained(axis: int, change: Float, covariance: Float, rules: FleetRules) -> list[tuple[AxisError, ...]]:
    """Return the explanations of a change (6,) by the fewest axes; the first one contains `axis` if any does."""
    # Errors within a quarter of the tolerance are systematic errors of the edges: they need no explanation by an axis.
    wide = covariance + np.diag((np.array(_sizes(rules.tolerance, "--tolerance")) / 4) ** 2)
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
    groups: dict[Pair, list[ExtrinsicState]] = {}
    for state in states:
        if state.current and state.mean is not None:
            groups.setdefault(state.pair, []).append(state)
    tolerance = np.array(_sizes(rules.type_tolerance, "--type-tolerance"))
    tests: dict[Pair, Systematic] = {}
    for pair, group in groups.items():
        if len(group) >= _MIN_VEHICLES:
            means = [state.mean for state in group if state.mean is not None]
            tests[pair] = systematic(np.stack([m.error for m in means]), np.stack([m.sigma for m in means]), tolerance)
    rejected = discoveries(np.concatenate([np.zeros(0), *(test.log_e for test in tests.values())]), rules.rate)
    alarms = dict(zip(tests, rejected.reshape(-1, len(AXES)), strict=True))
    types = []
    for pair, group in sorted(groups.items()):
        test, own = tests.get(pair), noise.get(pair)
        errors = (
            ()
            if test is None
            else tuple(AxisError(*AXES[n], float(test.error[n]), *test.interval(n)) for n in range(len(AXES)))
        )
        types.append(
            TypeState(
                *pair,
                len(group),
                errors,
                tuple(error for error, is_alarm in zip(errors, alarms.get(pair, ()), strict=False) if is_alarm),
                () if test is None else tuple(map(float, test.log_e)),
                (1.0,) * len(AXES) if own is None else own.model.scale,
                () if own is None else tuple(own.trend_texts()),
            )
        )
    return tuple(types)


def _attributed(state: ExtrinsicState, types: Sequence[TypeState]) -> ExtrinsicState:
    """Mark the alarm of an extrinsic as systematic if the errors of its axes are those of its type."""
    if state.alarm is None:
        return state
    own = next((one for one in types if (one.vehicle_type, one.camera, one.lidar) == state.pair), None)
    common = {} if own is None else {error.axis: error for error in own.alarms}
    same = bool(common) and all(
        error.axis in common
        and np.sign(error.size) == np.sign(common[error.axis].size)
        and 0.5 < error.size / common[error.axis].size < 2
        for error in state.alarm.axes
    )
    return replace(state, alarm=replace(state.alarm, systematic=same))


def _service_changes(states: Sequence[ExtrinsicState]) -> Iterator[ServiceChange]:
    """Yield the significant changes of an extrinsic at services (99.9 %)."""
    for before, after in pairwise(states):
        same = (before.vehicle, *before.pair, before.digest) == (after.vehicle, *after.pair, after.digest)
        if not same or before.service == after.service or before.mean is None or after.mean is None:
            continue
        change = after.mean.error - before.mean.error
        sigma = np.sqrt(after.mean.sigma**2 + before.mean.sigma**2)
        axes = np.flatnonzero(np.abs(change) > 3.8 * sigma)
        if len(axes):
            errors = _axis_errors(axes.tolist(), change[axes], sigma)
            yield ServiceChange(after.vehicle, after.camera, after.lidar, after.service, after.first, errors)
