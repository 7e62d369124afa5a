"""The rows of a suite as arrays: half a million rows need about 100 MB instead of several GB as objects."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Callable, Hashable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Generic, TypeVar

import numpy as np
from numpy.typing import NDArray
from p2o.arrays import Bool, Float, Int
from p2o.errors import InputError
from p2o.files.input_file import read_start
from p2o.files.parsed_text import DEEPEST
from p2o.geometry.pose_error import pose_errors
from p2o.results.result import Status
from p2o.results.verdict import Trust
from pydantic import BeforeValidator, Strict, ValidationError, ValidationInfo

from p2o_study.benchmark.results import Frames, Results
from p2o_study.benchmark.row import MAX_LINE_BYTES, Method, Methods, Row, checked_lines, lines_of, parsed_line

STATUSES, TRUSTS = tuple(Status), tuple(Trust)
SOLVED = [number for number, status in enumerate(STATUSES) if status.solved]
CRASHED = STATUSES.index(Status.STAGE_FAILED)
IDENTITY = ("dataset", "row", "protocol", "seed", "place")
"""Fields of a run that identify what is measured, in the order of the rows."""
RUN = np.dtype(
    [
        *((name, "u4") for name in ("dataset", "row", "protocol", "place", "section", "method", "content")),
        ("seed", "i8"),
        ("status", "u1"),
        ("verdict", "i1"),
        ("finished", "S19"),
        ("seconds", "f8"),
        *((f"predicted_{name}", "f8") for name in ("rotation_deg", "translation_m")),
        *((f"predicted_{name}_95", "f8") for name in ("rotation_deg", "translation_m")),
        *((name, "f8") for name in ("rotation_deg", "translation_m")),
        *((f"start_{name}", "f8") for name in ("rotation_deg", "translation_m")),
        ("offset", "i8"),
        ("hash", "i8"),
    ]
)
"""One run. Integers name texts of `Outcomes`, `status` and `verdict` those of `STATUSES` and `TRUSTS` (-1: none).

