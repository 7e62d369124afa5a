"""`p2o benchmark`: measure suites, list stale rows, compute rows again, score other methods, write tables."""

from __future__ import annotations

import functools
import json
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
from p2o.cli.json_output import json_option, print_json
from p2o.cli.plugin_options import plugin_options
from p2o.errors import printable

from p2o_study.cli.ablate import at_most_option, progress_shown

if TYPE_CHECKING:
    from p2o_study.benchmark.measure import SuiteStatus
    from p2o_study.benchmark.suite import SuiteFile
    from p2o_study.benchmark.tables import SuiteTables
    from p2o_study.worker import Plugins

_SHOWN = 20
_NAMES = ("row", "section", "dataset", "place", "protocol", "seed", "finished")
_MAX_SEED = 2**32 - 1


@click.group("benchmark")
def command() -> None:
    """Measure suites as rows of data, compute rows again, score external methods, write tables and a page.

    A suite is a TOML file of a plugin, its rows are lines of JSON in benchmarks/results. docs/how-to/benchmark.md
    explains how to run a suite and how to enter a method.
    """


_quiet = click.option("--quiet", is_flag=True, help="No progress.")
_by = click.option("--by", default="anonymous", show_default=True, metavar="NAME", help="Who measures.")
_workers = click.option(
    "--workers", type=click.IntRange(min=1), default=1, show_default=True, metavar="N", help="Number of processes."
)
_results = click.option(
    "--results", default="benchmarks/results", show_default=True, metavar="DIR", help="Folder of the rows."
)
_cards = click.option(
    "--cards", default="benchmarks/cards", show_default=True, metavar="DIR", help="Folder of the cards of data."
)


@dataclass(frozen=True)
class _Bench:
    """What the options that commands share name: suites on their data, plugins, and the folder of rows."""

    suites: str | None
    data: tuple[str, ...]
    root: str | None
    plugin: tuple[str, ...]
    block: tuple[str, ...]

    @cached_property
    def plugins(self) -> Plugins:
        from p2o_study.worker import Plugins

        return Plugins.of(self.block, self.plugin)

    def open(self, name: str) -> SuiteFile:
        """Return a suite on its data."""
        from p2o_study.benchmark.suite import find_suite

        return find_suite(name, self.plugins.registry(), self.suites).on(self.data, self.root)

    def names(self, suite: str | None = None) -> list[str]:
        """Return the name of a suite, or those of all."""
        from p2o_study.benchmark.suite import suites

        if suite is None and self.data:
            raise click.UsageError("--data needs the name of a suite; --root is for all")
        return list(suites(self.plugins.registry(), self.suites)) if suite is None else [suite]


def _suites(function: Callable[..., Any]) -> Callable[..., Any]:
    """Add the options of suites and plugins, which the command takes as `bench`, with those of `_data_options`."""

    @functools.wraps(function)
    def command(suites: str | None, plugin: tuple[str, ...], block: tuple[str, ...], **words: Any) -> Any:
        bench = _Bench(suites, words.pop("data", ()), words.pop("root", None), plugin, block)
        return function(bench=bench, **words)

    text = "Folder of the suites (default: those of the installed plugins)."
    return plugin_options(click.option("--suites", metavar="DIR", help=text)(command))


def _data_options(function: Callable[..., Any]) -> Callable[..., Any]:
    """Add the options that name the data of a suite."""
    many = "Run on these data; NAME selects one of several datasets."
    function = click.option("--data", multiple=True, metavar="[NAME=]DATASET:PATH", help=many)(function)
    text = "Folder with the data; the suite names the path of each dataset in it."
    return click.option("--root", metavar="DIR", help=text)(function)


