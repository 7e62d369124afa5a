"""`p2o ablate`: a study from the shell, with progress, a table, and a gate for continuous integration."""

from __future__ import annotations

import contextlib
import os
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from p2o.cli.plugin_options import plugin_options
from p2o.errors import InputError, P2OError, printable

if TYPE_CHECKING:
    from p2o.study.ablate import Ablation, Progress

_LINE_EVERY_S = 5.0
"""How often progress is a line where there is no terminal."""


@click.command("ablate")
@click.argument("study", required=False)
@click.option(
    "--data",
    "data",
    multiple=True,
    metavar="[NAME=]DATASET:PATH",
    help="Run on these data; NAME where there are several.",
)
@click.option("--root", metavar="DIR", help="Folder that holds the data, each where the study says.")
@click.option(
    "--frames",
    multiple=True,
    metavar="[NAME=]SPEC",
    help="Which frames, as in `p2o run`, of one dataset or all (default: as the study says).",
)
@click.option("--seeds", metavar="N|LIST", help="How many starts, or which, such as 3,5 (default: as the study says).")
@click.option(
    "--at-most",
    type=click.IntRange(min=1),
    metavar="N",
    help="So many calibrations are meant, where they are over 100,000.",
)
@click.option("--out", type=click.Path(file_okay=False), metavar="DIR", help="Keep rows here (default: p2o-out/STUDY).")
@click.option("--jobs", type=click.IntRange(min=1), metavar="N", help="Processes to use (default: one a core).")
@click.option("--backend", type=click.Choice(["loky", "dask", "ray"]), default="loky", help="Where jobs run.")
@click.option("--address", metavar="ADDRESS", help="Scheduler of an existing cluster of dask or ray.")
@click.option("--gate", type=click.Path(dir_okay=False), metavar="FILE", help="Exit 1 where worse than this reference.")
@click.option("--update", is_flag=True, help="Write the reference of --gate instead of comparing with it.")
@click.option("--list", "listed", is_flag=True, help="List the studies that are installed.")
@click.option("--quiet", is_flag=True, help="No progress.")
@plugin_options
def command(
    study: str | None,
    data: tuple[str, ...],
    root: str | None,
    frames: tuple[str, ...],
    seeds: str | None,
    at_most: int | None,
    out: str | None,
    jobs: int | None,
    backend: Any,
    address: str | None,
    gate: str | None,
    update: bool,
    listed: bool,
    quiet: bool,
    plugin: tuple[str, ...],
    block: tuple[str, ...],
) -> int:
    """Run a study: methods x frames x starts. STUDY is a name (see --list) or a TOML file; its table is printed.

    Started again, it goes on where it was.

    \b
    p2o ablate smoke
    p2o ablate table2 --data kitti-raw:PATH --frames @splits.json#test --jobs 2
    p2o ablate rigs --root DIR --frames @splits.json
    p2o ablate STUDY --gate reference.json

    Exit status 1 where a row crashed or the gate is closed. docs/studies.md explains study files.
    """  # noqa: D301  (click wants a real backspace: the examples keep their lines)
    from p2o.study.worker import Plugins

    plugins = Plugins.of(block, plugin)
    if listed:
        click.echo(_list(plugins))
        return 0
    if study is None:
        raise click.UsageError("which study? `p2o ablate --list` names those that are installed")
    if update and gate is None:
        raise InputError("there is no reference to write", where="--update", expected="--gate FILE beside it")

    from p2o.study import gate as gates
    from p2o.study.ablate import ablate, chosen_seeds
    from p2o.study.study import StudyFile, find_study
    from p2o.study.tally import table
    from p2o.work.parallel import Workers

    workers = Workers(_cores() if jobs is None else jobs, backend, address)
    found = find_study(study, plugins.registry())
    chosen = None if seeds is None else chosen_seeds(seeds)
    file = StudyFile(found.study.overridden(data, frames, chosen, root), found.text, found.source)
    reference = gates.read_reference(gate) if gate is not None and (not update or Path(gate).exists()) else None
    folder = Path("p2o-out") / file.study.name if out is None else Path(out)
    words = {"data": list(data), "root": root, "frames": list(frames), "seeds": seeds}
    overrides = {name: value for name, value in words.items() if value}
    with progress_shown(quiet) as (say, warn):
        done = ablate(
            file,
            folder,
            plugins=plugins,
            workers=workers,
            overrides=overrides,
            at_most=at_most,
            on_progress=say,
            on_warning=warn,
        )
    click.echo(f"{file.study.title}\n{table(file.study, done.rows)}")
    if not quiet:
        click.echo(_told(done, folder), err=True)
    if done.interrupted:
        return 130
    crashed = sum(row.crashed for row in done.rows)
    if gate is None:
        return 1 if crashed or done.missing else 0
    if update:
        if crashed or done.missing:
            raise InputError(
                "a study with rows that crashed or are missing is no reference",
                where=gate,
                got=f"{crashed} crashed, {len(done.missing)} missing",
            )
        gates.write_reference(gate, gates.make_reference(file.study, done.rows, reference))
        click.echo(f"reference written: {gate}")
        return 0
    assert reference is not None
    ruling = gates.judge(file.study, done.rows, done.missing, reference)
    click.echo(str(ruling))
    return 0 if ruling.open else 1


