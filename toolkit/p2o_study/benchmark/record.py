"""Outputs of measuring commands that are no calibrations, recorded with their origin and shown in pages.

Coverage of an audit, the memory of a run or the rate of wrong pairs are no poses: they have no rows. A record is the
output of their command, in RESULTS/records/NAME.json, so that no figure of a page is typed.
"""

from __future__ import annotations

import shlex
import subprocess
import time
from collections.abc import Mapping, Sequence
from itertools import groupby
from pathlib import Path
from typing import Annotated, Literal

from p2o.errors import InputError, UnknownNameError
from p2o.files.input_file import read_text
from p2o.files.parsed_text import parse_json
from p2o.files.whole_file import write_whole
from p2o.options import Options, validated
from pydantic import Field, StringConstraints

from p2o_study.benchmark.marks import Writer
from p2o_study.benchmark.measure import source_version
from p2o_study.machine import machine_info
from p2o_study.study import Line, Slug
from p2o_study.worker import now

FOLDER = "records"
MAX_CHARACTERS = 20_000


class Record(Options):
    """What a command printed: `output` is its standard output, `seconds` its duration on `machine`."""

    version: Literal[1] = 1
    name: Slug
    command: Annotated[str, StringConstraints(min_length=1, max_length=2000)]
    output: Annotated[str, StringConstraints(min_length=1, max_length=MAX_CHARACTERS)]
    seconds: Annotated[float, Field(ge=0, le=1e9)]
    commit: Line
    machine: dict[Line, Line | int | float]
    measured_by: Line
    finished: Line

    def markdown(self, numbers: Sequence[int] = ()) -> str:
        """Return the output, or some of its tables by their numbers from 1, then its origin in one line.

        Markdown tables, with single lines of text around, are not quoted. Raises InputError for a missing table.
        """
        lines = [line.rstrip() for line in self.output.strip("\n").splitlines()]
        blocks = [list(block) for filled, block in groupby(lines, key=bool) if filled]
        tables = [block for block in blocks if all(line.startswith("|") for line in block)]
        if any(number > len(tables) for number in numbers):
            raise InputError("a table is missing", where=f"record {self.name}", expected=numbers, got=len(tables))
        is_markdown = bool(tables) and all(block in tables or len(block) == 1 for block in blocks)
        shown = lines if is_markdown else ["```text", *lines, "```"]
        if numbers:
            shown = "\n\n".join("\n".join(tables[number - 1]) for number in numbers).splitlines()
        machine = f"{self.machine['processor']}, {self.machine['cores']} cores"
        commit, changed, _ = self.commit.partition("+changes")
        version = commit if commit.startswith("version") else f"commit {commit[:10]}{changed}"
        origin = f"{self.finished[:10]}, {version}, {self.seconds:.0f} s ({machine})"
        return "\n".join([*shown, "", f"Output of `{self.command.removeprefix('python ')}`: {origin}.", ""])


def recorded(name: str, command: Sequence[str], measured_by: str) -> Record:
    """Run a command without a shell, and return the record of its output.

    Raises InputError if it cannot be started, fails, or prints nothing or too much.
    """
    began, commit = time.monotonic(), source_version()  # of the code that runs, not of later commits
    try:
        done = subprocess.run(command, stdout=subprocess.PIPE, text=True, encoding="utf-8", check=False)
    except (OSError, UnicodeDecodeError) as problem:
        raise InputError("the command cannot be run", where=command[0], got=problem) from problem
    where = shlex.join(command)
    if done.returncode:
        raise InputError("the command failed", where=where, expected="exit status 0", got=done.returncode)
    if not 0 < len(done.stdout.strip()) <= len(done.stdout) <= MAX_CHARACTERS:
        expected = f"1 to {MAX_CHARACTERS} characters on standard output"
        raise InputError("the output is no record", where=where, expected=expected, got=len(done.stdout))
    values = {
        "name": name,
        "command": where,
        "output": done.stdout,
        "seconds": round(time.monotonic() - began, 1),
        "commit": commit,
        "machine": machine_info(),
        "measured_by": measured_by,
        "finished": now(),
    }
    return validated(Record, values, where=where)


def path_of(results: Path, name: str) -> Path:
    """Return the file of a record."""
    return results / FOLDER / f"{name}.json"


def write_record(results: Path, record: Record) -> Path:
    """Write a record to the folder of results, in place of an earlier one, and return its file."""
    path = path_of(results, record.name)
    path.parent.mkdir(parents=True, exist_ok=True)
    write_whole(path, f"{record.model_dump_json(indent=1)}\n".encode())
    return path


def read_record(results: Path, name: str) -> Record:
    """Return a record; raises UnknownNameError without its file, InputError for a file that is not valid."""
    path = path_of(results, name)
    if not path.is_file():
        known = sorted(file.stem for file in path.parent.glob("*.json"))
        raise UnknownNameError("record", name, known, where=path.parent, hint=f"p2o benchmark record {name} COMMAND")
    values = parse_json(read_text(path, "record"), "record", path)
    if not isinstance(values, dict):
        raise InputError("the record is not valid", where=path, expected="a JSON object")
    return validated(Record, values, where=path)


def record_text(results: Path) -> Writer:
    """Return the writer of marked parts with records; the choice `tables` selects tables of the output."""

    def text(name: str, choices: Mapping[str, str]) -> str:
        if choices.keys() - {"tables"}:
            raise KeyError(*choices)
        return read_record(results, name).markdown([int(n) for n in choices.get("tables", "").split(", ") if n])

    return text
