"""The results of studies in one SQLite file: one row per calibration, written atomically.

`pandas.read_sql("select * from rows", "sqlite:///DIR/study.sqlite")` reads the results of the studies in DIR.
"""

from __future__ import annotations

import contextlib
import itertools
import re
import sqlite3
import stat
import threading
import time
from array import array
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Any, Generic, TypeVar

from p2o.arrays import Float
from p2o.errors import InputError
from p2o.files.input_file import expanded
from p2o.results.figures import Value
from p2o.results.result import Round, Status
from p2o.results.verdict import Trust

from p2o_study.columns import (
    METRICS,
    figure_columns,
    from_column,
    json_text,
    parsed_object,
    parsed_published,
    to_column,
    type_of,
)

FILE = "study.sqlite"
_PAGE_ROWS = 1000
"""Number of rows per query."""
_VERSION = 5
_BUSY_S = 60.0
_WAIT_S = 1.0
"""Time that SQLite waits for a lock; Ctrl-C has no effect while it waits."""
_FILE_SYSTEM_ERRORS = (
    sqlite3.SQLITE_PERM,
    sqlite3.SQLITE_BUSY,
    sqlite3.SQLITE_READONLY,
    sqlite3.SQLITE_IOERR,
    sqlite3.SQLITE_FULL,
    sqlite3.SQLITE_CANTOPEN,
)
"""Errors of SQLite caused by the file system, not by the content of the file."""

_T = TypeVar("_T")
_Row = TypeVar("_Row", bound="Planned")


@dataclass(frozen=True, slots=True)
class Planned:
    """One calibration of a study; `key` identifies the computation, the other fields are labels of the study.

    `row` is the label of the row of the table, `section` the heading above it. `dataset`, `extractor` (IMAGE/CLOUD),
    `matcher`, `solver`, `init` and `calibrator` are the words of the study file, including names of variants; empty
    where a row has none.
    """

    key: str
    study: str
    row: str
    section: str = ""
    dataset: str = ""
    extractor: str = ""
    matcher: str = ""
    solver: str = ""
    init: str = ""
    calibrator: str = ""


@dataclass(frozen=True, eq=False, slots=True)
class StoredRow(Planned):
    """One finished calibration: the labels of `Planned`, and the outcome.

    `joint` is the number of frames of a joint calibration, 0 for single frames. `status` is that of the `Result`;
    `exception` the traceback where the run raised. The errors are those of `estimate` against `truth`, None where
    either is unknown; a refused calibration has the errors of its initial guess, which is its result.
    `trust` is the verdict and `why` its reasons, None without a result. `figures` holds the figures
    of the result (`p2o.results.figures`) by name, each a column of its own; unknown ones are None or absent.
    `estimate`, `start` and `truth` are camera_from_lidar (4, 4). `matches` holds counts by direction, `seconds` the
    time by stage, `recipe` every option that took effect, `inputs` the hashes of each frame's image and sweep.
    `machine` is the machine that computed the row (`p2o_study.machine`), `finished` the time in UTC, ISO 8601.
    """

    frames: tuple[str, ...] = ()
    joint: int = 0
    seed: int = 0
    perturb: str | None = None
    status: str = Status.STAGE_FAILED.value
    reason: str = ""
    rotation_deg: float | None = None
    translation_m: float | None = None
    roll_deg: float | None = None
    pitch_deg: float | None = None
    yaw_deg: float | None = None
    x_m: float | None = None
    y_m: float | None = None
    z_m: float | None = None
    start_rotation_deg: float | None = None
    start_translation_m: float | None = None
    trust: Trust | None = None
    why: str | None = None
    figures: Mapping[str, Value] = field(default_factory=dict)
    estimate: Float | None = None
    start: Float | None = None
    truth: Float | None = None
    rounds: tuple[Round, ...] = ()
    matches: Mapping[str, int] = field(default_factory=dict)
    seconds: Mapping[str, float] = field(default_factory=dict)
    recipe: Mapping[str, Any] = field(default_factory=dict)
    versions: Mapping[str, str] = field(default_factory=dict)
    inputs: Mapping[str, Any] = field(default_factory=dict)
    exception: str | None = None
    machine: Mapping[str, Any] = field(default_factory=dict)
    finished: str = ""

    @property
    def solved(self) -> bool:
        """True if `estimate` is a new pose and not the initial guess."""
        return Status(self.status).solved

    @property
    def crashed(self) -> bool:
        """True if the calibration raised: it is repeated when the study is started again."""
        return self.status == Status.STAGE_FAILED

    @property
    def total_s(self) -> float | None:
        """Time of the calibration in s including feature extraction; None if unknown."""
        return sum(value for value in self.seconds.values() if value is not None) if self.seconds else None

    @property
    def place(self) -> str:
        """Name of the frame, or "first +N" for a joint calibration with N more frames."""
        more = len(self.frames) - 1
        return self.frames[0] + (f" +{more}" if more else "") if self.frames else ""


