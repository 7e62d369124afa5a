"""External methods: initial guesses as a CSV file, and poses of any program as rows of the benchmark."""

from __future__ import annotations

import csv
import hashlib
import io
import math
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from p2o.arrays import Float
from p2o.errors import InputError, UnknownNameError
from p2o.files.input_file import MAX_TEXT_BYTES, read_bytes, read_text
from p2o.geometry import se3
from p2o.results.result import Status
from p2o.results.verdict import Trust

from p2o_study.cells import Cell
from p2o_study.row import Case, Environment, Method, Row, content_id
from p2o_study.worker import FrameRecord, now

KEY = ("group", "protocol", "seed")
"""Columns that identify a calibration of a suite."""
MATRIX = tuple(f"m{row}{column}" for row in range(4) for column in range(4))
QUATERNION = ("qx", "qy", "qz", "qw", "tx", "ty", "tz")
_SHOWN = 3
_NUMBER = re.compile(r"[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d{1,3})?", re.ASCII)
_ROUNDING = 1e-3
"""Largest deviation of a rotation from orthonormal that printed digits explain; it is projected onto SO(3)."""

Key = tuple[str, str, int]


@dataclass(frozen=True, eq=False)
class Start:
    """A calibration that every method of a suite makes, its frames, and the sections in which it occurs."""

    case: Case
    sections: tuple[str, ...]
    records: tuple[FrameRecord, ...] = ()


def starts_of(cells: Iterable[Cell], section: str | None = None) -> dict[Key, Start]:
    """Return the calibrations of a suite, or of one section, by group, protocol and seed: the same for all methods.

    Those of rigs are left out: their poses need the transforms between the cameras. Raises InputError if two methods
    have different initial guesses or frames for one of them, UnknownNameError for a section without calibrations.
    """
    starts: dict[Key, Start] = {}
    first: dict[Key, str] = {}
    for cell in cells:
        planned, case = cell.row, cell.row.case
        if cell.group.rig or case.start is None or not cell.group.readable:
            continue
        key = f"{case.dataset}: {case.place}", case.protocol, case.seed
        known = starts.setdefault(key, Start(case, (), cell.group.records))
        label = first.setdefault(key, planned.row)
        assert known.case.start is not None
        if not np.array_equal(known.case.start, case.start) or known.case.names != case.names:
            text = f"rows '{label}' and '{planned.row}' differ in frames or initial guess"
            raise InputError(text, where=f"{key[0]}, {key[1]}, seed {key[2]}", expected="the same for all")
        if planned.section not in known.sections:
            starts[key] = replace(known, sections=(*known.sections, planned.section))
    if section is None:
        return starts
    sections = {name for start in starts.values() for name in start.sections}
    if section not in sections:
        raise UnknownNameError("section", section, sections)
    return {key: replace(start, sections=(section,)) for key, start in starts.items() if section in start.sections}


def starts_csv(starts: Mapping[Key, Start]) -> str:
    """Return the initial guesses as CSV: group, protocol, seed, frames (separated by ";"), camera_from_lidar (4, 4)."""
    rows = [(*key, ";".join(start.case.names), *pose_cells(start.case.start)) for key, start in starts.items()]
    return csv_text((*KEY, "frames", *MATRIX), rows)


def pose_cells(pose: Float | None) -> list[str]:
    """Return the cells of a pose (4, 4) by `MATRIX`, which are empty without one."""
    return [""] * len(MATRIX) if pose is None else [repr(float(x)) for x in pose.ravel()]


def csv_text(header: Sequence[str], rows: Iterable[Sequence[Any]]) -> str:
    """Return rows as CSV."""
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows([header, *rows])
    return text.getvalue()


