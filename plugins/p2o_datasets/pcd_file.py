"""Read .pcd files of the Point Cloud Library: ascii, binary and binary_compressed."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from p2o import InputError

from p2o_datasets.number_text import as_stored, read_table

_TYPES = {"I": "i", "U": "u", "F": "f"}
_SIZES = {"I": ("1", "2", "4", "8"), "U": ("1", "2", "4", "8"), "F": ("4", "8")}
# A three-byte LZF token decodes to at most 264 bytes.
_MAX_LZF_RATIO = 88
_MAX_BYTES = 256 << 20
# Larger counts exceed every file size.
_MAX_COUNT = 1 << 32
_MAX_HEADER = 1 << 16
_PCL_BLOCK = 16
"""PCL stores the coordinates of a point as four floats and aligns whole points to their size."""

_Layout = list[tuple[str, np.dtype[Any], int]]
"""Name, type and count of each field."""


def read_pcd(data: bytes, path: Path) -> Mapping[str, Any]:
    """Return the fields of a .pcd file by name, each (N,); fields with several values per point are left out.

    If the body has more bytes per point than the header states, as for PCL's padded structs with missing or wrong
    fields `_`, fields are expected where PCL or a C compiler aligns them.

    Raises InputError if the header is invalid or contradicts the body, and if the body is truncated, damaged or not
    numeric.
    """
    header, body = _header(data, path)
    layout, points, encoding = _described(header, path)
    if encoding == "ascii":
        return _ascii_fields(body, layout, points, path)
    size = _offsets(layout)[-1]
    if encoding == "binary":
        offsets = _fitting_offsets(layout, points, len(body), path)
        pairs = zip(layout, offsets, strict=False)
        fields = [(name, kind, at) for (name, kind, n), at in pairs if _readable(name, n)]
        names, formats, starts = zip(*fields, strict=True)
        keys = [f"{i}" for i in range(len(names))]
        record: Any = {"names": keys, "formats": formats, "offsets": starts, "itemsize": offsets[-1]}
        table = np.frombuffer(body, np.dtype(record), points)
        return {name: table[key] for name, key in zip(names, keys, strict=True)}
    if encoding != "binary_compressed":
        expected = "ascii, binary or binary_compressed"
        raise InputError("unknown DATA of the .pcd file", where=path, expected=expected, got=encoding)
    sizes = np.frombuffer(body[:8].ljust(8, b"\0"), "<u4")
    packed, unpacked = int(sizes[0]), int(sizes[1])
    _check_size(len(body) - 8, packed, path)
    bare = [field for field in layout if field[0] != "_"]
    if unpacked == points * _offsets(bare)[-1]:
        # PCL omits its padding here, in contrast to the header.
        layout, size = bare, _offsets(bare)[-1]
    if unpacked != points * size or not unpacked <= min(_MAX_LZF_RATIO * packed, _MAX_BYTES):
        fault = "the compressed size of the .pcd file contradicts its header"
        raise InputError(fault, where=path, expected=f"{points * size} bytes", got=unpacked)
    plain = unpack_lzf(body[8 : 8 + packed], unpacked, path)
    # Compressed files store one field after the other, not one point after the other.
    return {
        name: np.frombuffer(plain, dtype, points, points * start)
        for (name, dtype, n), start in zip(layout, _offsets(layout), strict=False)
        if _readable(name, n)
    }


def _described(header: Mapping[str, list[str]], path: Path) -> tuple[_Layout, int, str]:
    """Return the fields, the number of points and the encoding of a header."""
    try:
        names = [n.lower() for n in header["FIELDS"]]
        kinds = list(zip(header["TYPE"], header["SIZE"], strict=True))
        if not kinds or any(size not in _SIZES[kind] for kind, size in kinds):
            raise ValueError
        repeats = [int(n[:20]) for n in header.get("COUNT", ["1"] * len(names))]
        # Longer numbers are invalid, and Python refuses numbers with more than 4300 digits.
        width, height = (int(header.get(key, ["1"])[0][:20]) for key in ("WIDTH", "HEIGHT"))
        points = int(header["POINTS"][0][:20]) if "POINTS" in header else width * height
        types = [np.dtype(f"<{_TYPES[kind]}{size}") for kind, size in kinds]
        layout = list(zip(names, types, repeats, strict=True))
        encoding = header["DATA"][0].lower()
    except (KeyError, ValueError, TypeError, IndexError) as problem:
        fault = "the header of the .pcd file is wrong"
        raise InputError(fault, where=path, expected="FIELDS SIZE TYPE COUNT POINTS DATA") from problem
    if not 0 <= points <= _MAX_COUNT or not all(0 <= n <= 65536 for n in repeats):
        raise InputError("the header of the .pcd file is wrong", where=path, expected=f"counts from 0 to {_MAX_COUNT}")
    if not any(_readable(name, n) for name, _, n in layout):
        raise InputError("the header of the .pcd file is wrong", where=path, expected="fields of one number per point")
    return layout, points, encoding


def _readable(name: str, count: int) -> bool:
    return count == 1 and name != "_"


def _offsets(layout: _Layout) -> list[int]:
    """Return the offset of each field without gaps, and the size of a point in bytes."""
    return [0, *np.cumsum([dtype.itemsize * n for _, dtype, n in layout], dtype=np.int64).tolist()]


def _fitting_offsets(layout: _Layout, points: int, have: int, path: Path) -> list[int]:
    """Return the offset of each field, and the size of a point in bytes, that fill a body of `have` bytes."""
    packed = _offsets(layout)
    _check_size(have, points * packed[-1], path)
    # A remainder of less than one byte per point follows the points.
    if have - points * packed[-1] < max(points, 1):
        return packed
    for block in (_PCL_BLOCK, 1):
        aligned = _aligned_offsets(layout, block)
        if have == points * aligned[-1]:
            return aligned
    fault = "the fields of the .pcd file do not fill its points"
    expected = f"{packed[-1]} bytes per point, or a struct that is aligned as in PCL"
    hint = "write it again without fields _"
    raise InputError(fault, where=path, expected=expected, got=f"{have} bytes for {points} points", hint=hint)


def _aligned_offsets(layout: _Layout, block: int) -> list[int]:
    """Return the offset of each field in a struct by the size of its type, and that of the struct; _ has size 0."""
    # The first field after the coordinates, and the next struct, start at a multiple of `block`.
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
    """Decompress data of LibLZF to `size` bytes with a loop over its tokens, each of at most 264 bytes.

    Raises InputError if the tokens are truncated, refer to data before the start, or give another size.
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
            # A run longer than its distance repeats the bytes that it has just written.
            out += (run * (length // len(run) + 1))[:length]
    except IndexError as problem:
        raise InputError("the compressed points of the .pcd file are damaged", where=path) from problem
    if len(out) != size:
        fault = "the compressed points of the .pcd file are damaged"
        raise InputError(fault, where=path, expected=f"{size} bytes", got=len(out))
    return bytes(out)


def _header(data: bytes, path: Path) -> tuple[dict[str, list[str]], bytes]:
    """Return the words of the header by key, and the bytes after it."""
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
    # A number and the blank after it take at least two bytes.
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
