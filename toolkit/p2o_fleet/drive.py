"""The drives to check: rows of a CSV table."""

from __future__ import annotations

import csv
import hashlib
import json
import math
import re
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from urllib.parse import quote

from p2o.errors import InputError, printable
from p2o.files.input_file import expanded, read_bytes, read_start

REQUIRED = ("vehicle", "camera", "lidar", "data", "extrinsic", "time")
OPTIONAL = ("vehicle_type", "service", "temperature_c", "frames")
TEMPERATURES = (-100.0, 200.0)
"""Lowest and highest temperature in degrees Celsius."""
MAX_TEXT = 1000
"""Maximum number of characters of a text."""
_MAX_LINE, _MAX_FOLDER = 1 << 16, 240
_MAX_EXTRINSIC = 64 << 20


@dataclass(frozen=True)
class Drive:
    """One log to check: a vehicle, a pair of sensors, the data with the extrinsic in use, and when it was recorded.

    `data` is DATASET:PATH as in `p2o run`; `extrinsic` a calibration file, `truth` or `start`. `time` is in s since
    1970 (UTC). `service` names the last service of the vehicle: with a new name, its history starts again.
    `temperature_c` may be unknown (None). `frames` selects frames as in `p2o run`.
    """

    vehicle: str
    camera: str
    lidar: str
    data: str
    extrinsic: str
    time: float
    vehicle_type: str = ""
    service: str = ""
    temperature_c: float | None = None
    frames: str = "all"

    def key(self, settings: str = "") -> str:
        """Return the key of the check of this drive: drives with equal keys are checked once.

        It contains the content of the extrinsic file where this machine can read it, and `settings` of the check.
        """
        identity = asdict(self)
        del identity["temperature_c"], identity["vehicle_type"]
        identity["extrinsic"] = _file_digest(self.extrinsic) or self.extrinsic
        return hashlib.sha256(json.dumps([identity, settings], sort_keys=True).encode()).hexdigest()[:32]


def month_of(time: float) -> str:
    """Return the month (UTC) of a time in s since 1970, such as 2026-11."""
    return datetime.fromtimestamp(time, UTC).strftime("%Y-%m")


def _file_digest(path: str) -> str:
    """Return the SHA-256 of a file, empty if it cannot be read."""
    try:
        return hashlib.sha256(read_bytes(expanded(path), "extrinsic", _MAX_EXTRINSIC)).hexdigest()
    except InputError:
        return ""


def drives_of(source: str) -> Iterator[Drive]:
    """Yield the drives of a CSV table, one by one.

    Raises InputError for a table that is missing, lacks a column or has an invalid cell, with its line.
    """
    path = expanded(source)
    if path.suffix.lower() != ".csv":
        got = path.suffix or "no suffix"
        raise InputError("this is no table of drives", where=source, expected="a CSV file", got=got)
    read_start(path, "table of drives", 1)
    with path.open(encoding="utf-8-sig", newline="") as stream:
        try:
            rows = csv.DictReader(iter(lambda: stream.readline(_MAX_LINE), ""), strict=True)
            names = rows.fieldnames or ()
            if missing := [name for name in REQUIRED if name not in names]:
                expected = f"{', '.join(REQUIRED)}; optional: {', '.join(OPTIONAL)}"
                got = ", ".join(names) or "no columns"
                raise InputError(f"the table has no column {missing[0]}", where=path, expected=expected, got=got)
            for number, row in enumerate(rows, start=2):
                yield _drive(row, f"{path}, line {number}")
        except (csv.Error, UnicodeDecodeError) as problem:
            raise InputError("the table cannot be read", where=path, expected="CSV in UTF-8", got=problem) from problem


def _drive(row: Mapping[str, str | None], where: str) -> Drive:
    """Return the drive of a row; raises InputError that names row and column."""
    texts = {name: _text(row, name, where) for name in (*REQUIRED, *OPTIONAL)}
    time, temperature = parse_time(texts.pop("time"), where), texts.pop("temperature_c")
    known = temperature not in ("", "nan")
    texts["frames"] = texts["frames"] or "all"
    return Drive(**texts, time=time, temperature_c=_temperature(temperature, where) if known else None)


def _text(row: Mapping[str, str | None], name: str, where: str) -> str:
    text = (row.get(name) or "").strip()
    longest = _MAX_FOLDER if name == "vehicle" else MAX_TEXT
    size = len(quote(text, safe="")) if name == "vehicle" else len(text)
    if (not text and name in REQUIRED) or size > longest or printable(text) != text:
        expected = f"a text of 1 to {longest} printable characters"
        raise InputError(f"{name} is not valid", where=where, expected=expected, got=text[:80] or "nothing")
    return text


def _temperature(text: str, where: str) -> float:
    try:
        number = float(text)
    except ValueError:
        number = math.nan
    if not TEMPERATURES[0] <= number <= TEMPERATURES[1]:
        expected = "a number from {:g} to {:g}".format(*TEMPERATURES)
        raise InputError("temperature_c is not valid", where=where, expected=expected, got=text)
    return number


def parse_time(text: str, where: str) -> float:
    """Return a time in s since 1970, of a text of ISO 8601 (UTC without a zone) or seconds.

    Raises InputError for other texts.
    """
    try:
        if re.fullmatch(r"\d+(\.\d+)?", text):
            seconds = float(text)
        else:
            moment = datetime.fromisoformat(text)
            seconds = (moment if moment.tzinfo else moment.replace(tzinfo=UTC)).timestamp()
        month_of(seconds)
        if seconds < 0:
            raise ValueError("a time before 1970")
    except (ValueError, OverflowError, OSError) as problem:
        expected = "ISO 8601, such as 2026-11-24T10:30:00Z, or seconds since 1970"
        raise InputError("time is not valid", where=where, expected=expected, got=text) from problem
    return seconds
