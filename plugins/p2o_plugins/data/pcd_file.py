"""Reading .pcd files of the Point Cloud Library: ascii, binary and binary_compressed."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from p2o import InputError

from p2o_plugins.data.number_text import as_stored, read_table

_TYPES = {"I": "i", "U": "u", "F": "f"}
_SIZES = {"I": ("1", "2", "4", "8"), "U": ("1", "2", "4", "8"), "F": ("4", "8")}
# A three-byte LZF token gives at most 264 bytes.
_MAX_LZF_RATIO = 88
_MAX_BYTES = 256 << 20
# No file is large enough for more.
_MOST = 1 << 32
_MAX_HEADER = 1 << 16
_PCL_BLOCK = 16
"""PCL keeps the coordinates of a point in four floats, and aligns whole points to as much."""

_Layout = list[tuple[str, np.dtype[Any], int]]
"""Name, type and count of each field."""


def read_pcd(data: bytes, path: Path) -> Mapping[str, Any]:
    """Return the fields of a .pcd file by name, each (N,); fields of several values a point are left out.

    Where the body holds more bytes a point than the header counts, as PCL's padded structs do whose fields `_` are
    wrong or left out, fields lie where PCL or a C compiler aligns them.

    Raises InputError if the header is not that of a .pcd file, does not fit the body, or the body is too short, damaged
    or not numbers.
    """
    header, body = _header(data, path)
    layout, points, encoding = _described(header, path)
    if encoding == "ascii":
        return _ascii_fields(body, layout, points, path)
    size = _offsets(layout)[-1]
    if encoding == "binary":
        offsets = _fitting_offsets(layout, points, len(body), path)
        fields = [
            (name, dtype, at) for (name, dtype, n), at in zip(layout, offsets, strict=False) if _readable(name, n)
        ]
        record = np.dtype(
            {
                "names": [f"{i}" for i in range(len(fields))],
                "formats": [dtype for _, dtype, _ in fields],
                "offsets": [at for _, _, at in fields],
                "itemsize": offsets[-1],
            }
        )
        table = np.frombuffer(body, record, points)
        return {name: table[f"{i}"] for i, (name, _, _) in enumerate(fields)}
    if encoding != "binary_compressed":
        raise InputError(
            "unknown DATA of the .pcd file", where=path, expected="ascii, binary or binary_compressed", got=encoding
        )
    sizes = np.frombuffer(body[:8].ljust(8, b"\0"), "<u4")
    packed, unpacked = int(sizes[0]), int(sizes[1])
    _check_size(len(body) - 8, packed, path)
    bare = [field for field in layout if field[0] != "_"]
    if unpacked == points * _offsets(bare)[-1]:
        # PCL leaves its padding out, whatever the header says of it.
        layout, size = bare, _offsets(bare)[-1]
    if unpacked != points * size or not unpacked <= min(_MAX_LZF_RATIO * packed, _MAX_BYTES):
        raise InputError(
            "the packed size of the .pcd file does not fit its header",
            where=path,
            expected=f"{points * size} bytes",
            got=unpacked,
        )
    plain = unpack_lzf(body[8 : 8 + packed], unpacked, path)
    # Compressed files store field after field, not point after point.
    return {
        name: np.frombuffer(plain, dtype, points, points * start)
        for (name, dtype, n), start in zip(layout, _offsets(layout), strict=False)
        if _readable(name, n)
    }


def _described(header: Mapping[str, list[str]], path: Path) -> tuple[_Layout, int, str]:
    """Return the fields, the number of points and the encoding that a header tells."""
    try:
        names = [n.lower() for n in header["FIELDS"]]
        kinds = list(zip(header["TYPE"], header["SIZE"], strict=True))
        if not kinds or any(size not in _SIZES[kind] for kind, size in kinds):
            raise ValueError
        repeats = [int(n[:20]) for n in header.get("COUNT", ["1"] * len(names))]
        # No count of more digits fits, and Python reads no number of more than 4300.
        width, height = (int(header.get(key, ["1"])[0][:20]) for key in ("WIDTH", "HEIGHT"))
        points = int(header["POINTS"][0][:20]) if "POINTS" in header else width * height
        layout = [
            (name, np.dtype(f"<{_TYPES[kind]}{size}"), n)
            for name, (kind, size), n in zip(names, kinds, repeats, strict=True)
        ]
        encoding = header["DATA"][0].lower()
    except (KeyError, ValueError, TypeError, IndexError) as problem:
        raise InputError(
            "the header of the .pcd file is wrong", where=path, expected="FIELDS SIZE TYPE COUNT POINTS DATA"
        ) from problem
    if not 0 <= points <= _MOST or not all(0 <= n <= 65536 for n in repeats):
        raise InputError("the header of the .pcd file is wrong", where=path, expected=f"counts from 0 to {_MOST}")
    if not any(_readable(name, n) for name, _, n in layout):
        raise InputError("the header of the .pcd file is wrong", where=path, expected="fields of one number a point")
    return layout, points, encoding


def _readable(name: str, count: int) -> bool:
    return count == 1 and name != "_"


def _offsets(layout: _Layout) -> list[int]:
    """Return where each field begins, without gaps, and the bytes of all."""
    return [0, *np.cumsum([dtype.itemsize * n for _, dtype, n in layout], dtype=np.int64).tolist()]


def _fitting_offsets(layout: _Layout, points: int, have: int, path: Path) -> list[int]:
    """Return where each field of a point begins, and the bytes of a point, in a body of `have` bytes.

    Raises InputError if the body is too short, or no layout fills it.
    """
    said = _offsets(layout)
    _check_size(have, points * said[-1], path)
    # What is less than a byte a point comes after the points.
    if have - points * said[-1] < max(points, 1):
        return said
    for block in (_PCL_BLOCK, 1):
        aligned = _aligned_offsets(layout, block)
        if have == points * aligned[-1]:
            return aligned
    raise InputError(
        "the fields of the .pcd file do not fill its points",
        where=path,
        expected=f"{said[-1]} bytes a point, or a struct that is aligned as PCL does",
        got=f"{have} bytes for {points} points",
        hint="write it anew without fields _",
    )


def _aligned_offsets(layout: _Layout, block: int) -> list[int]:
    """Return where a struct holds each field, by the size of its type, and the bytes of the struct; _ takes none.

    What follows the coordinates begins at a multiple of `block`, and so does the next struct.
    """
    starts, at, widest = [], 0, block
    for i, (name, dtype, n) in enumerate(layout):
        if [field for field, _, _ in layout[max(i - 3, 0) : i]] == ["x", "y", "z"]:
            at += -at % block
        if name != "_":
            at += -at % dtype.itemsize
            widest = max(widest, dtype.itemsize)
        starts.append(at)
        at += dtype.itemsize * n * (name != "_")
    return [*starts, at + -at % widest]


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
    while 0 <= (end := data.find(b"\n", start, start + 4096)) < _MAX_HEADER:
        key, *values = data[start:end].decode("latin-1").split() or ["#"]
        start = end + 1
        words[key.upper()] = values
        if key.upper() == "DATA":
            return words, data[start:]
    raise InputError("this is not a .pcd file", where=path, expected="a header that ends in DATA")


def _ascii_fields(body: bytes, layout: _Layout, points: int, path: Path) -> Mapping[str, Any]:
    columns = sum(n for _, _, n in layout)
    # A number and the blank after it take two bytes.
    _check_size(len(body) + 1, 2 * points * columns, path)
    table = read_table(body, columns, path, points)
    _check_size(len(table), points, path, unit="points")
    starts = np.cumsum([0] + [n for _, _, n in layout])
    return {
        name: as_stored(table[:, start], dtype.kind)
        for (name, dtype, n), start in zip(layout, starts[:-1], strict=True)
        if _readable(name, n)
    }


def _check_size(have: int, need: int, path: Path, unit: str = "bytes") -> None:
    if have < need:
        raise InputError("the .pcd file is truncated", where=path, expected=f"{need} {unit}", got=max(have, 0))
