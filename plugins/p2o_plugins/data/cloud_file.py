"""Reading a sweep from a file: .bin and .txt (KITTI), .pcd, .ply and .npz."""

from __future__ import annotations

import io
import struct
import zipfile
import zlib
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from p2o import Cloud, InputError
from p2o.files.input_file import naming, read_bytes

from p2o_plugins.data.pcd_file import read_pcd
from p2o_plugins.data.ply_file import read_ply

INTENSITY = ("intensity", "i", "reflectance", "reflectivity")
RING = ("ring", "channel")
TIME = ("time_s", "time", "t", "timestamp")
# No LiDAR for cars reaches 10 km: numbers beyond are bytes of something else.
_FAR_M = 1e4
_MAX_RING = 1e6
_MAX_NPZ_BYTES = 4 << 30
# What zipfile and NumPy raise for archives that are damaged, encrypted or of a kind they do not know.
_NPZ_FAILURES = (
    *(ValueError, TypeError, KeyError, EOFError, OSError, RuntimeError, NotImplementedError, MemoryError),
    *(struct.error, zlib.error, zipfile.BadZipFile),
)


def read_cloud(path: Path, image_time_s: float | None = None) -> tuple[Cloud, tuple[str, ...]]:
    """Return the sweep of a file and warnings about what was dropped.

    `image_time_s` is subtracted from the file's times, which are seconds if stored as floating point numbers and
    nanoseconds if stored as integers; times that stay further than 1000 s from the image are dropped with a warning.

    Raises InputError if the file is missing, a folder, empty, unreadable, truncated or of another format, has no
    points, or no finite points.
    """
    reader = _READERS.get(path.suffix.lower())
    if reader is None:
        raise InputError(
            "unknown kind of point cloud file", where=path, expected=" ".join(_READERS), got=path.suffix or "no suffix"
        )
    return cloud_from_fields(reader(read_bytes(path, "point cloud"), path), path, image_time_s)


def read_bin(data: bytes, path: Path) -> Mapping[str, Any]:
    """Return x y z intensity, each (N,) float32, of a file of four float32 a point; raises InputError if truncated."""
    if len(data) % 16:
        raise InputError(
            "the point cloud is truncated",
            where=path,
            expected="a multiple of 16 bytes (x y z intensity as float32)",
            got=f"{len(data)} bytes",
        )
    return dict(zip(("x", "y", "z", "intensity"), np.frombuffer(data, "<f4").reshape(-1, 4).T, strict=True))


def read_txt(data: bytes, path: Path) -> Mapping[str, Any]:
    """Return x y z intensity, each (N,), of text with four numbers a point; raises InputError if it holds others."""
    try:
        values = np.array(data.split(), dtype=np.float64)
    except ValueError as problem:
        raise InputError("the points are not numbers", where=path, expected="x y z intensity a line") from problem
    if values.size % 4:
        raise InputError(
            "the point cloud is truncated", where=path, expected="x y z intensity a line", got=f"{values.size} numbers"
        )
    return dict(zip(("x", "y", "z", "intensity"), values.reshape(-1, 4).T, strict=True))


def read_npz(data: bytes, path: Path) -> Mapping[str, Any]:
    """Return the fields of an .npz archive with `xyz` (N, 3) and optional (N,) fields; pickled objects are refused."""
    try:
        # NumPy takes what is no archive for a pickle; this asks for an archive first.
        with zipfile.ZipFile(io.BytesIO(data)) as packed:
            if sum(entry.file_size for entry in packed.infolist()) > _MAX_NPZ_BYTES:
                raise InputError("the .npz archive unpacks to more than 4 GiB", where=path)
        with np.load(io.BytesIO(data), allow_pickle=False) as archive:
            arrays = {name: archive[name] for name in archive.files}
    except _NPZ_FAILURES as problem:
        refused = "Object arrays" in str(problem)
        raise InputError(
            "the .npz archive holds pickled objects, which are never loaded"
            if refused
            else "this is not an .npz archive, or it is damaged",
            where=path,
            expected="an archive of plain number arrays",
        ) from problem
    xyz = arrays.pop("xyz", None)
    if xyz is None or xyz.ndim != 2 or xyz.shape[1] != 3:
        raise InputError(
            "the .npz archive has no points",
            where=path,
            expected="an array xyz of shape (N, 3)",
            got="no xyz" if xyz is None else xyz.shape,
        )
    return {**arrays, "x": xyz[:, 0], "y": xyz[:, 1], "z": xyz[:, 2]}


_READERS: Mapping[str, Callable[[bytes, Path], Mapping[str, Any]]] = {
    ".bin": read_bin,
    ".pcd": read_pcd,
    ".ply": read_ply,
    ".npz": read_npz,
    ".txt": read_txt,
}
SUFFIXES = tuple(suffix for suffix in _READERS if suffix != ".txt")
"""Suffixes of files that are sweeps for sure; a .txt file may be anything."""


def cloud_from_fields(
    fields: Mapping[str, Any], path: Path, image_time_s: float | None = None
) -> tuple[Cloud, tuple[str, ...]]:
    """Return the sweep made of named columns (N,), and warnings; see `read_cloud` for times and errors."""
    missing = [axis for axis in "xyz" if axis not in fields]
    if missing:
        raise InputError("the points have no coordinates", where=path, expected="fields x y z", got=" ".join(fields))
    try:
        columns = {name: np.asarray(value) for name, value in fields.items()}
        # Signalling NaN among the bytes would warn; they are dropped below.
        with np.errstate(invalid="ignore"):
            xyz = np.stack([columns[axis].astype(np.float64) for axis in "xyz"], axis=1)
    except (TypeError, ValueError) as problem:
        raise InputError("the points are not numbers", where=path, expected="numeric x y z") from problem
    with np.errstate(invalid="ignore"):
        far = int((np.abs(np.where(np.isfinite(xyz), xyz, 0)) > _FAR_M).any(axis=1).sum())
    if far > 0.01 * len(xyz):
        raise InputError(
            "this is not a point cloud in metres",
            where=path,
            expected=f"coordinates below {_FAR_M:g} m",
            got=f"{far} of {len(xyz)} points beyond",
        )
    warnings: list[str] = []
    per_point: dict[str, Any] = {}
    for target, aliases in (("intensity", INTENSITY), ("ring", RING), ("time_s", TIME)):
        name = next((n for n in aliases if n in columns), None)
        if name is None:
            continue
        value = columns[name]
        if value.shape != (len(xyz),):
            raise InputError(
                f"field {name} has another length than the points",
                where=path,
                expected=f"({len(xyz)},)",
                got=value.shape,
            )
        if value.dtype.kind not in "iuf" or not np.isfinite(value).all():
            warnings.append(f"{path.name}: field {name} ignored: not finite numbers")
        elif target == "ring" and np.abs(value, dtype=np.float64).max(initial=0) > _MAX_RING:
            warnings.append(f"{path.name}: field {name} ignored: numbers up to {np.abs(value).max():.3g} are no rings")
        elif target == "time_s":
            time_s = value * 1e-9 if value.dtype.kind in "iu" else value.astype(np.float64)
            time_s = time_s - (image_time_s or 0.0)
            if len(time_s) and np.abs(time_s).max() > 1000:
                warnings.append(f"{path.name}: field {name} ignored: not relative to the image; give image_time_s")
            else:
                per_point[target] = time_s
        else:
            per_point[target] = value
    with naming(path):
        cloud, dropped = Cloud.from_raw(xyz, **per_point)
    return cloud, (*warnings, *(f"{path.name}: {remark}" for remark in dropped))
