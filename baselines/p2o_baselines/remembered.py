"""What is made of a feature once serves all rounds: kept as long as the feature lives."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar
from weakref import WeakKeyDictionary

From = TypeVar("From")
Made = TypeVar("Made")


def remembered(make: Callable[[From], Made]) -> Callable[[From], Made]:
    """Return `make` with its results kept as long as its argument lives."""
    known: WeakKeyDictionary[From, Made] = WeakKeyDictionary()

    def look_up(feature: From) -> Made:
        if feature not in known:
            known[feature] = make(feature)
        return known[feature]

    return look_up
