"""A folder of rows as JSON lines: STUDY.jsonl has one line per calibration, in the order in which they were finished.

Frames, cases, methods and environments are written once, to _frames.jsonl and so on; other lines name them by the hash
of their line. Files are only appended to, so that an interrupted process loses no finished row, and merging two folders
is joining the lines of their files: repeated lines have no effect. STUDY.json has the plan of a study: its text, and
the keys of its calibrations.
"""

from __future__ import annotations

import json
import os
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import MISSING, dataclass, fields, replace
from functools import cached_property
from pathlib import Path
from typing import Any

from p2o.errors import InputError
from p2o.files.input_file import expanded, read_bytes, read_start
from p2o.files.parsed_text import parse_json
from p2o.files.whole_file import write_whole
from p2o.results.json_types import Schema, Tree
from p2o.results.result import Status

from p2o_study.row import PREDICTED, Case, Environment, Frame, Method, Row, Text, canonical, content_id

MAX_LINE_BYTES = 4 << 20
"""Maximum length of a line: a joint calibration of 10,000 frames needs 200 kB."""
_SHARED: Mapping[str, type] = {"frame": Frame, "case": Case, "method": Method, "environment": Environment}
"""Parts of rows that have a file of their own, by the key that names them in a line."""
_OLD_STORE = "study.sqlite"
_MOVE_HINT = "move the file to another folder and run again; cached features are reused"


@dataclass(frozen=True)
class PlanRow:
    """A row of the table of a study on one data set, with the keys of its calibrations in order."""

    row: Text
    section: Text
    dataset: Text
    keys: tuple[Text, ...]


@dataclass(frozen=True)
class StoredStudy:
    """A study as last started: the content of its file with the changes of the command line, and the plan."""

    name: Text
    content: Tree
    plan: tuple[PlanRow, ...] = ()

    @cached_property
    def keys(self) -> list[str]:
        """The distinct keys of the plan, in order."""
        return list(dict.fromkeys(key for row in self.plan for key in row.keys))