@dataclass(frozen=True)
class StoredStudy:
    """A study as last started: the text of its file, and the overrides `data` of the command line.

    `published` are the `[[published]]` tables of the file as dicts with label, source, values by metric, etc.
    """

    name: str
    toml: str
    data: Mapping[str, Any]
    published: tuple[Mapping[str, Any], ...]


@dataclass(frozen=True)
class Pending:
    """The positions of the `pending` calibrations of a study, and the number of distinct ones that are `kept`."""

    pending: array[int]
    kept: int


_LABELS = tuple(f.name for f in fields(Planned))
_FIELDS = tuple(f.name for f in fields(StoredRow) if f.name not in (*_LABELS, "figures"))
_BRIEF_LABELS = ("key", "study", "row", "section", "dataset")
_BRIEF_TEXTS = ("frames", "joint", "perturb", "status", "trust", "seconds")
_BRIEF_NUMBERS = ("seed", *METRICS, "start_rotation_deg", "start_translation_m")
_BRIEF_FIGURES = tuple(
    f"predicted_{norm}{bound}" for norm in ("rotation_deg", "translation_m") for bound in ("", "_95")
)
_MOST_KNOWN = 100_000
"""Maximum number of distinct values that `brief_rows` keeps in order to share them between rows."""
_PLAN = ("study", "position", *(c for c in _LABELS if c != "study"))


def _values() -> tuple[str, ...]:
    """Return the columns of the outcome of a calibration: fields of the row, then figures."""
    return (*_FIELDS, *figure_columns())


def _view() -> str:
    return (
        f"CREATE VIEW rows AS SELECT {', '.join(f'plan.{c} AS {c}' for c in _LABELS)},"
        f" {', '.join(f'runs.{c} AS {c}' for c in _values())}"
        " FROM plan JOIN runs ON runs.key = plan.key ORDER BY plan.study, plan.position"
    )


def _schema() -> tuple[str, ...]:
    """Return the statements that create the tables.

    Outcomes (runs) are separate from the labels of a study (plan): a new label, a second study with the same row or a
    reverted edit needs no computation. The view `rows` joins the two for the current studies.
    """
    return (
        "CREATE TABLE studies (name TEXT PRIMARY KEY, toml TEXT, data TEXT, published TEXT)",
        f"CREATE TABLE runs (key TEXT PRIMARY KEY, {', '.join(f'{c} {type_of(c)}' for c in _values())})",
        f"CREATE TABLE plan (study TEXT, position INTEGER, {', '.join(f'{c} TEXT' for c in _LABELS if c != 'study')},"
        " PRIMARY KEY (study, position))",
        _view(),
    )


_TABLES = {"studies": ("name", "toml", "data", "published"), "plan": _PLAN, "runs": ("key", *_FIELDS)}
"""Tables with their required columns; `runs` also has the columns of figures."""
_KEYS = {"studies": ("name",), "plan": ("study", "position"), "runs": ("key",)}
_COLUMN = re.compile(r"\W?\w+\W?( (text|real|integer))?( primary key)?", re.ASCII)
_SQLITE_TABLES = re.compile(r"sqlite_(autoindex_(studies|plan|runs)_\d+|stat\d)", re.ASCII)
_SIDE_FILES = ("", "-wal", "-shm", "-journal")
_MISSING = "FROM plan WHERE study = ? AND key NOT IN (SELECT key FROM runs)"
_MOVE_HINT = "move the file to another folder and run again; cached features are reused"


