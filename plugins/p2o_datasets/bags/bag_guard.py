"""Check bags before and while `rosbags` reads them: SQLite files are programs, and indexes may be false.

A schema may contain views that compute without end and columns that allocate gigabytes. An MCAP index may name one
chunk many times. Bags are refused unless they consist of plain tables and of chunks that do not overlap.
"""

from __future__ import annotations

import sqlite3
import threading
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any
from urllib.parse import quote

from p2o import InputError

_MAX_ROWS = 10_000
"""Maximum number of topics and of message definitions."""
_MAX_CELL_BYTES = 1 << 22
"""Maximum size of a cell of the small tables: definitions of messages are texts of some kilobytes."""
_STEPS, _STEPS_PER_BYTE, _STEPS_PER_CALL = 20_000_000, 50, 100_000
"""Number of instructions of SQLite per query: a stored message has at least ten bytes and costs below 100."""
_MAX_OVERLAP_BYTES = 2 << 30
"""Upper bound for the chunks of an MCAP file that contain one moment; all of them are in memory at that moment."""
_LOCK = threading.Lock()
_TABLES = ("schema", "message_definitions", "topics")
"""Tables other than messages that rosbags reads."""
_INTEGERS = ("id", "schema_version")


def escaped(file: Path) -> Path:
    """Return the path as rosbags has to get it: it writes the path into a URI, where ?, # and % have a meaning."""
    return Path(quote(bytes(file.absolute())))


def check_sqlite(file: Path) -> None:
    """Raise InputError or sqlite3.Error for a bag with other than plain tables, and for cells of another type or size.

    The contents of the table of messages are checked when they are read.
    """
    with closing(sqlite3.connect(f"file:{escaped(file)}?immutable=1&mode=ro", uri=True)) as connection:
        connection.execute("PRAGMA trusted_schema=OFF")
        connection.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, _MAX_CELL_BYTES)
        connection.set_progress_handler(_counter(0), _STEPS_PER_CALL)
        _check_schema(connection, file)
        _check_rows(connection, file)


def _check_schema(connection: sqlite3.Connection, file: Path) -> None:
    for kind, name, sql in connection.execute("SELECT type, name, sql FROM sqlite_master"):
        # The column `type` may contradict the statement, which is what SQLite executes.
        is_plain = isinstance(sql, str) and " ".join(sql.lower().split()).startswith(f"create {kind} ")
        if kind not in ("table", "index") or not (is_plain or (kind == "index" and sql is None)):
            raise _not_plain(file, f"the {kind} '{name}'")
    for table in ("messages", *_TABLES):
        for _, column, _, _, default, _, hidden in connection.execute(f"PRAGMA table_xinfo({table})"):
            if hidden or default is not None:
                raise _not_plain(file, f"the computed column '{column}' of '{table}'")


def _check_rows(connection: sqlite3.Connection, file: Path) -> None:
    size = file.stat().st_size
    for table in _TABLES:
        columns = [row[1] for row in connection.execute(f"PRAGMA table_info({table})")]
        identifiers: set[int] = set()
        for number, row in enumerate(connection.execute(f"SELECT * FROM {table}") if columns else (), 1):
            cells = dict(zip(columns, row, strict=True))
            wrong = [c for c, value in cells.items() if not isinstance(value, int if c in _INTEGERS else str)]
            if wrong:
                raise _not_plain(file, f"{type(cells[wrong[0]]).__name__} in column '{wrong[0]}' of '{table}'")
            size -= sum(len(value) for value in row if isinstance(value, str))
            identifiers.add(cells.get("id", number))
            # A join repeats messages for each topic of the same id; rows that share pages are larger than the file.
            if number > _MAX_ROWS or size < 0 or len(identifiers) < number:
                raise _not_plain(file, f"repeated or too many rows in '{table}'")


@contextmanager
def limited_connections(file: Path) -> Iterator[None]:
    """Limit the connections to SQLite that rosbags opens inside."""
    import apsw

    def limit(connection: Any) -> None:
        connection.config(apsw.SQLITE_DBCONFIG_TRUSTED_SCHEMA, 0)
        limit_steps(connection, file)

    with _LOCK:
        apsw.connection_hooks.append(limit)
        try:
            yield
        finally:
            apsw.connection_hooks.remove(limit)


def limit_steps(connection: Any, file: Path) -> None:
    """Limit the next queries of a connection of apsw: instructions, and the size of values to that of the file."""
    import apsw

    size = file.stat().st_size
    connection.limit(apsw.SQLITE_LIMIT_LENGTH, min(max(size, 1 << 20), 1 << 30))
    connection.set_progress_handler(_counter(size), _STEPS_PER_CALL)


def _counter(size: int) -> Callable[[], bool]:
    """Return a handler that interrupts a query of a file of `size` bytes after too many instructions."""
    calls = iter(range((_STEPS + _STEPS_PER_BYTE * size) // _STEPS_PER_CALL))
    return lambda: next(calls, None) is None


def check_chunks(reader: Any, file: Path) -> None:
    """Raise InputError if chunks in the index of an MCAP file overlap, in the file or too many at one moment."""
    end, moments = 0, []
    size = file.stat().st_size
    for chunk in sorted(reader.chunks, key=lambda chunk: chunk.chunk_start_offset):
        start, length = chunk.chunk_start_offset, chunk.chunk_length
        if start < end or start + length > size or chunk.compressed_size > length:
            got = f"a chunk at {start} of {length} bytes"
            raise InputError("the index of the bag is false", where=file, expected="chunks one after another", got=got)
        end = start + length
        moments += [(chunk.message_start_time, 0, chunk.uncompressed_size)]
        moments += [(chunk.message_end_time, 1, -chunk.uncompressed_size)]
    total = 0
    for _, _, change in sorted(moments):
        total += change
        if total > _MAX_OVERLAP_BYTES:
            expected = f"at most {_MAX_OVERLAP_BYTES} bytes of chunks at one moment"
            raise InputError("too many chunks overlap in time", where=file, expected=expected, got=f"{total} bytes")


def _not_plain(file: Path, got: str) -> InputError:
    expected, hint = "the plain tables that ROS 2 writes", "record or convert it again"
    return InputError("the bag cannot be read", where=file, expected=expected, got=got, hint=hint)
