"""Over a drive: since when a given extrinsic is off, from the steps that edges ask for frame after frame."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from p2o.arrays import Float
from p2o.calibration.audit import AXES
from p2o.calibration.cusum import Charts, autocorrelation, beside_mean, charts, innovations, limit_for
from p2o.calibration.edge_step import EdgeStep
from p2o.results.check import Slip, WatchedFrame

CLIP = 3.0
"""A single frame counts for so many deviations at most: its edges may have been taken for others."""
CORRELATION = 0.45
"""How steps of one frame go with those of the next at least, as measured on drives (`python benchmarks/audit.py`)."""
_MOST_CORRELATION = 0.9


@dataclass(frozen=True)
class Rule:
    """How a drive is watched: `alarms_per_hour` of false alarms are meant at `rate_hz` frames a second.

    The first `settle` frames only say what is usual; a chart takes `slack` off each value, half of the shift, in
    deviations of a value, that it notices soonest.
    """

    alarms_per_hour: float = 0.1
    rate_hz: float = 10.0
    settle: int = 20
    slack: float = 0.35

    @property
    def run(self) -> float:
        """Frames from one false alarm to the next, on average."""
        return 3600.0 * self.rate_hz / self.alarms_per_hour

    @property
    def limit(self) -> float:
        """Where a chart raises an alarm: two-sided ones of six axes are watched."""
        return limit_for(self.slack, self.run, 2 * len(AXES))


@dataclass(frozen=True, eq=False)
class Watched:
    """What was seen of a drive: `values` (T, A) that the charts add up, and the slips that were noticed."""

    frames: tuple[WatchedFrame, ...]
    slips: tuple[Slip, ...]
    correlation: float
    limit: float


def watched(names: Sequence[str], steps: Sequence[EdgeStep | None], rule: Rule) -> Watched:
    """Return what the steps of single frames, in order, say of a drive; None is a frame that tells nothing.

    Each step is divided by its likely error and cut off at `CLIP`. What a value says of the next is taken out, and the
    mean of all before, which is what is usual: charts add up what is new. After an alarm the drive begins again.
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
        seen = charts(values, rule.slack)
        alarm = _first(seen, limit)
        last = len(values) if alarm is None else alarm + 1
        level += [_frame(names[begin + at], seen, at, values, limit) for at in range(last)]
        if alarm is None:
            break
        slips.append(_slip(names, seen, alarm, begin, errors, sigma, correlation))
        begin += last
    return Watched(tuple(level), tuple(slips), correlation, limit)


def _mean(errors: Float, sigma: Float) -> Float:
    """Return the mean (A,) of errors, each weighed by its deviation; zero where there are none."""
    weight = np.where(np.isfinite(errors), 1 / sigma**2, 0.0)
    total = weight.sum(axis=0)
    return np.where(total > 0, (weight * np.nan_to_num(errors)).sum(axis=0) / np.where(total > 0, total, 1.0), 0.0)


def _first(seen: Charts, limit: float) -> int | None:
    """Return the place of the first alarm."""
    over = np.flatnonzero((np.maximum(seen.up, seen.down) > limit).any(axis=1))
    return int(over[0]) if len(over) else None


def _frame(name: str, seen: Charts, at: int, values: Float, limit: float) -> WatchedFrame:
    if np.isnan(values[at]).all():
        return WatchedFrame(name)
    highest = np.maximum(seen.up[at], seen.down[at])
    return WatchedFrame(name, float(highest.max() / limit), AXES[int(highest.argmax())][0])


def _slip(
    names: Sequence[str], seen: Charts, alarm: int, begin: int, errors: Float, sigma: Float, correlation: float
) -> Slip:
    """Return the slip that an alarm tells of: it began where the sum last left zero, and is the change of the mean."""
    highest = np.maximum(seen.up[alarm], seen.down[alarm])
    axis = int(highest.argmax())
    since = seen.up_since if seen.up[alarm, axis] >= seen.down[alarm, axis] else seen.down_since
    began, noticed = begin + int(since[alarm, axis]), begin + alarm
    before, its = slice(begin, began), slice(began, noticed + 1)
    size = float((_mean(errors[its], sigma[its]) - _mean(errors[before], sigma[before]))[axis])
    # Values that follow each other say less than as many that do not.
    wider = (1 + correlation) / (1 - correlation)
    spread = float(np.sqrt(wider * sum(_variance(sigma[part, axis]) for part in (before, its))))
    return Slip(*AXES[axis], noticed, names[noticed], began, names[began], size, spread)


def _variance(sigma: Float) -> float:
    """Return the variance of the mean of values with these deviations (T,), NaN where there is no value."""
    return float(1 / (1 / sigma[np.isfinite(sigma)] ** 2).sum())
