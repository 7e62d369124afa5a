"""The results of studies as data: one SQLite file, one row a calibration, written whole or not at all.

`pandas.read_sql("select * from rows", "sqlite:///DIR/study.sqlite")` reads what the studies in DIR came to.
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
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any, Generic, TypeVar

from p2o.arrays import Float
from p2o.errors import InputError
from p2o.files.input_file import expanded
from p2o.results.result import Status
from p2o.results.verdict import Trust
from p2o.study.columns import (
    LIKELY,
    RIVAL,
    TIME,
    from_column,
    json_text,
    parsed_object,
    parsed_published,
    to_column,
    type_of,
)

FILE = "study.sqlite"
_AT_A_TIME = 1000
"""So many rows are read at once."""
_VERSION = 3
_BUSY_S = 60.0
_WAIT_S = 1.0
"""SQLite itself waits so long at a time: while it does, nothing interrupts it."""
_OUTER_ERRORS = (
    sqlite3.SQLITE_PERM,
    sqlite3.SQLITE_BUSY,
    sqlite3.SQLITE_READONLY,
    sqlite3.SQLITE_IOERR,
    sqlite3.SQLITE_FULL,
    sqlite3.SQLITE_CANTOPEN,
)
"""Errors of SQLite that come from around the file, not from what is in it."""

_T = TypeVar("_T")
_Row = TypeVar("_Row", bound="Planned")


@dataclass(frozen=True)
class Planned:
    """One calibration that a study asks for; `key` names what is computed, the rest how the study calls it.

    `row` is the label of the row of the table it belongs to, `section` the heading above it. `dataset`, `extractor`
    (IMAGE/CLOUD), `matcher`, `solver`, `init` and `calibrator` are the words of the study file, so that the name of a
    variant stays; they are empty where a row has none.
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


