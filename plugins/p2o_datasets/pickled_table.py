"""Read pickled pandas tables of numbers without pandas and without executing anything from the file.

A pickle is a program that calls functions by name. Here the names resolve to classes that only store the arguments of
the call (`_Record`), and every other name is refused. The arrays are decoded from these records in the layouts that
pandas 1.0 to 2.2 write with protocols 2 to 5 (compared with files of pandas 1.0.5, 1.2.5, 1.5.3 and 2.2.3).
"""

from __future__ import annotations

import gzip
import io
import math
import pickle
import pickletools
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any, ClassVar, NoReturn, Self

import numpy as np
from p2o import InputError
from p2o.reading import read_bytes

_MAX_BYTES = 256 << 20
_MAX_OPCODES = 10_000  # tables of PandaSet have 400
_GZIP = b"\x1f\x8b"
_PLAIN = re.compile(r"(b1|[iu][1248]|f[248])")


class _Record:
    """An object of a pickle that is not constructed: the arguments of its constructor and its state."""

    args: tuple[Any, ...] = ()
    state: Any = None

    def __new__(cls, *args: Any) -> Self:
        record = object.__new__(cls)
        record.args = args
        return record

    def __setstate__(self, state: Any) -> None:
        self.state = state


_KINDS = {
    "frame": ("pandas.core.frame.DataFrame",),
    "manager": ("pandas.core.internals.managers.BlockManager",),
    "block": ("pandas._libs.internals._unpickle_block",),
    "index": ("pandas.core.indexes.base._new_Index",),
    "array": ("numpy.core.multiarray._reconstruct", "numpy._core.multiarray._reconstruct"),
    "buffer": ("numpy.core.numeric._frombuffer", "numpy._core.numeric._frombuffer"),
    "dtype": ("numpy.dtype",),
    "slice": ("builtins.slice", "__builtin__.slice"),
    "encode": ("_codecs.encode",),
    "class": (
        "numpy.ndarray",
        "pandas.core.indexes.base.Index",
        "pandas.core.indexes.range.RangeIndex",
        *(f"pandas.core.indexes.numeric.{kind}Index" for kind in ("Int64", "Float64", "UInt64")),
    ),
}
_CLASSES = {name: type(kind, (_Record,), {}) for kind, names in _KINDS.items() for name in names}
"""The allowed names of a pickle and the records that replace them; the named objects are never imported."""


class _LayoutError(Exception):
    """The pickle is not a table of numbers; the text is the reason."""


class _Unpickler(pickle._Unpickler):
    """Python's unpickler, which constructs records only.

    Not the unpickler in C, which allocates a memo of the size that an index in the file demands.
    """

    stack: list[Any]

    def find_class(self, module: str, name: str) -> Any:
        """Return the record of an allowed name."""
        record = _CLASSES.get(f"{module}.{name}")
        if record is None:
            raise _LayoutError(f"the name {module[:50]}.{name[:50]}, which is not allowed in a table of numbers")
        return record

    def load_reduce(self) -> None:
        """Load a call whose arguments are a tuple: unpacking a long text or byte array would exhaust the memory."""
        self._check_arguments()
        super().load_reduce()  # type: ignore[misc]

    def load_newobj(self) -> None:
        """Load the construction of an object, checked as a call is."""
        self._check_arguments()
        super().load_newobj()  # type: ignore[misc]

    def _check_arguments(self) -> None:
        if not self.stack or not isinstance(self.stack[-1], tuple):
            raise _LayoutError("a call without a tuple of arguments")

    dispatch: ClassVar[dict[int, Any]] = {
        **pickle._Unpickler.dispatch,
        pickle.REDUCE[0]: load_reduce,
        pickle.NEWOBJ[0]: load_newobj,
    }
    del dispatch[pickle.NEWOBJ_EX[0]]


def read_pickled_table(path: Path, what: str, columns: Sequence[str]) -> dict[str, Any]:
    """Read columns of a pickled table by name, each (N,) of numbers; the file may be compressed by gzip.

    Raises InputError for a file that is missing, too large or damaged, for pickles of anything else, and for columns
    that are missing or not numeric.
    """
    data = _decompressed(read_bytes(path, what, _MAX_BYTES), path, what)
    try:
        # Checked first, because the unpickler allocates byte arrays before it reads them.
        for count, _ in enumerate(pickletools.genops(data)):
            if count > _MAX_OPCODES:
                raise _LayoutError(f"more than {_MAX_OPCODES} opcodes")
        return _columns(_Unpickler(io.BytesIO(data)).load(), columns)
    except Exception as problem:  # damaged pickles raise any exception
        raise InputError(
            f"the {what} is not a table of numbers pickled by pandas; other pickles are never loaded",
            where=path,
            expected=f"a DataFrame of pandas 1.0 to 2.2 with the columns {' '.join(columns)}",
            got=(str(problem) or type(problem).__name__)[:200],
            hint="if you trust the file, read it with pandas below 3 and write its numeric columns again",
        ) from problem


