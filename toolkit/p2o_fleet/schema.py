"""Columns of the stored evidence, and the conversion of evidence to rows and of tables to arrays."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Any

import numpy as np
from p2o.arrays import Bool, Float
from p2o.confidence.audit import AXES

from p2o_fleet.evidence import UPPER, CheckEvidence, Verdict

ERROR_COLUMNS = tuple(f"{axis}_{unit}" for axis, unit in AXES)
"""Columns of the error of the extrinsic: roll_deg, pitch_deg, yaw_deg, x_m, y_m, z_m."""
COLUMNS: Mapping[str, tuple[str, str]] = {
    "key": ("string", "key of the check: rows of one key are one check"),
    "vehicle": ("string", "name of the vehicle"),
    "time": ("timestamp", "when the drive was recorded (UTC)"),
    "camera": ("string", "name of the camera"),
    "lidar": ("string", "name of the LiDAR"),
    "vehicle_type": ("string", "type of the vehicle; systematic errors are pooled over it"),
    "service": ("string", "last service before the drive, empty if not given"),
    "temperature_c": ("double", "temperature in degrees Celsius, null if not given"),
    "data": ("string", "the log, as in the table of drives"),
    "extrinsic": ("string", "the extrinsic in use, as in the table of drives"),
    "verdict": ("string", "holds, off, cannot-tell, or unreadable"),
    "reason": ("string", "reason of the verdict"),
    **{
        name: ("double", f"error of the extrinsic: {name[:-4] if name.endswith('deg') else name[:-2]}")
        for name in ERROR_COLUMNS
    },
    "covariance": ("list<double>", "upper triangle (21) of the predicted covariance of the six errors, row by row"),
    "camera_from_lidar": ("list<double>", "extrinsic in use, rows of the upper three rows (12)"),
    "odds_ratio": ("double", "odds ratio of the agreement of edges"),
    "cells": ("int64", "number of independent cells with edges"),
    "frame_count": ("int64", "number of frames of the estimate"),
    "frames": ("list<string>", "names of these frames"),
    "log": ("string", "digest of the content of the frames, empty if unreadable"),
    "extrinsic_digest": ("string", "digest of the extrinsic"),
    "seconds": ("double", "duration of the check in s"),
    "version": ("string", "version of p2o"),
}
"""Type and meaning of each column; `vehicle` and the day are also the names of the folders."""
_BOTTOM = np.array([[0.0, 0.0, 0.0, 1.0]])


def arrow_schema() -> Any:
    """Return the Arrow schema of the files."""
    import pyarrow as pa

    types = {
        "string": pa.string(),
        "timestamp": pa.timestamp("us", "UTC"),
        "double": pa.float64(),
        "int64": pa.int64(),
        "list<double>": pa.list_(pa.float64()),
        "list<string>": pa.list_(pa.string()),
    }
    return pa.schema([(name, types[kind]) for name, (kind, _) in COLUMNS.items()])


def row_of(evidence: CheckEvidence) -> dict[str, Any]:
    """Return the row of evidence, ready for JSON: `time` is in s since 1970."""
    drive = evidence.drive
    errors = [None] * len(AXES) if evidence.error is None else [float(value) for value in evidence.error]
    pose = evidence.camera_from_lidar
    return {
        "key": evidence.key,
        "vehicle": drive.vehicle,
        "time": drive.time,
        "camera": drive.camera,
        "lidar": drive.lidar,
        "vehicle_type": drive.vehicle_type,
        "service": drive.service,
        "temperature_c": drive.temperature_c,
        "data": drive.data,
        "extrinsic": drive.extrinsic,
        "verdict": evidence.verdict.value,
        "reason": evidence.reason,
        **dict(zip(ERROR_COLUMNS, errors, strict=True)),
        "covariance": None if evidence.covariance is None else evidence.covariance[UPPER].tolist(),
        "camera_from_lidar": None if pose is None else pose[:3].ravel().tolist(),
        "odds_ratio": evidence.odds_ratio,
        "cells": evidence.cells,
        "frame_count": len(evidence.frames),
        "frames": list(evidence.frames),
        "log": evidence.log,
        "extrinsic_digest": evidence.extrinsic_digest,
        "seconds": evidence.seconds,
        "version": evidence.version,
    }


def table_of(rows: Sequence[Mapping[str, Any]]) -> Any:
    """Return the Arrow table of rows as `row_of` gives them."""
    import pyarrow as pa

    timed = [{**row, "time": datetime.fromtimestamp(row["time"], UTC)} for row in rows]
    return pa.Table.from_pylist(timed, schema=arrow_schema())


@dataclass(frozen=True, eq=False)
class Checks:
    """The checks of one vehicle as arrays (N,), in order of time; NaN for values that are unknown.

    `error` (N, 6) is in deg and m, `covariance` (N, 6, 6), `pose` (N, 4, 4). `usable` (N,) marks rows with an estimate.
    """

    vehicle: str
    time: Float
    texts: Mapping[str, Any]
    temperature_c: Float
    error: Float
    covariance: Float
    pose: Float
    frame_count: Any

    def __len__(self) -> int:
        return len(self.time)

    @property
    def usable(self) -> Bool:
        """Return which checks (N,) have an estimate of all axes."""
        return np.asarray(np.isfinite(self.error).all(axis=1) & np.isfinite(self.covariance).all(axis=(1, 2)))

    def take(self, rows: Any) -> Checks:
        """Return the checks of these indices."""
        return Checks(
            self.vehicle,
            self.time[rows],
            {name: values[rows] for name, values in self.texts.items()},
            self.temperature_c[rows],
            self.error[rows],
            self.covariance[rows],
            self.pose[rows],
            self.frame_count[rows],
        )


TEXTS = (
    "key",
    "camera",
    "lidar",
    "vehicle_type",
    "service",
    "data",
    "extrinsic",
    "verdict",
    "reason",
    "log",
    "extrinsic_digest",
)
READ = ("key", "time", *TEXTS[1:], "temperature_c", *ERROR_COLUMNS, "covariance", "camera_from_lidar", "frame_count")
"""Columns that `checks_of` needs."""


def checks_of(vehicle: str, table: Any) -> Checks:
    """Return the checks of a vehicle from an Arrow table with the columns `READ`, each check once.

    Of rows with one key, a readable one counts; of checks with the same log, sensors and extrinsic, the earliest.
    """
    import pyarrow as pa

    count = table.num_rows
    texts = {name: table[name].to_numpy(zero_copy_only=False) for name in TEXTS}
    time = table["time"].cast(pa.int64()).to_numpy() / 1e6
    error = np.column_stack([_numbers(table[name]) for name in ERROR_COLUMNS])
    upper, pose = _lists(table["covariance"], len(UPPER[0])), _lists(table["camera_from_lidar"], 12)
    covariance = np.empty((count, len(AXES), len(AXES)))
    covariance[:, UPPER[0], UPPER[1]] = covariance[:, UPPER[1], UPPER[0]] = upper
    poses = np.concatenate([pose.reshape(count, 3, 4), np.broadcast_to(_BOTTOM, (count, 1, 4))], axis=1)
    frames = table["frame_count"].to_numpy()
    checks = Checks(vehicle, time, texts, _numbers(table["temperature_c"]), error, covariance, poses, frames)
    return checks.take(_distinct(checks))


def _distinct(checks: Checks) -> Any:
    """Return the indices of distinct checks in order of time."""
    texts = checks.texts
    logs = [log for log in texts["log"].tolist() if log]
    if len(set(texts["key"].tolist())) == len(checks) and len(set(logs)) == len(logs):
        return np.argsort(checks.time, kind="stable")
    unreadable = texts["verdict"] == Verdict.UNREADABLE.value
    order = np.lexsort((texts["key"].astype(str), checks.time, unreadable))
    keys, contents, kept = set[str](), set[tuple[str, ...]](), list[int]()
    columns = ("camera", "lidar", "log", "extrinsic_digest")
    for index, key, *content in zip(order.tolist(), *(texts[name][order] for name in ("key", *columns)), strict=True):
        identity = tuple(content)
        if key in keys or (identity[2] and identity in contents):
            continue
        keys.add(key)
        contents.add(identity)
        kept.append(index)
    rows = np.array(kept, np.int64)
    return rows[np.argsort(checks.time[rows], kind="stable")]


def _numbers(column: Any) -> Float:
    return np.asarray(column.cast("double").fill_null(np.nan).to_numpy(), np.float64)


def _lists(column: Any, size: int) -> Float:
    """Return lists of `size` numbers as an array (N, size); NaN where there is none."""
    import pyarrow as pa

    lists = column.combine_chunks() if isinstance(column, pa.ChunkedArray) else column
    lists = lists if isinstance(lists, pa.Array) else pa.concat_arrays(lists.chunks)
    out = np.full((len(lists), size), np.nan)
    known = np.asarray(lists.is_valid())
    values = np.asarray(lists.flatten(), np.float64)
    out[known] = values.reshape(-1, size)
    return out
