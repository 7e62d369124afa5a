"""Statistics of calibrations: errors with intervals over groups, coverage of predicted errors, false accepts.

The terminal, tables, pages, the gate and the comparison all take their figures from here. Intervals are confidence
intervals by cluster bootstrap: groups of frames are resampled with all their seeds. Seeds of one frame share image and
sweep and are not independent: resampling single calibrations would give too narrow intervals. Efron and Tibshirani, An
Introduction to the Bootstrap (1993), sections 8.5 and 13.3.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import Literal

import numpy as np
from p2o.arrays import Float, Int, UInt8
from p2o.geometry.perturb import Perturbation
from p2o.results.verdict import Trust

from p2o_study.row import METRICS, NORMS, PER_AXIS, Row

RESAMPLES = 2000
SHARE = 0.95
MIN_FRAMES = 5
"""With fewer frames there are too few distinct resamples for an interval: none is given."""
_WEIGHTS_AT_ONCE = 2_000_000
"""Maximum number of weights (resamples x values) in memory."""

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
    step = max(1, _WEIGHTS_AT_ONCE // len(sample))
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
    upto = np.cumsum(weights[:, frame], axis=1)
    middles = [ordered[np.argmax(upto > before[:, None], axis=1)] for before in ((total - 1) // 2, total // 2)]
    return np.asarray((middles[0] + middles[1]) / 2)


WRONG = Perturbation(angle_deg=1.0, distance_m=0.3)
"""A trusted result with a larger rotation or translation error is a false accept."""
WRONG_TEXT = f"with an error above {WRONG.angle_deg:g} deg or {100 * WRONG.distance_m:g} cm"
FRAMES_TEXT = (
    "in brackets distinct frames with such a result of those with a trusted one, for none the upper 95 % limit"
)
"""How to read a `Share`."""
BOUNDS = tuple(f"{norm}{suffix}" for suffix in ("", "_95") for norm in NORMS)
"""The predicted errors of a result: rotation and translation, 67 % and 95 %."""
NOT_RUN = "not run"
"""Failure of calibrations that are planned but not computed."""

GroupOf = Callable[[Row], str]


def by_frames(row: Row) -> str:
    """Return the independent group of a row if frames are independent: its data set and frames."""
    return f"{row.dataset}: {row.place}"


def by_drive(row: Row) -> str:
    """Return the independent group of a row if drives are independent: its data set, and its frames up to the "/"."""
    return f"{row.dataset}: {row.frames[0].rpartition('/')[0]}"


def is_within(row: Row, limits: Perturbation) -> bool:
    """Return whether a calibration has an estimate with errors within these limits."""
    return row.solved and row.error is not None and not _exceeds(row, limits)


def is_wrong(row: Row) -> bool:
    """Return whether the known error of a result is larger than `WRONG`."""
    return _exceeds(row, WRONG)


def _exceeds(row: Row, limits: Perturbation) -> bool:
    error = row.error
    return error is not None and (error.rotation_deg > limits.angle_deg or error.translation_m > limits.distance_m)


def is_worse(row: Row) -> bool:
    """Return whether the rotation or translation error of an estimate exceeds that of the initial guess."""
    before, after = row.case.start_error, row.error
    if not row.solved or before is None or after is None:
        return False
    return after.rotation_deg > before.rotation_deg or after.translation_m > before.translation_m


def is_covered(row: Row) -> dict[str, bool]:
    """Return for each of `BOUNDS` that is known whether the error is within it; empty if the error is unknown."""
    if not row.solved or row.error is None:
        return {}
    bounds = {name: row.predicted(name) for name in BOUNDS}
    errors = {name: row.error_of(name.removesuffix("_95")) for name in BOUNDS}
    pairs = [(name, errors[name], bound) for name, bound in bounds.items()]
    return {name: error <= bound for name, error, bound in pairs if error is not None and bound is not None}


def is_outside_95(row: Row) -> bool:
    """Return whether the rotation or translation error of a result exceeds its own 95 % bound."""
    covered = is_covered(row)
    return not all(covered.get(name, True) for name in BOUNDS[2:])


def error_rank(row: Row) -> tuple[float, int]:
    """Return a sort key of calibrations: the rotation error, then the verdict."""
    error = -1.0 if row.error is None else row.error.rotation_deg
    return error, -1 if row.trust is None else list(Trust).index(row.trust)


@dataclass(frozen=True)
class Coverage:
    """The coverage of predicted errors over `count` results with predicted and known errors.

    `within` counts, for each of `BOUNDS`, the errors within it. An infinite predicted error covers every error.
    """

    count: int
    within: Mapping[str, int]


@dataclass(frozen=True)
class Share:
    """Trusted results of one kind: `runs` of them, on `frames` of `out_of` distinct frames or groups of frames.

    Several initial guesses of one frame are no independent trials: limits are over distinct frames.
    """

    runs: int
    frames: int
    out_of: int

    @property
    def limit(self) -> float:
        """The upper 95 % limit of the share of frames if no frame has such a result, exact (Clopper, Pearson 1934)."""
        return float(1 - (1 - SHARE) ** (1 / self.out_of)) if self.out_of else 1.0

    def __str__(self) -> str:
        """Return "0 (< 4 %)", or with such results "6 (4 of 20)": runs, and frames of those with a trusted result."""
        if not self.out_of:
            return str(self.runs)
        return (
            f"{self.runs} ({self.frames} of {self.out_of})" if self.runs else f"0 (< {math.ceil(100 * self.limit)} %)"
        )


@dataclass(frozen=True, eq=False)
class Statistics:
    """The figures of `rows`, calibrations of one row of a table named `label`.

    `waiting` further ones are planned but not computed.

    Refused calibrations count with the error of their initial guess, which is their result; those that raised have no
    error. `group_of` names the independent group of a row, `within` are the limits of a study.
    """

    rows: Sequence[Row]
    label: str = ""
    group_of: GroupOf = by_frames
    within: Perturbation | None = None
    waiting: int = 0

    @property
    def count(self) -> int:
        """Number of calibrations."""
        return len(self.rows)

    @cached_property
    def solved(self) -> int:
        """Number of calibrations with an estimate."""
        return sum(row.solved for row in self.rows)

    @cached_property
    def crashed(self) -> int:
        """Number of calibrations that raised."""
        return sum(row.crashed for row in self.rows)

    @cached_property
    def failures(self) -> Mapping[str, int]:
        """Number of calibrations without an estimate by status, and of those that are not computed."""
        counts = Counter(row.status.value for row in self.rows if not row.solved)
        return {**dict(sorted(counts.items())), **({NOT_RUN: self.waiting} if self.waiting else {})}

    @cached_property
    def frames(self) -> int:
        """Number of distinct frames."""
        return len({(row.dataset, name) for row in self.rows for name in row.frames})

    @cached_property
    def groups(self) -> int:
        """Number of independent groups."""
        return len(set(self._groups))

    @cached_property
    def protocols(self) -> tuple[str, ...]:
        """The draws of the initial guesses."""
        return tuple(dict.fromkeys(row.case.protocol for row in self.rows))

    @cached_property
    def trust(self) -> Mapping[Trust, int]:
        """Number of calibrations by verdict; crashed ones and external methods have none."""
        counts = Counter(row.trust for row in self.rows)
        return {trust: counts[trust] for trust in Trust if counts[trust]}

    @property
    def judged(self) -> bool:
        """True if any calibration has a verdict other than a refusal."""
        return any(trust is not Trust.REFUSED for trust in self.trust)

    @property
    def trusted(self) -> int:
        """Number of trusted results."""
        return self.trust.get(Trust.TRUSTED, 0)

    @property
    def title(self) -> str:
        """The label, with the number of results that are the initial guess if there are any."""
        return f"{self.label} ({self.unmoved} of {self.count} not moved)" if self.unmoved else self.label

    @cached_property
    def false_accepts(self) -> Share:
        """The trusted results with an error above `WRONG`."""
        return self._accepted(is_wrong)

    @cached_property
    def outside_95(self) -> Share:
        """The trusted results whose rotation or translation error exceeds their own 95 % bound."""
        return self._accepted(is_outside_95, lambda row: bool(is_covered(row)))

    def _accepted(self, test: Callable[[Row], bool], known: Callable[[Row], bool] = lambda row: True) -> Share:
        trusted = [row for row in self.rows if row.trust is Trust.TRUSTED and row.error is not None and known(row)]
        wrong = [row for row in trusted if test(row)]
        return Share(len(wrong), len(set(map(by_frames, wrong))), len(set(map(by_frames, trusted))))

    @cached_property
    def unmoved(self) -> int:
        """Number of results that are the initial guess although they are not refused."""
        return sum(row.unmoved for row in self.rows)

    @cached_property
    def coverage(self) -> Coverage:
        """The coverage of the predicted errors."""
        known = [covered for row in self.rows if len(covered := is_covered(row)) == len(BOUNDS)]
        return Coverage(len(known), {name: sum(covered[name] for covered in known) for name in BOUNDS})

    @cached_property
    def reached(self) -> int | None:
        """Number of estimates within the limits; None without limits."""
        limits = self.within
        return None if limits is None else sum(is_within(row, limits) for row in self.rows)

    @cached_property
    def worse(self) -> int:
        """Number of estimates with a larger rotation or translation error than the initial guess."""
        return sum(map(is_worse, self.rows))

    @cached_property
    def seconds(self) -> float:
        """Median time of a calibration including extraction, NaN if unknown."""
        known = [row.total_s for row in self.rows if row.total_s is not None]
        return float(np.median(known)) if known else math.nan

    @cached_property
    def predicted(self) -> Mapping[str, float]:
        """Median predicted error (67 %) by norm, where there is any."""
        known = {norm: [row.predicted(norm) for row in self.rows if row.solved] for norm in NORMS}
        values = {norm: [value for value in some if value is not None] for norm, some in known.items()}
        return {norm: float(np.median(some)) for norm, some in values.items() if some}

    @property
    def complete(self) -> bool:
        """True if every planned calibration has an error."""
        return bool(self.rows) and not self.waiting and len(self._errors[1]) == self.count

    def errors(self, metric: str) -> Float:
        """Return the known absolute errors (K,) in one of `METRICS`."""
        return np.abs(self.signed(metric))

    def signed(self, metric: str) -> Float:
        """Return the known errors (K,) in one of `METRICS`, signed by axis, or the mean sizes of one of `PER_AXIS`."""
        if metric in PER_AXIS:
            return np.asarray(np.mean([self.errors(axis) for axis in PER_AXIS[metric]], axis=0))
        return np.asarray(self._errors[0][:, METRICS.index(metric)])

    def mean(self, metric: str) -> Interval | None:
        """Return the mean absolute error with its interval; None where no error is known."""
        return self._interval(metric, "mean")

    def median(self, metric: str) -> Interval | None:
        """Return the median absolute error with its interval; None where no error is known."""
        return self._interval(metric, "median")

    def average(self, metric: str) -> float:
        """Return the mean absolute error without an interval, NaN where no error is known."""
        errors = self.errors(metric)
        return float(errors.mean()) if len(errors) else math.nan

    @cached_property
    def solved_only(self) -> Statistics:
        """The statistics of the calibrations with an estimate alone."""
        return replace(self, rows=[row for row in self.rows if row.solved], waiting=0)

    @cached_property
    def _groups(self) -> list[str]:
        return [self.group_of(row) for row in self.rows]

    @cached_property
    def _errors(self) -> tuple[Float, Sequence[str]]:
        """Return errors (K, metrics) of the calibrations with a known error, and their groups."""
        known = [
            (row.error, group) for row, group in zip(self.rows, self._groups, strict=True) if row.error is not None
        ]
        values = [[e.rotation_deg, e.translation_m, *e.per_axis.values()] for e, _ in known]
        return np.array(values, np.float64).reshape(-1, len(METRICS)), [group for _, group in known]

    @cached_property
    def _intervals(self) -> dict[tuple[str, Statistic], Interval | None]:
        return {}

    def _interval(self, metric: str, statistic: Statistic) -> Interval | None:
        if (metric, statistic) not in self._intervals:
            self._intervals[metric, statistic] = interval(self.errors(metric), self._errors[1], statistic)
        return self._intervals[metric, statistic]


def by_label(rows: Iterable[Row]) -> dict[str, list[Row]]:
    """Return the calibrations of each row of the table, in the order of first occurrence."""
    labels: dict[str, list[Row]] = {}
    for row in rows:
        labels.setdefault(row.row, []).append(row)
    return labels


def pooled(rows: Sequence[Row]) -> list[str]:
    """Return lines on the coverage of predicted errors and on wrong trusted results over all rows."""
    figures, lines = Statistics(rows), []
    coverage = figures.coverage
    if coverage.count:
        shares = (f"{100 * coverage.within[name] / coverage.count:.0f} %" for name in BOUNDS)
        text = "{} of rotations and {} of translations (67 % expected), {} of rotations and {} of translations"
        lines.append(
            f"Coverage of the predicted errors of {coverage.count} runs: {text.format(*shares)} (95 % expected)"
        )
    if figures.trusted:
        outside = f"{figures.outside_95} outside their own 95 % bound (in brackets: distinct frames)"
        lines.append(f"Trusted: {figures.trusted} runs, {figures.false_accepts} of them {WRONG_TEXT}, {outside}")
    return lines


@dataclass(frozen=True)
class Difference:
    """The difference of two rows in one metric: negative is better; `better` and `tied` are shares of the pairs."""

    median: Interval
    better: float
    tied: float


@dataclass(frozen=True)
class Comparison:
    """Two rows on their common frames and seeds (`pairs`). `other_start`: the draws of their initial guesses differ."""

    row: str
    against: str
    pairs: int
    differences: Mapping[str, Difference]
    other_start: bool


def compared(row: Statistics, against: Statistics) -> Comparison | None:
    """Return the comparison of two rows of a table, None without common frames and seeds of known errors."""
    others = {(other.frames, other.seed): other for other in against.rows if other.error is not None}
    pairs = [
        (one, others[one.frames, one.seed])
        for one in row.rows
        if one.error is not None and (one.frames, one.seed) in others
    ]
    if not pairs:
        return None
    groups = [row.group_of(one) for one, _ in pairs]
    differences = {}
    for norm in NORMS:
        steps = np.array([(one.error_of(norm) or 0.0) - (other.error_of(norm) or 0.0) for one, other in pairs])
        median = interval(steps, groups, "median")
        if median is not None:
            differences[norm] = Difference(median, float((steps < 0).mean()), float((steps == 0).mean()))
    return Comparison(row.title, against.title, len(pairs), differences, row.protocols != against.protocols)


def top_groups(intervals: Sequence[Interval | None]) -> list[int | None]:
    """Return the group of each mean, 1 for the smallest ones; None without an interval.

    Means whose intervals overlap are in one group, also through a third one whose interval overlaps with both: within
    a group there is no order.
    """
    known = [
        (each.low, each.high, i)
        for i, each in enumerate(intervals)
        if each is not None and each.low is not None and each.high is not None
    ]
    groups: list[int | None] = [None] * len(intervals)
    group, reach = 0, -math.inf
    for low, high, number in sorted(known, key=lambda entry: entry[0]):
        group += low > reach
        reach = max(reach, high)
        groups[number] = group
    return groups


def brief_seconds(value: float) -> str:
    """Return seconds with two significant digits, "-" for NaN."""
    if np.isnan(value):
        return "-"
    return f"{value:.0f}" if value >= 10 else f"{value:.1f}" if value >= 1 else f"{value:.2f}"


def trust_text(trust: Mapping[Trust, int]) -> str:
    """Return counts by verdict as text, "-" without any."""
    return ", ".join(f"{number} {word}" for word, number in trust.items()) or "-"