class Rows:
    """The rows of a folder; several processes may add rows at the same time.

    Lines that a killed process or a full disk left incomplete, and rows that need such a line, are left out.
    """

    def __init__(self, folder: str | Path) -> None:
        self.folder = expanded(folder)
        self._shared: dict[str, dict[str, Any]] = {}
        self._status: dict[str, Status] = {}
        self._read_bytes: dict[Path, int] = {}

    @classmethod
    def existing(cls, folder: str | Path) -> Rows:
        """Return the rows of a folder; raises InputError if no study was run there."""
        rows = cls(folder)
        if not rows.studies:
            old = (rows.folder / _OLD_STORE).exists()
            hint = f"{_OLD_STORE} was written by p2o 0.2: run the study again with another --out" if old else None
            expected = "a folder that `p2o ablate --out` wrote"
            raise InputError("the folder has no rows of a study", where=rows.folder, expected=expected, hint=hint)
        return rows

    @property
    def studies(self) -> list[str]:
        """The names of the studies with rows or a plan."""
        paths = [*self.folder.glob("*.jsonl"), *self.folder.glob("*.json")]
        return sorted({p.stem for p in paths if not p.name.startswith("_") and (p.suffix == ".jsonl" or _is_plan(p))})

    def path(self, study: str) -> Path:
        """Return the file of the rows of a study."""
        return self.folder / f"{study}.jsonl"

    # ---- reading

    def each(self, study: str) -> Iterator[Row]:
        """Yield the rows of a study in the order of the file, repetitions included.

        Raises InputError, with file and line, for a line that is JSON but no row, and for a file that is not regular.
        """
        path = self.path(study)
        for where, plain in self._lines(path):
            if (row := self._row(plain, where)) is not None:
                yield row

    def planned(self, study: str, *, rounds: bool = True) -> list[Row]:
        """Return the finished calibrations of the plan of a study, in its order, under its labels.

        Without `rounds` rows have none, which halves the memory. A calibration of another study in the folder counts.
        """
        plan = self.study(study)
        wanted, by_key = set(plan.keys), dict[str, Row]()
        for name in self.studies:
            for row in self.each(name):
                if row.key in wanted and (row.key not in by_key or not row.crashed):
                    by_key[row.key] = row if rounds else replace(row, rounds=())
        rows = []
        for entry in plan.plan:
            rows += [_labelled(by_key[key], entry) for key in entry.keys if key in by_key]
        return rows

    def missing(self, study: str) -> list[PlanRow]:
        """Return one entry for each calibration of the plan that is not finished, with its key."""
        self.refresh()
        plan, known = self.study(study).plan, self._status
        return [replace(entry, keys=(key,)) for entry in plan for key in entry.keys if key not in known]

    def study(self, name: str) -> StoredStudy:
        """Return a study as last started; raises InputError if its file is missing or not valid."""
        path = self.folder / f"{name}.json"
        plain = parse_json(read_bytes(path, "plan of the study"), "plan of the study", path)
        try:
            stored: StoredStudy = replace(_STUDY.read(plain), name=name)
        except InputError as problem:
            text = "the plan of the study is not valid"
            raise InputError(text, where=path, got=problem, hint=_MOVE_HINT) from problem
        return stored

    def refresh(self) -> Mapping[str, Status]:
        """Return the status by key of all rows of the folder, with those that other processes added."""
        for study in self.studies:
            for _, plain in self._lines(self.path(study), new=True):
                key, status = plain.get("key"), plain.get("status")
                if not isinstance(key, str) or not isinstance(status, str) or status not in list(Status):
                    continue
                if self._status.get(key) in (None, Status.STAGE_FAILED):
                    self._status[key] = Status(status)
        return self._status

    def finished(self, key: str) -> bool:
        """Return whether a calibration is stored and did not raise; `refresh` takes notice of other processes."""
        return self._status.get(key, Status.STAGE_FAILED) is not Status.STAGE_FAILED

    def shared(self, kind: str) -> dict[str, Any]:
        """Return the frames, cases, methods or environments of the folder by id."""
        if kind not in self._shared:
            known = self._shared[kind] = {}
            for where, plain in self._lines(self._shared_path(kind)):
                if (entry := self._joined(plain)) is not None:
                    known[content_id(plain)] = _read(_SCHEMAS[kind], entry, where)
        return self._shared[kind]

    def _row(self, plain: dict[str, Any], where: str) -> Row | None:
        if (joined := self._joined(plain)) is None:
            return None
        # The predicted errors are a list in JSON.
        if isinstance(bounds := joined.pop("predicted", None), list):
            joined["figures"] = {**joined.get("figures", {}), **dict(zip(PREDICTED, bounds, strict=False))}
        row: Row = _read(_SCHEMAS["row"], joined, where)
        return row

    def _joined(self, plain: Mapping[str, Any]) -> dict[str, Any] | None:
        """Return a parsed line with the parts that it names; None if one of them is missing."""
        values = dict(plain)
        for kind in _SHARED:
            if kind in values:
                values[kind] = self.shared(kind).get(str(values[kind]))
                if values[kind] is None:
                    return None
        if isinstance(values.get("frames"), list):
            frames = [self.shared("frame").get(str(name)) for name in values["frames"]]
            if None in frames:
                return None
            values["frames"] = tuple(frames)
        return values

    def _lines(self, path: Path, *, new: bool = False) -> Iterator[tuple[str, dict[str, Any]]]:
        """Yield place and value of the lines of a file; `new` ones are those since the last such call.

        Lines that are no JSON and an incomplete last line are left out.
        """
        if not path.exists():
            return
        begin = self._read_bytes.get(path, 0) if new else 0
        if not begin:
            if path.is_file() and not path.stat().st_size:
                return
            read_start(path, "file of rows", 1)
        with path.open("rb") as file:
            file.seek(begin)
            for number, line in enumerate(iter(lambda: file.readline(MAX_LINE_BYTES + 1), b""), start=1):
                where = f"{path}:{number}"
                if len(line) > MAX_LINE_BYTES:
                    raise InputError("the line is too long", where=where, expected=f"at most {MAX_LINE_BYTES} bytes")
                if new and line.endswith(b"\n"):
                    self._read_bytes[path] = file.tell()
                try:
                    plain = parse_json(line, "line", where, halves=True) if line.strip() else None
                except InputError:
                    continue
                if plain is None:
                    continue
                if not isinstance(plain, dict):
                    raise InputError("the line is no row", where=where, expected="a JSON object", hint=_MOVE_HINT)
                yield where, plain

    def _shared_path(self, kind: str) -> Path:
        return self.folder / f"_{kind}s.jsonl"

    # ---- writing

    def begin(self, study: StoredStudy) -> None:
        """Write the plan of a study; raises InputError if the folder cannot be written."""
        self.make_folder()
        write_whole(self.folder / f"{study.name}.json", f"{json.dumps(_STUDY.plain(study))}\n".encode())

    def make_folder(self) -> None:
        """Create the folder; raises InputError if it cannot be created."""
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
        except OSError as problem:
            raise _cannot_write(self.folder, problem) from problem

    def put(self, study: str, row: Row) -> None:
        """Append a row; raises InputError if the file cannot be written, and then all finished rows are kept."""
        self._append(self.path(study), self._plain_row(row))
        self._status[row.key] = row.status

    def _plain_row(self, row: Row) -> dict[str, Any]:
        """Return a row for JSON, which names its shared parts; they are appended to their files if they are new."""
        names = {kind: self._id(kind, getattr(row, kind)) for kind in ("case", "method", "environment")}
        plain = {**_plain("row", row, names), **names}
        if PREDICTED[0] in (figures := plain.get("figures", {})) and figures.keys() >= set(PREDICTED):
            plain["predicted"] = [figures.pop(name) for name in PREDICTED]
            if not figures:
                del plain["figures"]
        return plain

    def rewrite(self, study: str, rows: Sequence[Row]) -> None:
        """Replace the rows of a study by these, sorted by identity."""
        path = self.path(study)
        ordered = sorted(rows, key=lambda row: (row.identity, row.finished))
        lines = [canonical(self._plain_row(row)) for row in ordered]
        if lines:
            write_whole(path, "".join(f"{line}\n" for line in dict.fromkeys(lines)).encode())
        else:
            path.unlink(missing_ok=True)

    def remove_unused(self) -> int:
        """Remove the shared parts that no row names, and return their number."""
        used = {kind: set[str]() for kind in _SHARED}
        for study in self.studies:
            for _, plain in self._lines(self.path(study)):
                for kind in ("case", "method", "environment"):
                    used[kind].add(str(plain.get(kind)))
        removed = 0
        for kind in ("case", "method", "environment", "frame"):
            path = self._shared_path(kind)
            lines = {content_id(plain): plain for _, plain in self._lines(path)}
            kept = {name: plain for name, plain in lines.items() if name in used[kind]}
            used["frame"] |= {str(name) for plain in kept.values() for name in plain.get("frames", ())}
            removed += len(lines) - len(kept)
            if kept:
                write_whole(path, "".join(f"{canonical(kept[name])}\n" for name in sorted(kept)).encode())
            else:
                path.unlink(missing_ok=True)
        self._shared.clear()
        return removed

    def _id(self, kind: str, part: Any) -> str:
        """Return the id of a shared part, which is appended to its file if it is new."""
        plain = _plain(kind, part, ("frames",))
        if isinstance(part, Case):
            plain["frames"] = [self._id("frame", frame) for frame in part.frames]
        name = content_id(plain)
        if name not in self.shared(kind):
            self._append(self._shared_path(kind), plain)
            joined = self._joined(plain)
            assert joined is not None
            # As it is read again: poses are rounded.
            self.shared(kind)[name] = _read(_SCHEMAS[kind], joined, kind)
        return name

    def _append(self, path: Path, plain: Mapping[str, Any]) -> None:
        """Append one line by a single call of the system; after an incomplete line on a line of its own."""
        data = f"{canonical(plain)}\n".encode()
        try:
            handle = os.open(path, os.O_RDWR | os.O_CREAT | os.O_APPEND, 0o644)
            try:
                end = os.lseek(handle, 0, os.SEEK_END)
                if end and os.lseek(handle, end - 1, os.SEEK_SET) >= 0 and os.read(handle, 1) != b"\n":
                    data = b"\n" + data
                if os.write(handle, data) < len(data):
                    raise OSError(0, "the disk is full")
            finally:
                os.close(handle)
        except OSError as problem:
            raise _cannot_write(path, problem) from problem


