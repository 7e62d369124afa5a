"""The outcome of one check, which is one row of the store: the only definition of its columns."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from enum import StrEnum
from functools import cache
from typing import Any, get_type_hints

import numpy as np
from p2o.arrays import Float
from p2o.confidence.audit import AXES
from p2o.errors import InputError

from p2o_fleet.drive import Drive

ERROR_COLUMNS = tuple(f"{axis}_{unit}" for axis, unit in AXES)
"""Columns of the error of the extrinsic: roll_deg, pitch_deg, yaw_deg, x_m, y_m, z_m."""
UPPER = np.triu_indices(len(AXES))
"""Rows and columns of the 21 stored elements of a covariance."""


class Verdict(StrEnum):
    """Outcome of a check: those of `p2o check`, and a log that could not be checked."""

    HOLDS = "holds"
    OFF = "off"
    CANNOT_TELL = "cannot-tell"
    UNREADABLE = "unreadable"


@dataclass(frozen=True, kw_only=True)
class Evidence:
    """What a check of a drive returns; it contains no image and no point.

    `key` identifies the check. `roll_deg` to `z_m` are the error of the extrinsic in use against the pose of the edges
    (`p2o.pose_error`), `covariance` the upper triangle (21) of its predicted covariance, row by row: None if the edges
    give no estimate. `camera_from_lidar` are the upper three rows (12) of the extrinsic, None if it could not be read.
    `odds_ratio` and the number of independent `cells` are the agreement of the edges. `frames` are the names of the
    `frame_count` frames of the estimate. `log` is the digest of the content of the frames, empty if unreadable,
    `extrinsic_digest` that of the extrinsic. `seconds` is the duration of the check, `version` that of p2o.
    """

    drive: Drive
    key: str
    verdict: Verdict
    reason: str
    roll_deg: float | None = None
    pitch_deg: float | None = None
    yaw_deg: float | None = None
    x_m: float | None = None
    y_m: float | None = None
    z_m: float | None = None
    covariance: tuple[float, ...] | None = None
    camera_from_lidar: tuple[float, ...] | None = None
    odds_ratio: float | None = None
    cells: int = 0
    frame_count: int = 0
    frames: tuple[str, ...] = ()
    log: str = ""
    extrinsic_digest: str = ""
    seconds: float = 0.0
    version: str = ""

    def row(self) -> dict[str, Any]:
        """Return the values by column, ready for JSON."""
        values = {**vars(self.drive), **vars(self)}
        return {name: values[name] for name in COLUMNS}


COLUMNS = {name: kind for name, kind in (get_type_hints(Drive) | get_type_hints(Evidence)).items() if name != "drive"}
"""Columns of the store and their types; `vehicle` and the month are also the names of the folders."""


def estimate_columns(error: Float, covariance: Float) -> dict[str, Any]:
    """Return the columns of the error (6,) of an extrinsic, in deg and m, and its covariance (6, 6)."""
    return {**dict(zip(ERROR_COLUMNS, error.tolist(), strict=True)), "covariance": tuple(covariance[UPPER].tolist())}


def symmetric(upper: Float) -> Float:
    """Return covariances (N, 6, 6) of their upper triangles (N, 21)."""
    out = np.empty((len(upper), len(AXES), len(AXES)))
    out[:, UPPER[0], UPPER[1]] = out[:, UPPER[1], UPPER[0]] = upper
    return out


@cache
def arrow_schema() -> Any:
    """Return the Arrow schema of the store."""
    import pyarrow as pa

    kinds: dict[Any, Any] = {str: pa.string(), Verdict: pa.string(), float: pa.float64(), int: pa.int64()}
    kinds |= {float | None: pa.float64(), tuple[float, ...] | None: pa.list_(pa.float64())}
    kinds |= {tuple[str, ...]: pa.list_(pa.string())}
    types = {name: kinds[kind] for name, kind in COLUMNS.items()}
    return pa.schema({**types, "time": pa.timestamp("us", "UTC")})


def table_of(rows: Iterable[Mapping[str, Any]]) -> Any:
    """Return the Arrow table of rows, whose `time` is in s since 1970; raises InputError for other types."""
    import pyarrow as pa

    try:
        timed = [{**row, "time": round(row["time"] * 1e6)} for row in rows]
        return pa.Table.from_pylist(timed, schema=arrow_schema())
    except (pa.ArrowException, LookupError, TypeError, ValueError, OverflowError) as problem:
        raise InputError("a value of the row is missing or has a wrong type", got=repr(problem)) from problem
