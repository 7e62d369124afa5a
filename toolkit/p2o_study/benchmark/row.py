"""Rows of the benchmark: one calibration per JSON line, without errors, which are computed from poses on reading.

A results folder holds SUITE.jsonl, one file of rows per suite, frames.jsonl, the digests and the ground truth of every
frame that a row names, and methods.jsonl, the methods that rows name by their digest. Lines are sorted and unique, so
that merging files is a set union in any order.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Iterator, Mapping
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any, BinaryIO, Literal, TypeVar

import numpy as np
from p2o.errors import InputError
from p2o.files.input_file import read_start
from p2o.files.parsed_text import parse_json
from p2o.files.whole_file import write_whole
from p2o.options import validated
from p2o.results.json_types import Number, Pose
from p2o.results.result import Status
from p2o.results.verdict import Trust
from pydantic import BaseModel, ConfigDict, Field, StrictBool, StringConstraints, model_validator

from p2o_study.columns import METRICS
from p2o_study.study import Label, Line, Seed, Slug

MAX_LINE_BYTES = 1 << 20
"""Maximum length of a line: a joint calibration of 4,541 frames needs 600 kB."""
MAX_LINES = 2_000_000
METHODS_FILE = "methods.jsonl"
_MAX_FRAMES = 10_000

Digest = Annotated[str, StringConstraints(pattern="^[0-9a-f]{64}$")]
Name = Annotated[str, StringConstraints(min_length=1, max_length=500)]
Bound = Annotated[Number, Field(ge=0)]
Timestamp = Annotated[str, StringConstraints(pattern=r"^\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d\+00:00$")]
_Finite = Annotated[float, Field(ge=0, le=1e9)]


class JsonLine(BaseModel):
    """One line of a file: frozen, without unknown keys, written with sorted keys."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    version: Literal[1] = 1

    @cached_property
    def line(self) -> str:
        """The record as one line of JSON; equal records have equal lines."""
        return _canonical(self.model_dump(mode="json"))

    @property
    def order(self) -> tuple[Any, ...]:
        """The position in a sorted file."""
        return (self.line,)


_Line = TypeVar("_Line", bound=JsonLine)


def _canonical(plain: object) -> str:
    """Return JSON with sorted keys and without white space, one text for equal values."""
    return json.dumps(plain, sort_keys=True, separators=(",", ":"), ensure_ascii=True, allow_nan=False)


class FrameData(JsonLine):
    """Content and ground truth of one frame of a dataset.

    `image`, `sweep` and `calibration` are the SHA-256 of the arrays as read, rounded to 6 decimals: pixels with the
    camera, points with their attributes, camera model. `truth` is camera_from_lidar (4, 4), None if unknown.
    """

    dataset: Slug
    name: Name
    image: Digest
    sweep: Digest
    calibration: Digest
    truth: Pose | None

    @cached_property
    def digest(self) -> str:
        """SHA-256 of content and ground truth, by which rows name the frame."""
        # Machines differ in the last bits of matrix products; adding 0 removes negative zeros.
        truth = None if self.truth is None else (np.round(np.asarray(self.truth), 9) + 0.0).tolist()
        content = json.dumps([self.image, self.sweep, self.calibration, truth])
        return hashlib.sha256(content.encode()).hexdigest()

    @property
    def order(self) -> tuple[Any, ...]:
        """Sort by dataset and name."""
        return (self.dataset, self.name, self.line)


class FrameOfRow(BaseModel):
    """A frame that a row names, with the digest of its `FrameData`."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    name: Name
    digest: Digest


class Method(BaseModel):
    """A method: the words of its row and every option that took effect, or the name of an external method."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    external: bool = False
    source: Line = ""
    words: dict[Slug, Line] = Field(default_factory=dict, max_length=50)
    options: dict[str, Any] = Field(default_factory=dict, max_length=100)

    @cached_property
    def digest(self) -> str:
        """SHA-256 of the JSON of the method, by which rows in a file name it."""
        return hashlib.sha256(_canonical(self.model_dump(mode="json")).encode()).hexdigest()


Methods = Mapping[str, Method]
"""Methods by digest."""


class MethodData(JsonLine):
    """A line of methods.jsonl; the digest is computed, not stored."""

    method: Method


class Predicted(BaseModel):
    """Predicted errors (67 % and 95 %) in degrees and metres; "inf" where a direction is unobservable."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    rotation_deg: Bound
    translation_m: Bound
    rotation_deg_95: Bound
    translation_m_95: Bound


class Machine(BaseModel):
    """The machine of a row; `load` is the load average of one minute at its end, -1 if unknown."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    processor: Line = ""
    cores: Annotated[int, Field(ge=0, le=100_000)] = 0
    load: Annotated[float, Field(ge=-1, le=1e6)] = -1.0
    system: Line = ""
    python: Line = ""