@dataclass(frozen=True, eq=False)
class StoredRow(Planned):
    """One finished calibration: `Planned` says what it is called, the rest what came out.

    `joint` is the number of frames that were solved together, 0 where each is solved alone. `status` is that of the
    `Result`; `exception` the traceback where the run raised. The errors are of `estimate` against `truth`, None
    where either is unknown; a refused calibration has the errors of its start, which is what the user is left with.
    `trust` is the word of the verdict and `why` its reasons, `agreement` the odds ratio, `rival_lead` (in `rival_unit`)
    and so on the next best pose, `likely_rotation_deg` and so on the likely accuracy, `time_offset_s`, `time_sigma_s`
    and `time_use` ("used" or "told") the offset between images and sweeps, `judged` the costs of start and estimate as
    a dict; None where there is none, as in every row of a store of a version that did not know it.
    `estimate`, `start` and `truth` are camera_from_lidar (4, 4). `rounds` holds `Round`s as dicts, `matches` counts
    by direction, `seconds` by stage, `recipe` every option that took effect, `inputs` the hashes of each frame's
    image and sweep. `finished` is the time of day in UTC, ISO 8601.
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
    agreement: float | None = None
    rival_lead: float | None = None
    rival_unit: str | None = None
    rival_rotation_deg: float | None = None
    rival_translation_m: float | None = None
    likely_rotation_deg: float | None = None
    likely_translation_m: float | None = None
    likely_rotation_deg_95: float | None = None
    likely_translation_m_95: float | None = None
    time_offset_s: float | None = None
    time_sigma_s: float | None = None
    time_use: str | None = None
    judged: Mapping[str, Any] | None = None
    estimate: Float | None = None
    start: Float | None = None
    truth: Float | None = None
    rounds: tuple[Mapping[str, Any], ...] = ()
    matches: Mapping[str, int] = field(default_factory=dict)
    seconds: Mapping[str, float] = field(default_factory=dict)
    recipe: Mapping[str, Any] = field(default_factory=dict)
    versions: Mapping[str, str] = field(default_factory=dict)
    inputs: Mapping[str, Any] = field(default_factory=dict)
    exception: str | None = None
    finished: str = ""

    @property
    def solved(self) -> bool:
        """True where the estimate is one, and not the start handed back."""
        return Status(self.status).solved

    @property
    def crashed(self) -> bool:
        """True where the run raised: such a row is computed again when the study is started again."""
        return self.status == Status.STAGE_FAILED

    @property
    def place(self) -> str:
        """Name of the frame, or "first +N" for N more that were solved with it."""
        more = len(self.frames) - 1
        return self.frames[0] + (f" +{more}" if more else "") if self.frames else ""


@dataclass(frozen=True)
class StoredStudy:
    """A study as it was last started: the text of its file, and the words of the command line that override it.

    `published` are the `[[published]]` tables of the file as dicts: label, source, values by metric, and so on.
    """

    name: str
    toml: str
    data: Mapping[str, Any]
    published: tuple[Mapping[str, Any], ...]


@dataclass(frozen=True)
class Begun:
    """What a study has before it: the positions in its table that are `pending`; so many different ones are `kept`."""

    pending: array[int]
    kept: int


_LABELS = tuple(f.name for f in fields(Planned))
_VALUES = tuple(f.name for f in fields(StoredRow) if f.name not in _LABELS)
_NEW_IN_2 = ("trust", "why", "agreement", *RIVAL, "rival_unit", *LIKELY, "judged")
_NEW_IN_3 = (*TIME, "time_use")
_NEW_SINCE = {1: (*_NEW_IN_2, *_NEW_IN_3), 2: _NEW_IN_3}
"""Columns that a store of an earlier version lacks."""
_PLAN = ("study", "position", *(c for c in _LABELS if c != "study"))
_RUNS = ("key", *_VALUES)

_VIEW = (
    f"CREATE VIEW rows AS SELECT {', '.join(f'plan.{c} AS {c}' for c in _LABELS)},"
    f" {', '.join(f'runs.{c} AS {c}' for c in _VALUES)}"
    " FROM plan JOIN runs ON runs.key = plan.key ORDER BY plan.study, plan.position"
)

# What is computed (runs) is kept apart from how a study calls it (plan): a new label, a second study with the same
# row, or an edit that is taken back cost nothing. `rows` is what the studies ask for now.
_SCHEMA = (
    "CREATE TABLE studies (name TEXT PRIMARY KEY, toml TEXT, data TEXT, published TEXT)",
    f"CREATE TABLE runs (key TEXT PRIMARY KEY, {', '.join(f'{c} {type_of(c)}' for c in _VALUES)})",
    f"CREATE TABLE plan (study TEXT, position INTEGER, {', '.join(f'{c} TEXT' for c in _LABELS if c != 'study')},"
    " PRIMARY KEY (study, position))",
    _VIEW,
)

# Version 2 has more columns, and rounds whose cost need not be in pixels. Rows of before have none of the new.
_FROM_1_TO_3 = (
    *(f"ALTER TABLE runs ADD COLUMN {c} {type_of(c)}" for c in _NEW_SINCE[1]),
    """UPDATE runs SET rounds = replace(replace(rounds, '"mean_residual_px":', '"mean_residual":'),
    '"directed_cost_px":', '"cost":')""",
    "DROP VIEW rows",
    _VIEW,
)
# Version 3 has the offset in time.
_FROM_2_TO_3 = (
    *(f"ALTER TABLE runs ADD COLUMN {c} {type_of(c)}" for c in _NEW_SINCE[2]),
    "DROP VIEW rows",
    _VIEW,
)


_TABLES = {"studies": ("name", "toml", "data", "published"), "plan": _PLAN, "runs": _RUNS}
_KEYS = {"studies": ("name",), "plan": ("study", "position"), "runs": ("key",)}
_COLUMN = re.compile(r"\W?\w+\W?( (text|real|integer))?( primary key)?", re.ASCII)
_OF_SQLITE = re.compile(r"sqlite_(autoindex_(studies|plan|runs)_\d+|stat\d)", re.ASCII)
_SIDE_FILES = ("", "-wal", "-shm", "-journal")
_MISSING = "FROM plan WHERE study = ? AND key NOT IN (SELECT key FROM runs)"
_AWAY = "move it away and run again: features that are cached are not extracted again"


class _Read(Sequence[_Row], Generic[_Row]):
    """Rows of the store in a folder that are read whenever they are looked at."""

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
        found = next(itertools.islice(self, wanted, None), None) if wanted >= 0 else None
        if found is None:
            raise IndexError(number)
        return found


class Store:
    """The file DIR/study.sqlite; several processes may use it at once, and none leaves half a row behind.

    The text form of every field is JSON. Use it as a context manager, or call `close`. A file may come from anywhere:
    one that holds more than the tables of a store is refused, and so is a value that no study writes.
    """

    def __init__(self, path: Path, connection: sqlite3.Connection) -> None:
        self.path = path
        self._connection = connection
        # A backend may ask from a thread of its own whether a row is still to be computed.
        self._alone = threading.RLock()

    @classmethod
    def open(cls, folder: str | Path, *, create: bool = True) -> Store:
        """Return the store of a folder, which is made if need be (`create` False: InputError where there is none).

        A store of an earlier version is brought to this one; its rows say nothing in the columns that are new. Raises
        InputError for a folder that cannot be written and for a file that is no store, one of another version, or one
        that is damaged.
        """
        path = expanded(folder) / FILE
        with _telling(path):
            _refuse_what_is_no_file(path)
            if not create and not path.exists():
                raise InputError("there is no study", where=path, expected="a folder that `p2o ablate --out` wrote")
            if create:
                path.parent.mkdir(parents=True, exist_ok=True)
            looked_at = path.exists() and cls._looked_at(path)
            connection = _connected(path)
        try:
            with _telling(path):
                store = cls(path, connection)
                if not looked_at:
                    store._check()
                _patiently(lambda: connection.execute("PRAGMA journal_mode=WAL"))
                # With a write-ahead log this loses no finished row when the process is killed.
                connection.execute("PRAGMA synchronous=NORMAL")
                store._prepare()
        except BaseException:
            connection.close()
            raise
        return store

    @classmethod
    def _looked_at(cls, path: Path) -> bool:
        """Return whether a file is found to be a store without touching it; raises InputError where it is none.

        False where only whoever may write can tell, as behind a crash. Closing a file that was opened for writing
        writes, where a log lies beside it: what is not ours has to stay as it is.
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
        # What the log of a full disk could not take over stays in the log.
        with contextlib.suppress(sqlite3.Error):
            self._connection.close()

    def begin(self, study: StoredStudy, planned: Iterable[Planned]) -> Begun:
        """Note what a study asks for now, in the order of its table; `rows` and `missing` follow it from here on.

        Returns what of it is still to be computed: it is not there, or it raised. Raises InputError where the file
        cannot be written.
        """
        columns = ", ".join(("position", *_LABELS))
        self._put_aside(planned, columns)
        with self._transaction():
            self._connection.execute(
                "INSERT OR REPLACE INTO studies VALUES (?, ?, ?, ?)",
                (study.name, study.toml, json_text(study.data), json_text(list(study.published))),
            )
            self._connection.execute("DELETE FROM plan WHERE study = ?", (study.name,))
            self._connection.execute(f"INSERT INTO plan ({columns}) SELECT {columns} FROM temp.planned")
            self._connection.execute("DROP TABLE temp.planned")
            # Two rows of the table may be one and the same calibration.
            found = self._connection.execute(
                "SELECT MIN(position) FROM plan LEFT JOIN runs ON runs.key = plan.key WHERE study = ?"
                " AND (runs.key IS NULL OR runs.status = ?) GROUP BY plan.key ORDER BY 1",
                (study.name, Status.STAGE_FAILED.value),
            )
            pending = array("q", (position for (position,) in found))
            [(different,)] = self._connection.execute(
                "SELECT COUNT(DISTINCT key) FROM plan WHERE study = ?", (study.name,)
            )
        return Begun(pending, different - len(pending))

    def _put_aside(self, planned: Iterable[Planned], columns: str) -> None:
        """Keep what is planned in a table of this connection: others may write while it is worked out."""
        values = ((i, *(to_column(c, getattr(p, c)) for c in _LABELS)) for i, p in enumerate(planned))
        with self._alone, _telling(self.path):
            self._connection.execute("DROP TABLE IF EXISTS temp.planned")
            self._connection.execute(f"CREATE TEMP TABLE planned ({columns})")
        insert = f"INSERT INTO temp.planned VALUES ({', '.join('?' * (len(_LABELS) + 1))})"
        while some := list(itertools.islice(values, _AT_A_TIME)):
            with self._alone, _telling(self.path):
                self._connection.execute("BEGIN")
                try:
                    self._connection.executemany(insert, some)
                finally:
                    self._connection.execute("COMMIT")

    def put(self, row: StoredRow) -> None:
        """Write one finished calibration, whole or not at all; one of the same key is replaced.

        Raises InputError where the file cannot be written; the rows that are there stay.
        """
        values = [to_column(c, getattr(row, c)) for c in _RUNS]
        marks = ", ".join("?" * len(values))
        with self._transaction():
            self._connection.execute(f"INSERT OR REPLACE INTO runs ({', '.join(_RUNS)}) VALUES ({marks})", values)

    def finished(self, keys: Iterable[str]) -> set[str]:
        """Return which of the keys need not be computed again: their run is there and did not raise."""
        keys = list(dict.fromkeys(keys))
        found: set[str] = set()
        for first in range(0, len(keys), 500):
            some = keys[first : first + 500]
            query = f"SELECT key FROM runs WHERE status != ? AND key IN ({', '.join('?' * len(some))})"
            found.update(key for (key,) in self._all(query, (Status.STAGE_FAILED.value, *some)))
        return found

    def count(self, study: str) -> int:
        """Return how much is finished of what the study asks for."""
        query = "SELECT COUNT(*) FROM plan JOIN runs ON runs.key = plan.key WHERE plan.study = ?"
        return int(self._all(query, (study,))[0][0])

    def rows(self, study: str) -> list[StoredRow]:
        """Return what is finished of what the study asks for, in the order of its table.

        Raises InputError for a row that no study has written.
        """
        return list(self._each_row(study))

    def missing(self, study: str) -> list[Planned]:
        """Return what the study asks for and is not there yet, in the order of its table."""
        return list(self._each_missing(study))

    def all_rows(self, study: str) -> Sequence[StoredRow]:
        """Return what `rows` does, read from the file whenever it is looked at: a million of them are 20 GB."""
        return _Read(self.path.parent, lambda store: store.count(study), lambda store: store._each_row(study))

    def all_missing(self, study: str) -> Sequence[Planned]:
        """Return what `missing` does, read from the file whenever it is looked at."""
        query = f"SELECT COUNT(*) {_MISSING}"
        return _Read(
            self.path.parent,
            lambda store: int(store._all(query, (study,))[0][0]),
            lambda store: store._each_missing(study),
        )

    def _each_row(self, study: str) -> Iterator[StoredRow]:
        # Not from the view, which a foreign file may define as it likes.
        query = (
            f"SELECT plan.position, {', '.join((*(f'plan.{c}' for c in _LABELS), *(f'runs.{c}' for c in _VALUES)))}"
            " FROM plan JOIN runs ON runs.key = plan.key WHERE plan.study = ?"
        )
        yield from self._each(StoredRow, (*_LABELS, *_VALUES), query, study)

    def _each_missing(self, study: str) -> Iterator[Planned]:
        yield from self._each(Planned, _LABELS, f"SELECT position, {', '.join(_LABELS)} {_MISSING}", study)

    def _each(self, kind: type[_Row], columns: Sequence[str], query: str, study: str) -> Iterator[_Row]:
        """Yield what a query finds that begins with the position, in its order, so many at a time."""
        query += f" AND plan.position > ? ORDER BY plan.position LIMIT {_AT_A_TIME}"
        position = -1
        while found := self._all(query, (study, position)):
            position = found[-1][0]
            with self._believing():
                some = [
                    kind(**{c: from_column(c, value) for c, value in zip(columns, values, strict=True)})
                    for _, *values in found
                ]
            yield from some

    def studies(self) -> list[StoredStudy]:
        """Return the studies of this folder, by name."""
        found = self._all("SELECT name, toml, data, published FROM studies ORDER BY name", ())
        with self._believing():
            return [
                StoredStudy(
                    from_column("study", name),
                    from_column("toml", toml),
                    parsed_object("data", data),
                    parsed_published(published),
                )
                for name, toml, data, published in found
            ]

    @contextlib.contextmanager
    def _believing(self) -> Iterator[None]:
        """Put the file and the way out on what is said of a value that is not what it must be."""
        try:
            yield
        except InputError as problem:
            raise InputError(
                "the store holds what no study writes", where=self.path, got=problem, hint=_AWAY
            ) from problem

    def _all(self, query: str, values: Sequence[Any]) -> list[tuple[Any, ...]]:
        with self._alone, _telling(self.path):
            return _patiently(lambda: self._connection.execute(query, values).fetchall())

    @contextlib.contextmanager
    def _transaction(self) -> Iterator[None]:
        with self._alone, _telling(self.path):
            _patiently(lambda: self._connection.execute("BEGIN IMMEDIATE"))
            try:
                yield
                self._connection.execute("COMMIT")
            except BaseException:
                # A full disk has ended the transaction by itself.
                if self._connection.in_transaction:
                    self._connection.execute("ROLLBACK")
                raise

    def _check(self) -> None:
        """Raise InputError for a file that is damaged, or that holds anything but the tables of a store."""
        with self._alone, _telling(self.path):
            # One look at one state: another process may be about to make the tables.
            self._connection.execute("BEGIN")
            try:
                self._check_tables()
                # Only now: it computes the checks and defaults that a foreign schema may hold.
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
            raise _foreign(self.path, f"no table '{table}'")
        self._check_version(0 < version <= _VERSION)
        for kind, name, sql in schema:
            # No view is ever asked.
            known = kind == "view" or bool(_OF_SQLITE.fullmatch(str(name)))
            if not known and not (kind == "table" and name in _TABLES and _is_plain(str(sql))):
                raise _foreign(self.path, f"the {kind} '{name}'")
        for table, expected in _TABLES.items():
            there = {name: key for _, name, _, _, _, key in self._all(f"PRAGMA table_info({table})", ())}
            asked = set(expected) - set(_NEW_SINCE.get(version, ()))
            if there.keys() != asked or {name for name, key in there.items() if key} != set(_KEYS[table]):
                raise _foreign(self.path, f"a table '{table}' of other columns")

    def _check_version(self, known: bool) -> None:
        if not known:
            raise InputError(
                "the store was written by another version of p2o",
                where=self.path,
                expected=f"version {_VERSION}",
                got=f"version {self._version()}",
                hint="choose another folder, or " + _AWAY,
            )

    def _prepare(self) -> None:
        """Make the tables of a new file, or bring those of an older one up to date."""
        for version, statements in ((0, _SCHEMA), (1, _FROM_1_TO_3), (2, _FROM_2_TO_3)):
            if self._version() == version:
                with self._transaction():
                    # Another process may have been first since we looked.
                    if self._version() == version:
                        for statement in statements:
                            self._connection.execute(statement)
                        self._connection.execute(f"PRAGMA user_version = {_VERSION}")
        self._check_version(self._version() == _VERSION)

    def _version(self) -> int:
        return int(self._all("PRAGMA user_version", ())[0][0])


