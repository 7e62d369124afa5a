"""The bytes of one ROS message, read value by value: ROS 1 packs them, ROS 2 (CDR) aligns them.

Definitions of types that a bag brings are not used: a library would have to make code of them. What is not as long as
its own counts say is refused before anything is made of it.
"""

from __future__ import annotations

import struct
from typing import Any, Literal

import numpy as np

from p2o.errors import InputError

_CDR: dict[bytes, Literal["<", ">"]] = {b"\0\0": ">", b"\0\1": "<"}


class MessageBytes:
    """A place in the bytes of a message; each method reads what is there and goes on behind it.

    `ros1` tells ROS 1 from CDR, whose first four bytes say the byte order. `where` is named in errors.

    Raises InputError, as all methods do, where the bytes end before the value does.
    """

    def __init__(self, data: bytes | memoryview, *, ros1: bool, where: object = None) -> None:
        self.data, self.ros1, self.where = memoryview(data), ros1, where
        self.place = 0
        self.order: Literal["<", ">"] = "<"
        if not ros1:
            order = _CDR.get(bytes(self.data[:2]))
            if order is None or len(self.data) < 4:
                raise InputError(
                    "the message is not in plain CDR",
                    where=where,
                    expected="the bytes 00 00 or 00 01, and two more",
                    got=bytes(self.data[:4]).hex(" ") or "nothing",
                )
            self.order = order
            self.data = self.data[4:]

    def numbers(self, kinds: str) -> tuple[Any, ...]:
        """Return numbers of the kinds of `struct`, one letter each, all of one size."""
        self._align(struct.calcsize(kinds[0]))
        form = struct.Struct(self.order + kinds)
        self._need(form.size)
        values = form.unpack_from(self.data, self.place)
        self.place += form.size
        return values

    def number(self, kind: str) -> Any:
        """Return one number."""
        return self.numbers(kind)[0]

    def text(self) -> str:
        """Return a text; raises InputError also where it is not UTF-8."""
        raw = bytes(self._taken(self.number("I")))
        try:
            return raw.decode() if self.ros1 else raw.rstrip(b"\0").decode()
        except UnicodeDecodeError as problem:
            raise InputError("a text of the message is not UTF-8", where=self.where, got=raw[:40]) from problem

    def raw(self) -> memoryview:
        """Return a list of bytes."""
        return self._taken(self.number("I"))

    def array(self, kind: str, count: int | None = None) -> Any:
        """Return `count` numbers of a NumPy type such as "f8", or as many as the message says, as an array."""
        count = self.number("I") if count is None else count
        dtype = np.dtype(self.order + kind)
        if count:
            self._align(dtype.itemsize)
        return np.frombuffer(self._taken(count * dtype.itemsize), dtype)

    def records(self, dtype: np.dtype[Any], align: int) -> Any:
        """Return as many records as the message says, as an array of a packed type; CDR aligns each to `align`."""
        count = self.number("I")
        if not count:
            return np.zeros(0, dtype)
        if self.ros1:
            return np.frombuffer(self._taken(count * dtype.itemsize), dtype)
        self._align(align)
        step = -(-dtype.itemsize // align) * align
        body = self._taken((count - 1) * step + dtype.itemsize)
        return np.ndarray((count,), dtype.newbyteorder(self.order), body, strides=(step,))

    def count(self, least_bytes: int) -> int:
        """Return the length of a list whose entries have at least so many bytes."""
        count: int = self.number("I")
        self._need(count * least_bytes)
        return count

    def end(self) -> None:
        """Raise InputError where more follows than the padding of CDR."""
        left = len(self.data) - self.place
        if left > (0 if self.ros1 else 3):
            raise InputError(
                "the message has another length than its type",
                where=self.where,
                expected=f"{self.place} bytes",
                got=f"{left} more",
            )

    def _align(self, size: int) -> None:
        if not self.ros1:
            self.place += -self.place % size

    def _taken(self, size: int) -> memoryview:
        self._need(size)
        self.place += size
        return self.data[self.place - size : self.place]

    def _need(self, size: int) -> None:
        if self.place + size > len(self.data):
            raise InputError(
                "the message is too short",
                where=self.where,
                expected=f"at least {self.place + size} bytes",
                got=f"{len(self.data)} bytes",
            )
