"""Reading .pcd files of the Point Cloud Library: ascii, binary and binary_compressed."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from p2o import InputError

_KIND = {"I": "i", "U": "u", "F": "f"}
# A three-byte LZF token gives at most 264 bytes.
_MAX_LZF_RATIO = 88


def read_pcd(data: bytes, path: Path) -> Mapping[str, Any]:
    """Return the fields of a .pcd file by name, each (N,); fields of several values a point are left out.

    Raises InputError if the header is not that of a .pcd file or the body is too short, damaged or not numbers.
    """
    header, body = _header(data, path)
    try:
        names = [n.lower() for n in header["FIELDS"]]
        dtypes = [np.dtype("<" + _KIND[t] + s) for t, s in zip(header["TYPE"], header["SIZE"], strict=True)]
        repeats = [int(n) for n in header.get("COUNT", ["1"] * len(names))]
        points = int(header["POINTS"][0]) if "POINTS" in header else int(header["WIDTH"][0]) * int(header["HEIGHT"][0])
        layout = list(zip(names, dtypes, repeats, strict=True))
        encoding = header["DATA"][0].lower()
    except (KeyError, ValueError, TypeError, IndexError) as problem:
        raise InputError(
            "the header of the .pcd file is wrong", where=path, expected="FIELDS SIZE TYPE COUNT POINTS DATA"
        ) from problem
    if points < 0 or not layout or not all(0 <= n <= 65536 for n in repeats):
        raise InputError("the header of the .pcd file is wrong", where=path, expected="counts >= 0")
    if encoding == "ascii":
        return _ascii_fields(body, layout, points, path)
    record = np.dtype([(f"{i} {name}", dtype, (n,)) for i, (name, dtype, n) in enumerate(layout)])
    if encoding == "binary":
        _check_size(len(body), points * record.itemsize, path)
        table = np.frombuffer(body, record, points)
        return {name: table[f"{i} {name}"][:, 0] for i, (name, _, n) in enumerate(layout) if n == 1}
    if encoding != "binary_compressed":
        raise InputError(
            "unknown DATA of the .pcd file", where=path, expected="ascii, binary or binary_compressed", got=encoding
        )
    sizes = np.frombuffer(body[:8].ljust(8, b"\0"), "<u4")
    packed, size = int(sizes[0]), points * record.itemsize
    _check_size(len(body) - 8, packed, path)
    if sizes[1] != size or size > _MAX_LZF_RATIO * packed:
        raise InputError(
            "the packed size of the .pcd file does not fit its header",
            where=path,
            expected=f"{size} bytes",
            got=int(sizes[1]),
        )
    plain = unpack_lzf(body[8 : 8 + packed], size, path)
    # Compressed files store field after field, not point after point.
    starts = np.cumsum([0] + [points * dtype.itemsize * n for _, dtype, n in layout])
    return {
        name: np.frombuffer(plain, dtype, points, int(start))
        for (name, dtype, n), start in zip(layout, starts[:-1], strict=True)
        if n == 1
    }


def unpack_lzf(packed: bytes, size: int, path: Path) -> bytes:
    """Return the `size` bytes that LibLZF packed; a loop over its tokens, each of up to 264 bytes.

    Raises InputError if the tokens are cut off, point before the start, or give another size.
    """
    out = bytearray()
    at, end = 0, len(packed)
    try:
        while at < end and len(out) <= size:
            control = packed[at]
            at += 1
            if control < 32:
                literal = packed[at : at + control + 1]
                at += control + 1
                out += literal
                continue
            length = (control >> 5) + 2
            if length == 9:
                length += packed[at]
                at += 1
            back = ((control & 31) << 8) + packed[at] + 1
            at += 1
            if back > len(out):
                raise IndexError
            run = out[-back:][:length]
            # A run longer than its distance repeats what it has just written.
            out += (run * (length // len(run) + 1))[:length]
    except IndexError as problem:
        raise InputError("the packed points of the .pcd file are damaged", where=path) from problem
    if len(out) != size:
        raise InputError(
            "the packed points of the .pcd file are damaged", where=path, expected=f"{size} bytes", got=len(out)
        )
    return bytes(out)


def _header(data: bytes, path: Path) -> tuple[dict[str, list[str]], bytes]:
    """Return the words of the header by their key, and the bytes after it."""
    words: dict[str, list[str]] = {}
    start = 0
    while (end := data.find(b"\n", start)) >= 0 and end - start < 4096:
        key, *values = data[start:end].decode("latin-1").split() or ["#"]
        start = end + 1
        words[key.upper()] = values
        if key.upper() == "DATA":
            return words, data[start:]
    raise InputError("this is not a .pcd file", where=path, expected="a header that ends in DATA")


def _ascii_fields(
    body: bytes, layout: list[tuple[str, np.dtype[Any], int]], points: int, path: Path
) -> Mapping[str, Any]:
    columns = sum(n for _, _, n in layout)
    tokens = body.split()
    _check_size(len(tokens), points * columns, path, unit="numbers")
    try:
        table = np.array(tokens[: points * columns], dtype=np.float64).reshape(points, columns)
    except ValueError as problem:
        raise InputError("the points of the .pcd file are not numbers", where=path, got=problem) from problem
    starts = np.cumsum([0] + [n for _, _, n in layout])
    return {
        name: _as_stored(table[:, start], dtype)
        for (name, dtype, n), start in zip(layout, starts[:-1], strict=True)
        if n == 1
    }


def _as_stored(column: Any, dtype: np.dtype[Any]) -> Any:
    """Return integers as integers: the type tells nanoseconds from seconds."""
    if dtype.kind in "iu" and np.isfinite(column).all():
        return column.astype(np.int64)
    return column


def _check_size(have: int, need: int, path: Path, unit: str = "bytes") -> None:
    if have < need:
        raise InputError("the .pcd file is truncated", where=path, expected=f"{need} {unit}", got=max(have, 0))
