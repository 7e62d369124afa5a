"""Progress on stderr: a status line on a terminal, lines about work that takes long, and durations as text."""

from __future__ import annotations

import contextlib
import sys
import threading
import time
from collections.abc import Callable, Iterator

from p2o.errors import printable
from p2o.runtime.stages import reported_stages

LINE_INTERVAL_S = 5.0
"""Interval of progress lines if stderr is no terminal."""
LONG_WORK_S = 20.0
"""Duration of a piece of work after which its duration is shown."""
_LONGEST_PAUSE_S = 300.0


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


@contextlib.contextmanager
def long_work(show: Callable[[str], None], rest: str = "") -> Iterator[Callable[[str], None]]:
    """Yield a function that names the current piece of work, whose stage and duration are shown if it takes long.

    On a terminal they are part of the status line, written by `show`. Elsewhere a line is written to stderr after 20 s,
    and again after twice that time, at least every 5 min. `rest` ends the lines. The stages are those that the work
    reports (`p2o.runtime.stages`).
    """
    changed, ended = threading.Event(), threading.Event()
    name, stage, terminal = [""], [""], sys.stderr.isatty()

    def text() -> str:
        return ": ".join(filter(None, (name[0], stage[0])))

    def work(text: str) -> None:
        name[0], stage[0] = text, ""
        show(text)
        changed.set()

    def on_stage(now: str) -> None:
        stage[0] = now
        show(text())

    def watch() -> None:
        since, pause = time.monotonic(), LONG_WORK_S
        while not ended.is_set():
            if changed.wait(pause):
                changed.clear()
                since, pause = time.monotonic(), LONG_WORK_S
                continue
            took = time.monotonic() - since
            line = f"{text()}, for {duration_text(took)}{rest}"
            if terminal:
                show(line)
            elif name[0]:
                print(f"p2o: {printable(line)}", file=sys.stderr, flush=True)
            pause = 1.0 if terminal else min(took, _LONGEST_PAUSE_S)

    thread = threading.Thread(target=watch, name="p2o-progress", daemon=True)
    thread.start()
    try:
        with reported_stages(on_stage):
            yield work
    finally:
        ended.set()
        changed.set()
        thread.join()


def duration_text(seconds: float) -> str:
    """Return a duration in s, min or h."""
    whole = max(1, round(seconds))
    return f"{whole} s" if whole < 90 else f"{whole / 60:.0f} min" if whole < 5400 else f"{whole / 3600:.1f} h"
