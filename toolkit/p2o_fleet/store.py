"""The evidence of all checks: an append-only Parquet data set by vehicle and month, and journals of running writers."""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import uuid
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from io import BytesIO
from pathlib import Path
from typing import IO, Any
from urllib.parse import quote, unquote

from p2o.errors import InputError, P2OError
from p2o.files.input_file import expanded, naming, read_bytes
from p2o.files.parsed_text import parse_json
from p2o.files.whole_file import sync_folder, write_errors, write_synced

from p2o_fleet.checks import READ, Checks
from p2o_fleet.drive import Drive, month_of
from p2o_fleet.evidence import COLUMNS, Evidence, Verdict, arrow_schema, table_of
from p2o_fleet.parquet_file import read_parquet

_FOLD_BYTES = 4 << 20
"""Size at which a journal becomes Parquet files: about 5,000 rows."""
_ATTEMPTS = 10
_MAX_VEHICLES = 1024
"""Number of vehicles whose keys are remembered."""
_MAX_ROWS, _MAX_JOURNAL = 400_000, 256 << 20
"""Maximum number of rows of a file, and of bytes of a journal."""

Row = dict[str, Any]


@dataclass(frozen=True)
class Store:
    """A folder with `checks/vehicle=V/day=D/part-*.parquet` and `journal/*.jsonl`.

    Finished checks are appended to a journal, one line each, and become Parquet files at the end of a run. `day` is the
    month of the drives (2026-11); stores of p2o 0.2 also have days and years. Any number of processes may write; a
    check that two of them store is read once. Files are never changed, but replaced by a file with more checks. A file
    is on the disk, not only in its cache, before the journal or the files that it replaces are removed. Files and lines
    that no writer of p2o leaves are skipped and named (`Checks.damaged`); they stay where they are.
    """

    root: Path

    @property
    def checks_folder(self) -> Path:
        """Return the folder of the Parquet files."""
        return self.root / "checks"

    @property
    def journals(self) -> Path:
        """Return the folder of the journals."""
        return self.root / "journal"

    @classmethod
    def existing(cls, root: Path | str) -> Store:
        """Return the store in a folder; raises InputError if there is none."""
        store = cls(expanded(root))
        if not (store.checks_folder.is_dir() or store.journals.is_dir()):
            raise InputError("there is no store of a fleet", where=root, expected="a folder that `p2o fleet run` wrote")
        return store

    def vehicles(self) -> list[str]:
        """Return the names of all vehicles, sorted."""
        names = {unquote(path.name[8:]) for path in self.checks_folder.glob("vehicle=*") if path.is_dir()}
        return sorted(names | {row["vehicle"] for row in self._journalled([])})

    def checks(self, vehicles: Sequence[str] | None = None) -> Iterator[Checks]:
        """Yield the checks of each vehicle; the evidence of one vehicle at a time is in memory."""
        lost: list[str] = []
        journalled: dict[str, list[Row]] = {}
        for row in self._journalled(lost):
            journalled.setdefault(row["vehicle"], []).append(row)
        for vehicle in self.vehicles() if vehicles is None else vehicles:
            damaged = list(lost)
            parts = self.parts_read(vehicle, damaged)
            if vehicle in journalled:
                parts.append(Checks.of(table_of(journalled[vehicle])))
            yield Checks.joined(vehicle, parts, damaged)

    def parts_read(self, vehicle: str, damaged: list[str]) -> list[Checks]:
        """Return the checks of each Parquet file of a vehicle; `damaged` names those that are skipped."""
        for _ in range(_ATTEMPTS):
            paths, skipped = self.parts(vehicle), list[str]()
            with contextlib.suppress(FileNotFoundError):
                parts = [part[1] for path in paths if (part := _read(path, vehicle, skipped)) is not None]
                # A change between two listings of folders could hide both a new file and those that it replaced.
                if self.parts(vehicle) == paths:
                    damaged.extend(skipped)
                    return parts
        raise P2OError("the store changes while it is read", where=self.root, hint="run the same command again")

    def parts(self, vehicle: str, day: str = "*") -> list[Path]:
        """Return the Parquet files of a vehicle, or those in the folder of a `day`, month or year."""
        return sorted(self.folder(vehicle).glob(f"day={day}/*.parquet"))

    def folder(self, vehicle: str) -> Path:
        """Return the folder of a vehicle."""
        return self.checks_folder / f"vehicle={quote(vehicle, safe='')}"

    def writer(self) -> Writer:
        """Return a writer; the journals of writers that were killed are stored first."""
        writer = Writer(self)
        with write_errors("the store of the fleet", self.root):
            self.checks_folder.mkdir(parents=True, exist_ok=True)
            self.journals.mkdir(exist_ok=True)
            sync_folder(self.root)
        for path in _journals(self.journals, writer.damaged):
            with contextlib.suppress(FileNotFoundError), path.open("rb") as journal:
                if _lock(journal):  # its writer has ended
                    self.fold(path, writer.damaged)
                else:
                    writer.own.update(_finished(_lines(path, writer.damaged)))
        return writer

    def fold(self, journal: Path, damaged: list[str]) -> None:
        """Turn a journal into Parquet files; it is kept as *.damaged if lines of it are damaged, which are named."""
        count = len(damaged)
        self.add(_lines(journal, damaged))
        if len(damaged) > count:
            journal.rename(journal.with_suffix(".damaged"))
        journal.unlink(missing_ok=True)

    def add(self, rows: Iterable[Row]) -> None:
        """Write rows to the file of their vehicle and month; the same rows again change nothing.

        Any number of processes may do it at the same time, and one that is killed does no harm: a file is written
        before those that it contains are removed.
        """
        import pyarrow as pa
        import pyarrow.parquet as pq

        groups: dict[tuple[str, str], list[Row]] = {}
        for row in rows:
            groups.setdefault((row["vehicle"], month_of(row["time"])), []).append(row)
        for (vehicle, month), group in groups.items():
            before = {}
            for path in self.parts(vehicle, month):
                with contextlib.suppress(FileNotFoundError):  # another process was faster
                    if (part := _read(path, vehicle, [], tuple(COLUMNS))) is not None:
                        before[path] = part[0].cast(arrow_schema())
            if len(group) + sum(map(len, before.values())) > _MAX_ROWS:
                before = {}
            table = pa.concat_tables([*before.values(), table_of(group)])
            identities = list(zip(*(table[name].to_pylist() for name in ("key", "verdict", "reason")), strict=True))
            first = {identity: number for number, identity in reversed(list(enumerate(identities)))}
            table = table.take(sorted(first.values()))
            # The name depends on the checks: processes that write different ones do not replace each other's file.
            digest = hashlib.sha256(json.dumps(sorted(first)).encode()).hexdigest()[:24]
            path = self.folder(vehicle) / f"day={month}" / f"part-{digest}.parquet"
            content = BytesIO()
            pq.write_table(table, content, compression="zstd", use_dictionary=True)
            with write_errors("evidence", path.parent):
                path.parent.mkdir(parents=True, exist_ok=True)
                write_synced(path, content.getvalue())
                for folder in (path.parent, path.parent.parent, self.checks_folder):
                    sync_folder(folder)
            for replaced in before.keys() - {path}:
                replaced.unlink(missing_ok=True)

    def _journalled(self, damaged: list[str]) -> Iterator[Row]:
        for path in _journals(self.journals, damaged):
            with contextlib.suppress(FileNotFoundError):
                yield from _lines(path, damaged)