def _list(plugins: Any) -> str:
    """Return the studies that are installed, one a line; one that cannot be read says why."""
    from p2o.study.study import find_study, shipped_studies

    registry = plugins.registry()
    titles = {}
    for name, owners in shipped_studies(registry).items():
        for dist, _ in owners:
            word = name if len(owners) == 1 else f"{name}@{dist}"
            try:
                titles[word] = find_study(word, registry).study.title
            except P2OError as problem:
                titles[word] = f"broken: {printable(str(problem))}"
    width = max((len(word) for word in titles), default=0)
    return "\n".join(f"{word:<{width}}  {title}" for word, title in titles.items()) or "no studies"


def _told(done: Ablation, folder: Path) -> str:
    """Return what happened, and what to do with it."""
    kept = len(done.rows) - done.computed
    parts = [f"{done.computed} rows computed", *([f"{kept} were there"] if kept > 0 else [])]
    crashed, first = 0, None
    for row in done.rows:
        crashed += row.crashed
        first = row if first is None and row.crashed else first
    if done.missing:
        parts.append(f"{len(done.missing)} missing")
    lines = [f"{', '.join(parts)}; they are in {folder}"]
    if first is not None:
        lines.append(f"{crashed} rows crashed, such as {first.row}, {first.place}: {first.reason}")
    if done.interrupted:
        lines.append("interrupted: the same command goes on from here")
    return "\n".join(f"p2o: {printable(line)}" for line in lines)


def _cores() -> int:
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


Say = Callable[["Progress"], None]
Warn = Callable[[str], None]
_PHASES = {"read": "reading frames", "extract": "extracting features", "calibrate": "calibrating"}


@contextlib.contextmanager
def progress_shown(quiet: bool) -> Iterator[tuple[Say, Warn]]:
    """Yield what shows progress and warnings on stderr: a bar on a terminal, now and then a line elsewhere, or nothing.

    Warnings are always shown.
    """
    if quiet:
        yield (lambda progress: None), _warned
        return
    if not sys.stderr.isatty():
        yield _Lines(), _warned
        return
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, TextColumn
    from rich.progress import Progress as Bars

    # Names of frames are not rich's markup.
    texts = (TextColumn(f"{{task.{word}}}", markup=False) for word in ("description", "fields[rest]"))
    columns = (next(texts), BarColumn(), MofNCompleteColumn(), next(texts))
    with Bars(*columns, console=Console(stderr=True), transient=True) as bars:
        task = bars.add_task("reading the study", total=None, rest="")

        def show(progress: Progress) -> None:
            bars.update(
                task,
                description=_PHASES[progress.phase],
                completed=progress.done,
                total=progress.total,
                rest=_rest(progress),
            )

        def warn(text: str) -> None:
            bars.console.print(f"p2o: warning: {printable(text)}", markup=False, highlight=False, soft_wrap=True)

        yield show, warn


def _warned(text: str) -> None:
    click.echo(f"p2o: warning: {printable(text)}", err=True)


class _Lines:
    """Progress as plain lines: when a phase ends, and every few seconds."""

    def __init__(self) -> None:
        self.last = time.monotonic()

    def __call__(self, progress: Progress) -> None:
        ended = progress.done == progress.total
        if ended or time.monotonic() - self.last > _LINE_EVERY_S:
            self.last = time.monotonic()
            rest = _rest(progress)
            text = f"p2o: {_PHASES[progress.phase]}: {progress.done} of {progress.total}"
            click.echo(text + (f" ({rest})" if rest else ""), err=True)


def _rest(progress: Progress) -> str:
    parts = [f"{progress.failed} failed"] if progress.failed else []
    if progress.seconds_left is not None and progress.done < progress.total:
        parts.append(f"about {_duration(progress.seconds_left)} left")
    if progress.name:
        parts.append(printable(progress.name))
    return ", ".join(parts)


def _duration(seconds: float) -> str:
    whole = max(1, round(seconds))
    return f"{whole} s" if whole < 90 else f"{whole / 60:.0f} min" if whole < 5400 else f"{whole / 3600:.1f} h"
