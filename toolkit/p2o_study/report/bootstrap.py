"""Confidence intervals by cluster bootstrap: frames are resampled with all their seeds.

Seeds of one frame share image and sweep and are not independent: resampling single runs would give too narrow
intervals. Efron and Tibshirani, An Introduction to the Bootstrap (1993), sections 8.5 and 13.3.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Literal

import numpy as np
from p2o.arrays import Float, Int, UInt8
from scipy.sparse import csr_array

RESAMPLES = 2000
SHARE = 0.95
MIN_FRAMES = 5
"""With fewer frames there are too few distinct resamples for an interval: none is given."""
_WEIGHTS_AT_ONCE = 2_000_000
"""Maximum number of weights (resamples x frames) in memory."""

Statistic = Literal["mean", "median"]


@dataclass(frozen=True)
class Interval:
    """A statistic of a sample and its 95 % interval; `low` and `high` are None for too few frames."""

    value: float
    low: float | None = None
    high: float | None = None


def interval(values: Sequence[float] | Float, frames: Sequence[str] | Int, statistic: Statistic) -> Interval | None:
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
    whole = float(_statistics(sample, frame, np.ones((1, len(names)), np.uint8), statistic)[0])
    if len(names) < MIN_FRAMES:
        return Interval(whole)
    draws = draws_of(len(names))
    step = max(1, _WEIGHTS_AT_ONCE // len(names))
    drawn = [_statistics(sample, frame, draws[i : i + step], statistic) for i in range(0, len(draws), step)]
    low, high = np.quantile(np.concatenate(drawn), [(1 - SHARE) / 2, (1 + SHARE) / 2])
    return Interval(whole, float(low), float(high))


@lru_cache(maxsize=2)
def draws_of(frames: int) -> UInt8:
    """Return the number of times each frame is drawn in each resample, (RESAMPLES, frames)."""
    rng = np.random.default_rng([RESAMPLES, frames])
    shares, draws = np.full(frames, 1 / frames), np.empty((RESAMPLES, frames), np.uint8)
    step = max(1, _WEIGHTS_AT_ONCE // frames)
    for i in range(0, RESAMPLES, step):
        # A frame is drawn once on average, and never 256 times.
        draws[i : i + step] = rng.multinomial(frames, shares, len(draws[i : i + step]))
    return draws


def _statistics(ordered: Float, frame: Int, draws: UInt8, statistic: Statistic) -> Float:
    """Return the statistic (B,) of ascending values (N,) of frames (N,), drawn as often as `draws` (B, frames) states.

    The median is the mean of the two middle values, which are equal if the count is odd.
    """
    counts = np.bincount(frame, minlength=draws.shape[1])
    weights = draws.astype(np.float64)
    total = weights @ counts
    if statistic == "mean":
        return np.asarray((weights @ np.bincount(frame, ordered, draws.shape[1])) / total)
    # Values drawn up to the end of each block; then only one block per resample is searched.
    size = math.isqrt(len(ordered) - 1) + 1
    blocks = np.arange(len(ordered)) // size
    in_block = csr_array((np.ones(len(ordered)), (frame, blocks)), shape=(draws.shape[1], blocks[-1] + 1))
    upto = np.cumsum(np.asarray(weights @ in_block), axis=1)
    resample, middles = np.arange(len(draws)), []
    for before in ((total - 1) // 2, total // 2):
        block = np.argmax(upto > before[:, None], axis=1)
        skipped = np.where(block > 0, upto[resample, block - 1], 0.0)
        places = np.minimum(block[:, None] * size + np.arange(size), len(ordered) - 1)
        reached = skipped[:, None] + np.cumsum(weights[resample[:, None], frame[places]], axis=1)
        middles.append(ordered[places[resample, np.argmax(reached > before[:, None], axis=1)]])
    return np.asarray((middles[0] + middles[1]) / 2)
