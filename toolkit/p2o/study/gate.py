"""A gate for continuous integration: a study may not become worse than a reference file says."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, model_validator

from p2o.errors import InputError, printable
from p2o.files.input_file import read_text
from p2o.files.parsed_text import parse_json
from p2o.files.whole_file import write_whole
from p2o.host.validation import validated
from p2o.results.verdict import Trust
from p2o.study.columns import METRICS
from p2o.study.store import Planned, StoredRow
from p2o.study.study import Study
from p2o.study.tally import Tally, tallies, told

TOLERANCE = {"deg": 0.05, "m": 0.01}
"""How much worse a mean may be, by unit, in a reference that is written for the first time."""

_SHOWN = 8


def _metric(name: str) -> str:
    if name not in METRICS:
        raise ValueError(f"one of: {', '.join(METRICS)}")
    return name


MetricName = Annotated[str, AfterValidator(_metric)]
Size = Annotated[float, Field(ge=0)]
Count = Annotated[int, Field(ge=0)]


class _Part(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class Tolerance(_Part):
    """How much worse than the reference a study may be; edit it in the file, `--update` keeps it.

    `mean` is by metric, in its unit; `rows` says by label where a row has another; `failures` is how many more
    calibrations of a row may be refused; `run` is how far, in the same units, the error of one calibration moves
    before it is shown.
    """

    mean: dict[MetricName, Size]
    rows: dict[str, dict[MetricName, Size]] = Field(default_factory=dict)
    failures: Count = 0
    run: dict[MetricName, Size]


class RowReference(_Part):
    """What one row of the table came to; `runs` holds the error by metric of each calibration, None where refused.

    `trust` counts the calibrations by the word of their verdict; a reference of before may have no such counts.
    """

    count: Count
    failures: Count
    trust: dict[Trust, Count] = Field(default_factory=dict)
    mean: dict[MetricName, Size | None]
    runs: dict[str, dict[MetricName, Size | None] | None]


class Reference(_Part):
    """The reference file of a study."""

    study: str
    tolerance: Tolerance
    rows: dict[str, RowReference]

    @model_validator(mode="after")
    def _known(self) -> Reference:
        for label, values in self.tolerance.rows.items():
            if label not in self.rows:
                raise ValueError(f"no tolerance of row '{label}', which is not in the reference")
            for metric in values.keys() - self.rows[label].mean.keys():
                raise ValueError(f"no tolerance of {metric} of row '{label}', which is not measured")
        return self


@dataclass(frozen=True)
class Ruling:
    """What the gate says: `failures` close it; `moved` are lines on rows and frames that changed either way."""

    failures: tuple[str, ...]
    moved: tuple[str, ...]

    @property
    def open(self) -> bool:
        """True where nothing is worse than it may be."""
        return not self.failures

    def __str__(self) -> str:
        head = "gate: open" if self.open else f"gate: closed, {len(self.failures)} reasons"
        lines = [head, *(f"  FAIL  {line}" for line in self.failures), *(f"  {line}" for line in self.moved)]
        return "\n".join(map(printable, lines))


def make_reference(study: Study, rows: Sequence[StoredRow], old: Reference | None = None) -> Reference:
    """Return the reference of finished rows, with the tolerances of the old one where it has them."""
    tolerance = old.tolerance if old is not None else Tolerance(mean={}, run={})
    usual: dict[str, float] = {metric: TOLERANCE[metric.rpartition("_")[2]] for metric in study.metrics}
    by_row = _by_row(rows)
    found = {
        tally.row: RowReference(
            count=tally.count,
            failures=tally.count - tally.solved,
            trust=dict(tally.trust),
            mean={metric: _finite(value) for metric, value in tally.mean.items()},
            runs={_name(row): _errors(row, study.metrics) for row in by_row[tally.row]},
        )
        for tally in tallies(rows, study.metrics)
    }
    kept = Tolerance(
        mean={**usual, **tolerance.mean},
        rows={label: values for label, values in tolerance.rows.items() if label in found},
        run={**usual, **tolerance.run},
        failures=tolerance.failures,
    )
    return Reference(study=study.name, tolerance=kept, rows=found)


def judge(study: Study, rows: Sequence[StoredRow], missing: Sequence[Planned], reference: Reference) -> Ruling:
    """Return whether finished rows are as good as the reference, within its tolerances.

    It is closed by a crashed or missing row, a mean that is worse, more refused calibrations than may be, a row of
    the reference that the study no longer has or has on fewer frames or seeds, and a row that the reference lacks.
    """
    found = {tally.row: tally for tally in tallies(rows, study.metrics)}
    by_row = _by_row(rows)
    absent_rows = Counter(p.row for p in missing)
    failures = [f"{label}: {number} calibrations are missing" for label, number in absent_rows.items()]
    moved: list[str] = []
    if reference.study != study.name:
        failures.append(f"the reference is of study {reference.study}, not of {study.name}")
    for label, tally in found.items():
        if tally.crashed:
            reasons = [row.reason for row in by_row[label] if row.crashed]
            failures.append(f"{label}: {tally.crashed} of {tally.count} crashed, such as: {reasons[0]}")
        if label not in reference.rows:
            failures.append(f"{label}: not in the reference (write it with --update)")
    for label, expected in reference.rows.items():
        if label not in found:
            if label not in absent_rows:
                failures.append(f"{label}: in the reference, but not in the study")
            continue
        failures += _worse(found[label], expected, reference.tolerance)
        runs = {_name(row): _errors(row, study.metrics) for row in by_row[label]}
        absent = [name for name in expected.runs if name not in runs]
        if absent:
            failures.append(f"{label}: {len(absent)} calibrations of the reference are missing, such as {absent[0]}")
        moved += _moved(found[label], runs, expected, reference.tolerance)
    return Ruling(tuple(failures), tuple(moved))


def _worse(tally: Tally, expected: RowReference, tolerance: Tolerance) -> list[str]:
    out = []
    for metric, before in expected.mean.items():
        now = tally.mean.get(metric)
        if before is not None and now is None:
            out.append(f"{tally.row}: mean {metric} is not measured, was {before:.4f}")
        allowed = tolerance.rows.get(tally.row, {}).get(metric, tolerance.mean.get(metric, 0.0))
        # Whatever is no number is not within the tolerance either.
        if before is not None and now is not None and not now <= before + allowed:
            out.append(f"{tally.row}: mean {metric} {now:.4f}, was {before:.4f} and may be {before + allowed:.4f}")
    refused = tally.count - tally.solved - tally.crashed
    if refused > expected.failures + tolerance.failures:
        out.append(f"{tally.row}: {refused} of {tally.count} calibrations were refused, was {expected.failures}")
    return out


def _moved(
    tally: Tally,
    runs: Mapping[str, Mapping[str, float | None] | None],
    expected: RowReference,
    tolerance: Tolerance,
) -> list[str]:
    """Return lines for the row where its verdicts or means moved, and lines for the calibrations that moved most."""
    lines = []
    if expected.trust and expected.trust != tally.trust:
        lines.append(f"{tally.row}: {told(expected.trust)} -> {told(tally.trust)}")
    for metric, before in expected.mean.items():
        now = tally.mean.get(metric)
        if before is not None and now is not None and abs(now - before) > 1e-9 * max(1.0, abs(before)):
            lines.append(f"{tally.row}: mean {metric} {before:.4f} -> {now:.4f}")
    changes: list[tuple[float, str]] = []
    for name, before_run in expected.runs.items():
        if name not in runs:
            continue
        now_run = runs[name]
        if before_run is None or now_run is None:
            if (before_run is None) != (now_run is None):
                words = ("was refused, now solved", "was solved, now refused or crashed")[before_run is not None]
                changes.append((float("inf"), f"{tally.row}, {name}: {words}"))
            continue
        for metric, value in before_run.items():
            later, allowed = now_run.get(metric), tolerance.run.get(metric, 0.0)
            if value is not None and later is not None and abs(later - value) > allowed:
                size = abs(later - value) / max(allowed, 1e-9)
                changes.append((size, f"{tally.row}, {name}: {metric} {value:.4f} -> {later:.4f}"))
    changes.sort(key=lambda change: -change[0])
    lines += [f"  {text}" for _, text in changes[:_SHOWN]]
    if len(changes) > _SHOWN:
        lines.append(f"  and {len(changes) - _SHOWN} more")
    return lines


def read_reference(path: str | Path) -> Reference:
    """Return the reference of a file; InputError where it is missing or of another form."""
    hint = "write it with --update"
    try:
        text = read_text(path, "reference")
    except InputError as problem:
        raise InputError(problem.what, where=path, expected=problem.expected, got=problem.got, hint=hint) from problem
    try:
        return validated(Reference, parse_json(text, "reference"))
    except InputError as problem:
        raise InputError("this is no reference of a study", where=path, got=problem, hint=hint) from problem


def write_reference(path: str | Path, reference: Reference) -> None:
    """Write a reference, one line a calibration, so that a change can be read in a diff.

    Raises InputError where the file cannot be written.
    """
    content: dict[str, Any] = reference.model_dump(mode="json")
    parts = []
    for label, row in content["rows"].items():
        runs = ",\n".join(f"    {_json(name)}: {_json(values)}" for name, values in row.pop("runs").items())
        parts.append(f'  {_json(label)}: {_json(row)[:-1]}, "runs": {{\n{runs}\n  }}}}')
    head = f'"study": {_json(content["study"])},\n"tolerance": {_json(content["tolerance"])},\n'
    write_whole(path, ("{\n" + head + '"rows": {\n' + ",\n".join(parts) + "\n}}\n").encode())


def _json(value: Any) -> str:
    return json.dumps(value, ensure_ascii=False, allow_nan=False)


def _by_row(rows: Sequence[StoredRow]) -> dict[str, list[StoredRow]]:
    out: dict[str, list[StoredRow]] = {}
    for row in rows:
        out.setdefault(row.row, []).append(row)
    return out


def _name(row: StoredRow) -> str:
    return f"{row.place}, seed {row.seed}"


def _errors(row: StoredRow, metrics: Sequence[str]) -> dict[str, float | None] | None:
    """Return the errors of a calibration, rounded to what a reader can use; None where it was refused."""
    if not row.solved:
        return None
    values = {metric: getattr(row, metric) for metric in metrics}
    return {metric: None if value is None else round(abs(value), 6) for metric, value in values.items()}


def _finite(value: float) -> float | None:
    return None if value != value else value
