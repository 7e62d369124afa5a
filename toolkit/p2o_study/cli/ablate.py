"""`p2o ablate`: a study from the shell, with progress, a table, and a gate for continuous integration."""

from __future__ import annotations

import contextlib
import functools
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
from p2o.cli.plugin_options import plugin_options
from p2o.cli.progress import LINE_INTERVAL_S, duration_text
from p2o.errors import InputError, P2OError, printable

if TYPE_CHECKING:
    from p2o_study.ablate import Ablation, Progress
    from p2o_study.gate import Reference
    from p2o_study.study import Study


at_most_option = click.option(
    "--at-most", type=click.IntRange(min=1), metavar="N", help="Confirm up to N calibrations, if more than 100,000."
)
jobs_option = click.option(
    "--jobs", type=click.IntRange(min=1), default=1, show_default=True, metavar="N", help="Number of processes."
)


def cluster_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """Add --backend and --address to a command."""
    text = "Scheduler of an existing dask or ray cluster."
    command = click.option("--address", metavar="ADDRESS", help=text)(command)
    kinds = click.Choice(["loky", "dask", "ray"])
    return click.option("--backend", type=kinds, default="loky", help="Backend that runs the jobs.")(command)


def data_options(text: str, owner: str) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    """Return a decorator that adds --data and --root, the data of a study or suite, to a command."""

    def decorate(command: Callable[..., Any]) -> Callable[..., Any]:
        root = f"Folder with the data; the {owner} names the path of each dataset in it."
        command = click.option("--root", metavar="DIR", help=root)(command)
        return click.option("--data", multiple=True, metavar="[NAME=]DATASET:PATH", help=text)(command)

    return decorate


@click.command("ablate")
@click.argument("study", required=False)
@data_options("Run on these data; NAME selects one of several datasets.", "study")
@click.option(
    "--frames",
    multiple=True,
    metavar="[NAME=]SPEC",
    help="Which frames, as in `p2o run`, of one dataset or all (default: those of the study).",
)
@click.option("--seeds", metavar="N|LIST", help="Number of seeds, or a list such as 3,5 (default: those of the study).")
@at_most_option
@click.option(
    "--out", type=click.Path(file_okay=False), metavar="DIR", help="Folder of the rows (default: p2o-out/STUDY)."
)
@click.option("--jobs", type=click.IntRange(min=1), metavar="N", help="Number of processes (default: one per core).")
@cluster_options
@click.option(
    "--isolate/--no-isolate",
    default=None,
    help="With --jobs 1: use a worker process, which a plugin may crash (default: if plugins are of other packages).",
)
@click.option(
    "--gate",
    type=click.Path(dir_okay=False),
    metavar="FILE",
    help="Exit status 1 if a row is worse than in this reference.",
)
@click.option("--update", is_flag=True, help="Write the reference of --gate instead of comparing.")
@click.option("--list", "listed", is_flag=True, help="List the installed studies.")
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
    isolate: bool | None,
    gate: str | None,
    update: bool,
    listed: bool,
    quiet: bool,
    plugin: tuple[str, ...],
    block: tuple[str, ...],
) -> int:
    """Run a study (methods x frames x seeds) and print its table. STUDY is a name (see --list) or a TOML file.

    Started again, it continues with the missing rows.

    \b
    p2o ablate smoke
    p2o ablate table2 --data kitti-raw:PATH --frames @splits.json#test --jobs 2
    p2o ablate rigs --root DIR --frames @splits.json
    p2o ablate STUDY --gate reference.json

    Exit status 1 if a row crashed or the gate is closed. docs/studies.md explains study files.
    """  # noqa: D301  (click wants a real backspace: the examples keep their lines)
    from p2o_study.worker import Plugins

    plugins = Plugins.of(block, plugin)
    if listed:
        click.echo(_list(plugins))
        return 0
    if study is None:
        raise click.UsageError("STUDY is missing; `p2o ablate --list` lists the installed studies")
    if update and gate is None:
        raise InputError("the reference has no file", where="--update", expected="--gate FILE")

    from p2o.runtime.native import available_cores

    from p2o_study import gate as gates
    from p2o_study.ablate import ablate, parse_seeds
    from p2o_study.parallel import Workers
    from p2o_study.study import StudyFile, find_study
    from p2o_study.summary import summarised
    from p2o_study.tables import terminal_text

    shipped = find_study(study, plugins.registry())
    overridden = shipped.study.overridden(data, frames, None if seeds is None else parse_seeds(seeds), root)
    file = StudyFile(overridden, shipped.text, shipped.source)
    reference = gates.read_reference(gate) if gate is not None and (not update or Path(gate).exists()) else None
    folder = Path("p2o-out") / file.study.name if out is None else Path(out)
    overrides = {"data": list(data), "root": root, "frames": list(frames), "seeds": seeds}
    with _progress_or_kept_rows(file.study, folder, quiet) as (say, warn):
        done = ablate(
            file,
            folder,
            plugins=plugins,
            workers=Workers(available_cores() if jobs is None else jobs, backend, address, isolate),
            overrides={name: value for name, value in overrides.items() if value},
            at_most=at_most,
            on_progress=say,
            on_warning=warn,
        )
    if done.rows:
        click.echo(f"{file.study.title}\n{terminal_text(summarised(file.study, done.rows, done.missing))}")
    if not quiet:
        click.echo(_outcome_text(done, folder), err=True)
    if done.interrupted:
        return 130
    if gate is None:
        return 1 if any(row.crashed for row in done.rows) or done.missing else 0
    return _gated(gate, file.study, done, reference, update=update)


