"""Read the tables of nuScenes v1.0: JSON lists of records that refer to each other by tokens, up to gigabytes long."""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TextIO, TypeVar

from p2o import Float, InputError
from p2o.reading import read_pose, read_start

# In the full data set, ego_pose.json and sample_data.json have about 1 GB each.
_MAX_BYTES = 4 << 30
_PART = 1 << 20
"""Number of characters in memory, and of the longest record."""
_BLANKS = re.compile(r"[ \t\r\n]*")


def records(folder: Path, table: str) -> Iterator[Mapping[str, Any]]:
    """Yield the records of a table one by one; only a part of the file is in memory.

    Raises InputError if the file is missing or is not a list of records.
    """
    path = folder / f"{table}.json"
    read_start(path, "table", 1)
    size = path.stat().st_size
    if size > _MAX_BYTES:
        expected, got = f"at most {_MAX_BYTES} bytes", f"{size} bytes"
        raise InputError("the table is too large", where=path, expected=expected, got=got)
    with path.open(encoding="utf-8", newline="") as file:
        text = _Text(file, path)
        text.skip("[")
        while text.next_sign() != "]":
            record = text.value()
            if not isinstance(record, dict):
                raise InputError("an entry of the table is not a record", where=path, got=str(record)[:80])
            yield record
            if text.next_sign() != "]":
                text.skip(",")


@dataclass
class _Text:
    """The text of a table, of which `part` is in memory; `place` is the next character, after `before` others."""

    file: TextIO
    path: Path
    part: str = ""
    place: int = 0
    before: int = 0

    def next_sign(self) -> str:
        """Return the next character that is not blank, without passing it; "" at the end."""
        while True:
            self.place = _BLANKS.match(self.part, self.place).end()  # type: ignore[union-attr]  # matches always
            if self.place < len(self.part) or not self._read_more():
                return self.part[self.place : self.place + 1]

    def skip(self, sign: str) -> None:
        """Pass a character; raises InputError if another one is next."""
        if self.next_sign() != sign:
            expected = f"'{sign}' at character {self.before + self.place}"
            got = self.part[self.place : self.place + 20] or "its end"
            fault = "the table is not a list of records, or is truncated"
            raise InputError(fault, where=self.path, expected=expected, got=got)
        self.place += 1

    def value(self) -> Any:
        """Return the next value of JSON; raises InputError if it is damaged or has more than `_PART` characters."""
        while True:
            try:
                value, self.place = _DECODER.raw_decode(self.part, self.place)
                return value
            except (ValueError, RecursionError) as problem:
                # It may be incomplete.
                if len(self.part) - self.place > _PART or not self._read_more():
                    message = getattr(problem, "msg", str(problem))
                    got = f"{message} in the record at character {self.before + self.place}"
                    raise InputError("the table is not JSON", where=self.path, got=got) from problem

    def _read_more(self) -> bool:
        try:
            more = self.file.read(_PART)
        except UnicodeDecodeError as problem:
            raise InputError("the table is not text", where=self.path, expected="UTF-8 text") from problem
        self.before += self.place
        self.part, self.place = self.part[self.place :] + more, 0
        return bool(more)


_DECODER = json.JSONDecoder()
_Entry = TypeVar("_Entry")


def by_token(folder: Path, table: str, kept: Callable[[str], bool] = lambda _: True) -> dict[str, Mapping[str, Any]]:
    """Return the records of a table for whose tokens `kept` is true, by token; raises InputError as `records`."""
    path = folder / f"{table}.json"
    tokens = ((text_of(record, "token", path), record) for record in records(folder, table))
    return {token: record for token, record in tokens if kept(token)}


def text_of(record: Mapping[str, Any], key: str, path: Path) -> str:
    """Return a text of a record; raises InputError if it is missing or of another type."""
    value = record.get(key)
    if not isinstance(value, str) or not value:
        raise wrong(record, key, "a text", path)
    return value


def number_of(record: Mapping[str, Any], key: str, path: Path) -> int:
    """Return a non-negative integer of a record; raises InputError if it is missing or of another type."""
    value = record.get(key)
    if not isinstance(value, int) or isinstance(value, bool) or not 0 <= value < 1 << 62:
        raise wrong(record, key, "an integer", path)
    return value


def named(table: Mapping[str, _Entry], token: str, path: Path) -> _Entry:
    """Return the entry of a token; raises InputError, with the `path` of a table, if it is missing."""
    if token not in table:
        raise InputError("a table refers to a missing record", where=path, expected=f"token {token[:80]}")
    return table[token]


def pose_of(record: Mapping[str, Any], path: Path) -> Float:
    """Return the pose (4, 4) of a record with `translation` and `rotation`, a quaternion w x y z.

    Raises InputError for an invalid pose.
    """
    rotation = record.get("rotation")
    if not isinstance(rotation, list) or len(rotation) != 4:
        raise wrong(record, "rotation", "a quaternion w x y z", path)
    value = {"rotation_xyzw": [*rotation[1:], rotation[0]], "translation_m": record.get("translation")}
    return read_pose(f"the pose of {str(record.get('token'))[:80]}", value, path)[0]


def matrix_of(record: Mapping[str, Any], key: str, path: Path) -> Any:
    """Return the rows of a 3x3 matrix; raises InputError if it is missing, as for sensors other than cameras."""
    value = record.get(key)
    if not isinstance(value, list) or len(value) != 3:
        raise wrong(record, key, "3 rows of 3 numbers", path)
    return value


def wrong(record: Mapping[str, Any], key: str, expected: str, path: Path) -> InputError:
    """Return the error for a value of a record."""
    got = f"{str(record.get(key))[:80]} (token {str(record.get('token'))[:80]})"
    return InputError(f"a record has a wrong '{key}'", where=path, expected=expected, got=got)