@command.command("run")
@click.argument("suite")
@click.option(
    "--section", "sections", multiple=True, metavar="NAME", help="Measure one section; repeat it for several."
)
@_workers
@click.option(
    "--backend", type=click.Choice(["loky", "dask", "ray"]), default="loky", help="Backend that runs the jobs."
)
@click.option("--address", metavar="ADDRESS", help="Scheduler of an existing dask or ray cluster.")
@_by
@_results
@_data_options
@_suites
@at_most_option
@_quiet
def run(
    bench: _Bench,
    suite: str,
    sections: tuple[str, ...],
    workers: int,
    backend: Any,
    address: str | None,
    by: str,
    results: str,
    at_most: int | None,
    quiet: bool,
) -> int:
    """Measure the missing and stale rows of a suite and add them to the results.

    Rows that are measurements of the current code, weights, options and data are not computed again. Started again
    after an interruption, it continues.

    \b
    p2o benchmark run smoke
    p2o benchmark run rigs --root DIR --workers 4 --by "A. Name"

    Exit status 1 if a calibration raised or is missing, 130 if interrupted.
    """  # noqa: D301  (click wants a real backspace: the examples keep their lines)
    from p2o_study.benchmark.measure import measure
    from p2o_study.parallel import Workers
    from p2o_study.rows import Rows

    file = bench.open(suite)
    rows = Rows(results)
    with progress_shown(quiet) as (say, warn):
        done = measure(
            file,
            rows,
            measured_by=by,
            sections=sections,
            plugins=bench.plugins,
            workers=Workers(workers, backend, address),
            at_most=at_most,
            on_progress=say,
            on_warning=warn,
        )
    shared = f" ({done.shared} measured for other suites)" if done.shared else ""
    parts = [
        f"{done.added} rows added{shared}",
        f"{done.fresh} fresh",
        f"{done.crashed} crashed",
        f"{done.missing} missing",
    ]
    parts += [f"{done.unreadable} with unreadable frames"] if done.unreadable else []
    click.echo(f"{file.name}: {', '.join(parts)}; {rows.path(file.name)}")
    if done.interrupted:
        click.echo("p2o: interrupted: the same command continues", err=True)
        return 130
    return 1 if done.crashed or done.missing or done.unreadable else 0


@command.command("status")
@click.argument("suite", required=False)
@_workers
@_results
@_data_options
@_suites
@json_option
@_quiet
def status(
    bench: _Bench,
    suite: str | None,
    workers: int,
    results: str,
    as_json: bool,
    quiet: bool,
) -> int:
    """List the rows of a suite, or of all, that are missing or whose method or data changed since.

    Nothing is computed. Datasets without a path are not compared: their rows are compared by method only.

    Exit status 1 if a row is missing or stale.
    """
    from p2o_study.benchmark.measure import status_of
    from p2o_study.parallel import Workers
    from p2o_study.rows import Rows

    states = []
    with progress_shown(quiet or as_json) as (say, _):
        for name in bench.names(suite):
            file = bench.open(name)
            states.append(
                status_of(file, Rows(results), plugins=bench.plugins, workers=Workers(workers), on_progress=say)
            )
    if as_json:
        print_json({"suites": [state.as_dict() for state in states]})
    else:
        click.echo("\n".join(map(_status_text, states)) or "no suites")
    return 1 if any(state.outdated for state in states) else 0


def _status_text(status: SuiteStatus) -> str:
    """Return the counts of a suite, and its missing and stale rows."""
    from p2o_study.benchmark.measure import State

    counts = [f"{status.count(state)} {state.value}" for state in State if status.count(state)]
    counts += [f"{status.surplus} surplus rows"] if status.surplus else []
    counts += [f"{status.unreadable} with unreadable frames"] if status.unreadable else []
    lines = [f"{status.suite}: {', '.join(counts) or 'no rows'}"]
    if status.unchecked:
        lines.append(f"  without data (--root DIR or --data), compared by method only: {', '.join(status.unchecked)}")
    lines += [f"  {e.state.value}: {e.row}, {e.place}, {e.protocol}, seed {e.seed}" for e in status.outdated[:_SHOWN]]
    if len(status.outdated) > _SHOWN:
        lines.append(f"  and {len(status.outdated) - _SHOWN} more (--json lists all)")
    return "\n".join(map(printable, lines))


@command.command("prune")
@click.argument("suite")
@click.option("--dry-run", is_flag=True, help="List the rows and remove none.")
@_workers
@_results
@_data_options
@_suites
@json_option
@_quiet
def prune(
    bench: _Bench,
    suite: str,
    dry_run: bool,
    workers: int,
    results: str,
    as_json: bool,
    quiet: bool,
) -> int:
    """Remove the rows that a suite no longer asks for, and those that a later row replaces; sort the others.

    Nothing is computed. Without their data, whether the suite has the frames of a row is unknown: only replaced rows
    are removed. Frames, cases, methods and environments that no row of any suite names are removed, too.

    \b
    p2o benchmark prune rigs --root DIR --dry-run
    """  # noqa: D301  (click wants a real backspace: the examples keep their lines)
    from p2o_study.benchmark.measure import prunable
    from p2o_study.parallel import Workers
    from p2o_study.rows import Rows

    file = bench.open(suite)
    known, unused = Rows(results), 0
    with progress_shown(quiet or as_json) as (say, _):
        kept, rows = prunable(file, known, plugins=bench.plugins, workers=Workers(workers), on_progress=say)
    if not dry_run:
        known.rewrite(file.name, kept)
        unused = known.remove_unused()
    if as_json:
        removable = [{name: getattr(row, name) for name in _NAMES} for row in rows]
        print_json({"suite": file.name, "dry_run": dry_run, "rows": removable, "unused": unused})
        return 0
    lines = [f"  {row.row}, {row.dataset} {row.place}, {row.protocol}, seed {row.seed}" for row in rows[:_SHOWN]]
    lines += [f"  and {len(rows) - _SHOWN} more (--json lists all)"] if len(rows) > _SHOWN else []
    counts = f"{len(rows)} rows" + (f" and {unused} unused frames, cases, methods and environments" if unused else "")
    done = "would be removed" if dry_run else "removed"
    click.echo("\n".join(map(printable, [*lines, f"{file.name}: {counts} {done}; {known.path(file.name)}"])))
    return 0


