"""Regression gate: no row of a study may become worse than in a reference file, within tolerances."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Mapping, Sequence
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
    references = {
        label: RowReference(
            count=len(own),
            failures=sum(not row.solved for row in own),
            trust=dict(Statistics(own).trust),
            mean={metric: None if np.isnan(value) else value for metric, value in _means(own, study.metrics).items()},
            runs={_name(row): _errors(row, study.metrics) for row in own},
        )
        for label, own in by_label(rows).items()
    }
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
        own = stored[label]
        means = _unimproved(own, expected, study.metrics)
        failures += _worse(label, Statistics(own), means, expected, reference.tolerance)
        runs = {_name(row): _errors(row, study.metrics) for row in own}
        absent = [name for name in expected.runs if name not in runs]
        if absent:
            failures.append(f"{label}: {len(absent)} calibrations of the reference are missing, such as {absent[0]}")
        moved += _moved(label, Statistics(own), means, runs, expected, reference.tolerance)
    return Ruling(tuple(failures), tuple(moved))


def _means(rows: Sequence[Row], metrics: Sequence[str]) -> dict[str, float]:
    """Return the mean absolute error by metric, NaN where no error is known."""
    statistics = Statistics(rows)
    return {metric: statistics.average(metric) for metric in metrics}


def _unimproved(rows: Sequence[Row], expected: RowReference, metrics: Sequence[str]) -> dict[str, float]:
    """Return means in which a refusal is no improvement.

    A refused calibration has the error of its initial guess. If the reference has an estimate with a larger error, the
    larger one counts: otherwise a method would become better by refusing its worst frames.
    """
    means: dict[str, float] = {}
    for metric in metrics:
        errors = []
        for row in rows:
            before = None if row.solved else (expected.runs.get(_name(row)) or {}).get(metric)
            if (error := row.error_of(metric)) is not None:
                errors.append(max(abs(error), before or 0.0))
        means[metric] = float(np.mean(errors)) if errors else float("nan")
    return means


def _worse(
    label: str, statistics: Statistics, means: Mapping[str, float], expected: RowReference, tolerance: Tolerance
) -> list[str]:
    out = []
    for metric, before in expected.mean.items():
        now = means.get(metric)
        if before is not None and now is None:
            out.append(f"{label}: mean {metric} is not measured, was {before:.4f}")
        allowed = tolerance.rows.get(label, {}).get(metric, tolerance.mean.get(metric, 0.0))
        # The negated comparison also fails for NaN.
        if before is not None and now is not None and not now <= before + allowed:
            out.append(f"{label}: mean {metric} {now:.4f}, was {before:.4f} and may be {before + allowed:.4f}")
    if statistics.refused > expected.failures + tolerance.failures:
        count = f"{statistics.refused} of {statistics.count}"
        out.append(f"{label}: {count} calibrations were refused, was {expected.failures}")
    return out


def _moved(
    label: str,
    statistics: Statistics,
    means: Mapping[str, float],
    runs: Mapping[str, Mapping[str, float | None] | None],
    expected: RowReference,
    tolerance: Tolerance,
) -> list[str]:
    """Return lines on changed verdicts and means of the row, and on the calibrations that changed most."""
    lines = []
    if expected.trust and expected.trust != statistics.trust:
        lines.append(f"{label}: {trust_text(expected.trust)} -> {trust_text(statistics.trust)}")
    for metric, before in expected.mean.items():
        now = means.get(metric)
        if before is not None and now is not None and abs(now - before) > 1e-9 * max(1.0, abs(before)):
            lines.append(f"{label}: mean {metric} {before:.4f} -> {now:.4f}")
    changes: list[tuple[float, str]] = []
    for name, before_run in expected.runs.items():
        if name not in runs:
            continue
        now_run = runs[name]
        if before_run is None or now_run is None:
            if (before_run is None) != (now_run is None):
                words = ("was refused, now solved", "was solved, now refused or crashed")[before_run is not None]
                changes.append((float("inf"), f"{label}, {name}: {words}"))
            continue
        for metric, value in before_run.items():
            later, allowed = now_run.get(metric), tolerance.run.get(metric, 0.0)
            if value is not None and later is not None and abs(later - value) > allowed:
                size = abs(later - value) / max(allowed, 1e-9)
                changes.append((size, f"{label}, {name}: {metric} {value:.4f} -> {later:.4f}"))
    changes.sort(key=lambda change: -change[0])
    lines += [f"  {text}" for _, text in changes[:_SHOWN]]
    if len(changes) > _SHOWN:
        lines.append(f"  and {len(changes) - _SHOWN} more")
    return lines


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