def _connected(path: Path | str) -> sqlite3.Connection:
    """Return a connection to a file, or to a URI where `path` is a text."""
    is_uri = isinstance(path, str)
    connection = sqlite3.connect(path, timeout=_WAIT_S, isolation_level=None, check_same_thread=False, uri=is_uri)
    # Functions that a foreign file names in its schema are not run.
    connection.execute("PRAGMA trusted_schema=OFF")
    return connection


def _kind_of(problem: BaseException | None) -> int:
    """Return the kind of an error of SQLite: the low byte of its code, above which are the details."""
    return int(getattr(problem, "sqlite_errorcode", sqlite3.SQLITE_ERROR)) & 0xFF


@contextlib.contextmanager
def _telling(path: Path) -> Iterator[None]:
    """Turn what SQLite and the system say into an error that names the file and the way out."""
    try:
        yield
    except OSError as problem:
        raise _unkept(path, problem.strerror or problem) from problem
    except (sqlite3.ProgrammingError, sqlite3.InterfaceError):
        raise  # a mistake of ours, not of the file
    except sqlite3.Error as problem:
        kind = _kind_of(problem)
        if kind in _OUTER_ERRORS:
            raise _unkept(path, problem) from problem
        if kind == sqlite3.SQLITE_CORRUPT:
            raise _damaged(path, problem) from problem
        raise InputError("this is not a store of studies", where=path, got=problem, hint=_AWAY) from problem
    except (MemoryError, UnicodeDecodeError) as problem:
        raise _damaged(path, problem or "it asks for more memory than there is") from problem


