"""Reading .bin and .txt sweeps: rows of numbers that say nowhere what they are."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from p2o import InputError

from p2o_plugins.data.number_text import read_table

# No LiDAR for cars reaches 10 km: numbers beyond are bytes of something else.
FAR_M = 1e4
KITTI_COLUMNS = ("x", "y", "z", "intensity")
KNOWN = {4: KITTI_COLUMNS, 5: (*KITTI_COLUMNS, "ring"), 6: (*KITTI_COLUMNS, "ring", "time")}
"""Columns by their number: those of KITTI, of nuScenes, and of nuScenes with times."""
OPTION = "cloud_columns"
_MAX_RING = 255
# A wrong reading would break a rule so many times, by the share of numbers that break it; by chance, once in 3000.
_TELLING = 8
_MOST = 64


def read_bin(data: bytes, path: Path, columns: Sequence[str] | None = None) -> Mapping[str, Any]:
    """Return the columns, each (N,) float32, of a file of rows of float32.

    Without `columns` the values tell the rows: see `columns_of`. Raises InputError if the file does not hold whole
    rows, and as `columns_of`.
    """
    values = np.frombuffer(data[: len(data) - len(data) % 4], "<f4")
    columns = columns_of(values, path) if columns is None else columns
    row = 4 * len(columns)
    if len(data) % row:
        raise InputError(
            "the point cloud is truncated",
            where=path,
            expected=f"a multiple of {row} bytes ({' '.join(columns)} as float32)",
            got=f"{len(data)} bytes",
        )
    return _named(values, columns)


def read_txt(data: bytes, path: Path, columns: Sequence[str] | None = None) -> Mapping[str, Any]:
    """Return the columns, each (N,), of text with a point a line; raises InputError if it holds anything else.

    Without `columns` there are as many as numbers in the first line.
    """
    if columns is None:
        first = len(next((words for line in data[:65536].splitlines() if (words := line.split())), []))
        columns = KNOWN.get(first, KITTI_COLUMNS)
    return _named(read_table(data, len(columns), path), columns)


def columns_of(values: Any, path: Path) -> Sequence[str]:
    """Return the columns of a stream of numbers (K,): four, five or six, see `KNOWN`.

    Read by another length, every column is a mixture of all: intensities come out negative, rings not whole. So one
    reading keeps the rules where others must break them many times; where too few numbers could break a rule, the
    size of the file has to tell.

    Raises InputError if no reading keeps the rules, if the last row of the one that does is not whole, and if several
    do; the text names the option to set.
    """
    with np.errstate(invalid="ignore"):
        told = [count for count in (5, 6, 4) if _holds(values, count) and _telling(values, count) >= _TELLING]
        if told:
            # Whole rings are the stronger sign: what looks to one side only may have no negative numbers.
            return KNOWN[told[0]]
        held = [count for count in (3, *KNOWN) if values.size % count == 0 and _holds(values, count)]
        if held not in ([4], [5], [6]):
            near = any(_near(values, count) for count in KNOWN)
            raise _untold(values, held, path, near=near)
    return KNOWN[held[0]]


def check_columns(columns: Sequence[str], known: Sequence[str], path: Path) -> None:
    """Raise InputError unless the names of columns hold x y z, else `known` ones or _, and none twice."""
    wanted = [name for name in columns if name != "_"]
    if not set("xyz") <= set(wanted) <= {*"xyz", *known} or len(set(wanted)) != len(wanted) or len(columns) > _MOST:
        raise InputError(
            f"wrong {OPTION}",
            where=path,
            expected=f"x y z once each, and any of {' '.join(known)}, or _ for others",
            got=" ".join(columns[:_MOST]),
        )


def _named(values: Any, columns: Sequence[str]) -> Mapping[str, Any]:
    table = values.reshape(-1, len(columns)).T
    return {name: column for name, column in zip(columns, table, strict=True) if name != "_"}


def _near(values: Any, count: int) -> bool:
    """Tell whether coordinates of this reading are metres, but for one point in a hundred."""
    rows = values[: values.size // count * count].reshape(-1, count)
    far = sum(np.count_nonzero(np.isfinite(rows[:, i]) & (np.abs(rows[:, i]) > FAR_M)) for i in range(3))
    return bool(far <= 0.01 * len(rows))


def _holds(values: Any, count: int) -> bool:
    """Tell whether rows of this many numbers keep the rules of their columns."""
    rows = values[: values.size // count * count].reshape(-1, count)
    if not len(rows) or not _near(values, count) or (count > 3 and (rows[:, 3] < 0).any()):
        return False
    if count < 5:
        return True
    ring = rows[np.isfinite(rows[:, :3]).all(axis=1), 4]
    whole = bool(len(ring) and ((ring >= 0) & (ring <= _MAX_RING) & (ring == np.floor(ring))).all())
    return whole and (count < 6 or bool(np.isfinite(rows[:, 5]).all()))


def _telling(values: Any, count: int) -> float:
    """Return how many numbers would break the rules of this reading, were its columns mixtures of all."""
    ring = values[4::count][: values.size // count] if count > 4 else values
    if ring.size == 0 or ring.min() == ring.max():
        return 0.0  # nothing but zeros is whole, too
    negative = np.count_nonzero(values < 0)
    broken = np.count_nonzero(np.isfinite(values) & (values != np.floor(values))) if count > 4 else 0
    return float((negative + broken) / count)


def _untold(values: Any, held: Sequence[int], path: Path, *, near: bool) -> InputError:
    hint = f"say what a row holds: '{OPTION}: [x, y, z, intensity, ring]'; _ for what is none of the known"
    if held and held != [3]:
        return InputError(
            "the rows of the point cloud can be read in several ways",
            where=path,
            expected="numbers that fit one number of columns alone",
            got=f"rows of {' or '.join(map(str, held))} fit",
            hint=hint,
        )
    if not near:
        return InputError(
            "this is not a point cloud in metres",
            where=path,
            expected=f"rows of float32, coordinates below {FAR_M:g} m",
            got="numbers beyond",
        )
    if values.size % 4 and values.size % 5 and values.size % 6:
        return InputError(
            "the point cloud is truncated",
            where=path,
            expected="rows of 16, 20 or 24 bytes (x y z intensity, ring, time as float32)",
            got=f"{4 * values.size} bytes",
        )
    return InputError(
        "the rows of the point cloud are none that are known",
        where=path,
        expected="float32 x y z intensity, intensity >= 0, then ring (whole numbers 0 to 255), then time",
        hint=hint,
    )
