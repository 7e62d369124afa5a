"""Commands of `p2o run` that repeat calibrations of a suite: the same frames, initial guess, method and options."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator
from shlex import join
from typing import Any

from p2o.errors import printable
from p2o.host.slots import METHOD_WORDS

from p2o_study.damage import STAGE as DAMAGE
from p2o_study.row import NORMS, Row
from p2o_study.study import PLAIN, StudyRow
from p2o_study.tables import NONE, with_unit


def repeat_text(asked: Iterable[StudyRow], rows: Iterable[Row]) -> str:
    """Return two lines for one calibration of each measured row of a suite: what it is, and the command to repeat it.

    The calibration is that of the first frames and seed. A comment replaces the command where there is none: for
    methods outside p2o, damaged features, and one calibration of all cameras of a rig from the ground truth.
    """
    first: dict[tuple[str, str], Row] = {}
    for row in rows:
        key = row.section, row.row
        if key not in first or (row.seed, row.frames) < (first[key].seed, first[key].frames):
            first[key] = row
    known = {(row.section, row.label): row for row in asked}
    return "\n".join(printable(line) for key, row in first.items() for line in _lines(known.get(key), row))


def _lines(asked: StudyRow | None, row: Row) -> Iterator[str]:
    error = row.error
    errors = [with_unit(getattr(error, norm), norm) for norm in NORMS] if error is not None else [NONE]
    yield f"# {row.section or 'all rows'}: {row.row}, {row.place}, seed {row.seed}: {', '.join(errors)}"
    if row.method.external:
        yield "# no command: a method outside p2o"
    elif asked is None:
        yield "# no command: the suite no longer has this row"
    elif row.case.rig:
        yield "# no command: all cameras of a rig, with the transforms of the ground truth (p2o benchmark run)"
    elif DAMAGE in asked.words.get("options", {}):
        yield "# no command: features are damaged, which only studies do (p2o ablate)"
    else:
        yield command_of(asked, row)


def command_of(asked: StudyRow, row: Row) -> str:
    """Return the `p2o run` command that repeats a calibration of a row of a suite.

    `PATH` stands for the path of data that the suite was not given.
    """
    data = f"{asked.dataset.data}PATH" if asked.dataset.left_out else asked.dataset.data
    words = ["p2o", "run", "--data", data, "--frames", ",".join(row.frames)]
    for name in (*METHOD_WORDS, *PLAIN):
        words += [f"--{name}", asked.words[name]] if asked.words.get(name) else []
    options = {**asked.words.get("options", {}), "data": row.case.options}
    for stage, values in options.items():
        for name, value in values.items():
            words += ["--set", f"{stage}.{name}={_text(value)}"]
    words += ["--seed", str(row.seed), *(["--joint"] if row.case.joint else [])]
    return join(words)


def _text(value: Any) -> str:
    return value if isinstance(value, str) else json.dumps(value)