def latest(rows: Iterable[Row], fresh: Collection[str] = ()) -> list[Row]:
    """Return one row of each identity: one that did not raise, then one with a `fresh` key, then the last measured."""

    def rank(row: Row) -> tuple[bool, bool, str]:
        return not row.crashed, row.key in fresh, row.finished

    by_identity: dict[Any, Row] = {}
    for row in rows:
        known = by_identity.setdefault(row.identity, row)
        if rank(row) >= rank(known):
            by_identity[row.identity] = row
    return list(by_identity.values())


def _is_plan(path: Path) -> bool:
    """Return whether a JSON file is the plan of a study."""
    with path.open("rb") as file:
        return file.read(len(_PLAN_BEGINS)) == _PLAN_BEGINS


_PLAN_BEGINS = b'{"name": '


def _labelled(row: Row, entry: PlanRow) -> Row:
    """Return a row under the labels of the plan."""
    if (row.row, row.section, row.dataset) == (entry.row, entry.section, entry.dataset):
        return row
    case = replace(row.case, dataset=entry.dataset)
    return replace(row, row=entry.row, section=entry.section, case=case)


def plan_of(rows: Iterable[Row]) -> tuple[PlanRow, ...]:
    """Return the plan of calibrations, in order."""
    keys: dict[tuple[str, str, str], list[str]] = {}
    for row in rows:
        keys.setdefault((row.row, row.section, row.dataset), []).append(row.key)
    return tuple(PlanRow(*labels, tuple(own)) for labels, own in keys.items())