def _gated(gate: str, study: Study, done: Ablation, reference: Reference | None, *, update: bool) -> int:
    """Return the exit status of a study with a gate; with `update` its reference is written instead."""
    from p2o_study import gate as gates

    if update:
        _write_reference(gate, study, done, reference)
        return 0
    assert reference is not None
    click.echo(str(ruling := gates.judge(study, done.rows, done.missing, reference)))
    return 0 if ruling.open else 1


@contextlib.contextmanager
def _progress_or_kept_rows(study: Study, folder: Path, quiet: bool) -> Iterator[tuple[Say, Warn]]:
    """Show progress as `progress_shown`; print the finished rows if an error ends a study that was computing."""
    from p2o_study.rows import Rows
    from p2o_study.summary import summarised
    from p2o_study.tables import terminal_text

    computing = False
    try:
        with progress_shown(quiet) as (say, warn):

            def on_progress(progress: Progress) -> None:
                nonlocal computing
                computing = computing or progress.phase == "calibrate"
                say(progress)

            yield on_progress, warn
    except (P2OError, OSError):
        with contextlib.suppress(P2OError, OSError):
            if computing and (rows := (stored := Rows(folder)).planned(study.name)):
                click.echo(f"{study.title}\n{terminal_text(summarised(study, rows, stored.missing(study.name)))}")
                click.echo(f"p2o: {len(rows)} rows are kept in {printable(folder)}", err=True)
        raise


def _write_reference(gate: str, study: Study, done: Ablation, reference: Reference | None) -> None:
    """Write the reference of a gate; raises InputError if rows crashed or are missing."""
    from p2o_study import gate as gates

    crashed = sum(row.crashed for row in done.rows)
    if crashed or done.missing:
        raise InputError(
            "a study with crashed or missing rows cannot be a reference",
            where=gate,
            got=f"{crashed} crashed, {len(done.missing)} missing",
        )
    gates.write_reference(gate, gates.make_reference(study, done.rows, reference))
    click.echo(f"reference written: {gate}")


def _list(plugins: Any) -> str:
    """Return the installed studies, one per line; a broken one with the error."""
    from p2o_study.study import find_study, shipped_studies

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


def _outcome_text(done: Ablation, folder: Path) -> str:
    """Return the counts of rows and how to continue."""
    kept = len(done.rows) - done.computed
    parts = [f"{done.computed} rows computed", *([f"{kept} kept"] if kept > 0 else [])]
    crashed, first = 0, None
    for row in done.rows:
        crashed += row.crashed
        first = row if first is None and row.crashed else first
    if done.missing:
        parts.append(f"{len(done.missing)} missing")
    lines = [f"{', '.join(parts)}; stored in {folder}"]
    if first is not None:
        lines.append(f"{crashed} rows crashed, such as {first.row}, {first.place}: {first.reason}")
    if done.interrupted:
        lines.append("interrupted: the same command continues")
    return "\n".join(f"p2o: {printable(line)}" for line in lines)


Say = Callable[["Progress"], None]
Warn = Callable[[str], None]
_PHASES = {"read": "reading frames", "extract": "extracting features", "calibrate": "calibrating"}


@contextlib.contextmanager
def progress_shown(quiet: bool) -> Iterator[tuple[Say, Warn]]:
    """Yield functions that show progress and warnings on stderr: a bar on a terminal, lines elsewhere.

    With `quiet` only warnings are shown.
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

    # Names of frames may contain brackets, which are no markup.
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
    """Shows progress as lines: at the end of a phase and every few seconds."""

    def __init__(self) -> None:
        self.last = time.monotonic()

    def __call__(self, progress: Progress) -> None:
        ended = progress.done == progress.total
        if ended or time.monotonic() - self.last > LINE_INTERVAL_S:
            self.last = time.monotonic()
            rest = _rest(progress)
            text = f"p2o: {_PHASES[progress.phase]}: {progress.done} of {progress.total}"
            click.echo(text + (f" ({rest})" if rest else ""), err=True)


def _rest(progress: Progress) -> str:
    parts = [f"{progress.failed} failed"] if progress.failed else []
    if progress.seconds_left is not None and progress.done < progress.total:
        parts.append(f"about {duration_text(progress.seconds_left)} left")
    if progress.name:
        parts.append(printable(progress.name))
    return ", ".join(parts)