class _LazyRows(Sequence[_Row], Generic[_Row]):
    """Rows of the store in a folder, read from the file on each access."""

    def __init__(self, folder: Path, count: Callable[[Store], int], each: Callable[[Store], Iterator[_Row]]) -> None:
        self._folder, self._count, self._each = folder, count, each

    def __len__(self) -> int:
        with Store.open(self._folder, create=False) as store:
            return self._count(store)

    def __iter__(self) -> Iterator[_Row]:
        with Store.open(self._folder, create=False) as store:
            yield from self._each(store)

    def __getitem__(self, number: Any) -> Any:
        if isinstance(number, slice):
            start, stop, step = number.indices(len(self))
            if step < 0:
                return list(self)[number]
            return list(itertools.islice(self, start, stop, step))
        wanted = number if number >= 0 else number + len(self)
        row = next(itertools.islice(self, wanted, None), None) if wanted >= 0 else None
        if row is None:
            raise IndexError(number)
        return row


class Store:
    """The file DIR/study.sqlite; several processes may use it at the same time, and rows are written atomically.

    Structured fields are JSON. Use it as a context manager, or call `close`. Foreign files with other tables and
    values that no study writes are refused.
    """

    def __init__(self, path: Path, connection: sqlite3.Connection) -> None:
        self.path = path
        self._connection = connection
        # A backend may iterate over jobs, which query the store, in its own thread.
        self._alone = threading.RLock()

    @classmethod
    def open(cls, folder: str | Path, *, create: bool = True) -> Store:
        """Open the store of a folder, creating it unless `create` is False (InputError if it is missing then).

        Missing columns of figures are added, with unknown values. Raises InputError for a folder that cannot be
        written and for a file that is not a store, of another version, or damaged.
        """
        path = expanded(folder) / FILE
        with _sqlite_errors(path):
            _refuse_special_files(path)
            if not create and not path.exists():
                raise InputError("the store is missing", where=path, expected="a folder that `p2o ablate --out` wrote")
            if create:
                path.parent.mkdir(parents=True, exist_ok=True)
            looked_at = path.exists() and cls._check_read_only(path)
            connection = _connected(path)
        try:
            with _sqlite_errors(path):
                store = cls(path, connection)
                if not looked_at:
                    store._check()
                _retry_while_locked(lambda: connection.execute("PRAGMA journal_mode=WAL"))
                # With a write-ahead log this loses no finished row when the process is killed.
                connection.execute("PRAGMA synchronous=NORMAL")
                store._prepare()
        except BaseException:
            connection.close()
            raise
        return store

    @classmethod
    def _check_read_only(cls, path: Path) -> bool:
        """Check with read-only access that a file is a store; raises InputError if it is not.

        Returns False if the check needs write access, as after a crash. A foreign file must not be opened for writing
        before the check: closing it would write its log.
        """
        with contextlib.closing(_connected(f"{path.absolute().as_uri()}?mode=ro")) as connection:
            try:
                cls(path, connection)._check()
            except InputError as problem:
                if _kind_of(problem.__cause__) in (sqlite3.SQLITE_READONLY, sqlite3.SQLITE_CANTOPEN):
                    return False
                raise
        return True

    def __enter__(self) -> Store:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Close the file."""
        # If the disk is full, changes stay in the write-ahead log.
        with contextlib.suppress(sqlite3.Error):
            self._connection.close()

    def begin(self, study: StoredStudy, planned: Iterable[Planned]) -> Pending:
        """Replace the plan of a study by `planned`, in the order of its table; `rows` and `missing` depend on it.

        Returns the calibrations to compute: missing ones and those that raised. Raises InputError if the file cannot be
        written.
        """
        columns = ", ".join(("position", *_LABELS))
        self._write_plan_table(planned, columns)
        with self._transaction():
            self._connection.execute(
                "INSERT OR REPLACE INTO studies VALUES (?, ?, ?, ?)",
                (study.name, study.toml, json_text(study.data), json_text(list(study.published))),
            )
            self._connection.execute("DELETE FROM plan WHERE study = ?", (study.name,))
            self._connection.execute(f"INSERT INTO plan ({columns}) SELECT {columns} FROM temp.planned")
            self._connection.execute("DROP TABLE temp.planned")
            # Two rows of the table may be the same calibration.
            positions = self._connection.execute(
                "SELECT MIN(position) FROM plan LEFT JOIN runs ON runs.key = plan.key WHERE study = ?"
                " AND (runs.key IS NULL OR runs.status = ?) GROUP BY plan.key ORDER BY 1",
                (study.name, Status.STAGE_FAILED.value),
            )
            pending = array("q", (position for (position,) in positions))
            [(different,)] = self._connection.execute(
                "SELECT COUNT(DISTINCT key) FROM plan WHERE study = ?", (study.name,)
            )
        return Pending(pending, different - len(pending))

    def _write_plan_table(self, planned: Iterable[Planned], columns: str) -> None:
        """Write the plan to a temporary table: other processes may write to the file while `planned` is iterated."""
        values = ((i, *(to_column(c, getattr(p, c)) for c in _LABELS)) for i, p in enumerate(planned))
        with self._alone, _sqlite_errors(self.path):
            self._connection.execute("DROP TABLE IF EXISTS temp.planned")
            self._connection.execute(f"CREATE TEMP TABLE planned ({columns})")
        insert = f"INSERT INTO temp.planned VALUES ({', '.join('?' * (len(_LABELS) + 1))})"
        while some := list(itertools.islice(values, _PAGE_ROWS)):
            with self._alone, _sqlite_errors(self.path):
                self._connection.execute("BEGIN")
                try:
                    self._connection.executemany(insert, some)
                finally:
                    self._connection.execute("COMMIT")

    def put(self, row: StoredRow) -> None:
        """Write one finished calibration atomically; a row of the same key is replaced.

        Raises InputError if the file cannot be written; existing rows are kept.
        """
        figures = figure_columns()
        values = [to_column(c, getattr(row, c)) for c in ("key", *_FIELDS)]
        values += [to_column(c, row.figures.get(c)) for c in figures]
        names, marks = ", ".join(("key", *_FIELDS, *figures)), ", ".join("?" * len(values))
        with self._transaction():
            self._connection.execute(f"INSERT OR REPLACE INTO runs ({names}) VALUES ({marks})", values)

    def finished(self, keys: Iterable[str]) -> set[str]:
        """Return the keys whose calibration is stored and did not raise."""
        keys = list(dict.fromkeys(keys))
        done: set[str] = set()
        for first in range(0, len(keys), 500):
            some = keys[first : first + 500]
            query = f"SELECT key FROM runs WHERE status != ? AND key IN ({', '.join('?' * len(some))})"
            done.update(key for (key,) in self._all(query, (Status.STAGE_FAILED.value, *some)))
        return done

    def count(self, study: str) -> int:
        """Return the number of finished calibrations of the study's plan."""
        query = "SELECT COUNT(*) FROM plan JOIN runs ON runs.key = plan.key WHERE plan.study = ?"
        return int(self._all(query, (study,))[0][0])

    def rows(self, study: str) -> list[StoredRow]:
        """Return the finished calibrations of the study, in the order of its table.

        Raises InputError for a row that no study writes.
        """
        return list(self._each_row(study))

    def brief_rows(
        self, study: str, on_rounds: Callable[[str, tuple[Round, ...]], None] = lambda label, rounds: None
    ) -> Iterator[StoredRow]:
        """Yield the finished calibrations of the study with the fields that a summary of many rows needs, in order.

        They are labels, frames, status, verdict, errors, predicted errors and seconds; all other fields have their
        default. `on_rounds` receives the label of each row and its rounds. `completed` reads the other fields. Rows
        share equal values, 1.3 kB each instead of 30 kB. Raises InputError for a value that no study writes.
        """
        known: dict[tuple[str, Any], Any] = {}

        def shared(column: str, value: Any) -> Any:
            if (column, value) not in known:
                if len(known) >= _MOST_KNOWN:
                    known.clear()
                known[column, value] = from_column(column, value)
            return known[column, value]

        def brief(**values: Any) -> StoredRow:
            figures = {c: from_column(c, v) for c in _BRIEF_FIGURES if (v := values.pop(c)) is not None}
            key, rounds = (from_column(c, values.pop(c)) for c in ("key", "rounds"))
            numbers = {c: from_column(c, values.pop(c)) for c in _BRIEF_NUMBERS}
            rest = {c: shared(c, value) for c, value in values.items()}
            on_rounds(rest["row"], rounds)
            return StoredRow(key, figures=figures, **numbers, **rest)

        own = (*_BRIEF_TEXTS, *_BRIEF_NUMBERS, *_BRIEF_FIGURES, "rounds")
        yield from self._each(brief, (*_BRIEF_LABELS, *own), _query_of(_BRIEF_LABELS, own), study, read=_unchanged)

    def completed(self, rows: Iterable[StoredRow]) -> list[StoredRow]:
        """Return `brief_rows` with all fields of their outcome; raises InputError for a value that no study writes."""
        columns, complete = _values(), []
        query = f"SELECT {', '.join(columns)} FROM runs WHERE key = ?"
        for row in rows:
            [record] = self._all(query, (row.key,))
            with self._naming_file():
                values = {c: from_column(c, value) for c, value in zip(columns, record, strict=True)}
            figures = {name: values.pop(name) for name in figure_columns()}
            complete.append(replace(row, **values, figures=figures))
        return complete

    def missing(self, study: str) -> list[Planned]:
        """Return the missing calibrations of the study, in the order of its table."""
        return list(self.each_missing(study))

    def all_rows(self, study: str) -> Sequence[StoredRow]:
        """Return `rows` as a sequence that reads the file on each access: a million rows are 20 GB."""
        return _LazyRows(self.path.parent, lambda store: store.count(study), lambda store: store._each_row(study))

    def all_missing(self, study: str) -> Sequence[Planned]:
        """Return `missing` as a sequence that reads the file on each access."""
        query = f"SELECT COUNT(*) {_MISSING}"
        return _LazyRows(
            self.path.parent,
            lambda store: int(store._all(query, (study,))[0][0]),
            lambda store: store.each_missing(study),
        )

    def _each_row(self, study: str) -> Iterator[StoredRow]:
        yield from self._each(_stored_row, (*_LABELS, *_values()), _query_of(_LABELS, _values()), study)

    def each_missing(self, study: str) -> Iterator[Planned]:
        """Yield the missing calibrations of the study, in the order of its table."""
        yield from self._each(Planned, _LABELS, f"SELECT position, {', '.join(_LABELS)} {_MISSING}", study)

    def _each(
        self,
        kind: Callable[..., _Row],
        columns: Sequence[str],
        query: str,
        study: str,
        read: Callable[[str, Any], Any] = from_column,
    ) -> Iterator[_Row]:
        """Yield the records of a query whose first column is the position, in this order, page by page."""
        query += f" AND plan.position > ? ORDER BY plan.position LIMIT {_PAGE_ROWS}"
        position = -1
        while records := self._all(query, (study, position)):
            position = records[-1][0]
            with self._naming_file():
                some = [
                    kind(**{c: read(c, value) for c, value in zip(columns, values, strict=True)})
                    for _, *values in records
                ]
            yield from some

    def studies(self) -> list[StoredStudy]:
        """Return the studies of this folder, by name."""
        records = self._all("SELECT name, toml, data, published FROM studies ORDER BY name", ())
        with self._naming_file():
            return [
                StoredStudy(
                    from_column("study", name),
                    from_column("toml", toml),
                    parsed_object("data", data),
                    parsed_published(published),
                )
                for name, toml, data, published in records
            ]

    @contextlib.contextmanager
    def _naming_file(self) -> Iterator[None]:
        """Add the file and a hint to the error of an invalid value."""
        try:
            yield
        except InputError as problem:
            raise InputError(
                "the store contains an invalid value", where=self.path, got=problem, hint=_MOVE_HINT
            ) from problem

    def _all(self, query: str, values: Sequence[Any]) -> list[tuple[Any, ...]]:
        with self._alone, _sqlite_errors(self.path):
            return _retry_while_locked(lambda: self._connection.execute(query, values).fetchall())

    @contextlib.contextmanager
    def _transaction(self) -> Iterator[None]:
        with self._alone, _sqlite_errors(self.path):
            _retry_while_locked(lambda: self._connection.execute("BEGIN IMMEDIATE"))
            try:
                yield
                self._connection.execute("COMMIT")
            except BaseException:
                # SQLite has rolled back already if the disk is full.
                if self._connection.in_transaction:
                    self._connection.execute("ROLLBACK")
                raise

    def _check(self) -> None:
        """Raise InputError for a file that is damaged or has other content than the tables of a store."""
        with self._alone, _sqlite_errors(self.path):
            # A transaction gives a consistent view: another process may be creating the tables.
            self._connection.execute("BEGIN")
            try:
                self._check_tables()
                # After the schema check: quick_check evaluates the checks and defaults of a foreign schema.
                [(verdict,), *_] = self._all("PRAGMA quick_check(1)", ())
                if verdict != "ok":
                    raise _damaged(self.path, verdict)
            finally:
                self._connection.execute("ROLLBACK")

    def _check_tables(self) -> None:
        schema = self._all("SELECT type, name, sql FROM sqlite_master", ())
        version = self._version()
        if not schema and version == 0:
            return
        tables = {name for kind, name, _ in schema if kind == "table"}
        for table in _TABLES.keys() - tables:
            raise _not_a_store(self.path, f"no table '{table}'")
        self._check_version(version == _VERSION)
        for kind, name, sql in schema:
            # Views are never queried.
            known = kind == "view" or bool(_SQLITE_TABLES.fullmatch(str(name)))
            if not known and not (kind == "table" and name in _TABLES and _is_plain(str(sql))):
                raise _not_a_store(self.path, f"the {kind} '{name}'")
        for table, expected in _TABLES.items():
            keys_of = {name: key for _, name, _, _, _, key in self._all(f"PRAGMA table_info({table})", ())}
            figures = set(figure_columns()) if table == "runs" else set()
            lacking, unknown = set(expected) - keys_of.keys(), keys_of.keys() - set(expected) - figures
            if table == "runs" and unknown and not lacking:
                self._check_version(False, f"columns {', '.join(sorted(unknown))}")
            if unknown or lacking or {name for name, key in keys_of.items() if key} != set(_KEYS[table]):
                raise _not_a_store(self.path, f"a table '{table}' with other columns")

    def _check_version(self, known: bool, got: str = "") -> None:
        if not known:
            raise InputError(
                "the store was written by another version of p2o",
                where=self.path,
                expected=f"version {_VERSION}",
                got=got or f"version {self._version()}",
                hint="choose another folder, or " + _MOVE_HINT,
            )

    def _prepare(self) -> None:
        """Create the tables of a new file, and missing columns of figures."""
        if self._version() == 0 or self._lacking():
            with self._transaction():
                # Another process may have created the tables.
                if self._version() == 0:
                    statements: Iterable[str] = (*_schema(), f"PRAGMA user_version = {_VERSION}")
                else:
                    lacking = [f"ALTER TABLE runs ADD COLUMN {c} {type_of(c)}" for c in self._lacking()]
                    statements = (*lacking, "DROP VIEW IF EXISTS rows", _view()) if lacking else ()
                for statement in statements:
                    self._connection.execute(statement)
        self._check_version(self._version() == _VERSION)

    def _lacking(self) -> list[str]:
        """Return the missing columns of figures."""
        columns = {name for _, name, *_ in self._all("PRAGMA table_info(runs)", ())}
        return [name for name in figure_columns() if name not in columns]

    def _version(self) -> int:
        return int(self._all("PRAGMA user_version", ())[0][0])


