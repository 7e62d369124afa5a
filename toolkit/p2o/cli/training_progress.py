"""Progress of labels and trainings on stderr: a live bar on a terminal, lines elsewhere, or nothing."""

from __future__ import annotations

import contextlib
import sys
import time
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import click

from p2o.errors import printable

if TYPE_CHECKING:
    from p2o.host.trainer import TrainingProgress
    from p2o.learn.label_files import LabelProgress

_LINE_EVERY_S = 5.0
"""How often the progress of labels is a line where there is no terminal."""


class Shown:
    """Says one line for each validation, and now and then how far the labels are; `bars` is a rich bar, or None."""

    def __init__(self, quiet: bool, bars: Any = None) -> None:
        self.quiet, self.bars = quiet, bars
        self.task = None if bars is None else bars.add_task("starting", total=None)
        self.fresh, self.said = 0, time.monotonic()
        self.last: TrainingProgress | None = None

    def label(self, progress: LabelProgress) -> None:
        """Show how far the labels are."""
        self.fresh += progress.fresh
        if self.bars is not None:
            self.bars.update(
                self.task,
                description=_shown_as_text(f"labels {progress.name}"),
                completed=progress.done,
                total=progress.total,
            )
        ended = progress.done == progress.total
        if ended or (self.bars is None and time.monotonic() - self.said > _LINE_EVERY_S):
            self.said = time.monotonic()
            text = f"labels: {progress.done} of {progress.total}"
            self._line(f"{text}, {self.fresh} of them new" if ended else text)

    def step(self, progress: TrainingProgress) -> None:
        """Show where the training stands."""
        parts = [f"step {progress.step} of {progress.of}", f"loss {progress.loss:.4f}"]
        parts += [] if progress.validation is None else [f"held out {progress.validation:.4f}"]
        left = self._left_s(progress)
        parts += [] if left is None else [f"about {_duration(left)} left"]
        self.last = progress
        if self.bars is not None:
            self.bars.update(self.task, description="training", completed=progress.step, total=progress.of)
        self._line(", ".join(parts))

    def _left_s(self, progress: TrainingProgress) -> float | None:
        # The first report does not tell the pace: a training that goes on did not begin at step 0.
        if self.last is None or progress.step >= progress.of or progress.step <= self.last.step:
            return None
        pace = (progress.seconds - self.last.seconds) / (progress.step - self.last.step)
        return pace * (progress.of - progress.step)

    def _line(self, text: str) -> None:
        if self.quiet:
            return
        if self.bars is not None:
            self.bars.console.print(f"p2o: {text}", markup=False, highlight=False)
        else:
            click.echo(f"p2o: {text}", err=True)


@contextlib.contextmanager
def shown(quiet: bool) -> Iterator[Shown]:
    """Yield what shows progress."""
    if quiet or not sys.stderr.isatty():
        yield Shown(quiet)
        return
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    with Progress(*columns, console=Console(stderr=True), transient=True) as bars:
        yield Shown(quiet, bars)


def _shown_as_text(name: str) -> str:
    """Return a text that a bar of rich shows as it is: brackets in it are no markup."""
    from rich.markup import escape

    return escape(printable(name))


def _duration(seconds: float) -> str:
    whole = max(1, round(seconds))
    return f"{whole} s" if whole < 90 else f"{whole / 60:.0f} min" if whole < 5400 else f"{whole / 3600:.1f} h"
