"""Over a drive: since when a given extrinsic is off, from the steps that edges ask for frame after frame."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from p2o.arrays import Float
from p2o.calibration.audit import AXES
from p2o.calibration.cusum import Charts, autocorrelation, charts, innovations, limit_for
from p2o.calibration.edge_step import EdgeStep
from p2o.results.check import Slip, WatchedFrame

CLIP = 3.0
"""A single frame counts for so many deviations at most: its edges may have been taken for others."""
CORRELATION = 0.3
"""How steps of one frame go with those of the next at least, as measured on drives (`python benchmarks/audit.py`)."""
_MOST_CORRELATION = 0.9


@dataclass(frozen=True)
class Rule:
    """How a drive is watched: `alarms_per_hour` of false alarms are meant at `rate_hz` frames a second.

    The first `settle` frames say what is usual; a chart takes `slack` off each value, half of the shift, in deviations
    of a value, that it notices soonest.
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

    Each step is divided by its likely error and cut off at `CLIP`; the mean of the settling frames is what is usual,
    and what a value says of the next is taken out, so that charts add up what is new. After an alarm what has been seen
    since the slip began is what is usual.
    """
    errors = np.array([np.full(len(AXES), np.nan) if step is None else step.error for step in steps])
    sigma = np.array([np.full(len(AXES), np.nan) if step is None else step.sigma for step in steps])
    level: list[WatchedFrame] = []
    slips: list[Slip] = []
    limit, begin, settled = rule.limit, 0, rule.settle
    settling = _standard(errors[:settled], sigma[:settled])
    correlation = min(max(autocorrelation(settling), CORRELATION), _MOST_CORRELATION)
    while begin < len(names):
        usual = _mean(errors[begin : begin + settled], sigma[begin : begin + settled])
        after = begin + settled
        values = innovations(_standard(errors[after:] - usual, sigma[after:]), correlation)
        seen = charts(values, rule.slack)
        level += [WatchedFrame(name) for name in names[len(level) : after]]
        alarm = _first(seen, limit)
        for at in range(len(values) if alarm is None else alarm + 1):
            level.append(_frame(names[after + at], seen, at, values, limit))
        if alarm is None:
            break
        slips.append(_slip(names, seen, alarm, after, errors, sigma, usual, correlation))
        begin = after + alarm + 1
    return Watched(tuple(level), tuple(slips), correlation, limit)


def _standard(errors: Float, sigma: Float) -> Float:
    return np.clip(errors / sigma, -CLIP, CLIP)


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
    names: Sequence[str],
    seen: Charts,
    alarm: int,
    after: int,
    errors: Float,
    sigma: Float,
    usual: Float,
    correlation: float,
) -> Slip:
    """Return the slip that an alarm tells of: it began where the sum last left zero, and is the mean since."""
    highest = np.maximum(seen.up[alarm], seen.down[alarm])
    axis = int(highest.argmax())
    since = seen.up_since if seen.up[alarm, axis] >= seen.down[alarm, axis] else seen.down_since
    began, noticed = after + int(since[alarm, axis]), after + alarm
    its = slice(began, noticed + 1)
    size = float(_mean(errors[its] - usual, sigma[its])[axis])
    known = np.isfinite(sigma[its, axis])
    # Values that follow each other say less than as many that do not.
    wider = (1 + correlation) / (1 - correlation)
    spread = float(np.sqrt(wider / (1 / sigma[its, axis][known] ** 2).sum()))
    return Slip(*AXES[axis], noticed, names[noticed], began, names[began], size, spread)
