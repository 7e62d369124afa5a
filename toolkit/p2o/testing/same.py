"""Whether two values are the same, bit for bit, and whether one was written to."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np

from p2o.arrays import leaves, parts
from p2o.testing.subject import require

_PLAIN = (str, bool, int, float, type(None))


def arrays_of(value: Any) -> dict[str, Any]:
    """Return every array inside of a value by its name."""
    return {name: leaf for name, leaf in leaves(value) if isinstance(leaf, np.ndarray)}


def equal(first: Any, second: Any) -> bool:
    """Return whether two arrays hold the same numbers, NaN in the same places."""
    return np.array_equal(first, second, equal_nan=first.dtype.kind == "f" and second.dtype.kind == "f")


def difference(first: Any, second: Any, name: str = "") -> str:
    """Return the name of the first part in which two values differ, "it" for the whole; empty where they are the same.

    Compared are types, arrays, numbers and texts; what is neither, nor made of them, is passed over.
    """
    here, there = parts(first), parts(second)
    if type(first) is not type(second):
        return name or "it"
    if isinstance(first, np.ndarray):
        same = first.dtype == second.dtype and equal(first, second)
        return "" if same else name or "it"
    if here is None or there is None:
        same = not isinstance(first, _PLAIN) or first == second or (first != first and second != second)
        return "" if same else name or "it"
    if [key for key, _ in here] != [key for key, _ in there]:
        return name or "it"
    for (key, one), (_, other) in zip(here, there, strict=True):
        found = difference(one, other, f"{name}.{key}" if name else str(key))
        if found:
            return found
    return ""


def require_equal(first: Any, second: Any, message: str) -> None:
    """Raise CheckFailed unless two values are the same."""
    found = difference(first, second)
    require(not found, f"{message}: {found}")


class Snapshot:
    """The arrays of a value as they are now."""

    def __init__(self, value: Any) -> None:
        self._value = value
        self._before = {name: array.copy() for name, array in arrays_of(value).items()}

    @property
    def written(self) -> str:
        """The name of an array that has been written to since, empty where there is none."""
        now = arrays_of(self._value)
        return next((name for name, array in self._before.items() if not equal(array, now[name])), "")


@contextmanager
def unchanged(value: Any) -> Iterator[None]:
    """Fail if an array inside of `value` changes."""
    snapshot = Snapshot(value)
    yield
    require(not snapshot.written, f"{snapshot.written} was written to")