def _decompressed(data: bytes, path: Path, what: str) -> bytes:
    if not data.startswith(_GZIP):
        return data
    try:
        with gzip.GzipFile(fileobj=io.BytesIO(data)) as file:
            plain = file.read(_MAX_BYTES + 1)
    except Exception as problem:  # gzip raises several types for damaged files
        raise InputError(f"the {what} is damaged or truncated", where=path, expected="gzip", got=problem) from problem
    if len(plain) > _MAX_BYTES:
        raise InputError(f"the decompressed {what} is too large", where=path, expected=f"at most {_MAX_BYTES} bytes")
    return plain


def _columns(table: Any, wanted: Sequence[str]) -> dict[str, Any]:
    """Decode the wanted columns of the record of a DataFrame."""
    state = _checked(table, "frame").state
    manager = _checked(state.get("_mgr", state.get("_data")), "manager")
    if isinstance(manager.state, tuple):  # pandas before 1.3
        inner = manager.state[3]["0.14.1"]
        axes = inner["axes"]
        blocks = [(block["values"], block["mgr_locs"]) for block in inner["blocks"]]
    else:
        records, axes = manager.args
        blocks = [_checked(block, "block").args[:2] for block in records]
    labels = _array(_checked(axes[0], "index").args[1]["data"])
    if not isinstance(labels, list):
        raise _LayoutError("columns without names")
    columns: dict[str, Any] = {}
    for values, locations in blocks:
        positions = _positions(locations, len(labels))
        rows = {labels[position]: row for row, position in enumerate(positions) if labels[position] in wanted}
        if rows:
            array = _array(values)
            if not isinstance(array, np.ndarray) or array.ndim != 2 or len(array) != len(positions):
                raise _LayoutError(f"column {next(iter(rows))} is not numeric")
            columns |= {label: array[row] for label, row in rows.items()}
    missing = next((name for name in wanted if name not in columns), None)
    if missing is not None:
        raise _LayoutError(f"no column {missing} among {', '.join(map(str, labels))[:100]}")
    if len({len(column) for column in columns.values()}) > 1:
        raise _LayoutError("columns of different lengths")
    return columns


def _positions(locations: Any, count: int) -> list[int]:
    """Decode the positions of the rows of a block among `count` columns: a slice or an array of integers."""
    if _kind(locations) == "slice":
        return list(range(count))[slice(*locations.args)]
    positions = _array(locations)
    if not isinstance(positions, np.ndarray) or positions.ndim != 1 or len(positions) > count:
        _refuse_array()
    return [range(count)[position] for position in positions]


def _array(record: Any) -> Any:
    """Decode the record of an array; an array of objects becomes a list."""
    if _kind(record) == "array":
        _, shape, dtype_record, fortran, raw = record.state
        order = "F" if fortran is True else "C"
    elif _kind(record) == "buffer":
        raw, dtype_record, shape, order = record.args
    else:
        _refuse_array()
    if isinstance(raw, list):
        return raw
    if _kind(raw) == "encode" and raw.args[1:] == ("latin1",):
        raw = raw.args[0].encode("latin1")
    dtype = _dtype(dtype_record)
    if not isinstance(shape, tuple) or not all(type(length) is int and 0 <= length <= _MAX_BYTES for length in shape):
        _refuse_array()
    if not isinstance(raw, bytes | bytearray) or order not in ("C", "F") or len(shape) not in (1, 2):
        _refuse_array()
    if math.prod(shape) * dtype.itemsize != len(raw):
        raise _LayoutError(f"an array of {math.prod(shape)} numbers of {dtype} in {len(raw)} bytes")
    return np.frombuffer(raw, dtype).reshape(shape, order="F" if order == "F" else "C")


def _dtype(record: Any) -> np.dtype[Any]:
    """Decode the record of a numeric type."""
    kind, *_ = _checked(record, "dtype").args
    order = record.state[1] if record.state else "|"
    if not isinstance(kind, str) or not _PLAIN.fullmatch(kind) or order not in ("<", ">", "|", "="):
        raise _LayoutError(f"an array of {str(kind)[:20]}")
    return np.dtype(order + kind)


def _kind(record: Any) -> str:
    """Return what a record stands for, "" for other values."""
    return type(record).__name__ if isinstance(record, _Record) else ""


def _checked(record: Any, kind: str) -> _Record:
    if _kind(record) != kind:
        raise _LayoutError(f"no {kind} at its place")
    return record  # type: ignore[no-any-return]


def _refuse_array() -> NoReturn:
    raise _LayoutError("no array of numbers at its place")
