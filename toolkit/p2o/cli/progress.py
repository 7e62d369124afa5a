"""Progress on stderr: a status line on a terminal, and durations as text."""

from __future__ import annotations

import contextlib
import sys
from collections.abc import Callable, Iterator

from p2o.errors import printable

LINE_INTERVAL_S = 5.0
"""Interval of progress lines if stderr is no terminal."""


@contextlib.contextmanager
def status_line(initial: str, *, quiet: bool = False) -> Iterator[Callable[[str], None]]:
    """Yield a function that shows a text on the status line; it shows nothing if stderr is no terminal."""
    if quiet or not sys.stderr.isatty():
        yield lambda text: None
        return
    from rich.console import Console
    from rich.markup import escape

    with Console(stderr=True).status(initial) as status:
        yield lambda text: status.update(escape(printable(text)))


def duration_text(seconds: float) -> str:
    """Return a duration in s, min or h."""
    whole = max(1, round(seconds))
    return f"{whole} s" if whole < 90 else f"{whole / 60:.0f} min" if whole < 5400 else f"{whole / 3600:.1f} h"