@dataclass(eq=False)
class Writer:
    """Appends evidence to the journal of this process, and knows which checks are finished.

    `damaged` are the files and lines of the store that were skipped, `own` the keys of finished checks in journals: of
    this writer, and of others when it began.
    """

    store: Store
    damaged: list[str] = field(default_factory=list)
    own: set[str] = field(default_factory=set)
    _journal: IO[bytes] | None = None
    _path: Path = Path()

    def __post_init__(self) -> None:
        self._keys = lru_cache(_MAX_VEHICLES)(self._keys_of)

    def __enter__(self) -> Writer:
        return self

    def __exit__(self, *error: object) -> None:
        self.fold()

    def finished(self, drive: Drive, key: str) -> bool:
        """Return whether this check is stored, by any writer; unreadable logs are not finished."""
        return key in self.own or key in self._keys(drive.vehicle)

    def _keys_of(self, vehicle: str) -> set[str]:
        """Return the keys of the finished checks of a vehicle in Parquet files."""
        keys: set[str] = set()
        for part in self.store.parts_read(vehicle, self.damaged):
            keys.update(part.texts["key"][part.texts["verdict"] != Verdict.UNREADABLE.value].tolist())
        return keys

    def put(self, evidence: Evidence) -> None:
        """Store evidence on the disk before returning.

        Raises InputError if it cannot be written; what was stored before is kept.
        """
        row = evidence.row()
        with write_errors("evidence", self.store.journals, "free some space, then run the same command again"):
            size = _append(self._open(), json.dumps(row, allow_nan=False).encode() + b"\n")
        self.own.update(_finished([row]))
        if size > _FOLD_BYTES:
            self.fold()

    def _open(self) -> IO[bytes]:
        if self._journal is None:
            # Locked before it has the name of a journal: another process would take it for that of a killed writer.
            name = self.store.journals / uuid.uuid4().hex
            self._journal = name.open("xb", buffering=0)
            _lock(self._journal)
            self._path = name.rename(name.with_suffix(".jsonl"))
            sync_folder(self.store.journals)
        return self._journal

    def fold(self) -> None:
        """Turn the journal of this writer into Parquet files."""
        if self._journal is not None:
            self.store.fold(self._path, self.damaged)
            self._journal.close()
            self._journal = None


