"""Aggregate calibrations to the rows of a study's table: counts, means and medians of single calibrations."""

from __future__ import annotations

from array import array
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from p2o.geometry.perturb import Perturbation
from p2o.results.result import SolverStatus
from p2o.results.verdict import Trust
from p2o.run.protocol import figures_text as protocol_told
from p2o.run.protocol import protocol_of

from p2o_study.coverage import NONE, BoundCoverage, bound_coverage, false_accepts, pooled
from p2o_study.store import StoredRow
from p2o_study.study import Published, Study

_BESIDE = 3
"""Up to this number of metrics, mean and median are columns of one line; otherwise they are two lines."""


@dataclass(frozen=True)
class Counts:
    """Counts over the calibrations of one row.

    `trust` counts calibrations by verdict; crashed ones have none. `seconds` is the median time of a calibration
    including extraction, NaN if unknown. `within` counts solved calibrations within the limits of the study (None
    without limits), `worse` those with a larger rotation or translation error than the initial guess. `coverage` is
    that of the predicted errors, `false_accepts` the number of trusted results with a large error
    (`p2o_study.coverage`).
    """

    trust: Mapping[Trust, int]
    seconds: float
    within: int | None
    worse: int
    coverage: BoundCoverage
    false_accepts: int


@dataclass(frozen=True)
class Tally(Counts):
    """One row of the table: of `count` calibrations `solved` gave an estimate and `crashed` raised.

    The others were refused and count with the error of their initial guess, which is their result. `mean` and
    `median` are of absolute errors by metric over all calibrations with a known error, NaN without any.
    """

    row: str
    section: str
    count: int
    solved: int
    crashed: int
    mean: Mapping[str, float]
    median: Mapping[str, float]

    @property
    def refused(self) -> int:
        """Number of calibrations without an estimate for a reason that the method reports."""
        return self.count - self.solved - self.crashed


def tallies(rows: Iterable[StoredRow], metrics: Sequence[str], within: Perturbation | None = None) -> list[Tally]:
    """Return one tally per row of the table, in the order of first occurrence."""
    by_row: dict[str, RunningCounts] = {}
    for row in rows:
        if row.row not in by_row:
            by_row[row.row] = RunningCounts(within, row.section, {metric: array("d") for metric in metrics})
        by_row[row.row].add(row)
    return [count.tally(label) for label, count in by_row.items()]


def by_row(rows: Iterable[StoredRow]) -> dict[str, list[StoredRow]]:
    """Return the calibrations of each row of the table, in the order of first occurrence."""
    out: dict[str, list[StoredRow]] = {}
    for row in rows:
        out.setdefault(row.row, []).append(row)
    return out


@dataclass
class RunningCounts:
    """Accumulates one row of the table as plain numbers, because there may be a million calibrations."""

    limits: Perturbation | None
    section: str = ""
    errors: Mapping[str, array[float]] = field(default_factory=dict)
    seconds: array[float] = field(default_factory=lambda: array("d"))
    coverage: BoundCoverage = NONE
    trust: Counter[Trust | None] = field(default_factory=Counter)
    count: int = 0
    solved: int = 0
    crashed: int = 0
    within: int = 0
    worse: int = 0
    false_accepts: int = 0

    def add(self, row: StoredRow) -> None:
        """Count a calibration."""
        self.count += 1
        self.solved += row.solved
        self.crashed += row.crashed
        self.worse += is_worse(row)
        self.within += self.limits is not None and is_within(row, self.limits)
        self.trust[row.trust] += 1
        self.coverage = bound_coverage([row], self.coverage)
        self.false_accepts += false_accepts([row])
        if row.total_s is not None:
            self.seconds.append(row.total_s)
        for metric, known in self.errors.items():
            if (value := getattr(row, metric)) is not None:
                known.append(abs(value))

    def counts(self) -> Counts:
        """Return the counts of all calibrations that were added."""
        return Counts(
            trust={trust: self.trust[trust] for trust in Trust if self.trust[trust]},
            seconds=float(np.median(self.seconds)) if self.seconds else float("nan"),
            within=None if self.limits is None else self.within,
            worse=self.worse,
            coverage=self.coverage,
            false_accepts=self.false_accepts,
        )

    def tally(self, label: str) -> Tally:
        """Return the counts and errors of all calibrations that were added."""
        return Tally(
            **vars(self.counts()),
            row=label,
            section=self.section,
            count=self.count,
            solved=self.solved,
            crashed=self.crashed,
            mean={metric: float(np.mean(v)) if v else float("nan") for metric, v in self.errors.items()},
            median={metric: float(np.median(v)) if v else float("nan") for metric, v in self.errors.items()},
        )


def is_within(row: StoredRow, within: Perturbation) -> bool:
    """Return whether a calibration has an estimate with errors within these limits."""
    if not row.solved or row.rotation_deg is None or row.translation_m is None:
        return False
    return row.rotation_deg <= within.angle_deg and row.translation_m <= within.distance_m


def is_worse(row: StoredRow) -> bool:
    """Return whether the rotation or translation error of an estimate exceeds that of the initial guess."""
    sizes = (row.rotation_deg, row.start_rotation_deg), (row.translation_m, row.start_translation_m)
    return row.solved and any(after is not None and before is not None and after > before for after, before in sizes)


def trust_text(trust: Mapping[Trust, int]) -> str:
    """Return counts by verdict as text, "-" without any."""
    return ", ".join(f"{number} {word}" for word, number in trust.items()) or "-"


