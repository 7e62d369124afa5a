"""Read .bin, .npy and .txt sweeps: rows of numbers without a description of their columns."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from p2o import InputError
from p2o.reading import read_npy

from p2o_datasets.number_text import read_table

# Larger than the range of any automotive LiDAR: larger numbers are not coordinates.
FAR_M = 1e4
KITTI_COLUMNS = ("x", "y", "z", "intensity")
KNOWN = {4: KITTI_COLUMNS, 5: (*KITTI_COLUMNS, "ring"), 6: (*KITTI_COLUMNS, "ring", "time")}
"""Columns by their number: those of KITTI, of nuScenes, and of nuScenes with times."""
OPTION = "cloud_columns"
_MAX_RING = 255
# Expected violations of a rule under a wrong number of columns; at random, all are avoided once in 3000.
_MIN_VIOLATIONS = 8
_SAMPLE, _FEWEST_ROWS, _UNEQUAL = 20_000, 256, 30.0
"""Number of examined rows, minimum number, and ratio of the spreads of every k-th row that hold other quantities."""
_COLUMNS = {3: KITTI_COLUMNS[:3], **KNOWN}
"""Columns of files that state their number."""


def read_bin(data: bytes, path: Path, columns: Sequence[str] | None = None) -> Mapping[str, Any]:
    """Return the columns, each (N,) float32, of a file with rows of float32.

    Without `columns`, they are inferred from the values by `columns_of`. Raises InputError for an incomplete row, and
    as `columns_of`.
    """
    values = np.frombuffer(data[: len(data) - len(data) % 4], "<f4")
    if columns is None:
        columns = columns_of(values, path)
    elif not _is_uniform(values, len(columns)):
        fault, expected = f"the rows do not have {len(columns)} numbers", "the same quantities in all rows"
        raise InputError(fault, where=path, expected=expected, got=f"{OPTION}: {' '.join(columns)[:200]}")
    row = 4 * len(columns)
    bare = len(data) % 12 == 0 and _is_possible(values, 3) and not _is_possible(values, len(columns))
    if len(data) % row or (bare and "intensity" in columns[3:4]):
        expected = f"a multiple of {row} bytes ({' '.join(columns)} as float32)"
        text = "the point cloud has other columns, or is truncated" if bare else "the point cloud is truncated"
        hint = "rows of three numbers (x y z) fit" if bare else None
        raise InputError(text, where=path, expected=expected, got=f"{len(data)} bytes", hint=hint)
    return _named(values, columns)


def read_txt(data: bytes, path: Path, columns: Sequence[str] | None = None) -> Mapping[str, Any]:
    """Return the columns, each (N,), of text with one point per line; raises InputError for other text.

    Without `columns`, the first line determines their number.
    """
    if columns is None:
        first = len(next((words for line in data[:65536].splitlines() if (words := line.split())), []))
        columns = _COLUMNS.get(first, KITTI_COLUMNS)
    return _named(read_table(data, len(columns), path), columns)


def read_rows(data: bytes, path: Path, columns: Sequence[str] | None = None) -> Mapping[str, Any]:
    """Return the columns, each (N,), of an .npy array (N, 3) to (N, 6), or of the width of `columns`.

    Without `columns`, their number determines them, see `KNOWN`; a structured array (N,) names them itself. Raises
    InputError for any other array.
    """
    table = read_npy(data, path)
    if table.dtype.names and columns is None:
        return {name: table[name].reshape(-1) for name in table.dtype.names if table.dtype[name].shape == ()}
    width = table.shape[1] if table.ndim == 2 else 0
    names = columns or _COLUMNS.get(width, ())
    if table.dtype.kind not in "iuf" or not width or len(names) != width:
        expected = f"numbers of shape (N, {len(columns)})" if columns else "numbers of shape (N, 3) to (N, 6)"
        got, hint = f"{table.dtype} {table.shape}", f"other columns: '{OPTION}: [x, y, z, _, ring]'"
        raise InputError("the .npy file is no sweep", where=path, expected=expected, got=got, hint=hint)
    return {name: column for name, column in zip(names, table.T, strict=True) if name != "_"}


def columns_of(values: Any, path: Path) -> Sequence[str]:
    """Infer the columns of a stream of numbers (K,): four, five or six, see `KNOWN`.

    With a wrong number of columns, each column mixes all quantities: intensities become negative, ring numbers
    fractional. A hypothesis is accepted if it violates no rule where wrong ones are expected to violate several. If
    too few numbers can violate a rule, the file size has to determine the columns.

    Raises InputError if no hypothesis, or more than one, is possible, and for an incomplete last row; the message
    names the option to set.
    """
    with np.errstate(invalid="ignore"):
        possible = [count for count in (5, 6, 4) if _is_possible(values, count)]
        proven = [count for count in possible if _expected_violations(values, count) >= _MIN_VIOLATIONS]
        if proven:
            # Integer rings are the stronger evidence: a LiDAR with a limited field of view may have no negative values.
            return KNOWN[proven[0]]
        possible = [count for count in (3, *KNOWN) if values.size % count == 0 and _is_possible(values, count)]
        if possible not in ([4], [5], [6]):
            raise _ambiguous(values, possible, path, near=any(_near(values, count) for count in KNOWN))
    return KNOWN[possible[0]]


def check_columns(columns: Sequence[str], known: Sequence[str], path: Path) -> None:
    """Raise InputError unless the columns contain x y z, otherwise `known` names or _, and no name twice."""
    wanted = [name for name in columns if name != "_"]
    if not set("xyz") <= set(wanted) <= {*"xyz", *known} or len(set(wanted)) != len(wanted) or len(columns) > 64:
        expected = "x y z once each, and any of intensity, ring, time and their other names, or _ for others"
        raise InputError(f"wrong {OPTION}", where=path, expected=expected, got=" ".join(columns[:64]))


def _named(values: Any, columns: Sequence[str]) -> Mapping[str, Any]:
    table = values.reshape(-1, len(columns)).T
    return {name: column for name, column in zip(columns, table, strict=True) if name != "_"}


def _near(values: Any, count: int) -> bool:
    """Return whether at least 99 % of the coordinates are plausible in metres."""
    rows = values[: values.size // count * count].reshape(-1, count)
    far = sum(np.count_nonzero(np.isfinite(rows[:, i]) & (np.abs(rows[:, i]) > FAR_M)) for i in range(3))
    return bool(far <= 0.01 * len(rows))


def _is_possible(values: Any, count: int) -> bool:
    """Return whether rows with this number of columns violate no rule."""
    rows = values[: values.size // count * count].reshape(-1, count)
    if not len(rows) or not _near(values, count) or (count > 3 and (rows[:, 3] < 0).any()):
        return False
    if not _is_uniform(values, count):
        return False
    if count < 5:
        return True
    ring = rows[np.isfinite(rows[:, :3]).all(axis=1), 4]
    whole = bool(len(ring) and ((ring >= 0) & (ring <= _MAX_RING) & (ring == np.floor(ring))).all())
    return whole and (count < 6 or bool(np.isfinite(rows[:, 5]).all()))


@np.errstate(invalid="ignore")
def _is_uniform(values: Any, count: int) -> bool:
    """Return whether x and y have similar spreads in every k-th row; rows of another length mix quantities."""
    rows = values[: min(values.size // count, _SAMPLE) * count].reshape(-1, count)[:, :2].astype(np.float64)
    # Rays without a return are rows of zeros or NaN, for instance in every second row of two returns.
    rows = rows[rows.any(axis=1) & np.isfinite(rows).all(axis=1) & (np.abs(rows) < FAR_M).all(axis=1)]
    for period in range(2, 13) if len(rows) >= _FEWEST_ROWS else ():
        spread = np.array([rows[start::period].std(axis=0) for start in range(period)])
        if (spread.max(axis=0) > _UNEQUAL * spread.min(axis=0)).any() and (spread.max(axis=0) > 0).all():
            return False
    return True


def _expected_violations(values: Any, count: int) -> float:
    """Return the expected number of rule violations if the columns were mixtures of all quantities."""
    ring = values[4::count][: values.size // count] if count > 4 else values
    if ring.size == 0 or ring.min() == ring.max():
        return 0.0  # constant values are integers in any arrangement
    negative = np.count_nonzero(values < 0)
    broken = np.count_nonzero(np.isfinite(values) & (values != np.floor(values))) if count > 4 else 0
    return float((negative + broken) / count)


def _ambiguous(values: Any, possible: Sequence[int], path: Path, *, near: bool) -> InputError:
    hint = f"give the columns: '{OPTION}: [x, y, z, intensity, ring]'; _ for others"
    if possible and possible != [3]:
        fault = "the columns of the point cloud are ambiguous"
        got = f"rows of {' or '.join(map(str, possible))} fit"
        return InputError(fault, where=path, expected="numbers that fit a single number of columns", got=got, hint=hint)
    if not near:
        expected = f"rows of float32, coordinates below {FAR_M:g} m"
        return InputError("this is not a point cloud in metres", where=path, expected=expected, got="larger numbers")
    if possible:
        expected, hint = "float32 x y z intensity", f"if the file has no intensity, give '{OPTION}: [x, y, z]'"
        got = "rows of three numbers, such as x y z"
        return InputError("the point cloud has no intensity", where=path, expected=expected, got=got, hint=hint)
    if values.size % 4 and values.size % 5 and values.size % 6:
        expected = "rows of 16, 20 or 24 bytes (x y z intensity, ring, time as float32)"
        return InputError("the point cloud is truncated", where=path, expected=expected, got=f"{4 * values.size} bytes")
    expected = "float32 x y z intensity, intensity >= 0, then ring (integers 0 to 255), then time"
    return InputError("the columns of the point cloud are unknown", where=path, expected=expected, hint=hint)
