"""Read tables of Apache Arrow with pyarrow (the extra `arrow`): complete Feather files, and rows of Parquet files."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from struct import error as StructError
from typing import Any

import numpy as np
from p2o import InputError
from p2o.reading import read_bytes, read_start

from p2o_datasets.arrow_size import stream_size
from p2o_datasets.lazy_dataset import damage_explained, optional_package

_MAGIC = b"ARROW1\0\0"
_MAX_BYTES = 256 << 20
"""Upper bound for sweeps and lists of poses, as a file and in memory."""
_MAX_ROWS = 1 << 24
_MAX_PARQUET_BYTES = 16 << 30
_MAX_TEXTS = 1 << 16
_MAX_RATIO = 1000
"""Upper bound for values compared with their bytes in the file: empty range images are compressed by 50."""


def read_feather(path: Path, what: str, columns: Mapping[str, str]) -> dict[str, Any]:
    """Return columns of a Feather file by name, each (N,); `columns` maps them to their kind.

    A "number" or "integer" column becomes an array, a "text" column a list. Other columns are not read.

    Raises InputError without pyarrow, for a missing or damaged file, and for columns that are missing, of another kind,
    or have empty cells.
    """
    pa = _arrow(path)
    # The footer is not used: it could name a part several times.
    data = read_bytes(path, what, _MAX_BYTES)
    stream = pa.py_buffer(data)[len(_MAGIC) :]
    with _explained(path, what):
        if not data.startswith(_MAGIC) or not data.endswith(_MAGIC.rstrip(b"\0")):
            raise ValueError("a file without its start or end, or of another version")
        rows, size = stream_size(stream)
        if size > _MAX_BYTES or rows > _MAX_ROWS:
            raise _too_large(path, what, f"{_MAX_BYTES} bytes and {_MAX_ROWS} rows", f"{size} bytes, {rows} rows")
        with pa.ipc.open_stream(stream, options=pa.ipc.IpcReadOptions(use_threads=False)) as reader:
            table = reader.read_all()
        table.validate(full=True)
    _check_names(columns, table.column_names, path, what)
    return {name: _values(table.column(name), name, kind, path) for name, kind in columns.items()}


@dataclass(frozen=True, eq=False)
class ParquetTable:
    """A Parquet file whose rows are read on demand; `what` names it in errors."""

    path: Path
    what: str

    def columns(self, columns: Mapping[str, str]) -> dict[str, Any]:
        """Return complete columns, each (N,), as `read_feather` does; intended for small columns."""
        with self._opened(columns) as file:
            for group in range(file.metadata.num_row_groups):
                self._check_group(file.metadata.row_group(group), columns)
            table = file.read(columns=list(columns), use_threads=False)
            table.validate(full=True)
        return {name: _values(table.column(name), name, kind, self.path) for name, kind in columns.items()}

    def row(self, number: int, columns: Sequence[str]) -> dict[str, Any]:
        """Return the values of a row by column: numbers, texts, bytes, arrays of numbers, and None for empty cells.

        Raises InputError as `columns`.
        """
        with self._opened(columns) as file:
            group = int(np.searchsorted(self._ends, number, side="right"))
            skipped = number - (int(self._ends[group - 1]) if group else 0)
            self._check_group(file.metadata.row_group(group), columns)
            batches = file.iter_batches(1, [group], list(columns), use_threads=False)
            for batch in batches:
                if skipped < batch.num_rows:
                    row = batch.slice(skipped, 1)
                    row.validate(full=True)
                    return {name: _cell(row.column(name)[0]) for name in columns}
                skipped -= batch.num_rows
        raise InputError(f"the {self.what} has fewer rows than stated", where=self.path)

    def _check_group(self, group: Any, columns: Mapping[str, str] | Sequence[str]) -> None:
        """Raise InputError if the columns of a group, whose sizes its metadata state, are too large when unpacked."""
        for number in range(group.num_columns):
            column = group.column(number)
            if column.path_in_schema.partition(".list.")[0] in columns or column.path_in_schema in columns:
                size = max(column.total_uncompressed_size, 8 * column.num_values)
                most = _MAX_BYTES + _MAX_RATIO * column.total_compressed_size
                if size > min(most, _MAX_BYTES * max(group.num_rows, 1)):
                    raise _too_large(self.path, self.what, f"{most} bytes", f"{size} in {column.path_in_schema}")

    @cached_property
    def _ends(self) -> Any:
        """Cumulative number of rows at the end of each group (G,)."""
        from pyarrow import parquet

        metadata = parquet.read_metadata(self.path)
        return np.cumsum([metadata.row_group(i).num_rows for i in range(metadata.num_row_groups)], dtype=np.int64)

    @contextmanager
    def _opened(self, columns: Mapping[str, str] | Sequence[str]) -> Iterator[Any]:
        _arrow(self.path)
        read_start(self.path, self.what, 4)
        if (size := self.path.stat().st_size) > _MAX_PARQUET_BYTES:
            raise _too_large(self.path, self.what, f"{_MAX_PARQUET_BYTES} bytes", f"{size}")
        from pyarrow import parquet

        with _explained(self.path, self.what), parquet.ParquetFile(self.path) as file:
            if file.metadata.num_rows > _MAX_ROWS:
                raise _too_large(self.path, self.what, f"{_MAX_ROWS} rows", f"{file.metadata.num_rows}")
            _check_names(columns, file.schema_arrow.names, self.path, self.what)
            yield file


def _arrow(path: Path) -> Any:
    return optional_package("pyarrow", "arrow", "Feather and Parquet", path)


def _explained(path: Path, what: str) -> AbstractContextManager[None]:
    """Convert the exceptions of pyarrow for damaged files, which have many types, to InputError."""
    errors = (_arrow(path).ArrowException, OSError, ValueError, LookupError, TypeError, MemoryError, StructError)
    expected = "Parquet" if path.suffix == ".parquet" else "Feather (Arrow IPC)"
    return damage_explained(path, f"the {what} is not a table of Arrow, or is damaged", expected, *errors)


def _check_names(wanted: Mapping[str, str] | Sequence[str], have: Sequence[str], path: Path, what: str) -> None:
    lacking = next((name for name in wanted if name not in have), None)
    if lacking is not None:
        listed = ", ".join(str(name) for name in have[:12])
        raise InputError(f"the {what} lacks a column", where=path, expected=lacking, got=listed or "no columns")
    if any(list(have).count(name) > 1 for name in wanted):
        raise InputError(f"the {what} has a column twice", where=path, got=", ".join(map(str, have))[:200])


def _values(column: Any, name: str, kind: str, path: Path) -> Any:
    """Return the values (N,) of a column: an array of numbers, or a list of texts."""
    import pyarrow as pa

    if kind == "text" and len(column) > _MAX_TEXTS:
        raise _too_large(path, f"column {name}", f"{_MAX_TEXTS} texts", f"{len(column)}")
    if pa.types.is_dictionary(column.type):
        column = column.cast(column.type.value_type)
    text = pa.types.is_string(column.type) or pa.types.is_large_string(column.type)
    whole = pa.types.is_integer(column.type)
    fits = {"text": text, "integer": whole, "number": whole or pa.types.is_floating(column.type)}
    if not fits[kind]:
        raise InputError(f"column {name} has another type", where=path, expected=f"{kind}s", got=str(column.type))
    if column.null_count:
        raise InputError(f"column {name} has empty cells", where=path, expected="none", got=column.null_count)
    return column.to_pylist() if kind == "text" else column.to_numpy()


def _cell(scalar: Any) -> Any:
    """Return the value of a cell: an array for a list of numbers, else the Python value."""
    import pyarrow as pa

    values = getattr(scalar, "values", None)
    if scalar.is_valid and isinstance(values, pa.Array) and not values.null_count:
        kind = values.type
        if pa.types.is_integer(kind) or pa.types.is_floating(kind):
            return values.to_numpy(zero_copy_only=False)
    return scalar.as_py()


def _too_large(path: Path, what: str, most: str, got: str) -> InputError:
    return InputError(f"the {what} is too large", where=path, expected=f"at most {most}", got=got)
