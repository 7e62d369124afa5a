"""The evidence of all checks: an append-only Parquet data set by vehicle and day, and journals of running writers."""

from __future__ import annotations

import contextlib
import hashlib
import itertools
import json
import os
import threading
import uuid
from collections import OrderedDict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path
from typing import IO, Any
from urllib.parse import quote, unquote

from p2o.errors import InputError, P2OError
from p2o.files.whole_file import write_errors
from p2o.frames.selection import spread

from p2o_fleet.drive import Drive, day_of
from p2o_fleet.durable_file import sync_folder, write_durable
from p2o_fleet.evidence import CheckEvidence, Verdict
from p2o_fleet.schema import READ, Checks, checks_of, row_of, table_of

_FOLD_ROWS = 2000
"""Number of rows after which a journal becomes Parquet files: it bounds the memory of a run."""
MAX_DAYS = 4
"""Number of files of single days of a vehicle after which its files are merged, so that a query opens few files."""
_READ_ATTEMPTS = 10
_MAX_PARTITIONS = 1024
"""Number of partitions whose keys are remembered."""

Row = dict[str, Any]


@dataclass(frozen=True)
class Store:
    """A folder with `checks/vehicle=V/day=D/part-*.parquet` and `journal/*.jsonl`.

    Finished checks are appended to a journal, one line each, and become Parquet files at the end of a run. `day` is the
    day of the drive (2026-11-24), or once files are merged its month (2026-11), or its year (2026) for months before
    the last one of the vehicle. Any number of processes may write; a check that two of them store is read once. Files
    are never changed; a merge writes a file before it removes those that it contains: others may work meanwhile. A file
    is on the disk, not only in its cache, before the journal or the files that it replaces are removed.
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
        store = cls(Path(root).expanduser())
        if not (store.checks_folder.is_dir() or store.journals.is_dir()):
            raise InputError("there is no store of a fleet", where=root, expected="a folder that `p2o fleet run` wrote")
        return store

    def vehicles(self) -> list[str]:
        """Return the names of all vehicles, sorted."""
        names = {unquote(entry.name[8:]) for entry in _folders(self.checks_folder) if entry.name.startswith("vehicle=")}
        return sorted(names | {row["vehicle"] for row in self._journalled()})

    def checks(self, vehicles: Sequence[str] | None = None, most_parts: int | None = None) -> Iterator[Checks]:
        """Yield the checks of each vehicle; the evidence of one vehicle at a time is in memory.

        With `most_parts`, at most this number of files, spread over time, is read for each vehicle.
        """
        import pyarrow as pa

        journalled: dict[str, list[Row]] = {}
        for row in self._journalled():
            journalled.setdefault(row["vehicle"], []).append(row)
        for vehicle in self.vehicles() if vehicles is None else vehicles:
            tables = self._tables(vehicle, most_parts)
            if vehicle in journalled:
                tables.append(table_of(journalled[vehicle]).select(READ))
            if tables:
                yield checks_of(vehicle, pa.concat_tables(tables))

    def _tables(self, vehicle: str, most: int | None) -> list[Any]:
        paths = self.parts(vehicle)
        for _ in range(_READ_ATTEMPTS):
            listed, tables = paths, None
            with contextlib.suppress(FileNotFoundError):
                tables = [read_part(paths[at], READ) for at in spread(range(len(paths)), most or max(1, len(paths)))]
            # A merge between two listings of folders could hide both the merged file and the files that it replaced.
            paths = self.parts(vehicle)
            if tables is not None and paths == listed:
                return tables
        raise P2OError("the store changes while it is read", where=self.root, hint="run the same command again")

    def parts(self, vehicle: str, day: str | None = None) -> list[Path]:
        """Return the Parquet files of a vehicle, with `day` those that may contain checks of this day."""
        folder = self.checks_folder / f"vehicle={quote(vehicle, safe='')}"
        wanted = None if day is None else {f"day={day}", f"day={day[:7]}", f"day={day[:4]}"}
        days = [entry.path for entry in _folders(folder) if wanted is None or entry.name in wanted]
        return sorted(Path(entry.path) for one in days for entry in _entries(one) if entry.name.endswith(".parquet"))

    def writer(self) -> Writer:
        """Return a writer; the journals of writers that were killed are stored first."""
        with write_errors("the store of the fleet", self.root):
            self.checks_folder.mkdir(parents=True, exist_ok=True)
            self.journals.mkdir(exist_ok=True)
            sync_folder(self.root)
        for path in self.journals.glob("*.jsonl"):
            with contextlib.suppress(FileNotFoundError), path.open("rb") as journal:
                if _lock(journal):  # its writer has ended
                    self.add(_rows_of(path))
                    path.unlink(missing_ok=True)
        return Writer(self)

    def add(self, rows: Iterable[Row]) -> None:
        """Write rows as Parquet files; the same rows again replace the same files."""
        groups: dict[tuple[str, str], list[Row]] = {}
        for row in rows:
            groups.setdefault((row["vehicle"], day_of(row["time"])), []).append(row)
        for (vehicle, day), group in groups.items():
            self._write(vehicle, day, table_of(group), [row["key"] + row["verdict"] for row in group])
        for vehicle in dict.fromkeys(vehicle for vehicle, _ in groups):
            paths = self.parts(vehicle)
            if sum(len(_days(path)) > len("2026-11") for path in paths) > MAX_DAYS:
                # The rows are stored: a damaged file or a full disk only prevents that they are read faster.
                with contextlib.suppress(InputError):
                    self._merge(vehicle, paths)

    def _write(self, vehicle: str, day: str, table: Any, keys: Sequence[str]) -> Path:
        import pyarrow.parquet as pq

        digest = hashlib.sha256("\n".join(sorted(keys)).encode()).hexdigest()[:24]
        folder = self.checks_folder / f"vehicle={quote(vehicle, safe='')}" / f"day={day}"
        content = BytesIO()
        pq.write_table(table, content, compression="zstd", use_dictionary=True)
        with write_errors("evidence", folder):
            write_durable(folder / f"part-{digest}.parquet", content.getvalue(), self.checks_folder)
        return folder / f"part-{digest}.parquet"

    def compact(self) -> int:
        """Merge the files of each vehicle; return the number of files that were written.

        Writers do it for vehicles with many files. Readers and writers may work at the same time; a second compaction
        or one that was killed does no harm.
        """
        return sum(self._merge(vehicle, self.parts(vehicle)) for vehicle in self.vehicles())

    def _merge(self, vehicle: str, paths: Sequence[Path]) -> int:
        """Merge the last month of a vehicle, and the months before by year; return the number of files written."""
        import pyarrow as pa

        last, merged = max((_days(path)[:7] for path in paths), default=""), 0
        groups: dict[str, list[Path]] = {}
        for path in paths:
            days = _days(path)
            groups.setdefault(last if days[:7] == last else days[:4], []).append(path)
        for days, own in groups.items():
            if len(own) < 2:
                continue
            with contextlib.suppress(FileNotFoundError):  # another merge was faster
                table = _rows_once(pa.concat_tables([read_part(path) for path in own]))
                columns = (table[name].to_pylist() for name in ("key", "verdict"))
                keys = [f"{key}{verdict}" for key, verdict in zip(*columns, strict=True)]
                written = self._write(vehicle, days, table, keys)
                for path in own:
                    if path != written:
                        path.unlink(missing_ok=True)
                        with contextlib.suppress(OSError):  # not empty: a late log was added
                            path.parent.rmdir()
                merged += 1
        return merged

    def _journalled(self) -> Iterator[Row]:
        for path in sorted(self.journals.glob("*.jsonl")) if self.journals.is_dir() else ():
            with contextlib.suppress(FileNotFoundError):
                yield from _rows_of(path)


@dataclass(eq=False)
class Writer:
    """Appends evidence to the journal of this process, and knows which checks are finished."""

    store: Store
    _pending: list[Row] = field(default_factory=list)
    _own: dict[str, tuple[str, str]] = field(default_factory=dict)
    _partitions: OrderedDict[tuple[str, str], dict[str, tuple[str, str]]] = field(default_factory=OrderedDict)
    _offsets: dict[Path, int] = field(default_factory=dict)
    _journal: IO[bytes] | None = None
    _path: Path | None = None
    _lock: threading.RLock = field(default_factory=threading.RLock)

    def __enter__(self) -> Writer:
        return self

    def __exit__(self, *error: object) -> None:
        self.fold()

    def finished(self, drive: Drive, key: str) -> bool:
        """Return whether this check is stored, by any writer; unreadable logs are not finished. Thread-safe."""
        with self._lock:
            return self._stored(drive, key)[:1] not in ((), (Verdict.UNREADABLE.value,))

    def _stored(self, drive: Drive, key: str) -> tuple[str, ...]:
        """Return verdict and reason of a stored check, empty if there is none."""
        self._follow()
        if key in self._own:
            return self._own[key]
        place = (drive.vehicle, drive.day)
        if place not in self._partitions:
            self._partitions[place] = _keys(self.store.parts(*place))
            if len(self._partitions) > _MAX_PARTITIONS:
                self._partitions.popitem(last=False)
        return self._partitions[place].get(key, ())

    def _follow(self) -> None:
        """Read what other writers have appended to their journals since the last call."""
        for path in self.store.journals.glob("*.jsonl"):
            if path == self._path:
                continue
            with contextlib.suppress(FileNotFoundError):
                if path.stat().st_size > self._offsets.get(path, 0):
                    rows, self._offsets[path] = _rows_from(path, self._offsets.get(path, 0))
                    self._own |= {row["key"]: (row["verdict"], row["reason"]) for row in rows}

    def put(self, evidence: CheckEvidence) -> bool:
        """Store evidence on the disk before returning; False if it is stored already. Thread-safe.

        Raises InputError if it cannot be written; what was stored before is kept.
        """
        with self._lock:
            return self._put(evidence)

    def _put(self, evidence: CheckEvidence) -> bool:
        outcome = (evidence.verdict.value, evidence.reason)
        stored = self._stored(evidence.drive, evidence.key)
        if stored and (stored[0] != Verdict.UNREADABLE.value or stored == outcome):
            return False
        row = row_of(evidence)
        with write_errors("evidence", self.store.journals, "free some space, then run the same command again"):
            _append(self._open(), json.dumps(row, allow_nan=False).encode() + b"\n")
        self._pending.append(row)
        self._own[evidence.key] = outcome
        if len(self._pending) >= _FOLD_ROWS:
            self.fold()
        return True

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
        if self._journal is None or self._path is None:
            return
        self.store.add(self._pending)
        self._path.unlink(missing_ok=True)
        self._journal.close()
        self._journal = self._path = None
        self._pending.clear()


def _days(path: Path) -> str:
    """Return the day, month or year whose checks a file contains."""
    return path.parent.name.removeprefix("day=")


def _append(file: IO[bytes], line: bytes) -> None:
    """Write a line to the disk, whole or not at all."""
    before = file.seek(0, os.SEEK_END)
    try:
        rest = memoryview(line)
        while rest:
            rest = rest[file.write(rest) :]
        os.fsync(file.fileno())
    except OSError:
        file.truncate(before)
        raise


def read_part(path: Path, columns: Sequence[str] | None = None) -> Any:
    """Return the Arrow table of a file; raises InputError if it is damaged, FileNotFoundError if it was replaced."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    try:
        with pq.ParquetFile(path) as file:
            return file.read(columns=None if columns is None else list(columns), use_threads=False)
    except (pa.ArrowInvalid, pa.ArrowKeyError) as problem:
        hint = "delete the file, then run `p2o fleet run` with the drives of this vehicle and day again"
        raise InputError("the evidence cannot be read", where=path, got=problem, hint=hint) from problem