def score(
    path: Path, starts: Mapping[Key, Start], name: str, *, source: str, measured_by: str, known: Iterable[str] = ()
) -> list[Row]:
    """Return the rows of an external method from its file of poses, one for each section of a calibration.

    The file is CSV with a header: group, protocol and seed as in `starts_csv`, then camera_from_lidar as m00 to m33, or
    as qx, qy, qz, qw, tx, ty, tz (quaternion with the scalar last, translation in metres), and optionally seconds.
    Empty pose columns are a refused calibration. `known` are the labels of the suite's own rows.

    Raises InputError with file and line for a pose that is missing, doubled, unknown or not rigid.
    """
    if name in known:
        raise InputError(f"'{name}' is a row of the suite", where="--name", expected="another name")
    digest = hashlib.sha256(read_bytes(path, "file of poses", MAX_TEXT_BYTES)).hexdigest()
    method = Method(digest, external=True, source=source)
    environment = Environment(commit="external", measured_by=measured_by)
    rows: list[Row] = []
    lines: dict[Key, int] = {}
    for number, values in records(path):
        where = f"{path}:{number}"
        key = values["group"], values["protocol"], _seed(values["seed"], where)
        if key not in starts:
            names = (", ".join(map(str, start)) for start in starts)
            raise UnknownNameError("calibration", ", ".join(map(str, key)), names, where=where)
        if key in lines:
            text = f"a second pose for {key[0]}, {key[1]}, seed {key[2]}"
            raise InputError(text, where=where, expected="one line each", got=f"the first in line {lines[key]}")
        lines[key] = number
        pose, seconds = pose_in(values, where), values.get("seconds", "").strip()
        rows += [
            Row(
                content_id([name, digest, section, *key]),
                name,
                starts[key].case,
                method,
                section,
                status=Status.NO_IMPROVEMENT if pose is None else Status.CONVERGED,
                reason="no pose in the file" if pose is None else "",
                estimate=pose,
                trust=Trust.REFUSED if pose is None else None,
                seconds={"total": _finite(seconds, "seconds", where)} if seconds else {},
                environment=environment,
                finished=now(),
            )
            for section in starts[key].sections
        ]
    missing = [key for key in starts if key not in lines]
    if missing:
        shown = "; ".join(f"{group}, {protocol}, seed {seed}" for group, protocol, seed in missing[:_SHOWN])
        hint = "write a line with an empty pose where the method refuses"
        text = f"{len(missing)} of {len(starts)} poses are missing"
        raise InputError(text, where=path, expected="a line for each initial guess of the suite", got=shown, hint=hint)
    return rows


def records(path: Path) -> Iterable[tuple[int, dict[str, str]]]:
    """Yield line number and values by column; raises InputError for a wrong header or number of columns."""
    text = read_text(path, "file of poses").lstrip("\ufeff")
    reader = csv.DictReader(io.StringIO(text, newline=""), strict=True)
    expected = f"columns {', '.join(KEY)}, and {MATRIX[0]} to {MATRIX[-1]} or {', '.join(QUATERNION)}"
    try:
        reader.fieldnames = header = [column.strip() for column in reader.fieldnames or ()]
        columns = set(header)
        complete = columns.issuperset(KEY) and columns.issuperset(MATRIX) != columns.issuperset(QUATERNION)
        if len(columns) < len(header) or not complete:
            got = ", ".join(header)
            raise InputError("the columns are not those of poses", where=f"{path}:1", expected=expected, got=got)
        for values in reader:
            # None is the name of surplus values, and the value of missing ones.
            if None in values or None in values.values():
                raise InputError("wrong number of columns", where=f"{path}:{reader.line_num}", expected=len(header))
            yield reader.line_num, values
    except csv.Error as problem:
        raise InputError("the file of poses is not CSV", where=f"{path}:{reader.line_num}", got=problem) from problem


def _seed(text: str, where: str) -> int:
    if not re.fullmatch("[0-9]{1,10}", text.strip()):
        raise InputError("the seed is not valid", where=where, expected="a whole number", got=repr(text))
    return int(text)


def pose_in(values: Mapping[str, str], where: str) -> Float | None:
    """Return camera_from_lidar (4, 4), None for an empty pose; raises InputError for one that is not rigid."""
    columns: Sequence[str] = MATRIX if MATRIX[0] in values else QUATERNION
    texts = [values[column].strip() for column in columns]
    if not any(texts):
        return None
    numbers = [_finite(text, column, where) for text, column in zip(texts, columns, strict=True)]
    if columns is MATRIX:
        return se3.check_rigid("the pose", np.reshape(numbers, (4, 4)), where=where, tolerance=_ROUNDING)
    *quaternion, x, y, z = numbers
    length = math.hypot(*quaternion)
    if abs(length - 1) > _ROUNDING:
        expected = "x, y, z, w of length 1"
        raise InputError("the quaternion is no rotation", where=where, expected=expected, got=f"length {length:.6g}")
    from scipy.spatial.transform import Rotation

    return se3.check_rigid("the pose", se3.make(Rotation.from_quat(quaternion).as_matrix(), [x, y, z]), where=where)


def _finite(text: str, column: str, where: str) -> float:
    value = float(text) if _NUMBER.fullmatch(text) else math.nan
    if not math.isfinite(value):
        expected = "a finite number, or an empty pose for a refused calibration"
        raise InputError(f"column {column} is not a number", where=where, expected=expected, got=repr(text[:40]))
    return value
