"""Regression gate: no row of a study may become worse than in a reference file, within tolerances."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from p2o.errors import InputError, printable
from p2o.files.input_file import read_text
from p2o.files.parsed_text import parse_json
from p2o.files.whole_file import write_whole
from p2o.options import Options, validated
from p2o.results.verdict import Trust
from pydantic import Field, model_validator

from p2o_study.row import Row
from p2o_study.rows import PlanRow
from p2o_study.statistics import Statistics, by_label, trust_text
from p2o_study.study import MetricName, Study

TOLERANCE = {"deg": 0.05, "m": 0.01}
"""Tolerance of a mean by unit, in a reference that is written for the first time."""

_SHOWN = 8


Size = Annotated[float, Field(ge=0)]
Count = Annotated[int, Field(ge=0)]


class Tolerance(Options):
    """How much worse than the reference a study may be; users edit it in the file, `--update` keeps it.

    `mean` is the tolerance of the mean by metric, in its unit, `rows` the exceptions by row label, `failures` the
    number of additional refused calibrations per row. Changes of single calibrations above `run` are listed.
    """

    mean: dict[MetricName, Size]
    rows: dict[str, dict[MetricName, Size]] = Field(default_factory=dict)
    failures: Count = 0
    run: dict[MetricName, Size]


class RowReference(Options):
    """One row of the reference; `runs` holds the errors by metric of each calibration, None where it was refused.

    `trust` counts the calibrations by verdict; references of earlier versions have no counts.
    """

    count: Count
    failures: Count
    trust: dict[Trust, Count] = Field(default_factory=dict)
    mean: dict[MetricName, Size | None]
    runs: dict[str, dict[MetricName, Size | None] | None]


class Reference(Options):
    """The reference file of a study."""

    study: str
    tolerance: Tolerance
    rows: dict[str, RowReference]

    @model_validator(mode="after")
    def _known(self) -> Reference:
        for label, values in self.tolerance.rows.items():
            if label not in self.rows:
                raise ValueError(f"no tolerance of row '{label}': the row is not in the reference")
            for metric in values.keys() - self.rows[label].mean.keys():
                raise ValueError(f"no tolerance of {metric} of row '{label}': the metric is not measured")
        return self


@dataclass(frozen=True)
class Ruling:
    """The outcome of the gate: `failures` close it; `moved` lists rows and calibrations that changed."""

    failures: tuple[str, ...]
    moved: tuple[str, ...]

    @property
    def open(self) -> bool:
        """True if nothing is worse than the tolerances allow."""
        return not self.failures

    def __str__(self) -> str:
        head = "gate: open" if self.open else f"gate: closed, {len(self.failures)} reasons"
        lines = (head, *(f"  FAIL  {line}" for line in self.failures), *(f"  {line}" for line in self.moved))
        return "\n".join(map(printable, lines))


def make_reference(study: Study, rows: Sequence[Row], old: Reference | None = None) -> Reference:
    """Return the reference of finished rows; tolerances of the old reference are kept."""
    tolerance = old.tolerance if old is not None else Tolerance(mean={}, run={})
    usual: dict[str, float] = {metric: TOLERANCE[metric.rpartition("_")[2]] for metric in study.metrics}
    references = {label: _row_reference(own, study.metrics) for label, own in by_label(rows).items()}
    exceptions = {label: values for label, values in tolerance.rows.items() if label in references}
    changes = {"mean": {**usual, **tolerance.mean}, "rows": exceptions, "run": {**usual, **tolerance.run}}
    return Reference(study=study.name, tolerance=tolerance.model_copy(update=changes), rows=references)


def judge(study: Study, rows: Sequence[Row], missing: Sequence[PlanRow], reference: Reference) -> Ruling:
    """Compare finished rows with the reference, within its tolerances.

    The gate is closed by crashed or missing calibrations, a worse mean, too many refused calibrations, a row or
    calibration of the reference that the study lacks, and a row that the reference lacks. A refusal improves no mean.
    """
    stored = by_label(rows)
    absent_rows = Counter(p.row for p in missing)
    failures = [f"{label}: {number} calibrations are missing" for label, number in absent_rows.items()]
    moved: list[str] = []
    if reference.study != study.name:
        failures.append(f"the reference is of study {reference.study}, not of {study.name}")
    for label, own in stored.items():
        if reasons := [row.reason for row in own if row.crashed]:
            failures.append(f"{label}: {len(reasons)} of {len(own)} crashed, such as: {reasons[0]}")
        if label not in reference.rows:
            failures.append(f"{label}: not in the reference (write it with --update)")
    for label, expected in reference.rows.items():
        if label not in stored:
            if label not in absent_rows:
                failures.append(f"{label}: in the reference, but not in the study")
            continue
        compared = _compared(label, stored[label], study.metrics, expected, reference.tolerance)
        failures, moved = failures + compared[0], moved + compared[1]
    return Ruling(tuple(failures), tuple(moved))


def _row_reference(rows: Sequence[Row], metrics: Sequence[str]) -> RowReference:
    statistics = Statistics(rows)
    means = {metric: statistics.average(metric) for metric in metrics}
    return RowReference(
        count=len(rows),
        failures=sum(not row.solved for row in rows),
        trust=dict(statistics.trust),
        mean={metric: None if np.isnan(value) else value for metric, value in means.items()},
        runs={_name(row): _errors(row, metrics) for row in rows},
    )


def _unimproved(rows: Sequence[Row], expected: RowReference, metric: str) -> float:
    """Return a mean in which a refusal is no improvement, NaN where no error is known.

    A refused calibration has the error of its initial guess. If the reference has an estimate with a larger error, the
    larger one counts: otherwise a method would become better by refusing its worst frames.
    """
    errors = []
    for row in rows:
        before = None if row.solved else (expected.runs.get(_name(row)) or {}).get(metric)
        if (error := row.error_of(metric)) is not None:
            errors.append(max(abs(error), before or 0.0))
    return float(np.mean(errors)) if errors else float("nan")


def _compared(
    label: str, rows: Sequence[Row], metrics: Sequence[str], expected: RowReference, tolerance: Tolerance
) -> tuple[list[str], list[str]]:
    """Return why a row closes the gate, and what changed: verdicts, means and the most changed calibrations."""
    now, failures, moved = _row_reference(rows, metrics), list[str](), list[str]()
    if expected.trust and expected.trust != now.trust:
        moved.append(f"{label}: {trust_text(expected.trust)} -> {trust_text(now.trust)}")
    for metric, before in expected.mean.items():
        if before is None:
            continue
        if metric not in metrics:
            failures.append(f"{label}: mean {metric} is not measured, was {before:.4f}")
            continue
        mean, allowed = _unimproved(rows, expected, metric), tolerance.mean.get(metric, 0.0)
        most = before + tolerance.rows.get(label, {}).get(metric, allowed)
        # The negated comparison also fails for NaN.
        if not mean <= most:
            failures.append(f"{label}: mean {metric} {mean:.4f}, was {before:.4f} and may be {most:.4f}")
        if abs(mean - before) > 1e-9 * max(1.0, abs(before)):
            moved.append(f"{label}: mean {metric} {before:.4f} -> {mean:.4f}")
    refused = sum(not (row.solved or row.crashed) for row in rows)
    if refused > expected.failures + tolerance.failures:
        failures.append(f"{label}: {refused} of {now.count} calibrations were refused, was {expected.failures}")
    if absent := [name for name in expected.runs if name not in now.runs]:
        failures.append(f"{label}: {len(absent)} calibrations of the reference are missing, such as {absent[0]}")
    changes: list[tuple[float, str]] = []
    for name, old in expected.runs.items():
        new = now.runs.get(name)
        if name in now.runs and (old is None) != (new is None):
            words = "was refused, now solved" if old is None else "was solved, now refused or crashed"
            changes.append((float("inf"), f"{label}, {name}: {words}"))
        for metric, value in (old or {}).items():
            later, allowed = (new or {}).get(metric), tolerance.run.get(metric, 0.0)
            if value is not None and later is not None and abs(later - value) > allowed:
                size = abs(later - value) / max(allowed, 1e-9)
                changes.append((size, f"{label}, {name}: {metric} {value:.4f} -> {later:.4f}"))
    changes.sort(key=lambda change: -change[0])
    moved += [f"  {text}" for _, text in changes[:_SHOWN]]
    moved += [f"  and {len(changes) - _SHOWN} more"] if len(changes) > _SHOWN else []
    return failures, moved


def read_reference(path: str | Path) -> Reference:
    """Read a reference file; raises InputError if it is missing or invalid."""
    try:
        return validated(Reference, parse_json(read_text(path, "reference"), "reference"))
    except InputError as problem:
        hint = "write it with --update"
        raise InputError("cannot read the reference of a study", where=path, got=problem, hint=hint) from problem


def write_reference(path: str | Path, reference: Reference) -> None:
    """Write a reference with one line per calibration, for readable diffs; raises InputError if that fails."""
    content: dict[str, Any] = reference.model_dump(mode="json")
    parts = []
    for label, row in content["rows"].items():
        runs = ",\n".join(f"    {_json(name)}: {_json(values)}" for name, values in row.pop("runs").items())
        parts.append(f'  {_json(label)}: {_json(row)[:-1]}, "runs": {{\n{runs}\n  }}}}')
    head = f'"study": {_json(content["study"])},\n"tolerance": {_json(content["tolerance"])},\n'
    write_whole(path, ("{\n" + head + '"rows": {\n' + ",\n".join(parts) + "\n}}\n").encode())


def _json(value: Any) -> str:
    return json.dumps(value, ensure_ascii=False, allow_nan=False)


def _name(row: Row) -> str:
    return f"{row.place}, seed {row.seed}"


def _errors(row: Row, metrics: Sequence[str]) -> dict[str, float | None] | None:
    """Return the absolute errors of a calibration, rounded to 6 decimals; None where it was refused."""
    if not row.solved:
        return None
    values = {metric: row.error_of(metric) for metric in metrics}
    return {metric: None if value is None else round(abs(value), 6) for metric, value in values.items()}