def _query_of(labels: Iterable[str], values: Iterable[str]) -> str:
    """Return the query of the finished calibrations of a study, the position first."""
    # The view is not used: a foreign file may define it differently.
    columns = ", ".join((*(f"plan.{c}" for c in labels), *(f"runs.{c}" for c in values)))
    return f"SELECT plan.position, {columns} FROM plan JOIN runs ON runs.key = plan.key WHERE plan.study = ?"


def _unchanged(_: str, value: Any) -> Any:
    return value


def _stored_row(**columns: Any) -> StoredRow:
    """Return a row from the values of its columns."""
    figures = {name: columns.pop(name) for name in figure_columns()}
    return StoredRow(**columns, figures=figures)


def _connected(path: Path | str) -> sqlite3.Connection:
    """Return a connection to a file, or to a URI where `path` is a text."""
    is_uri = isinstance(path, str)
    connection = sqlite3.connect(path, timeout=_WAIT_S, isolation_level=None, check_same_thread=False, uri=is_uri)
    # Do not run functions that the schema of a foreign file calls.
    connection.execute("PRAGMA trusted_schema=OFF")
    return connection


def _kind_of(problem: BaseException | None) -> int:
    """Return the primary error code of SQLite: the low byte of the extended code."""
    return int(getattr(problem, "sqlite_errorcode", sqlite3.SQLITE_ERROR)) & 0xFF


