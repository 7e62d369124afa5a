"""KITTI's files of time stamps: a line a picture or sweep, blank where it was lost."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from p2o import InputError
from p2o.files.input_file import read_text

_STAMP = re.compile(r"(19[7-9]|20\d|21\d)\d-\d\d-\d\d[ T]\d\d:\d\d:\d\d(\.\d{1,9})?", re.ASCII)


def seconds_of(span: np.timedelta64) -> float:
    """Return a time span in seconds."""
    return float(span / np.timedelta64(1, "s"))


def read_stamp(path: Path, line: int) -> np.datetime64 | None:
    """Return one time stamp, or None where the file or its line is absent or blank; raises as `read_stamps`."""
    found = read_stamps(path)
    return found[line] if line < len(found) and not np.isnat(found[line]) else None


def read_stamps(path: Path) -> NDArray[np.datetime64]:
    """Return the time stamps of a file (N,), NaT for blank lines (sweeps the sensor lost); empty without the file.

    Raises InputError for lines that are no time.
    """
    if not path.exists():
        return np.array([], dtype="datetime64[ns]")
    lines = [line.strip() for line in read_text(path, "file of time stamps").splitlines()]
    try:
        # NumPy would take "now" and time zones too, and lets years that do not fit into 64 bit run over.
        wrong = next((i for i, line in enumerate(lines) if line and not _STAMP.fullmatch(line)), None)
        if wrong is None:
            return np.array([line or "NaT" for line in lines], dtype="datetime64[ns]")
        got = f"line {wrong + 1}: {lines[wrong][:40]}"
    except ValueError as problem:
        got = str(problem)
    raise InputError("a line is not a time", where=path, expected="YYYY-MM-DD HH:MM:SS.nnnnnnnnn", got=got)