def table(study: Study, rows: Sequence[StoredRow]) -> str:
    """Return the table of a study as text: measured rows, each followed by the published rows it compares with."""
    within = study.limits
    row_tallies = tallies(rows, study.metrics, within)
    stacked = len(study.metrics) > _BESIDE
    # Refused calibrations are part of the column "failed".
    words = [
        word for word in Trust if word is not Trust.REFUSED and any(tally.trust.get(word) for tally in row_tallies)
    ]
    trusting, promising = Trust.TRUSTED in words, any(tally.coverage.count for tally in row_tallies)
    counted = ["runs", "failed", *words, *(["false accepts"] if trusting else [])]
    counted += ["coverage 67 %", "coverage 95 %"] if promising else []
    counted += [*([] if within is None else ["within", "worse"]), "s"]
    if stacked:
        head = ["", *counted, "", *map(_head, study.metrics), ""]
    else:
        numbers = (f"{_head(m)} {word}" for m in study.metrics for word in ("mean", "median"))
        head = ["", *counted, *numbers, ""]
    lines: list[list[str]] = []
    section = ""
    for tally in row_tallies:
        if tally.section != section:
            section = tally.section
            lines.append([f"[{section}]" if section else ""])
        counts = [tally.row, str(tally.count), _failed(tally)]
        counts += [str(tally.trust.get(word, 0)) if tally.trust else "-" for word in words]
        counts += ([str(tally.false_accepts)] if tally.trust else ["-"]) if trusting else []
        counts += [tally.coverage.text_67, tally.coverage.text_95] if promising else []
        counts += [] if within is None else [str(tally.within), str(tally.worse)]
        counts.append(brief_seconds(tally.seconds))
        if stacked:
            means, medians = ([_number(m, values[m]) for m in study.metrics] for values in (tally.mean, tally.median))
            lines.append([*counts, "mean", *means, "measured"])
            lines.append([*[""] * len(counts), "median", *medians, "measured"])
        else:
            cells = [_number(m, values[m]) for m in study.metrics for values in (tally.mean, tally.median)]
            lines.append([*counts, *cells, "measured"])
        lines += [_published(study, p, len(counted), stacked) for p in study.published if p.compares_with(tally.row)]
    apart = [p for p in study.published if p.beside is None]
    if apart:
        lines.append(["[published]"])
        lines += [_published(study, p, len(counted), stacked) for p in apart]
    widths = [max((len(line[i]) for line in [head, *lines] if len(line) > i > 0), default=0) for i in range(len(head))]
    widths[0] = max((len(line[0]) for line in lines), default=0)
    below = (*pooled(rows), *_unmoved(rows), *_by_protocol(study, rows))
    return "\n".join([*(_line(cells, widths) for cells in (head, *lines)), *below])


def is_unmoved(row: StoredRow) -> bool:
    """Return whether the estimate of a calibration is its initial guess: its solver did not move."""
    if not row.solved or row.start is None or row.estimate is None:
        return False
    status = SolverStatus.of(np.asarray(row.start), np.asarray(row.estimate), converged=True)
    return status is SolverStatus.NOT_MOVED


def _unmoved(rows: Sequence[StoredRow]) -> list[str]:
    """Return a line for each row of the table with results that are the initial guess, without being refused."""
    lines = []
    for label, known in by_row(rows).items():
        count = sum(map(is_unmoved, known))
        if count:
            lines.append(
                f"{label}: {count} of {len(known)} results are the initial guess, which the solver did not move"
            )
    return lines


def _by_protocol(study: Study, rows: Sequence[StoredRow]) -> list[str]:
    """Return the figures of the protocol, one line per row; a refused calibration counts with its initial guess."""
    if study.protocol is None:
        return []
    protocol = protocol_of(study.protocol)
    lines = []
    for label, known in by_row(row for row in rows if row.truth is not None and row.start is not None).items():
        estimates = np.array([row.start if row.estimate is None else row.estimate for row in known])
        truths = np.array([row.truth for row in known])
        lines.append(f"{label}: {protocol_told(protocol, protocol.figures(estimates, truths))}")
    return lines


def _line(cells: Sequence[str], widths: Sequence[int]) -> str:
    numbers = [cell.rjust(width) for cell, width in zip(cells[1:], widths[1:], strict=False)]
    return "  ".join([cells[0].ljust(widths[0]), *numbers]).rstrip()


def _published(study: Study, row: Published, counted: int, stacked: bool) -> list[str]:
    means = [_number(m, row.values.get(m)) for m in study.metrics]
    numbers = ["mean", *means] if stacked else [cell for mean in means for cell in (mean, "")]
    return [f"  {row.label}", *[""] * counted, *numbers, "published"]


def brief_seconds(value: float) -> str:
    """Return seconds with two significant digits, "-" for NaN."""
    if np.isnan(value):
        return "-"
    return f"{value:.0f}" if value >= 10 else f"{value:.1f}" if value >= 1 else f"{value:.2f}"


def _failed(tally: Tally) -> str:
    crashed = f" ({tally.crashed} crashed)" if tally.crashed else ""
    return f"{tally.refused + tally.crashed}{crashed}"


def _head(metric: str) -> str:
    name, _, unit = metric.rpartition("_")
    return f"{ {'rotation': 'rot', 'translation': 'trans'}.get(name, name) } {unit}"


def _number(metric: str, value: float | None) -> str:
    if value is None or np.isnan(value):
        return "-"
    return f"{value:.3f}"