def _keys(paths: Iterable[Path]) -> dict[str, tuple[str, str]]:
    """Return verdict and reason by key; a readable row of a key counts more than an unreadable one."""
    outcomes: dict[str, tuple[str, str]] = {}
    for path in paths:
        with contextlib.suppress(FileNotFoundError):
            table = read_part(path, ("key", "verdict", "reason"))
            for key, verdict, reason in zip(*(table[name].to_pylist() for name in table.column_names), strict=True):
                if outcomes.get(key, (Verdict.UNREADABLE.value,))[0] == Verdict.UNREADABLE.value:
                    outcomes[key] = verdict, reason
    return outcomes


def _rows_once(table: Any) -> Any:
    """Return the rows of a table without those that repeat a key with the same verdict and reason."""
    seen, rows = set[tuple[str, ...]](), list[int]()
    names = ("key", "verdict", "reason")
    for number, identity in enumerate(zip(*(table[name].to_pylist() for name in names), strict=True)):
        if identity not in seen:
            seen.add(identity)
            rows.append(number)
    return table.take(rows)


def _rows_of(path: Path) -> list[Row]:
    return _rows_from(path, 0)[0]


def _rows_from(path: Path, offset: int) -> tuple[list[Row], int]:
    """Return the complete lines of a journal from an offset, and the offset behind them.

    The last line of a killed writer, or of a full disk, may be incomplete: its check was not finished.
    """
    with path.open("rb") as file:
        file.seek(offset)
        data = file.read()
    end = data.rfind(b"\n") + 1
    rows = []
    for line in data[:end].splitlines():
        with contextlib.suppress(ValueError):
            row: Mapping[str, Any] = json.loads(line)
            rows.append(dict(row))
    return rows, offset + end


def _lock(file: IO[bytes]) -> bool:
    """Take the lock of a journal, which the operating system releases when its writer ends; False if it has one."""
    try:
        import fcntl
    except ImportError:  # Windows: no other process may delete an open file, so its journal stays
        return True
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except OSError:  # a file system without locks: the journal is stored twice, and read once
        return True
    return True


def _entries(folder: Path | str) -> list[os.DirEntry[str]]:
    try:
        with os.scandir(folder) as entries:
            return list(itertools.chain(entries))
    except (FileNotFoundError, NotADirectoryError):
        return []


def _folders(folder: Path | str) -> list[os.DirEntry[str]]:
    return [entry for entry in _entries(folder) if entry.is_dir()]