@contextlib.contextmanager
def _sqlite_errors(path: Path) -> Iterator[None]:
    """Convert errors of SQLite and of the operating system into InputError with the file and a hint."""
    try:
        yield
    except OSError as problem:
        raise _cannot_write(path, problem.strerror or problem) from problem
    except (sqlite3.ProgrammingError, sqlite3.InterfaceError):
        raise  # a programming error, not a fault of the file
    except sqlite3.Error as problem:
        kind = _kind_of(problem)
        if kind in _FILE_SYSTEM_ERRORS:
            raise _cannot_write(path, problem) from problem
        if kind == sqlite3.SQLITE_CORRUPT:
            raise _damaged(path, problem) from problem
        raise _not_a_store(path, problem) from problem
    except (MemoryError, UnicodeDecodeError) as problem:
        raise _damaged(path, problem or "not enough memory") from problem


def _is_plain(sql: str) -> bool:
    """Return whether a table definition has only names and types, without checks and computed defaults."""
    head, _, columns = " ".join(sql.lower().split()).partition("(")
    columns = re.sub(r", ?primary key ?\(study, ?position\)(?=\)$)", "", columns.replace(" )", ")").strip())
    return head.startswith("create table ") and all(
        _COLUMN.fullmatch(column.strip()) for column in columns.removesuffix(")").split(",")
    )


