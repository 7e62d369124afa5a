"""Read a sweep from a file: .bin, .npy and .txt (rows of numbers), .pcd, .ply, .npz, .las and .laz."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from p2o import Bool, Cloud, InputError
from p2o.reading import naming, read_bytes
from p2o.reading import read_npz as read_archive

from p2o_datasets.bin_file import FAR_M, OPTION, check_columns, read_bin, read_rows, read_txt
from p2o_datasets.las_file import read_las
from p2o_datasets.number_text import MAX_POINTS
from p2o_datasets.pcd_file import read_pcd
from p2o_datasets.ply_file import read_ply

INTENSITY = ("intensity", "i", "reflectance", "reflectivity")
RING = ("ring", "channel")
TIME = ("time_s", "time", "t", "timestamp")
_MAX_BYTES = 256 << 20
# Larger than the number of rings of any automotive LiDAR: larger numbers are not rings.
_MAX_RING = 1023


def read_cloud(
    path: Path, image_time_s: float | None = None, columns: Sequence[str] | None = None
) -> tuple[Cloud, tuple[str, ...]]:
    """Return the sweep of a file, and warnings about dropped data.

    `image_time_s` is subtracted from the times of the points, which are seconds if stored as floating point numbers and
    nanoseconds if stored as integers; times more than 1000 s from the image are dropped with a warning. `columns` name
    the columns of files without names (.bin, .npy, .txt), _ those to ignore.

    Raises InputError if the file is missing, a folder, empty, unreadable, truncated, too large or of another format,
    or has no finite points.
    """
    suffix = path.suffix.lower()
    if suffix not in (*_ROWS, *_READERS):
        fault = "unknown format of a point cloud file"
        raise InputError(fault, where=path, expected=" ".join((*_ROWS, *_READERS)), got=path.suffix or "no suffix")
    data = read_bytes(path, "point cloud", _MAX_BYTES)
    if suffix in _ROWS:
        if columns is not None:
            check_columns(columns, (*INTENSITY, *RING, *TIME), path)
        fields = _ROWS[suffix](data, path, columns)
    elif columns is not None:
        raise InputError(f"{OPTION} given for a file with named columns", where=path, expected=" or ".join(_ROWS))
    else:
        fields = _READERS[suffix](data, path)
    return cloud_from_fields(fields, path, image_time_s)


def read_npz(data: bytes, path: Path) -> Mapping[str, Any]:
    """Return the fields of an .npz archive with `xyz` (N, 3) and optional (N,) fields; pickled objects are refused."""
    arrays = read_archive(data, path)
    xyz = arrays.pop("xyz", None)
    if xyz is None or xyz.ndim != 2 or xyz.shape[1] != 3:
        got = "no xyz" if xyz is None else xyz.shape
        raise InputError("the .npz archive has no points", where=path, expected="an array xyz of shape (N, 3)", got=got)
    return {**arrays, "x": xyz[:, 0], "y": xyz[:, 1], "z": xyz[:, 2]}


_ROWS = {".bin": read_bin, ".npy": read_rows, ".txt": read_txt}
_READERS = {".pcd": read_pcd, ".ply": read_ply, ".npz": read_npz, ".las": read_las, ".laz": read_las}
SUFFIXES = (".bin", *_READERS)
"""Suffixes of files that are always sweeps, unlike .npy and .txt."""
NAMED_SUFFIXES = (*SUFFIXES, ".npy")
"""Suffixes of sweeps called `cloud`."""


def cloud_from_fields(
    fields: Mapping[str, Any], path: Path, image_time_s: float | None = None
) -> tuple[Cloud, tuple[str, ...]]:
    """Return the sweep of named columns (N,), and warnings; see `read_cloud` for times and errors."""
    missing = [axis for axis in "xyz" if axis not in fields]
    if missing:
        raise InputError("the points have no coordinates", where=path, expected="fields x y z", got=" ".join(fields))
    columns = {name: np.asarray(value) for name, value in fields.items()}
    count = columns["x"].size
    if any(columns[axis].dtype.kind not in "iuf" or columns[axis].shape != (count,) for axis in "xyz"):
        raise InputError("the points are not numbers", where=path, expected="numeric x y z, one per point")
    if count > MAX_POINTS:
        raise InputError("the point cloud has too many points", where=path, expected=f"at most {MAX_POINTS}", got=count)
    # Signalling NaN and numbers beyond double precision would emit warnings; both are dropped below.
    with np.errstate(invalid="ignore", over="ignore"):
        xyz = np.stack([columns[axis] for axis in "xyz"], axis=1, dtype=np.float64, casting="unsafe")
        usable: Bool = np.asarray(np.isfinite(xyz).all(axis=1))
        far = int(np.count_nonzero((np.abs(xyz) > FAR_M).any(axis=1) & usable))
    if far > 0.01 * count:
        fault = "this is not a point cloud in metres"
        expected = f"coordinates below {FAR_M:g} m"
        raise InputError(fault, where=path, expected=expected, got=f"{far} of {count} points farther away")
    warnings: list[str] = []
    per_point: dict[str, Any] = {}
    for target, aliases in (("intensity", INTENSITY), ("ring", RING), ("time_s", TIME)):
        name = next((n for n in aliases if n in columns), None)
        if name is None:
            continue
        value = columns[name]
        if value.shape != (count,):
            fault = f"field {name} has another length than the points"
            raise InputError(fault, where=path, expected=f"({count},)", got=value.shape)
        wrong = None if _is_finite(value, usable) else "not finite numbers"
        if wrong is None and target == "ring":
            wrong = _no_rings(value[usable])
        elif wrong is None and target == "time_s":
            with np.errstate(invalid="ignore", over="ignore"):
                value = value * 1e-9 if value.dtype.kind in "iu" else value.astype(np.float64)
                value = value - (image_time_s or 0.0)
            if np.abs(value[usable]).max(initial=0) > 1000:
                wrong = "not relative to the image; give image_time_s"
        if wrong is None:
            per_point[target] = value
        else:
            warnings.append(f"{path.name}: field {name} ignored: {wrong}")
    with naming(path):
        cloud, dropped = Cloud.from_raw(xyz, **per_point)
    return cloud, (*warnings, *(f"{path.name}: {remark}" for remark in dropped))


def _is_finite(value: Any, usable: Bool) -> bool:
    """Return whether a field is a finite number at the usable points."""
    if value.dtype.kind != "f":
        return value.dtype.kind in "iu"
    with np.errstate(invalid="ignore", over="ignore"):
        return bool(np.isfinite(value[usable].astype(np.float64)).all())


def _no_rings(ring: Any) -> str | None:
    """Return why numbers cannot be ring numbers, or None."""
    if not ring.size:
        return None
    least, most = ring.min(), ring.max()
    if least < 0 or most > _MAX_RING:
        return f"numbers from {least:.6g} to {most:.6g} are not rings"
    if ring.dtype.kind == "f" and (ring != np.floor(ring)).any():
        return "rings are not integers"
    if ring.size > 1 and least == most:
        return f"all {ring.size} points have ring {most:.6g}"
    return None
