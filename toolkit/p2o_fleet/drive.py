"""The drives to check: rows of a table (CSV or Parquet), or the files of a folder convention."""

from __future__ import annotations

import csv
import hashlib
import json
import math
import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any
from urllib.parse import quote

from p2o.errors import InputError, printable
from p2o.files.input_file import existing_folder, expanded, listing, read_bytes, read_start, read_text
from p2o.files.parsed_text import parse_yaml

from p2o_fleet.parquet_file import MAX_TEXT, check_texts, open_parquet

REQUIRED = ("vehicle", "camera", "lidar", "data", "extrinsic", "time")
OPTIONAL = ("vehicle_type", "service", "temperature_c", "frames")
TEMPERATURES = (-100.0, 200.0)
"""Lowest and highest temperature in degrees Celsius."""
_MAX_LINE, _MAX_FOLDER = 1 << 16, 240
_MAX_EXTRINSIC = 64 << 20
_BAGS = (".bag", ".mcap", ".db3")
_TIME_IN_NAME = re.compile(r"(\d{4}-\d{2}-\d{2})T(\d{2})[-:](\d{2})[-:](\d{2})")
_DEFAULTS = {"camera": "camera", "lidar": "lidar", "extrinsic": "extrinsic.yaml"}
"""Contents of `vehicle.yaml` that may be left out."""


