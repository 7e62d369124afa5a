"""Messages of Protocol Buffers, taken apart field by field without their definitions.

The wire format (protobuf.dev/programming-guides/encoding): a key of field number and kind, then a varint, 8 bytes,
4 bytes, or a length and so many bytes. Groups, which nobody writes any more, are refused.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from typing import Any

import numpy as np

_VARINT, _EIGHT, _BYTES, _FOUR = 0, 1, 2, 5
_LONGEST_VARINT = 10
_MOST_FIELDS = 100_000
_MOST_WHOLES = 1000


def fields(data: memoryview) -> Iterator[tuple[int, int | memoryview]]:
    """Yield number and value of each field: whole numbers for varints, bytes for all else.

    Raises ValueError for bytes that are no message, and for more fields than any message here has.
    """
    place = count = 0
    while place < len(data):
        key, place = _varint(data, place)
        kind, count = key & 7, count + 1
        if key < 8 or count > _MOST_FIELDS:
            raise ValueError("a field without a number" if key < 8 else f"more than {_MOST_FIELDS} fields")
        if kind == _VARINT:
            value, place = _varint(data, place)
            yield key >> 3, value
            continue
        if kind == _BYTES:
            length, place = _varint(data, place)
        elif kind in (_EIGHT, _FOUR):
            length = 8 if kind == _EIGHT else 4
        else:
            raise ValueError(f"a field of the kind {kind}")
        if length > len(data) - place:
            raise ValueError(f"a field of {length} bytes where {len(data) - place} are left")
        yield key >> 3, data[place : place + length]
        place += length


class Message:
    """The fields of a message by their numbers; a repeated one has several values, and the last of others counts."""

    def __init__(self, data: memoryview) -> None:
        self._values: dict[int, list[int | memoryview]] = {}
        for number, value in fields(data):
            self._values.setdefault(number, []).append(value)

    def whole(self, number: int) -> int:
        """Return a whole number; 0 where it is left out. Raises ValueError for another kind."""
        value = self._values.get(number, [0])[-1]
        if not isinstance(value, int):
            raise ValueError(f"field {number} is no whole number")
        return value

    def content(self, number: int) -> memoryview | None:
        """Return the bytes of a field, None where it is left out; raises ValueError for another kind."""
        value = self._values.get(number, [None])[-1]
        if isinstance(value, int):
            raise ValueError(f"field {number} has no bytes")
        return value

    def inner(self, number: int) -> Message:
        """Return a message in this one; one without fields where it is left out."""
        return Message(self.content(number) or memoryview(b""))

    def all_inner(self, number: int) -> list[Message]:
        """Return all messages of a repeated field."""
        values = self._values.get(number, [])
        return [Message(value) for value in values if isinstance(value, memoryview)]

    def real(self, number: int) -> float | None:
        """Return a floating point number of 8 or 4 bytes, None where it is left out."""
        value = self.content(number)
        if value is None:
            return None
        if len(value) not in (4, 8):
            raise ValueError(f"field {number} is no floating point number")
        found: float = struct.unpack("<d" if len(value) == 8 else "<f", value)[0]
        return found

    def reals(self, number: int, kind: str) -> Any:
        """Return floating point numbers (N,) of a type, packed or one by one."""
        joined = b"".join(value for value in self._values.get(number, []) if isinstance(value, memoryview))
        return np.frombuffer(joined, kind)

    def wholes(self, number: int) -> list[int]:
        """Return whole numbers, packed or one by one; raises ValueError for more than any field here has."""
        found: list[int] = []
        for value in self._values.get(number, []):
            if isinstance(value, int):
                found.append(value)
                continue
            if len(value) > _MOST_WHOLES:
                raise ValueError(f"more than {_MOST_WHOLES} bytes of whole numbers")
            place = 0
            while place < len(value):
                one, place = _varint(value, place)
                found.append(one)
        return found


def _varint(data: memoryview, place: int) -> tuple[int, int]:
    """Return a whole number of 7 bits a byte, and where it ends."""
    value = 0
    for count in range(_LONGEST_VARINT):
        if place >= len(data):
            raise ValueError("a number that is cut off")
        byte = data[place]
        place += 1
        value |= (byte & 0x7F) << 7 * count
        if byte < 0x80:
            return value, place
    raise ValueError("a number that does not end")
