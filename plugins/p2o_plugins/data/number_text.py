"""Tables of numbers in long texts, read in pieces: what is no number, and what is too long, costs no memory."""

from __future__ import annotations

import io
from collections.abc import Iterator
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
from p2o import InputError
from p2o.arrays import Float

MAX_POINTS = 1 << 23
"""No sweep has more points."""
MAX_NUMBERS = 1 << 25
_PIECE = 1 << 20


def read_table(text: bytes, columns: int, path: Path, most: int = MAX_POINTS + 1) -> Float:
    """Return the first `most` lines of a text, as many as it has, as (N, columns); nan and inf are numbers.

    Blank lines do not count. Raises InputError where a line before that has another count of words, or a word that is
    no number, and for more than MAX_NUMBERS.
    """
    parts: list[Float] = []
    found = 0
    for piece in _pieces(text if most else b"", path):
        rows = _rows(piece, columns, path, most - found)
        found += len(rows)
        parts.append(rows)
        if found * columns > MAX_NUMBERS:
            raise InputError("the point cloud has too many numbers", where=path, expected=f"at most {MAX_NUMBERS}")
        if found == most:
            break
    return np.concatenate(parts) if parts else np.zeros((0, columns))


def as_stored(column: Float, kind: str) -> Any:
    """Return a column of type `kind` as whole numbers if it is of them: the type tells nanoseconds from seconds."""
    # Doubles below 2^63 alone can be stored so; NaN and what is beyond stay as they are.
    if kind in "iu" and bool((np.abs(column) < 2.0**63).all()):
        return column.astype(np.int64)
    return column


def _pieces(text: bytes, path: Path) -> Iterator[bytes]:
    """Yield the text in pieces of whole lines, without those of blanks alone."""
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
        # NumPy counts lines from the start of the piece.
        got = str(problem).partition(" at row")[0][:100]
        if "number of columns changed" not in got:
            raise InputError(
                "the points are not numbers", where=path, expected=f"{columns} numbers a line", got=got
            ) from problem
        rows = np.zeros((0, 0))
    if rows.shape[1] != columns:
        raise InputError(
            "the point cloud is truncated or has other columns",
            where=path,
            expected=f"{columns} numbers a line",
            got=got,
        )
    return rows
