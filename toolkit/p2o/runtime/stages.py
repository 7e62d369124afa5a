"""Report the current stage of long work, for a command that shows it."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TypeVar

_Item = TypeVar("_Item")
_Result = TypeVar("_Result")

_reports: list[Callable[[str], object]] = []
"""Receive the stages; at most one."""


def report_stage(text: str) -> None:
    """Report what the work does from now on."""
    for report in _reports:
        report(text)


@contextmanager
def reported_stages(report: Callable[[str], object]) -> Iterator[None]:
    """Report the stages of this process to a function, which may be called by any thread."""
    _reports.append(report)
    try:
        yield
    finally:
        _reports.remove(report)


def counted(text: str, function: Callable[[_Item], _Result], count: int) -> Callable[[_Item], _Result]:
    """Return the function of one of `count` items, which reports a stage and its progress at each call."""
    numbers = itertools.count(1)

    def reporting(item: _Item) -> _Result:
        report_stage(f"{text}, {min(next(numbers), count)} of {count}" if count > 1 else text)
        return function(item)

    return reporting