def _finished(rows: Iterable[Row]) -> Iterator[str]:
    """Yield the keys of the rows that are not those of unreadable logs."""
    return (row["key"] for row in rows if row["verdict"] != Verdict.UNREADABLE.value)


def _append(file: IO[bytes], line: bytes) -> int:
    """Write a line to the disk, whole or not at all; return the size of the file."""
    before = file.seek(0, os.SEEK_END)
    try:
        if file.write(line) < len(line):
            raise OSError(0, "the disk is full")
        os.fsync(file.fileno())
        return before + len(line)
    except OSError:
        file.truncate(before)
        raise


def _read(path: Path, vehicle: str, damaged: list[str], names: Sequence[str] = READ) -> tuple[Any, Checks] | None:
    """Return table and checks of a file; None, with the reason in `damaged`, if it is not a valid one of this vehicle.

    Raises FileNotFoundError if another file has replaced it.
    """
    try:
        table = read_parquet(path, "evidence", names, _MAX_ROWS)
        with naming(path):
            return table, Checks.of(table, vehicle)
    except InputError as problem:
        _skip(problem, damaged)
        return None


def _skip(problem: InputError, damaged: list[str]) -> None:
    """Name a file that cannot be read in `damaged`; raises FileNotFoundError if another process has removed it."""
    if isinstance(problem.__cause__, FileNotFoundError):
        raise problem.__cause__ from problem
    damaged.append(str(problem))


def _journals(folder: Path, damaged: list[str]) -> list[Path]:
    """Return the journals in a folder; `damaged` names devices, pipes and folders, which are never opened."""
    every = [path for path in sorted(folder.glob("*.jsonl")) if path.exists()]
    damaged += [f"{path}: the journal is not a file" for path in every if not path.is_file()]
    return [path for path in every if path.is_file()]


def _lines(path: Path, damaged: list[str]) -> list[Row]:
    """Return the rows of the complete lines of a journal.

    The last line of a killed writer, or of a full disk, may be incomplete: its check was not finished. Other lines that
    are not rows are skipped and named in `damaged`. Raises FileNotFoundError if the journal has been stored meanwhile.
    """
    try:
        data = read_bytes(path, "journal", _MAX_JOURNAL) if path.stat().st_size else b""
    except InputError as problem:
        _skip(problem, damaged)
        return []
    rows: list[tuple[str, Row]] = []
    for number, line in enumerate(data.split(b"\n")[:-1], start=1):
        where = f"{path}, line {number}"
        try:
            row = parse_json(line, "row", where)
            if not isinstance(row, dict):
                raise InputError("the row is not an object", where=where, got=repr(row)[:40])
            rows.append((where, row))
        except InputError as problem:
            damaged.append(str(problem))
    return _valid(rows, damaged)


def _valid(rows: Sequence[tuple[str, Row]], damaged: list[str]) -> list[Row]:
    """Return the rows that are checks; rows of which one is not are halved until it is found."""
    if not rows:
        return []
    try:
        Checks.of(table_of(row for _, row in rows))
        return [row for _, row in rows]
    except InputError as problem:
        if len(rows) == 1:
            damaged.append(str(InputError(problem.what, where=rows[0][0], expected=problem.expected, got=problem.got)))
            return []
    half = len(rows) // 2
    return _valid(rows[:half], damaged) + _valid(rows[half:], damaged)


def _lock(file: IO[bytes]) -> bool:
    """Take the lock of a journal, which the operating system releases when its writer ends; False if it has one.

    Without locks (Windows, some file systems) a journal is stored twice, and read once.
    """
    try:
        import fcntl

        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except (ImportError, OSError):
        return True
    return True
