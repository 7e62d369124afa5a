"""Confidence intervals by cluster bootstrap: frames are resampled with all their seeds.

Seeds of one frame share image and sweep and are not independent: resampling single runs would give too narrow
intervals. Efron and Tibshirani, An Introduction to the Bootstrap (1993), sections 8.5 and 13.3.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Literal

import numpy as np
from p2o.arrays import Float, Int

RESAMPLES = 2000
SHARE = 0.95
MIN_FRAMES = 5
"""With fewer frames there are too few distinct resamples for an interval: none is given."""
_WEIGHTS_AT_ONCE = 4_000_000
"""Maximum number of weights (resamples x values) in memory."""

Statistic = Literal["mean", "median"]


@dataclass(frozen=True)
class Interval:
    """A statistic of a sample and its 95 % interval; `low` and `high` are None for too few frames."""

    value: float
    low: float | None = None
    high: float | None = None


def interval(values: Sequence[float] | Float, frames: Sequence[str], statistic: Statistic) -> Interval | None:
    """Return mean or median of values (N,) with its percentile interval; `frames` (N,) names the frame of each value.

    The interval does not depend on the order of the values, because the random draws depend on the number of frames
    only. Returns None without values. Raises ValueError if the lengths differ.
    """
    sample = np.asarray(values, dtype=np.float64)
    if sample.shape != (len(frames),):
        raise ValueError(f"{sample.shape} values for {len(frames)} frames")
    if not len(sample):
        return None
    names, frame = np.unique(np.asarray(frames), return_inverse=True)
    order = np.lexsort((frame, sample))
    sample, frame = sample[order], frame[order]
    whole = float(_statistics(sample, np.ones((1, len(sample)), np.int64), statistic)[0])
    if len(names) < MIN_FRAMES:
        return Interval(whole)
    draws = draws_of(len(names))
    step = max(1, _WEIGHTS_AT_ONCE // len(sample))
    drawn = [_statistics(sample, draws[i : i + step, frame], statistic) for i in range(0, len(draws), step)]
    low, high = np.quantile(np.concatenate(drawn), [(1 - SHARE) / 2, (1 + SHARE) / 2])
    return Interval(whole, float(low), float(high))


@lru_cache(maxsize=16)
def draws_of(frames: int) -> Int:
    """Return the number of times each frame is drawn in each resample, (RESAMPLES, frames)."""
    rng = np.random.default_rng([RESAMPLES, frames])
    return rng.multinomial(frames, np.full(frames, 1 / frames), RESAMPLES)


def _statistics(ordered: Float, weights: Int, statistic: Statistic) -> Float:
    """Return the statistic (B,) of ascending values (N,) with integer weights (B, N)."""
    if statistic == "mean":
        return np.asarray((weights @ ordered) / weights.sum(axis=1))
    # The median is the mean of the two middle values, which are equal if the count is odd.
    upto = np.cumsum(weights, axis=1)
    total = upto[:, -1:]
    lower = np.argmax(upto > (total - 1) // 2, axis=1)
    upper = np.argmax(upto > total // 2, axis=1)
    return np.asarray((ordered[lower] + ordered[upper]) / 2)
