"""Detect when a given extrinsic changed during a drive, from the edge step of each frame (CUSUM charts)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from p2o.arrays import Float, Int
from p2o.confidence.audit import AXES, EdgeStep
from p2o.results.check import Detectable, Slip, WatchedFrame

CLIP = 3.0
"""Limit of the value of a single frame, in standard deviations: its edges may be wrong matches."""
CORRELATION = 0.45
"""Minimum autocorrelation of the steps of successive frames, measured on drives (`python benchmarks/audit.py`)."""
_MOST_CORRELATION = 0.9


@dataclass(frozen=True)
class Rule:
    """Parameters of the monitoring of a drive: `alarms_per_hour` is the design rate of false alarms at `rate_hz` Hz.

    The first `settle` frames only estimate the usual mean. A chart subtracts `slack` from each value: half of the shift
    that it detects with the shortest delay, in standard deviations of a value.
    """

    alarms_per_hour: float = 0.1
    rate_hz: float = 10.0
    settle: int = 20
    slack: float = 0.35

    @property
    def limit(self) -> float:
        """Return the alarm limit of a chart, for two-sided charts of six axes."""
        frames_between_alarms = 3600.0 * self.rate_hz / self.alarms_per_hour
        return limit_for(self.slack, frames_between_alarms, 2 * len(AXES))


@dataclass(frozen=True, eq=False)
class Watched:
    """Monitoring result of a drive: the level of the charts for each frame, the detected and the detectable slips."""

    frames: tuple[WatchedFrame, ...]
    slips: tuple[Slip, ...]
    detectable: tuple[Detectable, ...]
    correlation: float
    limit: float


def watched(names: Sequence[str], steps: Sequence[EdgeStep | None], rule: Rule) -> Watched:
    """Detect slips of the extrinsic from the steps of single frames, in order; None is a frame without a step.

    Each step is divided by its predicted error and clipped at `CLIP`. The part that the previous value predicts and the
    mean of all previous values are subtracted; the charts sum up the innovations. An alarm resets the charts.
    """
    nothing = np.full(len(AXES), np.nan)
    errors = np.array([nothing if step is None else step.error for step in steps])
    sigma = np.array([nothing if step is None else step.sigma for step in steps])
    standard = np.clip(errors / sigma, -CLIP, CLIP)
    correlation = min(max(autocorrelation(standard[: rule.settle]), CORRELATION), _MOST_CORRELATION)
    level: list[WatchedFrame] = []
    slips: list[Slip] = []
    limit, begin = rule.limit, 0
    while begin < len(names):
        values = beside_mean(innovations(standard[begin:], correlation))
        values[: rule.settle] = np.nan
        sums, since = charts(values, rule.slack)
        highest = sums.max(axis=0)
        over = np.flatnonzero((highest > limit).any(axis=1))
        last = int(over[0]) + 1 if len(over) else len(values)
        level += [_frame(names[begin + at], highest[at], values[at], limit) for at in range(last)]
        if not len(over):
            break
        axis = int(highest[last - 1].argmax())
        began = begin + int(since[sums[:, last - 1, axis].argmax(), last - 1, axis])
        slips.append(_slip(names, axis, (begin, began, begin + last - 1), errors[:, axis], sigma[:, axis], correlation))
        begin += last
    return Watched(tuple(level), tuple(slips), detectable(sigma, correlation, rule), correlation, limit)


def detectable(sigma: Float, correlation: float, rule: Rule) -> tuple[Detectable, ...]:
    """Return the smallest slips that raise an alarm on frames with errors of standard deviation sigma (T, A).

    They begin after the frames that settle, and the charts of their expected values reach the limit by the last frame.
    """
    smallest = []
    for (axis, unit), own in zip(AXES, sigma.T, strict=True):
        known = own[np.isfinite(own)]
        shift = _smallest_shift(len(known), correlation, rule)
        size = None if shift is None else float(shift * np.median(known))
        smallest.append(Detectable(axis, unit, size))
    return tuple(smallest)


def _smallest_shift(count: int, correlation: float, rule: Rule) -> float | None:
    """Return the shift, in standard deviations of `count` values, whose expected chart reaches the limit; else None."""
    from scipy.optimize import brentq

    before = np.arange(rule.settle, count)
    if not len(before):
        return None
    # The mean of all previous values follows the shift: n of k previous values are those before it.
    share = rule.settle / before * np.sqrt(before / (before + 1.0)) * np.sqrt((1 - correlation) / (1 + correlation))
    limit = rule.limit

    def excess(shift: float) -> float:
        return float(np.cumsum(shift * share - rule.slack).max()) - limit

    return float(brentq(excess, 0.0, CLIP)) if excess(CLIP) > 0 else None


def _mean_and_variance(errors: Float, sigma: Float) -> tuple[float, float]:
    """Return the mean of errors, weighted by their inverse variances, and its variance; unknown ones are NaN."""
    known = np.isfinite(errors)
    weight = 1 / sigma[known] ** 2
    return float((weight * errors[known]).sum() / weight.sum()) if len(weight) else 0.0, float(1 / weight.sum())


def _frame(name: str, highest: Float, values: Float, limit: float) -> WatchedFrame:
    if np.isnan(values).all():
        return WatchedFrame(name)
    return WatchedFrame(name, float(highest.max() / limit), AXES[int(highest.argmax())][0])


def _slip(
    names: Sequence[str], axis: int, times: tuple[int, int, int], errors: Float, sigma: Float, correlation: float
) -> Slip:
    """Estimate the slip of an alarm on one axis: its size is the change of the mean at its onset.

    `times` are the first frame of the charts, the onset, where the sum last left zero, and the frame of the alarm.
    """
    begin, began, noticed = times
    parts = (slice(begin, began), slice(began, noticed + 1))
    (before, variance), (after, other) = (_mean_and_variance(errors[part], sigma[part]) for part in parts)
    # Correlated values contain less information than the same number of independent values.
    wider = (1 + correlation) / (1 - correlation)
    spread = float(np.sqrt(wider * (variance + other)))
    return Slip(*AXES[axis], noticed, names[noticed], began, names[began], after - before, spread)


_OVERSHOOT = 1.166
"""Mean overshoot of a sum over its limit, for Gaussian values (Siegmund, Sequential Analysis, 1985)."""


def mean_run(slack: float, limit: float) -> float:
    """Return the average run length of a one-sided chart until a false alarm (Siegmund's approximation).

    Values have standard deviation 1 and mean 0.
    """
    steps = -2 * slack * (limit + _OVERSHOOT)
    return float((np.exp(-steps) + steps - 1) / (2 * slack**2))


def limit_for(slack: float, run: float, charts: int = 1) -> float:
    """Return the limit for which `charts` one-sided charts raise one false alarm per `run` values on average."""
    low, high = 0.0, 1.0
    while mean_run(slack, high) < charts * run:
        low, high = high, 2 * high
    for _ in range(60):
        middle = (low + high) / 2
        low, high = (middle, high) if mean_run(slack, middle) < charts * run else (low, middle)
    return high


def charts(values: Float, slack: float) -> tuple[Float, Int]:
    """Compute the two-sided sums (2, T, A) of rows (T, A): S_t = max(0, S_(t-1) +- value_t - slack), and their onsets.

    NaN does not change a sum. The onset (2, T, A) is the index of the first value of a sum; the next if it is zero.
    """
    sums, since = np.zeros((2, *values.shape)), np.zeros((2, *values.shape), np.int64)
    run, begin = sums[:, 0].copy(), since[:, 0].copy()
    for place, row in enumerate(values):
        run = np.where(np.isnan(row), run, np.maximum(0.0, run + np.stack([row, -row]) - slack))
        begin = np.where(run > 0, begin, place + 1)
        sums[:, place], since[:, place] = run, begin
    return sums, since


def innovations(values: Float, correlation: float) -> Float:
    """Subtract from rows (T, A) the AR(1) prediction of the previous row; standard deviation 1 is preserved.

    A permanent shift d of the values becomes a shift of d sqrt((1 - c) / (1 + c)).
    """
    before = np.vstack([np.full((1, values.shape[1]), np.nan), values[:-1]])
    innovation = (values - correlation * before) / np.sqrt(1 - correlation**2)
    return np.where(np.isnan(before), values, innovation)


def beside_mean(values: Float) -> Float:
    """Return the differences of rows (T, A) from the mean of all n previous rows, times sqrt(n / (n + 1)).

    If values are independent with standard deviation 1 about an unknown mean, the differences are independent with
    standard deviation 1 about zero (Hawkins, The Statistician 1987, with a known standard deviation). The first value
    of a column and missing values are NaN.
    """
    known = np.isfinite(values)
    before = np.cumsum(known, axis=0) - known
    total = np.cumsum(np.where(known, values, 0.0), axis=0) - np.where(known, values, 0.0)
    mean = np.where(known & (before > 0), total / np.maximum(before, 1), np.nan)
    return np.asarray(np.sqrt(before / (before + 1.0)) * (values - mean))


def autocorrelation(values: Float) -> float:
    """Return the lag-1 autocorrelation of the rows (T, A), pooled over columns with their own means; 0 if unknown."""
    centred = values - np.nansum(values, axis=0) / np.maximum(np.isfinite(values).sum(axis=0), 1)
    products, squares = centred[1:] * centred[:-1], centred**2
    if not np.isfinite(products).any():
        return 0.0
    return float(np.nanmean(products) / max(np.nanmean(squares), np.finfo(float).tiny))
