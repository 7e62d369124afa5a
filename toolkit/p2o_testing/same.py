"""Compare two values bit by bit, also with what the cache returns, and detect writes to arrays.

Values are compared as they are, not as JSON: dtypes and types count, and values that JSON has no form for are allowed.
"""

from __future__ import annotations

import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from p2o.arrays import leaves, parts
from p2o.cache import FeatureCache, why_not_kept

from p2o_testing.subject import Subject, require

_PLAIN = (str, bool, int, float, type(None))


def arrays_of(value: Any) -> dict[str, Any]:
    """Return every array in a value by its name."""
    return {name: leaf for name, leaf in leaves(value) if isinstance(leaf, np.ndarray)}


def equal(first: Any, second: Any) -> bool:
    """Return whether two arrays hold the same numbers, NaN at the same indices."""
    return np.array_equal(first, second, equal_nan=first.dtype.kind == "f" and second.dtype.kind == "f")


def difference(first: Any, second: Any, name: str = "") -> str:
    """Return the name of the first part in which two values differ, "it" for the whole; empty where they are the same.

    Types, arrays, numbers and texts are compared; objects of other types are skipped.
    """
    first_parts, second_parts = parts(first), parts(second)
    if type(first) is not type(second):
        return name or "it"
    if isinstance(first, np.ndarray):
        same = first.dtype == second.dtype and equal(first, second)
        return "" if same else name or "it"
    if first_parts is None or second_parts is None:
        same = not isinstance(first, _PLAIN) or first == second or (first != first and second != second)
        return "" if same else name or "it"
    if [key for key, _ in first_parts] != [key for key, _ in second_parts]:
        return name or "it"
    for (key, one), (_, other) in zip(first_parts, second_parts, strict=True):
        path = difference(one, other, f"{name}.{key}" if name else str(key))
        if path:
            return path
    return ""


def require_equal(first: Any, second: Any, message: str) -> None:
    """Raise CheckFailed unless two values are the same."""
    path = difference(first, second)
    require(not path, f"{message}: {path}")


class Snapshot:
    """Copies of the arrays of a value, to detect later writes."""

    def __init__(self, value: Any) -> None:
        self._value = value
        self._before = {name: array.copy() for name, array in arrays_of(value).items()}

    @property
    def written(self) -> str:
        """The name of an array that was written to, empty where there is none."""
        now = arrays_of(self._value)
        return next((name for name, array in self._before.items() if not equal(array, now[name])), "")


@dataclass(frozen=True, eq=False)
class Call:
    """A call of a stage: what is `given` to it, its `answer`, and the array of `given` that it wrote to, else empty."""

    given: tuple[Any, ...]
    answer: Any
    written: str

    @classmethod
    def of(cls, subject: Subject, *given: Any) -> Call:
        """Call a freshly built stage."""
        snapshot = Snapshot(given)
        answer = subject.built()(*given)
        return cls(given, answer, snapshot.written)

    def require_unwritten(self) -> None:
        """Raise CheckFailed if the stage wrote to an array that was given to it."""
        require(not self.written, f"array {self.written} of the arguments was written to")

    def require_repeated(self, subject: Subject, what: str) -> None:
        """Raise CheckFailed unless a freshly built stage gives the same answer."""
        require_equal(self.answer, subject.built()(*self.given), f"the {what} of the same input differ")


def require_kept(value: Any, what: str) -> None:
    """Raise CheckFailed, with the reason, unless the cache returns the same value."""
    reason = why_not_kept(value)
    require(not reason, f"{what} cannot be kept: {reason}")
    with tempfile.TemporaryDirectory() as folder:
        cache, key = FeatureCache(Path(folder)), "0" * 64
        cache.put(key, value, 0.0)
        kept = cache.get(key)
    require(kept is not None, f"{what} cannot be read again: its dataclasses do not take their own fields")
    assert kept is not None
    require_equal(value, kept.features, f"{what} comes back from the cache changed")
