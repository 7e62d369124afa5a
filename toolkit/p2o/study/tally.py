"""What the rows of a study's table come to: means and medians from single calibrations, never from other means."""

from __future__ import annotations

from array import array
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from p2o.geometry.perturb import Perturbation
from p2o.results.verdict import Trust
from p2o.run.protocol import protocol_of
from p2o.run.protocol import told as protocol_told
from p2o.study.held import NONE, Held, held, pooled, trusted_wrong
from p2o.study.store import StoredRow
from p2o.study.study import Published, Study

_BESIDE = 3
"""Means and medians of so many metrics stand side by side; of more, each has a line of its own."""


@dataclass(frozen=True)
class Tally:
    """One row of the table: of `count` calibrations `solved` gave an estimate and `crashed` raised.

    The others were refused and count with the error of their start, which is what the user is left with. `mean` and
    `median` are of absolute errors by metric, over all calibrations whose error is known; NaN where there is none.
    `trust` counts the calibrations by the word of their verdict; those that crashed, and those of stores that know
    nothing of verdicts, have none. `seconds` is the median time of a calibration, extraction and all; NaN where none is
    known. `within` counts those that were solved to within what the study asks for, None where it asks for nothing,
    `worse` those that ended farther from the truth than they began, in rotation or in translation. `held` counts likely
    errors that held, `trusted_wrong` those that were called trusted and are far off (`p2o.study.held`).
    """

    row: str
    section: str
    count: int
    solved: int
    crashed: int
    mean: Mapping[str, float]
    median: Mapping[str, float]
    trust: Mapping[Trust, int]
    seconds: float
    within: int | None
    worse: int
    held: Held
    trusted_wrong: int

    @property
    def refused(self) -> int:
        """How many ended without an estimate, for a reason that the method tells."""
        return self.count - self.solved - self.crashed


def tallies(rows: Iterable[StoredRow], metrics: Sequence[str], within: Perturbation | None = None) -> list[Tally]:
    """Return one tally for each row of the table, in the order in which they first occur."""
    by_row: dict[str, _Count] = {}
    for row in rows:
        if row.row not in by_row:
            by_row[row.row] = _Count(row.section, {metric: array("d") for metric in metrics})
        by_row[row.row].add(row, within)
    return [count.tally(label, within) for label, count in by_row.items()]


@dataclass
class _Count:
    """What is counted of one row of the table, calibration by calibration: numbers alone, as there may be a million."""

    section: str
    errors: Mapping[str, array[float]]
    seconds: array[float] = field(default_factory=lambda: array("d"))
    held: Held = NONE
    trust: Counter[Trust | None] = field(default_factory=Counter)
    count: int = 0
    solved: int = 0
    crashed: int = 0
    within: int = 0
    worse: int = 0
    trusted_wrong: int = 0

    def add(self, row: StoredRow, within: Perturbation | None) -> None:
        self.count += 1
        self.solved += row.solved
        self.crashed += row.crashed
        self.worse += farther(row)
        self.within += within is not None and near(row, within)
        self.trust[row.trust] += 1
        self.held = held([row], self.held)
        self.trusted_wrong += trusted_wrong([row])
        if row.seconds:
            self.seconds.append(_whole_seconds(row))
        for metric, known in self.errors.items():
            if (value := getattr(row, metric)) is not None:
                known.append(abs(value))

    def tally(self, label: str, within: Perturbation | None) -> Tally:
        return Tally(
            row=label,
            section=self.section,
            count=self.count,
            solved=self.solved,
            crashed=self.crashed,
            mean={metric: float(np.mean(v)) if v else float("nan") for metric, v in self.errors.items()},
            median={metric: float(np.median(v)) if v else float("nan") for metric, v in self.errors.items()},
            trust={trust: self.trust[trust] for trust in Trust if self.trust[trust]},
            seconds=float(np.median(self.seconds)) if self.seconds else float("nan"),
            within=None if within is None else self.within,
            worse=self.worse,
            held=self.held,
            trusted_wrong=self.trusted_wrong,
        )


def seconds_of(rows: Iterable[StoredRow]) -> float:
    """Return the median time of a calibration, the extraction of its features included; NaN where none is known."""
    known = [_whole_seconds(row) for row in rows if row.seconds]
    return float(np.median(known)) if known else float("nan")


def _whole_seconds(row: StoredRow) -> float:
    return sum(value for value in row.seconds.values() if value is not None)


