"""Read a sweep from a file: .bin, .npy and .txt (rows of numbers), .pcd, .ply, .npz, .las and .laz."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from p2o import Cloud, InputError
from p2o.reading import naming, read_bytes
from p2o.reading import read_npz as read_archive

from p2o_datasets import point_fields
from p2o_datasets.bin_file import FAR_M, OPTION, check_columns, read_bin, read_rows, read_txt
from p2o_datasets.las_file import read_las
from p2o_datasets.number_text import MAX_POINTS
from p2o_datasets.pcd_file import read_pcd
from p2o_datasets.ply_file import read_ply
from p2o_datasets.point_fields import PointClock

_MAX_BYTES = 256 << 20
_SCALE_HINT = "scale the points to metres (cloud_scale in frame.yaml: 0.001 for millimetres, 0.01 for centimetres)"


def read_cloud(
    path: Path, image_time_s: float | None = None, columns: Sequence[str] | None = None
) -> tuple[Cloud, tuple[str, ...]]:
    """Return the sweep of a file, and warnings about dropped data; raises as `read_fields` and `read_points`."""
    return cloud_from_fields(read_fields(path, columns), path, image_time_s)


def read_fields(path: Path, columns: Sequence[str] | None = None) -> Mapping[str, Any]:
    """Return the fields of the points of a file by name, each (N,).

    `columns` name the columns of files without names (.bin, .npy, .txt), _ those to ignore.

    Raises InputError if the file is missing, a folder, empty, unreadable, truncated, too large or of another format.
    """
    suffix = path.suffix.lower()
    if suffix not in (*_ROWS, *_READERS):
        fault = "unknown format of a point cloud file"
        raise InputError(fault, where=path, expected=" ".join((*_ROWS, *_READERS)), got=path.suffix or "no suffix")
    data = read_bytes(path, "point cloud", _MAX_BYTES)
    if suffix in _ROWS:
        if columns is not None:
            check_columns(columns, point_fields.KNOWN_NAMES, path)
        return _ROWS[suffix](data, path, columns)
    if columns is not None:
        raise InputError(f"{OPTION} given for a file with named columns", where=path, expected=" or ".join(_ROWS))
    return _READERS[suffix](data, path)


def read_npz(data: bytes, path: Path) -> Mapping[str, Any]:
    """Return the fields of an .npz archive with `xyz` (N, 3), or x, y, z, and optional (N,) fields.

    Raises InputError without coordinates, and for pickled objects.
    """
    arrays = read_archive(data, path)
    if "xyz" not in arrays and {"x", "y", "z"} <= {name.lower() for name in arrays}:
        return arrays
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


class ReadPoints(NamedTuple):
    """A sweep, warnings about its fields, and the names of the fields that are not used."""

    cloud: Cloud
    warnings: tuple[str, ...]
    unused: tuple[str, ...]


def cloud_from_fields(
    fields: Mapping[str, Any], path: Path, image_time_s: float | None = None
) -> tuple[Cloud, tuple[str, ...]]:
    """Return the sweep of named columns (N,), and warnings, as `read_points`; times share the clock of the image."""
    return read_points(fields, path, PointClock.of_image(image_time_s))[:2]


def read_points(fields: Mapping[str, Any], path: Path, clock: PointClock, scale: float = 1.0) -> ReadPoints:
    """Return the sweep of named columns (N,), with intensity, ring and time by the names of `point_fields`.

    `clock` converts times to seconds after the image, and `scale` coordinates to metres. Fields that hold no rings or
    times are ignored: those of the usual names with a warning.

    Raises InputError for missing, wrong or too many points, and as `PointClock.after_image`.
    """
    columns = {name: np.asarray(value) for name, value in point_fields.plain_names(fields).items()}
    missing = [axis for axis in "xyz" if axis not in columns]
    if missing:
        raise InputError("the points have no coordinates", where=path, expected="fields x y z", got=" ".join(fields))
    count = columns["x"].size
    if any(columns[axis].dtype.kind not in "iuf" or columns[axis].shape != (count,) for axis in "xyz"):
        raise InputError("the points are not numbers", where=path, expected="numeric x y z, one per point")
    if count > MAX_POINTS:
        raise InputError("the point cloud has too many points", where=path, expected=f"at most {MAX_POINTS}", got=count)
    # Signalling NaN and numbers beyond double precision would emit warnings; both are dropped below.
    with np.errstate(invalid="ignore", over="ignore"):
        xyz = np.stack([columns[axis] for axis in "xyz"], axis=1, dtype=np.float64, casting="unsafe") * scale
        far = int(np.count_nonzero((np.abs(xyz) > FAR_M).any(axis=1) & np.isfinite(xyz).all(axis=1)))
    if far > 0.01 * count:
        fault = "this is not a point cloud in metres"
        expected, got = f"coordinates below {FAR_M:g} m", f"{far} of {count} points farther away"
        raise InputError(fault, where=path, expected=expected, got=got, hint=_SCALE_HINT)
    usable = point_fields.usable_points(xyz)
    warnings: list[str] = []
    per_point: dict[str, Any] = {}
    used: list[str] = []
    for target, names in point_fields.candidates(list(columns)).items():
        for name in names:
            value: Any = columns[name]
            if value.shape != (count,):
                fault = f"field {name} has another length than the points"
                raise InputError(fault, where=path, expected=f"({count},)", got=value.shape)
            wrong = point_fields.not_finite(value[usable])
            if target == "time" and wrong is None:
                with naming(path):
                    value, wrong = clock.after_image(value, usable, point_fields.time_unit(name) or "auto")
                if value is not None and wrong is not None:
                    warnings.append(f"{path.name}: {wrong}")
                    wrong = None
            elif target == "ring" and wrong is None:
                wrong = point_fields.no_rings(name, value[usable])
            if wrong is None:
                used.append(name)
                if value is not None:
                    per_point["time_s" if target == "time" else target] = value
                break
            if target != "ring" or point_fields.only_rings(name):
                used.append(name)
                warnings.append(f"{path.name}: field {name} ignored: {wrong}")
    with naming(path):
        cloud, dropped = Cloud.from_raw(xyz, **per_point)
    warnings += [f"{path.name}: {remark}" for remark in dropped]
    return ReadPoints(cloud, tuple(warnings), point_fields.unused_fields(columns, used))
