"""Tables of Apache Arrow, by pyarrow (the extra `arrow`): Feather files whole, Parquet files row by row."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from p2o import InputError
from p2o.files.input_file import read_bytes, read_start

_MAX_BYTES = 256 << 20
"""No sweep, no list of poses is larger, as a file and in memory."""
_MAX_ROWS = 1 << 24
_MAX_PARQUET_BYTES = 16 << 30
# So many rows of pictures or sweeps are in memory at a time.
_BATCH = 4


def read_feather(path: Path, what: str, columns: Mapping[str, str]) -> dict[str, Any]:
    """Return columns of a Feather file by name, each (N,); `columns` maps them to their kind.

    Kinds are "number" (integers stay integers), and "text", which becomes a list. Columns that are not asked for are
    not looked at.

    Raises InputError without pyarrow, for a file that is missing, damaged or no table, and for columns that are
    missing, of another kind, or have empty cells.
    """
    pa = _arrow(path)
    data = read_bytes(path, what, _MAX_BYTES)
    from pyarrow import feather

    with _explained(path, what):
        table = feather.read_table(pa.BufferReader(data), memory_map=False, use_threads=False)
        table.validate(full=True)
    if table.nbytes > _MAX_BYTES:
        raise _too_large(path, what, f"{_MAX_BYTES} bytes", f"{table.nbytes}")
    _check_names(columns, table.column_names, path, what)
    return {name: _values(table.column(name), name, kind, path) for name, kind in columns.items()}


@dataclass(frozen=True, eq=False)
class ParquetTable:
    """A Parquet file whose rows are read when they are asked for; `what` names it in errors."""

    path: Path
    what: str

    def columns(self, columns: Mapping[str, str]) -> dict[str, Any]:
        """Return whole columns, each (N,), as `read_feather` does; for those that are small."""
        with self._opened(columns) as file:
            table = file.read(columns=list(columns), use_threads=False)
            table.validate(full=True)
        return {name: _values(table.column(name), name, kind, self.path) for name, kind in columns.items()}

    def row(self, number: int, columns: Sequence[str]) -> dict[str, Any]:
        """Return the values of a row by their columns: numbers, texts, bytes, None where a cell is empty.

        Lists of numbers are arrays. Raises InputError as `columns`.
        """
        with self._opened(columns) as file:
            group = int(np.searchsorted(self._ends, number, side="right"))
            skipped = number - (int(self._ends[group - 1]) if group else 0)
            batches = file.iter_batches(_BATCH, [group], list(columns), use_threads=False)
            for batch in batches:
                if skipped < batch.num_rows:
                    row = batch.slice(skipped, 1)
                    row.validate(full=True)
                    return {name: _cell(row.column(name)[0]) for name in columns}
                skipped -= batch.num_rows
        raise InputError(f"the {self.what} has fewer rows than it says", where=self.path)

    @cached_property
    def _ends(self) -> Any:
        """The number of rows up to the end of each group (G,)."""
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
    try:
        import pyarrow
    except ModuleNotFoundError as problem:
        raise InputError(
            "reading Feather and Parquet needs pyarrow, which is not installed",
            where=path,
            hint='run: pip install "p2o-calib[arrow]"',
        ) from problem
    return pyarrow


@contextmanager
def _explained(path: Path, what: str) -> Iterator[None]:
    """Raise InputError for what pyarrow says about a file; damaged ones make it raise many kinds."""
    import pyarrow

    try:
        yield
    except InputError:
        raise
    except (pyarrow.ArrowException, OSError, ValueError, KeyError, IndexError, TypeError, MemoryError) as problem:
        raise InputError(
            f"the {what} is no table of Arrow, or is damaged",
            where=path,
            expected="Parquet" if path.suffix == ".parquet" else "Feather (Arrow IPC)",
            got=str(problem)[:200] or type(problem).__name__,
            hint="take it from its source again",
        ) from problem


def _check_names(wanted: Mapping[str, str] | Sequence[str], have: Sequence[str], path: Path, what: str) -> None:
    lacking = next((name for name in wanted if name not in have), None)
    if lacking is not None:
        listed = ", ".join(str(name) for name in have[:12])
        raise InputError(f"the {what} lacks a column", where=path, expected=lacking, got=listed or "no columns")
    twice = next((name for name in wanted if list(have).count(name) > 1), None)
    if twice is not None:
        raise InputError(f"the {what} has a column twice", where=path, got=twice)


def _values(column: Any, name: str, kind: str, path: Path) -> Any:
    """Return the values (N,) of a column: an array of numbers, or a list of texts."""
    import pyarrow as pa

    if pa.types.is_dictionary(column.type):
        column = column.cast(column.type.value_type)
    numeric = pa.types.is_integer(column.type) or pa.types.is_floating(column.type)
    text = pa.types.is_string(column.type) or pa.types.is_large_string(column.type)
    if not (numeric if kind == "number" else text):
        raise InputError(f"column {name} holds something else", where=path, expected=f"{kind}s", got=str(column.type))
    if column.null_count:
        raise InputError(f"column {name} has empty cells", where=path, expected="none", got=column.null_count)
    return column.to_numpy() if kind == "number" else column.to_pylist()


def _cell(scalar: Any) -> Any:
    """Return the value of a cell: an array for a list of numbers, else what Python has for it."""
    import pyarrow as pa

    values = getattr(scalar, "values", None)
    if scalar.is_valid and isinstance(values, pa.Array) and not values.null_count:
        kind = values.type
        if pa.types.is_integer(kind) or pa.types.is_floating(kind):
            return values.to_numpy(zero_copy_only=False)
    return scalar.as_py()


def _too_large(path: Path, what: str, most: str, got: str) -> InputError:
    return InputError(f"the {what} is too large", where=path, expected=f"at most {most}", got=got)