_STUDY = Schema(StoredStudy)
_SCHEMAS = {kind: Schema(part) for kind, part in {**_SHARED, "row": Row}.items()}


def _plain(kind: str, part: Any, without: Collection[str]) -> dict[str, Any]:
    """Return a record as plain values for JSON, without those that are empty or their default."""
    required = {f.name for f in fields(part) if f.default is MISSING and f.default_factory is MISSING}
    defaults = {f.name: f.default for f in fields(part)}
    values = {name: value for name, value in _SCHEMAS[kind].plain(part).items() if name not in without}
    return {k: v for k, v in values.items() if k in required or not (v in _EMPTY or v == defaults[k])}


_EMPTY: tuple[Any, ...] = (None, {}, [], "")


def _read(schema: Schema, plain: Mapping[str, Any], where: str) -> Any:
    try:
        return schema.read(plain)
    except InputError as problem:
        hint = f"it was written by another version of p2o, or changed: {_MOVE_HINT}"
        raise InputError("the line is no valid record", where=where, got=problem, hint=hint) from problem


def _cannot_write(path: Path, problem: OSError) -> InputError:
    return InputError(
        "the results cannot be written",
        where=path,
        expected="a writable folder with free space",
        got=problem.strerror or problem,
        hint="free some space and run the same command, which continues with the stored rows, or name another folder "
        "(a copy of this one keeps the rows)",
    )