@command.command("recheck")
@click.argument("suite", required=False)
@click.option(
    "--sample", type=click.IntRange(min=0), default=30, show_default=True, metavar="N", help="Rows of each suite."
)
@click.option(
    "--seed", type=click.IntRange(0, _MAX_SEED), metavar="N", help="Seed of the sample (default: drawn at random)."
)
@_workers
@_results
@_data_options
@_suites
@_quiet
def recheck(
    bench: _Bench,
    suite: str | None,
    sample: int,
    seed: int | None,
    workers: int,
    results: str,
    quiet: bool,
) -> int:
    """Compute a random sample of the rows of a suite, or of all, again, and compare the outcomes.

    Status, verdict, pose and predicted errors have to agree: rows of this processor to 1e-6 deg and m, those of another
    processor to 0.02 deg and 5 mm. Calibrations that were measured twice with different outcomes, and missing ones, are
    named. With no difference among n rows, at most 3/n of the rows differ (95 %).

    \b
    p2o benchmark recheck smoke
    p2o benchmark recheck --root DIR --sample 50 --workers 4

    Exit status 1 if a row differs, 130 if interrupted.
    """  # noqa: D301  (click wants a real backspace: the examples keep their lines)
    import secrets

    from p2o_study.benchmark.measure import recheck as rechecked
    from p2o_study.parallel import Workers
    from p2o_study.rows import Rows

    drawn, clean = secrets.randbelow(_MAX_SEED) if seed is None else seed, True
    try:
        with progress_shown(quiet) as (say, warn):
            for name in bench.names(suite):
                file = bench.open(name)
                outcome = rechecked(
                    file,
                    Rows(results),
                    sample=sample,
                    seed=drawn,
                    plugins=bench.plugins,
                    workers=Workers(workers),
                    on_progress=say,
                    on_warning=warn,
                )
                click.echo("\n".join(map(printable, str(outcome).splitlines())))
                clean &= outcome.clean
    except KeyboardInterrupt:
        click.echo("p2o: interrupted", err=True)
        return 130
    return 0 if clean else 1


def _starts(file: SuiteFile, plugins: Plugins, quiet: bool) -> Any:
    """Return the initial guesses of a suite by group, protocol and seed; frames are read."""
    from p2o_study.ablate import open_session
    from p2o_study.benchmark.score import starts_of

    with (
        progress_shown(quiet) as (say, warn),
        open_session(file.study.study, plugins, on_progress=say, on_warning=warn) as session,
    ):
        return starts_of(session.cells())


@command.command("starts")
@click.argument("suite")
@click.option("--out", required=True, metavar="FILE.csv", help="The file to write.")
@_data_options
@_suites
@_quiet
def starts(
    bench: _Bench,
    suite: str,
    out: str,
    quiet: bool,
) -> int:
    """Write the initial guesses of a suite as CSV, for a method outside p2o.

    Each line is one calibration: group, protocol, seed, the names of its frames separated by ";", and the initial guess
    camera_from_lidar as m00 to m33 (row by row, metres).

    \b
    p2o benchmark starts smoke --out starts.csv
    """  # noqa: D301  (click wants a real backspace: the examples keep their lines)
    from p2o.files.whole_file import write_whole

    from p2o_study.benchmark.score import starts_csv

    file = bench.open(suite)
    known = _starts(file, bench.plugins, quiet)
    write_whole(out, starts_csv(known).encode())
    click.echo(f"wrote {out}: {len(known)} initial guesses")
    return 0


