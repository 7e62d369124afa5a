"""Read the vertices of .ply files: ascii and binary of both byte orders."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from p2o import InputError

from p2o_datasets.number_text import as_stored, read_table

_TYPES = {
    "char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4", "float": "f4",
    "int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2", "int32": "i4", "uint32": "u4", "float32": "f4",
    "double": "f8", "float64": "f8",
}  # fmt: skip
# Larger counts exceed every file size.
_MAX_COUNT = 1 << 32
_MAX_HEADER = 1 << 16
_ORDER = {"ascii": "<", "binary_little_endian": "<", "binary_big_endian": ">"}


def read_ply(data: bytes, path: Path) -> Mapping[str, Any]:
    """Return the vertex properties of a .ply file by name, each (N,); other elements are not read.

    Raises InputError if the header is invalid, if another element comes first, and for truncated or invalid bodies.
    """
    end = data.find(b"end_header", 0, _MAX_HEADER)
    body_start = data.find(b"\n", end) + 1
    if not data.startswith(b"ply") or end < 0 or body_start == 0:
        raise InputError("this is not a .ply file", where=path, expected="a header from ply to end_header")
    encoding, points, properties = _header(data[:end].decode("latin-1"), path)
    body = data[body_start:]
    if encoding != "ascii":
        record = np.dtype([(f"{i} {name}", _ORDER[encoding] + code) for i, (name, code) in enumerate(properties)])
        if len(body) < points * record.itemsize:
            expected = f"{points * record.itemsize} bytes"
            raise InputError("the .ply file is truncated", where=path, expected=expected, got=len(body))
        table = np.frombuffer(body, record, points)
        return {name: table[f"{i} {name}"] for i, (name, _) in enumerate(properties)}
    # A number and the blank after it take at least two bytes.
    short = 2 * points * len(properties) > len(body) + 1
    values = np.zeros((0, len(properties))) if short else read_table(body, len(properties), path, points)
    if len(values) != points:
        expected, got = f"{points} lines of {len(properties)} numbers", f"{len(body)} bytes" if short else len(values)
        raise InputError("the .ply file is truncated", where=path, expected=expected, got=got)
    return {name: as_stored(column, code[0]) for (name, code), column in zip(properties, values.T, strict=True)}


def _header(text: str, path: Path) -> tuple[str, int, list[tuple[str, str]]]:
    """Return the encoding, the number of vertices and their properties (name, type code)."""
    lines = [words for line in text.splitlines() if (words := line.split()) and words[0] not in ("comment", "obj_info")]
    elements = [i for i, words in enumerate(lines) if words[0] == "element"]
    try:
        encoding = next(words[1] for words in lines if words[0] == "format")
        first, last = elements[0], [*elements, len(lines)][1]
        if encoding not in _ORDER or lines[first][1] != "vertex":
            raise ValueError
        points = int(lines[first][2][:20])
        properties = [(words[-1].lower(), _TYPES[words[1]]) for words in lines[first + 1 : last]]
        if not 0 <= points <= _MAX_COUNT or not properties:
            raise ValueError
    except (StopIteration, IndexError, ValueError, KeyError) as problem:
        expected = "a format, then element vertex first, with scalar properties"
        raise InputError("the header of the .ply file is wrong", where=path, expected=expected) from problem
    return encoding, points, properties
