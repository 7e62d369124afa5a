"""The checks of one vehicle as arrays: the content of the store is validated here, once, when it is read."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from p2o.arrays import Bool, Float, Int
from p2o.errors import InputError, printable

from p2o_fleet.drive import MAX_TEXT, TEMPERATURES
from p2o_fleet.evidence import COLUMNS, ERROR_COLUMNS, Verdict, arrow_schema, symmetric

TEXTS = tuple(name for name, kind in COLUMNS.items() if kind in (str, Verdict) and name != "vehicle")
"""Columns of texts, without that of the vehicle."""
READ = ("vehicle", "time", *TEXTS, "temperature_c", *ERROR_COLUMNS, "covariance", "camera_from_lidar", "frame_count")
"""Columns that `Checks.of` needs."""
_MAX_TIME = 253402300799.0
"""The last second of the year 9999."""
_MAX_M, _MAX_FRAMES = 1e9, 1_000_000
_MIN_SIGMA, _MAX_SIGMA = 1e-6, 1e6
_MOST = np.repeat([180.0, _MAX_M], 3)
"""Largest errors in deg and m."""
_BOTTOM = np.array([[0.0, 0.0, 0.0, 1.0]])


@dataclass(frozen=True, eq=False)
class Checks:
    """The checks of one vehicle as arrays (N,), in order of time; NaN for values that are unknown.

    `error` (N, 6) is in deg and m, `covariance` (N, 6, 6), `pose` (N, 4, 4). `damaged` are files and lines of the store
    that were skipped, each with the reason.
    """

    vehicle: str
    time: Float
    texts: Mapping[str, Any]
    temperature_c: Float
    error: Float
    covariance: Float
    pose: Float
    frame_count: Int
    damaged: tuple[str, ...] = ()

    def __len__(self) -> int:
        return len(self.time)

    @property
    def usable(self) -> Bool:
        """Return which checks (N,) have an estimate of all axes."""
        return np.asarray(np.isfinite(self.error[:, 0]))

    def take(self, rows: Any) -> Checks:
        """Return the checks of these indices."""
        texts = {name: values[rows] for name, values in self.texts.items()}
        return replace(self, texts=texts, **{name: getattr(self, name)[rows] for name in _ARRAYS})

    @classmethod
    def of(cls, table: Any, vehicle: str | None = None) -> Checks:
        """Return the checks of an Arrow table with the columns `READ`, in its order.

        Raises InputError if a column has another type or contains a value that no check has, such as another `vehicle`.
        """
        import pyarrow as pa

        try:
            if "frames" in table.column_names:
                _texts("frames", pa.chunked_array([table["frames"].combine_chunks().flatten()]))
            texts = {name: _texts(name, table[name]) for name in ("vehicle", *TEXTS)}
            moments = table["time"].cast(pa.timestamp("us", "UTC")).cast(pa.int64())
            time = _numbers("time", moments, 0.0, 1e6 * _MAX_TIME, required=True) / 1e6
            temperature = _numbers("temperature_c", table["temperature_c"], *TEMPERATURES)
            columns = [_numbers(name, table[name], -np.inf, np.inf) for name in ERROR_COLUMNS]
            frames = _numbers("frame_count", table["frame_count"], 0, _MAX_FRAMES, required=True).astype(np.int64)
            upper, pose = (_lists(table[name], size) for name, size in (("covariance", 21), ("camera_from_lidar", 12)))
        except (pa.ArrowException, ValueError) as problem:
            raise InputError("a column has a wrong type", got=problem) from problem
        vehicles, count = set(texts.pop("vehicle").tolist()), len(time)
        _require("vehicle", vehicle is None or vehicles <= {vehicle})
        _require("verdict", set(texts["verdict"].tolist()) <= {verdict.value for verdict in Verdict})
        covariance, error = symmetric(upper), np.column_stack(columns)
        known = ~np.isnan(error[:, 0])
        given = np.isnan(np.hstack([error, upper])) != known[:, None]
        _require("an error or its covariance", given.all() and valid_estimate(error[known], covariance[known]))
        poses = np.concatenate([pose.reshape(count, 3, 4), np.broadcast_to(_BOTTOM, (count, 1, 4))], axis=1)
        _require("camera_from_lidar", _rigid(poses[np.isfinite(pose).all(axis=1)]))
        return cls(vehicle or "", time, texts, temperature, error, covariance, poses, frames)

    @classmethod
    def joined(cls, vehicle: str, parts: Sequence[Checks], damaged: Sequence[str] = ()) -> Checks:
        """Return the checks of all parts in order of time, each check once.

        Of rows with one key, a readable one counts; of checks with the same log, sensors and extrinsic, the earliest.
        """
        parts = parts or [cls.of(arrow_schema().empty_table())]
        texts = {name: np.concatenate([part.texts[name] for part in parts]) for name in TEXTS}
        arrays = {name: np.concatenate([getattr(part, name) for part in parts]) for name in _ARRAYS}
        every = cls(vehicle, texts=texts, **arrays, damaged=tuple(dict.fromkeys(damaged)))
        return every.take(_distinct(every))


_ARRAYS = ("time", "temperature_c", "error", "covariance", "pose", "frame_count")


def valid_estimate(error: Float, covariance: Float) -> bool:
    """Return whether errors (N, 6) in deg and m and their covariances (N, 6, 6) are finite and in range."""
    variances = np.einsum("nii->ni", covariance)
    if not (np.abs(error) <= _MOST).all() or not ((variances >= _MIN_SIGMA**2) & (variances <= _MAX_SIGMA**2)).all():
        return False
    sigma = np.sqrt(variances)
    try:
        np.linalg.cholesky(covariance / (sigma[:, :, None] * sigma[:, None]))
    except np.linalg.LinAlgError:
        return False
    return True


def _rigid(poses: Float) -> bool:
    rotation = poses[:, :3, :3]
    orthonormal = np.abs(np.swapaxes(rotation, 1, 2) @ rotation - np.eye(3)).max(initial=0) < 1e-4
    return bool(orthonormal and (np.linalg.det(rotation) > 0).all() and np.abs(poses).max(initial=0) <= _MAX_M)


def _require(name: str, holds: Any) -> None:
    if not np.all(holds):
        raise InputError(f"{name} is out of range")


def _texts(name: str, column: Any) -> Any:
    """Return a column of texts as an array (N,) of objects; equal texts are one object."""
    import pyarrow as pa

    if column.null_count:
        raise InputError(f"{name} is missing")
    if not pa.types.is_dictionary(column.type):
        column = column.cast(pa.string()).dictionary_encode()
    coded = column.unify_dictionaries().combine_chunks()
    texts = coded.dictionary.cast(pa.string()).to_pylist()
    if any(len(text) > MAX_TEXT or (not text.isprintable() and printable(text) != text) for text in texts):
        raise InputError(f"{name} is not valid", expected=f"at most {MAX_TEXT} printable characters")
    return np.array([*texts, ""], object)[coded.indices.to_numpy()]


def _numbers(name: str, column: Any, low: float, high: float, *, required: bool = False) -> Float:
    """Return a column of numbers as an array (N,), NaN for null; raises InputError if one is out of bounds."""
    values = np.asarray(column.cast("double", safe=False).fill_null(np.nan).to_numpy(), np.float64)
    _require(name, (values >= low) & (values <= high) | (np.isnan(values) & (not required)))
    return values


def _lists(column: Any, size: int) -> Float:
    """Return lists of `size` numbers as an array (N, size); NaN where there is none."""
    import pyarrow as pa

    lists = column.cast(pa.list_(pa.float64())).combine_chunks()
    if (np.asarray(lists.value_lengths().drop_null()) != size).any():
        raise InputError("a list has a wrong length", expected=f"{size} numbers")
    out = np.full((len(lists), size), np.nan)
    out[np.asarray(lists.is_valid())] = np.asarray(lists.flatten(), np.float64).reshape(-1, size)
    return out


def _distinct(checks: Checks) -> Any:
    """Return the indices of distinct checks in order of time."""
    texts = checks.texts
    logs = [log for log in texts["log"].tolist() if log]
    if len(set(texts["key"].tolist())) == len(checks) and len(set(logs)) == len(logs):
        return np.argsort(checks.time, kind="stable")
    unreadable = texts["verdict"] == Verdict.UNREADABLE.value
    order = np.lexsort((texts["key"].astype(str), checks.time, unreadable))
    keys, contents, kept = set[str](), set[tuple[str, ...]](), list[int]()
    columns = (texts[name][order] for name in ("log", "camera", "lidar", "extrinsic_digest"))
    for index, key, *content in zip(order.tolist(), texts["key"][order], *columns, strict=True):
        identity = tuple(content)
        if key not in keys and not (identity[0] and identity in contents):
            keys.add(key)
            contents.add(identity)
            kept.append(index)
    rows = np.array(kept, np.int64)
    return rows[np.argsort(checks.time[rows], kind="stable")]