@command.command("score")
@click.argument("poses")
@click.option("--suite", required=True, metavar="SUITE", help="The suite of the initial guesses.")
@click.option("--name", required=True, metavar="NAME", help="The name of the method in tables.")
@click.option("--source", default="", metavar="TEXT", help="Where the method is described: a paper or an address.")
@click.option("--by", default="anonymous", show_default=True, metavar="NAME", help="Who measured; part of each row.")
@_results
@_data_options
@_suites
@_quiet
def score(
    bench: _Bench,
    poses: str,
    suite: str,
    name: str,
    source: str,
    by: str,
    results: str,
    quiet: bool,
) -> int:
    """Add the poses of a method outside p2o to the results of a suite.

    POSES is a CSV file with the columns group, protocol and seed of `p2o benchmark starts`, and camera_from_lidar as
    m00 to m33 or as qx, qy, qz, qw, tx, ty, tz (scalar last, metres); optionally seconds. An empty pose is a refused
    calibration. Every calibration of the suite needs a line.

    \b
    p2o benchmark score poses.csv --suite smoke --name "PnP on boards"
    """  # noqa: D301  (click wants a real backspace: the examples keep their lines)
    from p2o_study.benchmark import score as external
    from p2o_study.rows import Rows

    file = bench.open(suite)
    known = _starts(file, bench.plugins, quiet)
    labels = [row.label for row in file.rows]
    rows = external.score(Path(poses), known, name, source=source, measured_by=by, known=labels)
    stored = Rows(results)
    stored.make_folder()
    for row in rows:
        stored.put(file.name, row)
    refused = sum(row.estimate is None for row in rows)
    click.echo(f"{file.name}: {len(rows)} rows of '{name}' added, {refused} refused")
    return 0


def _tables(bench: _Bench, results: str) -> Callable[[str], SuiteTables]:
    """Return the function that reads the tables of a suite, once each."""
    from p2o_study.benchmark.tables import SuiteTables
    from p2o_study.rows import Rows

    @cache
    def tables(suite: str) -> SuiteTables:
        return SuiteTables.read(bench.open(suite), Rows(results))

    return tables


@command.command("table")
@click.argument("suite")
@click.option("--section", metavar="NAME", help="One section of the suite (default: all).")
@_results
@_suites
def table(
    bench: _Bench,
    suite: str,
    section: str | None,
    results: str,
) -> int:
    """Print the tables of a suite in Markdown, from its rows; no data are needed.

    Means with 95 % intervals by bootstrap over independent groups, medians, refused calibrations, false accepts and
    coverage of the predicted errors.
    """
    from p2o_study.benchmark.tables import NOTE, Choice

    tables = _tables(bench, results)(suite)
    click.echo(tables.markdown(Choice(tables.suite.name, section)))
    click.echo(NOTE)
    return 0


@command.command("page")
@click.option("--out", required=True, metavar="FOLDER", help="The folder to write: index.html, and its runs in data.")
@click.option("--overlays", is_flag=True, help="Draw worst and median run of each row on synthetic data.")
@_results
@_suites
@_cards
@_quiet
def page(
    bench: _Bench,
    out: str,
    overlays: bool,
    results: str,
    cards: str,
    quiet: bool,
) -> int:
    """Write one page of all suites: tables with top groups, plots, and the runs of each row; no data are needed.

    The page works offline, on a phone and without a server. It has filters by data set, initial error, number of
    frames, family and needs of the methods.

    \b
    p2o benchmark page --out p2o-out/benchmark/page
    """  # noqa: D301  (click wants a real backspace: the examples keep their lines)
    from p2o_study.benchmark.card import read_cards
    from p2o_study.benchmark.overlays import Overlays
    from p2o_study.benchmark.page import write_page
    from p2o_study.rows import Rows

    registry = bench.plugins.registry()
    files = list(map(bench.open, bench.names()))
    tell = (lambda name: None) if quiet else (lambda name: click.echo(f"suite {name}", err=True))
    drawing = Overlays(registry) if overlays else None
    known = read_cards(Path(cards)).values()
    written = write_page(
        files,
        Rows(results),
        Path(out),
        registry,
        cards=lambda table: {card.title: card.facts for card in known if card.covers(table)},
        overlays=drawing,
        on_suite=tell,
    )
    left_out = f", {written.left_out} rows left out" if written.left_out else ""
    click.echo(f"wrote {written.path}: {written.rows} rows, {written.runs} runs{left_out}")
    if drawing is not None:
        reason = "method or frame differs from that of the row, or the method is external"
        click.echo(f"{drawing.drawn} runs drawn, {drawing.left_out} not ({reason})")
    return 0


