"""Common options of the commands that use training data, and their progress on stderr: a live bar or lines."""

from __future__ import annotations

import contextlib
import sys
import time
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, Any

import click
from p2o.cli.plugin_options import plugin_options
from p2o.cli.progress import LINE_INTERVAL_S, duration_text
from p2o.errors import printable

if TYPE_CHECKING:
    from p2o.host.method import TrainingProgress

    from p2o_train.train import LabelProgress


def training_data_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """Add METHOD, --data, --frames, --out, --quiet and the options of plugins to a command."""
    command = plugin_options(command)
    command = click.option("--quiet", is_flag=True, help="No progress.")(command)
    folder, written = click.Path(file_okay=False), "Folder to write to (created if needed)."
    command = click.option("--out", required=True, type=folder, metavar="DIR", help=written)(command)
    which = "Which frames, as in `p2o run`: one for all data, or the i-th for the i-th --data (default: all)."
    command = click.option("--frames", multiple=True, metavar="SPEC", help=which)(command)
    data = "The training data; repeat for several datasets."
    command = click.option("--data", multiple=True, required=True, metavar="[NAME=]DATASET:PATH", help=data)(command)
    return click.argument("method", metavar="METHOD")(command)


class Shown:
    """Shows one line per validation and the progress of labels every few seconds; `bars` is a rich bar, or None."""

    def __init__(self, quiet: bool, bars: Any = None) -> None:
        self.quiet, self.bars = quiet, bars
        self.task = None if bars is None else bars.add_task("starting", total=None)
        self.fresh, self.last_line_s = 0, time.monotonic()
        self.last: TrainingProgress | None = None

    def label(self, progress: LabelProgress) -> None:
        """Show the progress of labels."""
        self.fresh += progress.fresh
        if self.bars is not None:
            from rich.markup import escape

            text = escape(printable(f"labels {progress.name}"))
            self.bars.update(self.task, description=text, completed=progress.done, total=progress.total)
        ended = progress.done == progress.total
        if ended or (self.bars is None and time.monotonic() - self.last_line_s > LINE_INTERVAL_S):
            self.last_line_s = time.monotonic()
            text = f"labels: {progress.done} of {progress.total}"
            self._line(f"{text}, {self.fresh} of them new" if ended else text)

    def step(self, progress: TrainingProgress) -> None:
        """Show the progress of the training."""
        parts = [f"step {progress.step} of {progress.of}", f"loss {progress.loss:.4f}"]
        parts += [] if progress.validation is None else [f"held out {progress.validation:.4f}"]
        left = self._left_s(progress)
        parts += [] if left is None else [f"about {duration_text(left)} left"]
        self.last = progress
        if self.bars is not None:
            self.bars.update(self.task, description="training", completed=progress.step, total=progress.of)
        self._line(", ".join(parts))

    def _left_s(self, progress: TrainingProgress) -> float | None:
        # The speed needs two reports: a resumed training does not begin at step 0.
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
    """Yield the object that shows progress."""
    if quiet or not sys.stderr.isatty():
        yield Shown(quiet)
        return
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    with Progress(*columns, console=Console(stderr=True), transient=True) as bars:
        yield Shown(quiet, bars)