class Row(JsonLine):
    """One calibration of a suite; `line` contains its method, `stored` the digest of the method.

    `row` and `section` are the labels of the study. `joint` is True for several frames of one camera, "rig" for one
    calibration of all cameras, whose poses are those of the camera of the first frame. `protocol` is the draw of the
    initial guess `start` (4, 4) with `seed`. `digest` is the hash of code, weights and options, for an external method
    that of its file of poses.
    `estimate` is camera_from_lidar (4, 4), None if the calibration was refused. `seconds` is the time of computation,
    `commit` the version of the sources, `versions` that of packages, `measured_by` who computed the row.
    """

    suite: Slug
    row: Label
    section: Line = ""
    dataset: Slug
    frames: tuple[FrameOfRow, ...] = Field(min_length=1, max_length=_MAX_FRAMES)
    joint: StrictBool | Literal["rig"]
    protocol: Line
    seed: Seed
    start: Pose
    method: Method
    digest: Digest
    commit: Line
    estimate: Pose | None
    status: Status
    reason: Annotated[str, StringConstraints(max_length=2000)] = ""
    verdict: Trust | None
    predicted: Predicted | None
    seconds: _Finite | None
    machine: Machine
    versions: dict[Line, Line] = Field(default_factory=dict, max_length=200)
    measured_by: Line
    finished: Timestamp

    @model_validator(mode="after")
    def _consistent(self) -> Row:
        if self.status.solved != (self.estimate is not None):
            raise ValueError("an estimate if, and only if, the status is converged or rounds-spent")
        if len(self.frames) > 1 and not self.joint:
            raise ValueError("one frame unless joint is true")
        return self

    @property
    def identity(self) -> tuple[str, ...]:
        """What is measured: suite, dataset, row, protocol, seed and names of the frames; not the outcome."""
        return (self.suite, self.dataset, self.row, self.protocol, f"{self.seed:010d}", *(f.name for f in self.frames))

    @property
    def order(self) -> tuple[Any, ...]:
        """Sort by identity, then by time."""
        return (self.identity, self.finished, self.stored)

    @cached_property
    def stored(self) -> str:
        """The row as a line of SUITE.jsonl: as `line`, with the digest of the method instead of the method."""
        return _canonical(self.model_dump(mode="json", exclude={"method"}) | {"method": self.method.digest})

    @property
    def crashed(self) -> bool:
        """True if the calibration raised; such a row counts as missing."""
        return self.status is Status.STAGE_FAILED

    @property
    def place(self) -> str:
        """The names of the frames as one text: first, and the number of others."""
        return place_of([frame.name for frame in self.frames])


def place_of(names: list[str]) -> str:
    """Return the names of frames as one text: the first, and the number of others."""
    return names[0] + (f" +{len(names) - 1}" if len(names) > 1 else "")


def parsed_line(model: type[_Line], text: bytes, where: str, methods: Methods | None = None) -> _Line:
    """Return the record of one line, which may name one of `methods` by its digest.

    Raises InputError with the place for anything else, and for stated errors.
    """
    value = parse_json(text, "line", where)
    if not isinstance(value, dict):
        raise InputError("the line is no row", where=where, expected="a JSON object", got=type(value).__name__)
    stated = next((metric for metric in METRICS if metric in value), None)
    if stated is not None:
        message, hint = f"the line states an error: {stated}", "remove it; errors are computed from the poses"
        raise InputError(message, where=where, expected="poses only", hint=hint)
    name = value.get("method")
    if methods is not None and isinstance(name, str):
        if name not in methods:
            message, hint = "the row names a method that is not listed", f"join {METHODS_FILE} of all merged results"
            expected = f"a line of {METHODS_FILE} with this digest"
            raise InputError(message, where=where, expected=expected, got=name, hint=hint)
        value["method"] = methods[name]
    return validated(model, value, where=where)


def parsed_lines(
    model: type[_Line], lines: Iterable[bytes], where: object, methods: Methods | None = None
) -> Iterator[_Line]:
    """Yield the records of lines; raises InputError with `where` and the number of the line."""
    for place, text in checked_lines(lines, where):
        yield parsed_line(model, text, place, methods)


def checked_lines(lines: Iterable[bytes], where: object) -> Iterator[tuple[str, bytes]]:
    """Yield place and text of the lines that are not empty; raises InputError for too many and too long ones."""
    for number, text in enumerate(lines, start=1):
        place = f"{where}:{number}"
        if number > MAX_LINES:
            raise InputError("too many lines", where=place, expected=f"at most {MAX_LINES}")
        if len(text) > MAX_LINE_BYTES:
            raise InputError("the line is too long", where=place, expected=f"at most {MAX_LINE_BYTES} bytes")
        if text.strip():
            yield place, text


def lines_of(file: BinaryIO) -> Iterator[bytes]:
    """Yield the lines of an open file; of one that is too long, the beginning, which `checked_lines` refuses."""
    return iter(lambda: file.readline(MAX_LINE_BYTES + 1), b"")


def read_records(model: type[_Line], path: Path, methods: Methods | None = None) -> list[_Line]:
    """Return the records of a file, sorted and without repetitions; none if the file is missing."""
    if not path.exists():
        return []
    read_start(path, "file of rows", 1)
    with path.open("rb") as file:
        return merged(parsed_lines(model, lines_of(file), path, methods))


def merged(*parts: Iterable[_Line]) -> list[_Line]:
    """Return the records of all parts, sorted and without repetitions: the order of the parts has no effect."""
    unique = {record.order: record for part in parts for record in part}
    return [unique[order] for order in sorted(unique)]


def add_records(path: Path, records: Iterable[_Line], model: type[_Line]) -> int:
    """Add records to a file, which keeps all that it has, and return the number of new ones."""
    before = read_records(model, path)
    after = merged(before, records)
    if len(after) > len(before):
        path.parent.mkdir(parents=True, exist_ok=True)
        write_whole(path, "".join(f"{record.line}\n" for record in after).encode())
    return len(after) - len(before)


def latest(rows: Iterable[Row]) -> list[Row]:
    """Return the last measured row of each identity, in the order of the file."""
    by_identity: dict[tuple[str, ...], Row] = {}
    for row in sorted(rows, key=lambda row: row.order):
        by_identity[row.identity] = row
    return list(by_identity.values())