def _cannot_write(path: Path, problem: object) -> InputError:
    return InputError(
        "the results cannot be written",
        where=path,
        expected="a writable folder with free space",
        got=problem,
        hint="free some space and run the same command, which continues with the stored rows, or name another folder "
        "(a copy of this one keeps the rows)",
    )


def _damaged(path: Path, problem: object) -> InputError:
    return InputError(
        "the store of studies is damaged",
        where=path,
        got=problem,
        hint=f"{_MOVE_HINT}; `sqlite3 FILE .recover` may save rows",
    )


def _not_a_store(path: Path, got: object) -> InputError:
    return InputError("the file is not a store of studies", where=path, got=got, hint=_MOVE_HINT)


def _refuse_special_files(path: Path) -> None:
    """Raise InputError if the store or one of SQLite's side files is a folder, a pipe or a device."""
    for suffix in _SIDE_FILES:
        beside = path.with_name(path.name + suffix)
        try:
            mode = beside.stat().st_mode
        except (FileNotFoundError, NotADirectoryError):
            continue
        if not stat.S_ISREG(mode):
            raise InputError(
                "not a regular file", where=beside, expected="a store of studies, or nothing", hint=_MOVE_HINT
            )


def _retry_while_locked(act: Callable[[], _T]) -> _T:
    """Return the result of `act`, repeated while another process holds a lock."""
    until = time.monotonic() + _BUSY_S
    while True:
        try:
            return act()
        except sqlite3.OperationalError as problem:
            # SQLite does not wait if two processes switch to the write-ahead log at the same time.
            if "locked" not in str(problem) or time.monotonic() > until:
                raise
            time.sleep(0.01)