Unknown numbers are NaN. `finished` is the time in UTC, `offset` the position of the line in the file.
"""
Runs = NDArray[np.void]
"""An array of `RUN`."""
_REACH_M, _DEVIATION = 1e6, 1e-10
"""Poses with shorter translations and rotations closer to orthonormal need no complete check."""
_AT_ONCE = 10_000
"""Number of rows whose poses are in memory."""

_Real = Annotated[float, Strict()]
_Four = tuple[_Real, _Real, _Real, _Real]
_Matrix = tuple[_Four, _Four, _Four, _Four]
_T = TypeVar("_T", bound=Hashable)


def _listed_method(value: Any, info: ValidationInfo) -> Any:
    """Return the method that a row names by its digest; the context of the validation are the methods by digest."""
    methods: Methods = info.context or {}
    return methods.get(value, value) if isinstance(value, str) else value


class _QuickRow(Row):
    """A row whose poses are plain numbers: whether they are rigid is checked for many rows at once."""

    method: Annotated[Method, BeforeValidator(_listed_method)]
    start: _Matrix  # type: ignore[assignment]
    estimate: _Matrix | None  # type: ignore[assignment]


@dataclass(frozen=True, eq=False)
class Outcomes:
    """The rows of a suite in the order of `Row.order`: `runs` (N,) and the texts that they name.

    `latest` (N,) marks the last measured row of each calibration. `places` are the names of the frames of a
    calibration, `methods` pairs of method and digest of the row. `listed` are the methods that rows of the file name.
    """

    path: Path
    suite: str
    listed: Methods
    runs: Runs
    latest: Bool
    datasets: tuple[str, ...]
    rows: tuple[str, ...]
    protocols: tuple[str, ...]
    places: tuple[tuple[str, ...], ...]
    sections: tuple[str, ...]
    methods: tuple[tuple[Method, str], ...]

    @classmethod
    def read(cls, results: Results, suite: str, frames: Frames | None = None) -> Outcomes:
        """Return the rows of a suite, with errors against the ground truth of `frames` (default: all errors are NaN).

        Raises InputError, with file and line, for a line that is not a valid row of the suite, and for a row whose
        frame is not listed in `frames`, or whose method is not listed in the results.
        """
        path = results.path(suite)
        reader = _Reader(path, suite, results.methods, frames)
        if path.exists():
            read_start(path, "file of rows", 1)
            with path.open("rb") as file:
                reader.read(checked_lines(lines_of(file), path), file.tell)
        return reader.outcomes()

    def row(self, number: int) -> Row:
        """Return a row of `runs`, read from the file again."""
        return parsed_line(Row, _line_at(self.path, self.runs["offset"][number]), str(self.path), self.listed)

    def measured(self, identity: Sequence[str]) -> list[Row]:
        """Return the rows with a `Row.identity`, the last measured one first."""
        numbers = self.find(identity)
        return sorted(map(self.row, numbers), key=lambda row: row.order, reverse=True)

    def find(self, identity: Sequence[str]) -> range:
        """Return the places in `runs` of the rows with a `Row.identity`."""
        _, dataset, row, protocol, seed, *names = identity
        texts = (self.datasets, dataset), (self.rows, row), (self.protocols, protocol), (self.places, tuple(names))
        places = [_place(known, value) for known, value in texts]
        values = [*places[:3], int(seed), places[3]]
        low, high = 0, len(self.runs) if identity[0] == self.suite else 0
        for name, value in zip(IDENTITY, values, strict=True):
            part = self.runs[name][low:high]
            low, high = low + int(np.searchsorted(part, value)), low + int(np.searchsorted(part, value, "right"))
        return range(low, high)


def split_by(runs: Runs, *names: str) -> list[Runs]:
    """Return the runs (N,) with equal values in these fields, in the order of the values."""
    if not len(runs):
        return []
    ordered = runs[np.lexsort([runs[name] for name in reversed(names)])]
    return np.split(ordered, np.flatnonzero(_changes(ordered, names)) + 1)


def _changes(runs: Runs, names: Sequence[str]) -> Bool:
    """Return for each run but the last whether the next one differs in one of the fields."""
    return np.asarray(np.any([runs[name][1:] != runs[name][:-1] for name in names], axis=0))


def is_in(values: Any, wanted: Sequence[int]) -> Bool:
    """Return whether each of the values (N,) is one of a few wanted ones."""
    return np.asarray(np.isin(values, wanted))


def _place(known: Sequence[Any], value: Any) -> int:
    """Return the place of a value, or the number of values if it is none of them."""
    place = bisect_left(known, value)
    return place if place < len(known) and known[place] == value else len(known)


def _line_at(path: Path, offset: int) -> bytes:
    with path.open("rb") as file:
        file.seek(offset)
        return file.readline(MAX_LINE_BYTES + 1)


class _Numbered(Generic[_T]):
    """Values without duplicates, by number."""

    def __init__(self) -> None:
        self.numbers: dict[_T, int] = {}

    def __getitem__(self, value: _T) -> int:
        return self.numbers.setdefault(value, len(self.numbers))

    def ordered(self) -> tuple[tuple[_T, ...], Int]:
        """Return the values in ascending order, and for each number the place in it."""
        values = tuple(sorted(self.numbers))  # type: ignore[type-var]
        places = {value: place for place, value in enumerate(values)}
        return values, np.array([places[value] for value in self.numbers], np.int64)


class _Reader:
    """Reads rows line by line into arrays."""

    def __init__(self, path: Path, suite: str, listed: Methods, frames: Frames | None) -> None:
        self.path, self.suite, self.listed, self.frames = path, suite, listed, frames
        self.texts: dict[str, _Numbered[Any]] = {name: _Numbered() for name in ("dataset", "row", "protocol", "place")}
        self.sections, self.methods = _Numbered[str](), _Numbered[tuple[str, bool, str]]()
        self.described: list[tuple[Method, str]] = []
        self.contents = _Numbered[Any]()
        self.truths: list[Float] = []
        self.parts: list[Runs] = []
        self.runs: list[tuple[Any, ...]] = []
        self.starts: list[Any] = []
        self.ends: list[Any] = []
        self.lines: list[str] = []

    def read(self, lines: Iterable[tuple[str, bytes]], position: Callable[[], int]) -> None:
        """Read lines with their places; `position` is the end of the last one in the file."""
        for where, text in lines:
            row = _parsed(text, where, self.listed)
            if row.suite != self.suite:
                raise InputError("a row of another suite", where=where, expected=self.suite, got=row.suite)
            self.runs.append(self._run(row, position() - len(text), hash(text.rstrip())))
            self.starts.append(row.start)
            self.ends.append(row.start if row.estimate is None else row.estimate)
            self.lines.append(where)
            if len(self.runs) == _AT_ONCE:
                self._finish()
        self._finish()

    def _run(self, row: Row, offset: int, line: int) -> tuple[Any, ...]:
        names = tuple(frame.name for frame in row.frames)
        content = self.contents[row.dataset, names, tuple(frame.digest for frame in row.frames)]
        if content == len(self.truths):
            truth = None if self.frames is None else self.frames.truth_of(row)
            self.truths.append(np.full((4, 4), np.nan) if truth is None else truth)
        method = self.methods[row.row, row.method.external, row.digest]
        if method == len(self.described):
            self.described.append((row.method, row.digest))
        texts = self.texts
        numbers = (texts["dataset"][row.dataset], texts["row"][row.row], texts["protocol"][row.protocol])
        bounds = row.predicted
        return (
            *numbers,
            texts["place"][names],
            self.sections[row.section],
            method,
            content,
            row.seed,
            STATUSES.index(row.status),
            -1 if row.verdict is None else TRUSTS.index(row.verdict),
            row.finished[:19].encode(),
            np.nan if row.seconds is None else row.seconds,
            *(_NO_BOUNDS if bounds is None else (bounds.rotation_deg, bounds.translation_m)),
            *(_NO_BOUNDS if bounds is None else (bounds.rotation_deg_95, bounds.translation_m_95)),
            *_NO_BOUNDS,
            *_NO_BOUNDS,
            offset,
            line,
        )

    def _finish(self) -> None:
        """Check the poses of the last rows, and compute their errors."""
        if not self.runs:
            return
        runs = np.array(self.runs, RUN)
        starts, ends = np.array(self.starts, np.float64), np.array(self.ends, np.float64)
        for number in np.flatnonzero(~(_surely_rigid(starts) & _surely_rigid(ends))):
            # Raises unless the complete check accepts the poses.
            parsed_line(Row, _line_at(self.path, runs["offset"][number]), self.lines[number], self.listed)
        truths = np.array(self.truths)[runs["content"]]
        runs["rotation_deg"], runs["translation_m"] = pose_errors(ends, truths)
        runs["start_rotation_deg"], runs["start_translation_m"] = pose_errors(starts, truths)
        for name in ("rotation_deg", "translation_m"):
            runs[name][runs["status"] == CRASHED] = np.nan
        self.parts.append(runs)
        for values in (self.runs, self.starts, self.ends, self.lines):
            values.clear()

    def outcomes(self) -> Outcomes:
        """Return all rows that were read, sorted."""
        runs = np.concatenate([np.empty(0, RUN), *self.parts])
        self.parts.clear()
        texts = {}
        for name, numbered in self.texts.items():
            texts[name], places = numbered.ordered()
            runs[name] = places[runs[name]]
        runs = runs[np.lexsort((runs["hash"], runs["finished"], *(runs[name] for name in reversed(IDENTITY))))]
        latest = np.append(_changes(runs, IDENTITY), True)[: len(runs)]
        self._order_ties(runs, latest)
        return Outcomes(
            self.path,
            self.suite,
            self.listed,
            runs,
            latest,
            texts["dataset"],
            texts["row"],
            texts["protocol"],
            texts["place"],
            tuple(self.sections.numbers),
            tuple(self.described),
        )

    def _order_ties(self, runs: Runs, latest: Bool) -> None:
        """Order the different rows of a calibration that were finished in the same second by their lines, in place."""
        same = ~latest[:-1] & (runs["finished"][1:] == runs["finished"][:-1])
        for number in np.flatnonzero(same & latest[1:]):
            first = number
            while first and same[first - 1]:
                first -= 1
            tied = slice(first, number + 2)
            if len(np.unique(runs["hash"][tied])) == 1:
                continue
            texts = [_line_at(self.path, at) for at in runs["offset"][tied]]
            lines = [parsed_line(Row, text, str(self.path), self.listed).stored for text in texts]
            runs[tied] = runs[tied][sorted(range(len(lines)), key=lines.__getitem__)]


def _surely_rigid(poses: Float) -> Bool:
    """Return for each of the poses (N, 4, 4) whether a row may contain it (`se3.check_rigid`); False if in doubt."""
    rotation = poses[:, :3, :3]
    small = (np.abs(poses[:, :3]).max(axis=(1, 2)) < _REACH_M) & (poses[:, 3] == [0, 0, 0, 1]).all(axis=1)
    rotation = np.where(small[:, None, None], rotation, 0.0)
    deviation = np.abs(rotation.swapaxes(1, 2) @ rotation - np.eye(3)).max(axis=(1, 2))
    return np.asarray((deviation < _DEVIATION) & (np.linalg.det(rotation) > 0))


_NO_BOUNDS = (np.nan, np.nan)


def _parsed(text: bytes, where: str, methods: Methods) -> Row:
    """Return the row of a line, without a check whether its poses are rigid; raises as `parsed_line`."""
    try:
        row = _QuickRow.model_validate_json(text, context=methods)
    except ValidationError:
        return parsed_line(Row, text, where, methods)
    # The number of brackets bounds the nesting, whose levels the complete check counts.
    if text.count(b"[") + text.count(b"{") - len(row.frames) > DEEPEST:
        return parsed_line(Row, text, where, methods)
    return row
