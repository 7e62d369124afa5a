"""Read .las and .laz files (ASPRS LAS 1.0 to 1.4) with laspy and lazrs, the extra `las`."""

from __future__ import annotations

import io
import struct
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from p2o import InputError

from p2o_datasets.lazy_dataset import optional_package
from p2o_datasets.number_text import MAX_POINTS

_MAGIC = b"LASF"
_SHORTEST_HEADER = 227
_MAX_BYTES = 256 << 20
_MAX_RECORDS = 1000
_COMPRESSED = 0x80
_TIME = "gps_time"


def read_las(data: bytes, path: Path) -> Mapping[str, Any]:
    """Return the fields of a .las or .laz file by name, each (N,): x, y, z in metres, intensity, time, extra bytes.

    `gps_time` is the time in seconds, `gps_time_s` here; times and intensities that are all zero are none. Rings are in
    extra bytes, because LAS has no field for them.

    Raises InputError without laspy, for headers that contradict the file size, and for damaged files.
    """
    _check_header(data, path)
    laspy = optional_package("laspy", "las", ".las and .laz", path)
    plain = _unpacked(data, path) if data[104] & _COMPRESSED else data
    try:
        las = laspy.read(io.BytesIO(plain))
        fields = {axis: np.asarray(getattr(las, axis), dtype=np.float64) for axis in "xyz"}
        fields |= {name: np.asarray(las[name]) for name in las.point_format.extra_dimension_names}
        if np.any(las["intensity"]):
            fields["intensity"] = np.asarray(las["intensity"])
        if _TIME in las.point_format.dimension_names and np.any(las[_TIME]):
            fields["gps_time_s"] = np.asarray(las[_TIME], dtype=np.float64)
    except Exception as problem:  # laspy raises many types for damaged files
        raise _damaged(path, str(problem) or type(problem).__name__) from problem
    return {name: value for name, value in fields.items() if value.ndim == 1}


def _unpacked(data: bytes, path: Path) -> bytes:
    """Decompress a .laz file in a separate process of limited memory.

    For damaged files, lazrs allocates any number of bytes, and aborts its process.
    """
    # -P: do not import modules from the working directory.
    words = [sys.executable, "-P", "-c", _UNPACK]
    try:
        done = subprocess.run(words, input=data, capture_output=True, timeout=_TIMEOUT_S, check=False)
    except subprocess.TimeoutExpired as problem:
        raise _damaged(path, f"no result within {_TIMEOUT_S} s") from problem
    if done.returncode != 0:
        lines = done.stderr.decode(errors="replace").strip().splitlines()[-1:] or [f"status {done.returncode}"]
        raise _damaged(path, lines[0])
    _check_header(done.stdout, path)
    return done.stdout


_TIMEOUT_S = 120
_UNPACK = """
import contextlib, io, os, sys
os.environ["OPENBLAS_NUM_THREADS"] = "1"
with contextlib.suppress(ImportError):
    import resource
    resource.setrlimit(resource.RLIMIT_AS, (8 << 30, 8 << 30))
import laspy
found = laspy.read(io.BytesIO(sys.stdin.buffer.read()), laz_backend=laspy.LazBackend.Lazrs)
out = io.BytesIO()
found.write(out, do_compress=False)
sys.stdout.buffer.write(out.getvalue())
"""


def _damaged(path: Path, got: str) -> InputError:
    return InputError("the point cloud cannot be read as LAS", where=path, got=got[:200])


def _check_header(data: bytes, path: Path) -> None:
    """Raise InputError for a header that contradicts the file size, before memory is allocated."""
    if not data.startswith(_MAGIC) or len(data) < _SHORTEST_HEADER:
        raise InputError("this is not a LAS file", where=path, expected="LASF", got=repr(data[:4]))
    version, start, records = (data[24], data[25]), *struct.unpack_from("<II", data, 96)
    size, points = struct.unpack_from("<HI", data, 105)
    if version >= (1, 4) and len(data) >= 255:
        extended, points_14 = struct.unpack_from("<IQ", data, 243)
        points, records = max(points, points_14), records + extended
    body = len(data) - start
    if records > _MAX_RECORDS or not _SHORTEST_HEADER <= start <= len(data) or size < 20:
        expected = f"points within {len(data)} bytes, at most {_MAX_RECORDS} records"
        got = f"points from {start}, {records} records"
        raise InputError("the header of the LAS file contradicts its size", where=path, expected=expected, got=got)
    if points > MAX_POINTS or points * size > _MAX_BYTES:
        fault, got = "the point cloud has too many points", f"{points} of {size} bytes"
        raise InputError(fault, where=path, expected=f"at most {MAX_POINTS}, and {_MAX_BYTES} bytes", got=got)
    if not data[104] & _COMPRESSED and points * size > body:
        expected = f"{points * size} bytes of points"
        raise InputError("the point cloud is truncated", where=path, expected=expected, got=body)
