"""Cumulative sums: charts that notice a small lasting change in a row of noisy values (Page, Biometrika 1954)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from p2o.arrays import Float, Int

_OVERSHOOT = 1.166
"""What a sum steps over its limit on average, for Gaussian values (Siegmund, Sequential Analysis, 1985)."""


def mean_run(slack: float, limit: float, shift: float = 0.0) -> float:
    """Return after how many values on average a one-sided chart raises an alarm (Siegmund's approximation).

    Values are of deviation 1 and mean `shift`; 0 gives the run to a false alarm.
    """
    drift, reach = shift - slack, limit + _OVERSHOOT
    if abs(drift) < 1e-9:
        return reach**2
    steps = 2 * drift * reach
    return float((np.exp(-steps) + steps - 1) / (2 * drift**2))


def limit_for(slack: float, run: float, charts: int = 1) -> float:
    """Return the limit at which the first of so many one-sided charts raises a false alarm after `run` values."""
    low, high = 0.0, 1.0
    while mean_run(slack, high) < charts * run:
        low, high = high, 2 * high
    for _ in range(60):
        middle = (low + high) / 2
        low, high = (middle, high) if mean_run(slack, middle) < charts * run else (low, middle)
    return high


@dataclass(frozen=True, eq=False)
class Charts:
    """Two-sided charts of rows of values (T, A): `up` and `down` (T, A), and since when each sum is above zero.

    `up_since` and `down_since` (T, A) are the places of the first value of each sum; where it is zero, the next one.
    """

    up: Float
    down: Float
    up_since: Int
    down_since: Int


def charts(values: Float, slack: float) -> Charts:
    """Return the sums S_t = max(0, S_(t-1) +- value_t - slack) of rows (T, A); NaN leaves a sum as it is."""
    sums: list[tuple[Float, Int]] = []
    for sign in (1.0, -1.0):
        level: Float = np.zeros(values.shape)
        since: Int = np.zeros(values.shape, np.int64)
        run, begin = np.zeros(values.shape[1]), np.zeros(values.shape[1], np.int64)
        for place, row in enumerate(values):
            run = np.where(np.isnan(row), run, np.maximum(0.0, run + sign * row - slack))
            begin = np.where(run > 0, begin, place + 1)
            level[place], since[place] = run, begin
        sums.append((level, since))
    (up, up_since), (down, down_since) = sums
    return Charts(up, down, up_since, down_since)


def innovations(values: Float, correlation: float) -> Float:
    """Return rows (T, A) without what each says of the one before: of deviation 1 where values are (AR(1)).

    A lasting shift d of the values is one of d sqrt((1 - c) / (1 + c)) in these.
    """
    before = np.vstack([np.full((1, values.shape[1]), np.nan), values[:-1]])
    told = (values - correlation * before) / np.sqrt(1 - correlation**2)
    return np.where(np.isnan(before), values, told)


def beside_mean(values: Float) -> Float:
    """Return how rows (T, A) differ from the mean of all rows before, times sqrt(n / (n + 1)) for n of these.

    Where values are independent and of deviation 1 about a mean that nobody knows, these are so about zero (Hawkins,
    The Statistician 1987, with a known deviation). The first of a column is NaN, as are values that are NaN.
    """
    known = np.isfinite(values)
    before = np.cumsum(known, axis=0) - known
    total = np.cumsum(np.where(known, values, 0.0), axis=0) - np.where(known, values, 0.0)
    there = known & (before > 0)
    mean = np.where(there, total / np.maximum(before, 1), np.nan)
    return np.asarray(np.sqrt(before / (before + 1.0)) * (values - mean))


def autocorrelation(values: Float) -> float:
    """Return the correlation of each row (T, A) with the next, over all columns, each about its own mean."""
    centred = values - np.nanmean(values, axis=0)
    products, squares = centred[1:] * centred[:-1], centred**2
    if not np.isfinite(products).any():
        return 0.0
    return float(np.nanmean(products) / max(np.nanmean(squares), np.finfo(float).tiny))
