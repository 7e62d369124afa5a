"""Read the tables of nuScenes v1.0: JSON lists of records that refer to each other by tokens, up to gigabytes long."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

from p2o import Float, InputError
from p2o.reading import read_bytes, read_pose

# In the full data set, ego_pose.json and sample_data.json have about 1 GB each.
_MAX_BYTES = 4 << 30
_BLANK = " \t\r\n"


def records(folder: Path, table: str) -> Iterator[Mapping[str, Any]]:
    """Yield the records of a table one by one, without storing them.

    Raises InputError if the file is missing or is not a list of records.
    """
    path = folder / f"{table}.json"
    try:
        text = read_bytes(path, "table", _MAX_BYTES).decode("utf-8")
    except UnicodeDecodeError as problem:
        raise InputError("the table is not text", where=path, expected="UTF-8 text") from problem
    decode = json.JSONDecoder().raw_decode
    place = _after_blanks(text, 0)
    _expect(text, place, "[", path)
    place = _after_blanks(text, place + 1)
    while text[place : place + 1] != "]":
        try:
            record, place = decode(text, place)
        except (ValueError, RecursionError) as problem:
            raise InputError("the table is not JSON", where=path, got=str(problem)[:200]) from problem
        if not isinstance(record, dict):
            raise InputError("an entry of the table is not a record", where=path, got=str(record)[:80])
        yield record
        place = _after_blanks(text, place)
        if text[place : place + 1] == ",":
            place = _after_blanks(text, place + 1)
        else:
            _expect(text, place, "]", path)


def by_token(
    folder: Path, table: str, kept: Callable[[Mapping[str, Any]], bool] = lambda _: True
) -> dict[str, Mapping[str, Any]]:
    """Return the records of a table for which `kept` is true, by token; raises InputError as `records`."""
    path = folder / f"{table}.json"
    return {text_of(record, "token", path): record for record in records(folder, table) if kept(record)}


def text_of(record: Mapping[str, Any], key: str, path: Path) -> str:
    """Return a text of a record; raises InputError if it is missing or of another type."""
    value = record.get(key)
    if not isinstance(value, str) or not value:
        raise _wrong(record, key, "a text", path)
    return value


def number_of(record: Mapping[str, Any], key: str, path: Path) -> int:
    """Return a non-negative integer of a record; raises InputError if it is missing or of another type."""
    value = record.get(key)
    if not isinstance(value, int) or isinstance(value, bool) or not 0 <= value < 1 << 62:
        raise _wrong(record, key, "an integer", path)
    return value


def named(table: Mapping[str, Mapping[str, Any]], token: str, path: Path) -> Mapping[str, Any]:
    """Return the record with a token; raises InputError, with the `path` of the table, if it is missing."""
    if token not in table:
        raise InputError("a table refers to a missing record", where=path, expected=f"token {token[:80]}")
    return table[token]


def pose_of(record: Mapping[str, Any], path: Path) -> Float:
    """Return the pose (4, 4) of a record with `translation` and `rotation`, a quaternion w x y z.

    Raises InputError for an invalid pose.
    """
    rotation = record.get("rotation")
    if not isinstance(rotation, list) or len(rotation) != 4:
        raise _wrong(record, "rotation", "a quaternion w x y z", path)
    value = {"rotation_xyzw": [*rotation[1:], rotation[0]], "translation_m": record.get("translation")}
    return read_pose(f"the pose of {str(record.get('token'))[:80]}", value, path)[0]


def matrix_of(record: Mapping[str, Any], key: str, path: Path) -> Any:
    """Return the rows of a 3x3 matrix; raises InputError if it is missing, as for sensors other than cameras."""
    value = record.get(key)
    if not isinstance(value, list) or len(value) != 3:
        raise _wrong(record, key, "3 rows of 3 numbers", path)
    return value


def _wrong(record: Mapping[str, Any], key: str, expected: str, path: Path) -> InputError:
    got = f"{str(record.get(key))[:80]} (token {str(record.get('token'))[:80]})"
    return InputError(f"a record has a wrong '{key}'", where=path, expected=expected, got=got)


def _after_blanks(text: str, place: int) -> int:
    while text[place : place + 1] and text[place] in _BLANK:
        place += 1
    return place


def _expect(text: str, place: int, sign: str, path: Path) -> None:
    if text[place : place + 1] != sign:
        expected = f"'{sign}' at character {place}"
        got = text[place : place + 20] or "its end"
        raise InputError("the table is not a list of records, or is truncated", where=path, expected=expected, got=got)
