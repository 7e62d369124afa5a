"""Read .npy and .npz files of numbers: bounded by the size of the file, without pickled objects."""

from __future__ import annotations

import io
import math
import zipfile
from typing import Any

import numpy as np

from p2o.errors import InputError

MAX_BYTES = 256 << 20
"""Largest unpacked .npz archive in bytes: sweeps, depth maps and label maps are smaller."""
_MAX_ENTRIES = 1000


def read_npy(data: bytes, where: object = None) -> Any:
    """Decode the array of an .npy file.

    Raises InputError if the bytes are not an .npy file, hold pickled objects, or are shorter than the header requires;
    the header is checked before memory is allocated.
    """
    try:
        return _array(data)
    except Exception as problem:  # NumPy's parser raises many types for damaged headers
        text = "this is not an .npy file of numbers"
        raise InputError(text, where=where, expected="a plain array", got=str(problem)[:200]) from problem


def read_npz(data: bytes, where: object = None, most: int = MAX_BYTES) -> dict[str, Any]:
    """Decode the arrays of an .npz archive by name; they are writable.

    Raises InputError as `read_npy`, and if the archive is damaged or unpacks to more than `most` bytes.
    """
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            entries = archive.infolist()
            size = sum(entry.file_size for entry in entries)
            if size > most or len(entries) > _MAX_ENTRIES:
                text = "the unpacked .npz archive is too large"
                expected = f"at most {most} bytes in {_MAX_ENTRIES} arrays"
                raise InputError(text, where=where, expected=expected, got=f"{size} bytes in {len(entries)}")
            if any(entry.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED) for entry in entries):
                raise ValueError("a compression that NumPy does not write")
            return {entry.filename.removesuffix(".npy"): _array(bytearray(archive.read(entry))) for entry in entries}
    except InputError:
        raise
    except Exception as problem:  # zipfile raises many types for damaged archives
        pickled = "pickled" in str(problem)
        raise InputError(
            "the .npz archive holds pickled objects, which are never loaded"
            if pickled
            else "this is not an .npz archive, or it is damaged",
            where=where,
            expected="an archive of plain number arrays",
            got=None if pickled else str(problem)[:200] or type(problem).__name__,
        ) from problem


def _array(data: bytes | bytearray) -> Any:
    """Decode an .npy file as a view of `data`, unlike `numpy.load`, which allocates before it checks the length."""
    file = io.BytesIO(data)
    version = np.lib.format.read_magic(file)
    parse = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
    shape, fortran_order, dtype = parse(file)
    fields = [dtype[name] for name in dtype.names] if dtype.names else [dtype]
    if dtype.hasobject:
        raise ValueError("pickled objects")
    if any(field.kind not in "biufcU" for field in fields):
        raise ValueError(f"unsupported type {str(dtype)[:60]}")
    size = math.prod(shape) * dtype.itemsize
    if min(shape, default=0) < 0 or size > len(data) - file.tell():
        raise ValueError(f"an array {str(shape)[:60]} of {dtype} does not fit into {len(data)} bytes")
    array = np.frombuffer(data, dtype, math.prod(shape), file.tell())
    return array.reshape(shape, order="F" if fortran_order else "C")