@command.command("cards")
@click.argument("name", required=False)
@click.option("--digest", metavar="DATASET:PATH", help="Print the digests of these frames and verify them.")
@click.option("--frames", metavar="SPEC", help="Frames of --digest (default: those of the card, all if it has none).")
@_cards
@plugin_options
def cards(
    name: str | None,
    digest: str | None,
    frames: str | None,
    cards: str,
    plugin: tuple[str, ...],
    block: tuple[str, ...],
) -> int:
    """Print the cards of data in Markdown, or verify that frames are those of a card.

    \b
    p2o benchmark cards waymo
    p2o benchmark cards waymo --digest folder:build/data/rigs/waymo

    Exit status 1 if a frame differs from the card.
    """  # noqa: D301  (click wants a real backspace: the examples keep their lines)
    from p2o.errors import UnknownNameError

    from p2o_study.benchmark.card import cards_text, differences, frame_digests, read_cards
    from p2o_study.worker import Plugins

    known = read_cards(Path(cards))
    if name is not None and name not in known:
        raise UnknownNameError("card", name, known, where=cards)
    if digest is None:
        click.echo(cards_text(known if name is None else {name: known[name]}), nl=False)
        return 0
    if name is None:
        raise click.UsageError("--digest needs the name of a card")
    card = known[name]
    digests = frame_digests(digest, frames or ",".join(card.digests) or "all", Plugins.of(block, plugin))
    different = differences(card, digests)
    click.echo(
        "\n".join(["digests:", *(f"  {json.dumps(frame)}: {json.dumps(value)}" for frame, value in digests.items())])
    )
    click.echo("\n".join(map(printable, different)), nl=bool(different))
    state = f"{len(digests) - len(different)} of {len(digests)} frames as in" if card.digests else "no digests in"
    click.echo(f"{state} the card {name}")
    return 1 if different else 0


@command.command("record", context_settings={"ignore_unknown_options": True})
@click.argument("name")
@click.argument("measuring", nargs=-1, required=True, metavar="COMMAND", type=click.UNPROCESSED)
@_by
@_results
def record(name: str, measuring: tuple[str, ...], by: str, results: str) -> int:
    """Run a measuring command and record what it prints, for pages: figures that are no calibrations.

    The record states command, commit, date and machine. A page shows it between `<!-- record: NAME -->` and
    `<!-- /record -->` (`p2o benchmark docs`).

    \b
    p2o benchmark record structure python benchmarks/structure.py
    """  # noqa: D301  (click wants a real backspace: the examples keep their lines)
    from p2o_study.benchmark.record import recorded, write_record

    path = write_record(Path(results), recorded(name, measuring, by))
    click.echo(f"wrote {path}")
    return 0


@command.command("docs")
@click.argument("pages", nargs=-1, metavar="[FILE.md]...")
@click.option("--check", is_flag=True, help="Change nothing; exit status 1 if a page differs from the rows or cards.")
@_results
@_suites
@_cards
def docs(
    bench: _Bench,
    pages: tuple[str, ...],
    check: bool,
    results: str,
    cards: str,
) -> int:
    """Write the tables of marked parts of pages from rows and cards of data (default: README.md and docs).

    A table is marked by the lines `<!-- rows: SUITE -->`, or
    `<!-- rows: SUITE, SECTION; data: A, B; methods: X, Y -->`, and `<!-- /rows -->`; a record by
    `<!-- record: NAME -->` and `<!-- /record -->`; the cards by `<!-- cards -->` and `<!-- /cards -->`.
    """
    from p2o.files.whole_file import write_whole

    from p2o_study.benchmark.card import read_cards, with_cards
    from p2o_study.benchmark.record import with_records
    from p2o_study.benchmark.tables import pages_with_marks, rendered

    paths = [Path(page) for page in pages] or [Path("README.md"), *sorted(Path("docs").rglob("*.md"))]
    tables = _tables(bench, results)
    different = 0
    for path, before in pages_with_marks(paths).items():
        after = with_cards(rendered(before, str(path), tables), str(path), lambda: read_cards(Path(cards)))
        after = with_records(after, str(path), Path(results))
        if after != before:
            different += 1
            click.echo(f"{path}: {'differs from rows, records or cards' if check else 'written'}")
            if not check:
                write_whole(path, after.encode())
    click.echo(f"{different} pages {'differ' if check else 'changed'}")
    return 1 if check and different else 0
