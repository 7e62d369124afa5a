"""`p2o ablate`: a study from the shell, with progress, a table, and a gate for continuous integration."""

from __future__ import annotations

import contextlib
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
from p2o.cli import INTERRUPTED
from p2o.cli.plugin_options import plugin_options
from p2o.cli.progress import LINE_INTERVAL_S, duration_text, status_line
from p2o.errors import InputError, P2OError, printable

if TYPE_CHECKING:
    from p2o_study.ablate import Ablation, Progress
    from p2o_study.gate import Reference
    from p2o_study.parallel import Workers
    from p2o_study.study import Study
    from p2o_study.worker import Plugins


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


def columns_option(command: Callable[..., Any]) -> Callable[..., Any]:
    """Add --columns, the columns of tables of errors, to a command."""
    text = "Columns of the tables of errors, such as 'runs,outside 95 %,rotation mean' (default: those with figures)."

    def parsed(_: Any, __: Any, value: str | None) -> tuple[str, ...]:
        return () if value is None else tuple(word.strip() for word in value.split(","))

    return click.option("--columns", metavar="NAMES", callback=parsed, help=text)(command)


def data_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """Add --data and --root, the data of a study, to a command."""
    text = "Folder with the data; the study names the path of each dataset in it."
    command = click.option("--root", metavar="DIR", help=text)(command)
    text = "Run on these data; NAME selects one of several datasets."
    return click.option("--data", multiple=True, metavar="[NAME=]DATASET:PATH", help=text)(command)


@click.command("ablate")
@click.argument("study", required=False)
@data_options
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
@columns_option
@click.option("--report", is_flag=True, help="Then write tables (LaTeX, Markdown), figures and a page: `p2o report`.")
@click.option("--list", "listed", is_flag=True, help="List the installed studies.")
@click.option("--quiet", is_flag=True, help="No progress.")
@plugin_options
def command(
    study: str | None,
    seeds: str | None,
    at_most: int | None,
    out: str | None,
    jobs: int | None,
    backend: Any,
    address: str | None,
    isolate: bool | None,
    gate: str | None,
    update: bool,
    columns: tuple[str, ...],
    report: bool,
    listed: bool,
    quiet: bool,
    plugin: tuple[str, ...],
    block: tuple[str, ...],
    **data: Any,
) -> int:
    """Run a study (methods x frames x seeds) and print its table. STUDY is a name (see --list) or a TOML file.

    Started again, it continues with the missing rows.

    \b
    p2o ablate smoke
    p2o ablate table2 --data kitti-raw:PATH --frames @splits.json#test --jobs 2 --report
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

    from p2o_study.ablate import ablate, parse_seeds
    from p2o_study.gate import read_reference
    from p2o_study.parallel import Workers
    from p2o_study.study import find_study
    from p2o_study.summary import summarised
    from p2o_study.tables import entries_of, terminal_text

    entries_of(columns, "--columns")  # before any work
    shipped = find_study(study, plugins.registry())
    overridden = shipped.overridden(**data, seeds=None if seeds is None else parse_seeds(seeds))
    reference = read_reference(gate) if gate is not None and (not update or Path(gate).exists()) else None
    folder = Path("p2o-out") / overridden.name if out is None else Path(out)
    workers = Workers(available_cores() if jobs is None else jobs, backend, address, isolate)
    with session_words(plugins, workers, quiet) as session:
        done = ablate(overridden, folder, at_most=at_most, **session)
    if done.rows:
        click.echo(f"{overridden.title}\n{terminal_text(summarised(overridden, done.rows, done.missing), columns)}")
    if done.rows and report:
        from p2o_study.report import write_report

        click.echo("\n".join(map(str, write_report(folder, studies=[overridden.name], columns=columns))))
    if not quiet:
        click.echo(_outcome_text(done, folder), err=True)
    if done.interrupted:
        return INTERRUPTED
    if gate is None:
        return 1 if any(row.crashed for row in done.rows) or done.missing else 0
    return _gated(gate, overridden, done, reference, update=update)


def _gated(gate: str, study: Study, done: Ablation, reference: Reference | None, *, update: bool) -> int:
    """Return the exit status of a study with a gate; with `update` its reference is written instead.

    Raises InputError for a reference of a study with crashed or missing rows.
    """
    from p2o_study.gate import judge, make_reference, write_reference

    if not update:
        assert reference is not None
        click.echo(str(ruling := judge(study, done.rows, done.missing, reference)))
        return 0 if ruling.open else 1
    if (crashed := sum(row.crashed for row in done.rows)) or done.missing:
        text = "a study with crashed or missing rows cannot be a reference"
        raise InputError(text, where=gate, got=f"{crashed} crashed, {len(done.missing)} missing")
    write_reference(gate, make_reference(study, done.rows, reference))
    click.echo(f"reference written: {gate}")
    return 0


def _list(plugins: Any) -> str:
    """Return the installed studies, one per line; a broken one with the error."""
    from p2o_study.study import FOLDER, find_study, shipped_toml

    registry = plugins.registry()
    titles = {}
    for word in shipped_toml(registry, FOLDER):
        try:
            titles[word] = find_study(word, registry).title
        except P2OError as problem:
            titles[word] = f"broken: {printable(str(problem))}"
    width = max((len(word) for word in titles), default=0)
    return "\n".join(f"{word:<{width}}  {title}" for word, title in titles.items()) or "no studies"


def _outcome_text(done: Ablation, folder: Path) -> str:
    """Return the counts of rows and how to continue."""
    kept, crashed = len(done.rows) - done.computed, [row for row in done.rows if row.crashed]
    parts = [f"{done.computed} rows computed"]
    parts += [f"{count} {what}" for count, what in ((kept, "kept"), (len(done.missing), "missing")) if count > 0]
    lines = [f"{', '.join(parts)}; stored in {folder}"]
    if crashed:
        first = crashed[0]
        lines.append(f"{len(crashed)} rows crashed, such as {first.row}, {first.place}: {first.reason}")
    if done.interrupted:
        lines.append("interrupted: the same command continues")
    return "\n".join(f"p2o: {printable(line)}" for line in lines)


_PHASES = {"read": "reading frames", "extract": "extracting features", "calibrate": "calibrating"}


@contextlib.contextmanager
def session_words(plugins: Plugins, workers: Workers, quiet: bool) -> Iterator[dict[str, Any]]:
    """Yield the words of a session that computes (`p2o_study.ablate.open_session`), and show its progress on stderr.

    Progress is a status line on a terminal, elsewhere a line at the end of a phase and every few seconds. With `quiet`
    only warnings are shown.
    """
    last = time.monotonic()
    with status_line("reading the study", quiet=quiet) as show:

        def say(progress: Progress) -> None:
            nonlocal last
            rest = [f"{progress.failed} failed"] if progress.failed else []
            if progress.seconds_left is not None and progress.done < progress.total:
                rest.append(f"about {duration_text(progress.seconds_left)} left")
            rest += [printable(progress.name)] if progress.name else []
            text = f"{_PHASES[progress.phase]}: {progress.done} of {progress.total}"
            text += f" ({', '.join(rest)})" if rest else ""
            if sys.stderr.isatty():
                show(text)
            elif progress.done == progress.total or time.monotonic() - last > LINE_INTERVAL_S:
                last = time.monotonic()
                click.echo(f"p2o: {text}", err=True)

        def warn(text: str) -> None:
            click.echo(f"p2o: warning: {printable(text)}", err=True)

        on_progress = (lambda progress: None) if quiet else say
        yield {"plugins": plugins, "workers": workers, "on_progress": on_progress, "on_warning": warn}
