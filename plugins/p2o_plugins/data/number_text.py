"""Tables of numbers in long texts, read in pieces: what is no number, and what is too long, costs no memory."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from p2o import InputError
from p2o.arrays import Float

_PIECE = 1 << 20
# Seventeen digits, sign, point and exponent; writers that print a fixed number of places take more.
_LONGEST = 400


def read_table(text: bytes, columns: int, path: Path, most: int | None = None) -> Float:
    """Return the first `most` lines of a text, as many as it has, as (N, columns); nan and inf are numbers.

    Blank lines do not count. Raises InputError where a line before that has another count of words, or a word that is
    no number.
    """
    parts: list[Float] = []
    found = 0
    for piece in _pieces(text, path):
        lines = [words for line in piece.splitlines() if (words := line.split())]
        lines = lines if most is None else lines[: most - found]
        found += len(lines)
        parts.append(_numbers(lines, columns, path))
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
    """Yield the text in pieces of whole lines."""
    start = 0
    while start < len(text):
        stop = start + _PIECE
        if stop < len(text):
            stop = text.rfind(b"\n", start, stop) + 1
            if stop == 0:
                raise InputError("the points are not numbers", where=path, got=f"a line of more than {_PIECE} bytes")
        yield text[start:stop]
        start = stop


def _numbers(lines: list[list[bytes]], columns: int, path: Path) -> Float:
    odd = next((words for words in lines if len(words) != columns), None)
    try:
        if any(len(word) > _LONGEST for words in lines for word in words):
            raise ValueError(f"a word of more than {_LONGEST} characters")
        # Words first: a text that holds none is of another kind, however long its lines are.
        values = np.array([word for words in lines for word in words], dtype=np.float64)
    except ValueError as problem:
        raise InputError(
            "the points are not numbers", where=path, expected=f"{columns} numbers a line", got=str(problem)[:100]
        ) from problem
    if odd is not None:
        raise InputError(
            "the point cloud is truncated or has other columns",
            where=path,
            expected=f"{columns} numbers a line",
            got=f"a line of {len(odd)}",
        )
    return values.reshape(-1, columns)
