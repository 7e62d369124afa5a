"""Read tables of numbers from long texts in pieces, so that invalid or too long texts allocate little memory."""

from __future__ import annotations

import io
from collections.abc import Iterator
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
from p2o import Float, InputError

MAX_POINTS = 1 << 23
"""Maximum number of points of a sweep."""
MAX_NUMBERS = 1 << 25
_PIECE = 1 << 20


def read_table(text: bytes, columns: int, path: Path, most: int = MAX_POINTS + 1) -> Float:
    """Return the first `most` lines of a text as (N, columns), N at most `most`; nan and inf are valid numbers.

    Blank lines are ignored. Raises InputError if one of these lines has another number of words or an invalid number,
    and for more than MAX_NUMBERS.
    """
    parts: list[Float] = []
    count = 0
    for piece in _pieces(text if most else b"", path):
        rows = _rows(piece, columns, path, most - count)
        count += len(rows)
        parts.append(rows)
        if count * columns > MAX_NUMBERS:
            raise InputError("the point cloud has too many numbers", where=path, expected=f"at most {MAX_NUMBERS}")
        if count == most:
            break
    return np.concatenate(parts) if parts else np.zeros((0, columns))


def as_stored(column: Float, kind: str) -> Any:
    """Return a column of type `kind` as integers if it is an integer type, which keeps the digits of large times."""
    # Only doubles below 2^63 can be converted; a column with NaN or larger values stays as it is.
    if kind in "iu" and bool((np.abs(column) < 2.0**63).all()):
        return column.astype(np.int64)
    return column


def _pieces(text: bytes, path: Path) -> Iterator[bytes]:
    """Yield the text in pieces of complete lines, without blank pieces."""
    start = 0
    while start < len(text):
        stop = start + _PIECE
        if stop < len(text):
            stop = text.rfind(b"\n", start, stop) + 1
            if stop == 0:
                raise InputError("the points are not numbers", where=path, got=f"a line of more than {_PIECE} bytes")
        piece = text[start:stop]
        if not piece.isspace():
            yield piece
        start = stop


def _rows(piece: bytes, columns: int, path: Path, most: int) -> Float:
    lines = (line for line in io.StringIO(piece.decode("latin-1")) if not line.isspace())
    try:
        rows = np.loadtxt(islice(lines, most), ndmin=2, comments=None)
        got = f"{rows.shape[1]} numbers"
    except ValueError as problem:
        # NumPy counts rows from the start of the piece, so that the row number is removed.
        got = str(problem).partition(" at row")[0][:100]
        if "number of columns changed" not in got:
            fault = "the points are not numbers"
            raise InputError(fault, where=path, expected=f"{columns} numbers per line", got=got) from problem
        rows = np.zeros((0, 0))
    if rows.shape[1] != columns:
        expected = f"{columns} numbers per line"
        raise InputError("the point cloud is truncated or has other columns", where=path, expected=expected, got=got)
    return rows