@dataclass(frozen=True)
class Recording:
    """What was recorded: a vehicle, a pair of sensors, the data with the extrinsic in use, and when.

    `data` is DATASET:PATH as in `p2o run`, or a URL of a bag or folder; `extrinsic` a calibration file, `truth` or
    `start`. `time` is in s since 1970 (UTC). `service` names the last service of the vehicle: with a new name, its
    history starts again. `temperature_c` may be unknown (None).
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


@dataclass(frozen=True)
class Drive(Recording):
    """One log to check; `frames` selects frames as in `p2o run`."""

    frames: str = "all"

    @property
    def day(self) -> str:
        """Return the day (UTC) of the drive, such as 2026-11-24."""
        return day_of(self.time)

    def key(self, settings: str = "") -> str:
        """Return the key of the check of this drive: drives with equal keys are checked once.

        It contains the content of the extrinsic file where this machine can read it, and `settings` of the check.
        """
        identity = asdict(self)
        del identity["temperature_c"], identity["vehicle_type"]
        identity["extrinsic"] = _file_digest(self.extrinsic) or self.extrinsic
        return hashlib.sha256(json.dumps([identity, settings], sort_keys=True).encode()).hexdigest()[:32]


def day_of(time: float) -> str:
    """Return the day (UTC) of a time in s since 1970."""
    return datetime.fromtimestamp(time, UTC).strftime("%Y-%m-%d")


def _file_digest(path: str) -> str:
    """Return the SHA-256 of a file, empty if it cannot be read."""
    try:
        return hashlib.sha256(read_bytes(expanded(path), "extrinsic", _MAX_EXTRINSIC)).hexdigest()
    except InputError:
        return ""


def drives_of(source: str) -> Iterator[Drive]:
    """Yield the drives of a table (.csv, .parquet) or of a folder, one by one.

    Raises InputError for a table that is missing, lacks a column or has an invalid cell, with its row.
    """
    path = expanded(source)
    readers = {".csv": _csv_rows, ".parquet": _parquet_rows}
    suffix = path.suffix.lower()
    if suffix not in readers and not path.is_dir():
        expected = "a table .csv or .parquet, or a folder of vehicles"
        raise InputError("this is no table of drives", where=source, expected=expected, got=suffix or "no suffix")
    for row, where in _folder_rows(path) if path.is_dir() else readers[suffix](path):
        yield _drive(row, where)


_Rows = Iterator[tuple[Mapping[str, Any], str]]
"""Rows of a table, each with the text that names it in errors."""


def _csv_rows(path: Path) -> _Rows:
    read_start(path, "table of drives", 1)
    with path.open(encoding="utf-8-sig", newline="") as stream:
        try:
            rows = csv.DictReader(iter(lambda: stream.readline(_MAX_LINE), ""), strict=True)
            _check_columns(rows.fieldnames or (), path)
            for number, row in enumerate(rows, start=2):
                yield row, f"{path}, line {number}"
        except (csv.Error, UnicodeDecodeError) as problem:
            raise InputError("the table cannot be read", where=path, expected="CSV in UTF-8", got=problem) from problem


def _parquet_rows(path: Path) -> _Rows:
    number = 0
    with open_parquet(path, "table of drives") as file:
        names = file.schema_arrow.names
        _check_columns(names, path)
        for batch in file.iter_batches(4096, columns=[name for name in (*REQUIRED, *OPTIONAL) if name in names]):
            check_texts(batch)
            for row in batch.to_pylist():
                yield row, f"{path}, row {number}"
                number += 1


def _check_columns(names: Iterable[str], path: Path) -> None:
    missing = [name for name in REQUIRED if name not in names]
    if missing:
        expected = f"{', '.join(REQUIRED)}; optional: {', '.join(OPTIONAL)}"
        got = ", ".join(map(str, names)) or "no columns"
        raise InputError(f"the table has no column {missing[0]}", where=path, expected=expected, got=got)


def _drive(row: Mapping[str, Any], where: str) -> Drive:
    """Return the drive of a row; raises InputError that names row and column."""
    texts = {name: _text(row, name, where) for name in (*REQUIRED, *OPTIONAL) if name not in ("time", "temperature_c")}
    temperature = row.get("temperature_c")
    known = temperature is not None and str(temperature).strip() not in ("", "nan")
    return Drive(
        **{**texts, "frames": texts["frames"] or "all"},
        time=parse_time(row.get("time"), where),
        temperature_c=_temperature(temperature, where) if known else None,
    )


def _text(row: Mapping[str, Any], name: str, where: str) -> str:
    text = str(row.get(name) if row.get(name) is not None else "").strip()
    longest = _MAX_FOLDER if name == "vehicle" else MAX_TEXT
    size = len(quote(text, safe="")) if name == "vehicle" else len(text)
    if (not text and name in REQUIRED) or size > longest or printable(text) != text:
        expected = f"a text of 1 to {longest} printable characters"
        raise InputError(f"{name} is not valid", where=where, expected=expected, got=text[:80] or "nothing")
    return text


def _temperature(value: Any, where: str) -> float:
    try:
        number = float(value)
    except (TypeError, ValueError):
        number = math.nan
    if not TEMPERATURES[0] <= number <= TEMPERATURES[1]:
        expected = "a number from {:g} to {:g}".format(*TEMPERATURES)
        raise InputError("temperature_c is not valid", where=where, expected=expected, got=value)
    return number


def parse_time(value: Any, where: str) -> float:
    """Return a time in s since 1970: of a datetime, a text of ISO 8601 (UTC without a zone), or seconds.

    Raises InputError for other values.
    """
    moment = value.strip() if isinstance(value, str) else value
    try:
        if isinstance(moment, str):
            moment = float(moment) if re.fullmatch(r"\d+(\.\d+)?", moment) else datetime.fromisoformat(moment)
        if isinstance(moment, datetime):
            moment = (moment if moment.tzinfo else moment.replace(tzinfo=UTC)).timestamp()
        seconds = float(moment)
        day_of(seconds)
        if seconds < 0:
            raise ValueError("a time before 1970")
    except (TypeError, ValueError, OverflowError, OSError) as problem:
        expected = "ISO 8601, such as 2026-11-24T10:30:00Z, or seconds since 1970"
        raise InputError("time is not valid", where=where, expected=expected, got=value) from problem
    return seconds


def _folder_rows(root: Path) -> _Rows:
    """Yield the drives of ROOT/VEHICLE/TIME (folders of frames) and ROOT/VEHICLE/TIME.bag, .mcap or .db3.

    TIME begins as 2026-11-24T10-30-00 (UTC). ROOT/VEHICLE/vehicle.yaml may give vehicle_type, camera, lidar, extrinsic
    (a file beside it) and service.
    """
    vehicles = [folder for folder in listing(existing_folder(root, "folder of vehicles"), "folder") if folder.is_dir()]
    if not vehicles:
        raise InputError("the folder contains no vehicles", where=root, expected="ROOT/VEHICLE/2026-11-24T10-30-00/")
    for folder in vehicles:
        file = folder / "vehicle.yaml"
        words = parse_yaml(read_text(file, "vehicle file"), "vehicle file", file) if file.exists() else {}
        known = {*_DEFAULTS, "vehicle_type", "service"}
        if not isinstance(words, dict) or not words.keys() <= known:
            raise InputError("the vehicle file is not valid", where=file, expected=", ".join(sorted(known)))
        words = {**_DEFAULTS, **words}
        words["extrinsic"] = str(folder / str(words["extrinsic"]))
        for path in listing(folder, "folder of a vehicle"):
            match = _TIME_IN_NAME.match(path.name)
            if match is None or not (path.is_dir() or path.suffix.lower() in _BAGS):
                continue
            time = f"{match[1]}T{match[2]}:{match[3]}:{match[4]}"
            reader = "ros" if path.suffix.lower() in _BAGS or (path / "metadata.yaml").exists() else "folder"
            yield {**words, "vehicle": folder.name, "data": f"{reader}:{path}", "time": time}, str(path)