def _is_plain(sql: str) -> bool:
    """Return whether a table is made of names and types alone: no check and no default that computes something."""
    head, _, columns = " ".join(sql.lower().split()).partition("(")
    columns = re.sub(r", ?primary key ?\(study, ?position\)(?=\)$)", "", columns.replace(" )", ")").strip())
    return head.startswith("create table ") and all(
        _COLUMN.fullmatch(column.strip()) for column in columns.removesuffix(")").split(",")
    )


def _unkept(path: Path, problem: object) -> InputError:
    return InputError(
        "the results cannot be kept here",
        where=path,
        expected="a folder that can be written, with room in it",
        got=problem,
        hint="make room and run again, which goes on with the rows that are there, or name another folder; a copy of "
        "this one does, too",
    )


def _damaged(path: Path, problem: object) -> InputError:
    return InputError(
        "the store of studies is damaged",
        where=path,
        got=problem,
        hint=f"{_AWAY}; `sqlite3 FILE .recover` may save rows",
    )


def _foreign(path: Path, what: str) -> InputError:
    return InputError("this is not a store of studies", where=path, got=what, hint=_AWAY)


def _refuse_what_is_no_file(path: Path) -> None:
    """Raise InputError where the store or a file that SQLite keeps beside it is a folder, a pipe or a device."""
    for suffix in _SIDE_FILES:
        beside = path.with_name(path.name + suffix)
        try:
            mode = beside.stat().st_mode
        except (FileNotFoundError, NotADirectoryError):
            continue
        if not stat.S_ISREG(mode):
            raise InputError("this is no file", where=beside, expected="a store of studies, or nothing", hint=_AWAY)


def _patiently(act: Callable[[], _T]) -> _T:
    """Return what `act` returns, trying again while another process holds the file."""
    until = time.monotonic() + _BUSY_S
    while True:
        try:
            return act()
        except sqlite3.OperationalError as problem:
            # SQLite does not wait by itself where two processes turn to the write-ahead log at the same moment.
            if "locked" not in str(problem) or time.monotonic() > until:
                raise
            time.sleep(0.01)
