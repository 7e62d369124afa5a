"""Reading .npy and .npz files: plain numbers of the size that the file itself has, never more, never objects."""

from __future__ import annotations

import io
import re
import struct
import zipfile
import zlib
from typing import Any

import numpy as np

from p2o.errors import InputError

MAX_BYTES = 256 << 20
"""No sweep, no map of depth and no label is larger, unpacked."""
_MAGIC = b"\x93NUMPY"
_MAX_HEADER = 1 << 16
_MAX_ENTRIES = 1000
_KEYS = re.compile(r"'(descr|fortran_order|shape)'\s*:\s*('[^']*'|\[[^]]*\]|True|False|\([\d\s,L]*\))")
_FIELD = re.compile(r"\(\s*'(\w+)'\s*,\s*'([^']*)'\s*\)")
# What zipfile raises for archives that are damaged, encrypted or of a kind it does not know.
_DAMAGED = (
    *(ValueError, TypeError, KeyError, IndexError, EOFError, OSError, RuntimeError, NotImplementedError, MemoryError),
    *(OverflowError, AttributeError, struct.error, zlib.error, zipfile.BadZipFile),
)


def read_npy(data: bytes, where: object = None) -> Any:
    """Return the array of an .npy file.

    Raises InputError if it is none, holds pickled objects, or is shorter than its header says: before any memory is
    taken.
    """
    try:
        return _array(data)
    except (ValueError, TypeError, KeyError, SyntaxError, OverflowError, MemoryError) as problem:
        raise InputError(
            "this is not an .npy file of numbers", where=where, expected="a plain array", got=str(problem)[:200]
        ) from problem


def read_npz(data: bytes, where: object = None, most: int = MAX_BYTES) -> dict[str, Any]:
    """Return the arrays of an .npz archive by name.

    Raises InputError as `read_npy`, and if the archive is damaged or unpacks to more than `most` bytes.
    """
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as packed:
            entries = packed.infolist()
            size = sum(entry.file_size for entry in entries)
            if size > most or len(entries) > _MAX_ENTRIES:
                raise InputError(
                    "the .npz archive unpacks to too much",
                    where=where,
                    expected=f"at most {most} bytes in {_MAX_ENTRIES} arrays",
                    got=f"{size} bytes in {len(entries)}",
                )
            if any(entry.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED) for entry in entries):
                raise ValueError("packed in a way that NumPy does not write")
            return {entry.filename.removesuffix(".npy"): _array(bytearray(packed.read(entry))) for entry in entries}
    except _DAMAGED as problem:
        refused = "pickled" in str(problem)
        raise InputError(
            "the .npz archive holds pickled objects, which are never loaded"
            if refused
            else "this is not an .npz archive, or it is damaged",
            where=where,
            expected="an archive of plain number arrays",
            got=None if refused else str(problem)[:200] or type(problem).__name__,
        ) from problem


def _array(data: bytes | bytearray) -> Any:
    """Return the array of an .npy file; raises ValueError and the like.

    NumPy's own reader takes the memory first and evaluates the header as Python.
    """
    if not data.startswith(_MAGIC) or len(data) < 12:
        raise ValueError("no .npy file")
    wide = data[6] > 1
    start = 12 if wide else 10
    size = int.from_bytes(data[8:start], "little")
    if size > _MAX_HEADER or len(data) < start + size:
        raise ValueError("the header is cut off or too long")
    said = dict(_KEYS.findall(data[start : start + size].decode("utf-8")))
    dtype = _dtype(said["descr"])
    lengths = [word.strip().rstrip("L") for word in said["shape"].strip("()").split(",")]
    # No length of more digits fits, and Python reads no number of more than 4300.
    shape = tuple(int(word[:20]) for word in lengths if word)
    count = 1
    for length in shape:
        count *= length
    if count * dtype.itemsize > len(data) - start - size or len(shape) > 32 or not dtype.itemsize:
        raise ValueError(f"an array {str(shape)[:60]} of {dtype} does not fit into {len(data)} bytes")
    array = np.frombuffer(data, dtype, count, start + size)
    return array.reshape(shape, order="F" if said["fortran_order"] == "True" else "C")


def _dtype(said: str) -> np.dtype[Any]:
    """Return the type that a header names: of plain numbers or texts, or of fields of them."""
    fields = _FIELD.findall(said)
    types = [(name, np.dtype(_plain(kind))) for name, kind in fields] if said.startswith("[") else _plain(said[1:-1])
    if isinstance(types, list) and f"[{', '.join(map(str, fields))}]" != said:
        raise ValueError(f"unknown type {said[:60]}")
    return np.dtype(types)


def _plain(kind: str) -> str:
    if re.fullmatch(r"[<>|=]?O\d*", kind):
        raise ValueError("pickled objects")
    if not re.fullmatch(r"[<>|=]?(b1|[iu][1248]|f(2|4|8|16)|c(8|16)|U\d{1,6})", kind):
        raise ValueError(f"unknown type {kind[:60]}")
    return kind