def near(row: StoredRow, within: Perturbation) -> bool:
    """Return whether a calibration has an estimate that is so near to the truth."""
    if not row.solved or row.rotation_deg is None or row.translation_m is None:
        return False
    return row.rotation_deg <= within.angle_deg and row.translation_m <= within.distance_m


def farther(row: StoredRow) -> bool:
    """Return whether a calibration ended farther from the truth than it began, in rotation or in translation."""
    sizes = (row.rotation_deg, row.start_rotation_deg), (row.translation_m, row.start_translation_m)
    return row.solved and any(after is not None and before is not None and after > before for after, before in sizes)


def trust_of(rows: Iterable[StoredRow]) -> dict[Trust, int]:
    """Return how many calibrations have which word, best first; words of none are left out."""
    counts = Counter(row.trust for row in rows)
    return {trust: counts[trust] for trust in Trust if counts[trust]}


def told(trust: Mapping[Trust, int]) -> str:
    """Return such counts in words, "-" where there are none."""
    return ", ".join(f"{number} {word}" for word, number in trust.items()) or "-"


def table(study: Study, rows: Sequence[StoredRow]) -> str:
    """Return a table for the eye: what was measured, and beside it what was published."""
    within = study.limits
    found = tallies(rows, study.metrics, within)
    stacked = len(study.metrics) > _BESIDE
    # Those that were refused are among the failed ones.
    words = [word for word in Trust if word is not Trust.REFUSED and any(tally.trust.get(word) for tally in found)]
    trusting, promising = Trust.TRUSTED in words, any(tally.held.count for tally in found)
    counted = ["runs", "failed", *words, *(["trusted wrong"] if trusting else [])]
    counted += ["held 2/3", "held 19/20"] if promising else []
    counted += [*([] if within is None else ["within", "worse"]), "s"]
    if stacked:
        head = ["", *counted, "", *map(_head, study.metrics), ""]
    else:
        numbers = (f"{_head(m)} {word}" for m in study.metrics for word in ("mean", "median"))
        head = ["", *counted, *numbers, ""]
    lines: list[list[str]] = []
    section = ""
    for tally in found:
        if tally.section != section:
            section = tally.section
            lines.append([f"[{section}]" if section else ""])
        counts = [tally.row, str(tally.count), _failed(tally)]
        counts += [str(tally.trust.get(word, 0)) if tally.trust else "-" for word in words]
        counts += ([str(tally.trusted_wrong)] if tally.trust else ["-"]) if trusting else []
        counts += [tally.held.two_thirds, tally.held.nineteen_twentieths] if promising else []
        counts += [] if within is None else [str(tally.within), str(tally.worse)]
        counts.append(brief_seconds(tally.seconds))
        if stacked:
            means, medians = ([_number(m, values[m]) for m in study.metrics] for values in (tally.mean, tally.median))
            lines.append([*counts, "mean", *means, "measured"])
            lines.append([*[""] * len(counts), "median", *medians, "measured"])
        else:
            cells = [_number(m, values[m]) for m in study.metrics for values in (tally.mean, tally.median)]
            lines.append([*counts, *cells, "measured"])
        beside = [p for p in study.published if p.beside in (tally.row, tally.row.rpartition(" @ ")[0])]
        lines += [_published(study, p, len(counted), stacked) for p in beside]
    apart = [p for p in study.published if p.beside is None]
    if apart:
        lines.append(["[published]"])
        lines += [_published(study, p, len(counted), stacked) for p in apart]
    widths = [max((len(line[i]) for line in [head, *lines] if len(line) > i > 0), default=0) for i in range(len(head))]
    widths[0] = max((len(line[0]) for line in lines), default=0)
    below = (*pooled(rows), *_by_protocol(study, rows))
    return "\n".join([*(_line(cells, widths) for cells in (head, *lines)), *below])


def _by_protocol(study: Study, rows: Sequence[StoredRow]) -> list[str]:
    """Return the figures that the protocol reports, a line a row; a refused calibration counts with its start."""
    if study.protocol is None:
        return []
    protocol = protocol_of(study.protocol)
    known: dict[str, list[tuple[Any, Any]]] = {}
    for row in rows:
        if row.truth is not None and row.start is not None:
            known.setdefault(row.row, []).append((row.start if row.estimate is None else row.estimate, row.truth))
    lines = []
    for label, pairs in known.items():
        estimates, truths = (np.array(poses) for poses in zip(*pairs, strict=True))
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
    """Return seconds with two figures, "-" for none."""
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
