"""`p2o benchmark`: measure suites, list stale rows, compute rows again, score other methods, write tables."""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager
from dataclasses import dataclass
from functools import cache, cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
from p2o.cli import INTERRUPTED
from p2o.cli.json_output import json_option, print_json
from p2o.cli.plugin_options import plugin_options
from p2o.errors import InputError, printable

from p2o_study.cli.ablate import at_most_option, cluster_options, columns_option, data_options, session_words

if TYPE_CHECKING:
    from p2o_study.benchmark.measure import SuiteStatus
    from p2o_study.benchmark.suite import Suite
    from p2o_study.benchmark.tables import SuiteTables
    from p2o_study.rows import Rows
    from p2o_study.worker import Plugins

_SHOWN = 20
_MAX_SEED = 2**32 - 1


@click.group("benchmark")
def command() -> None:
    """Measure suites as rows of data, compute rows again, score external methods, write tables and a page.

    A suite is a TOML file of a plugin, its rows are lines of JSON in benchmarks/results. docs/how-to/benchmark.md
    explains how to run a suite and how to enter a method.
    """


@dataclass(frozen=True)
class _Bench:
    """What the options that commands share name: suites on their data, plugins, workers, and the folder of rows."""

    plugin: tuple[str, ...]
    block: tuple[str, ...]
    suites: str | None = None
    data: tuple[str, ...] = ()
    root: str | None = None
    results: str = ""
    workers: int = 1
    backend: Any = "loky"
    address: str | None = None
    quiet: bool = False

    @cached_property
    def plugins(self) -> Plugins:
        from p2o_study.worker import Plugins

        return Plugins.of(self.block, self.plugin)

    @cached_property
    def rows(self) -> Rows:
        from p2o_study.rows import Rows

        return Rows(self.results)

    def open(self, name: str) -> Suite:
        """Return a suite on its data."""
        from p2o_study.benchmark.suite import find_suite

        return find_suite(name, self.plugins.registry(), self.suites).overridden(data=self.data, root=self.root)

    def opened(self, suite: str | None = None) -> Iterator[Suite]:
        """Yield a suite on its data, or all."""
        from p2o_study.benchmark.suite import suites

        if suite is None and self.data:
            raise click.UsageError("--data needs the name of a suite; --root is for all")
        return map(self.open, suites(self.plugins.registry(), self.suites) if suite is None else [suite])

    def tables(self) -> Callable[[str], SuiteTables]:
        """Return the function that reads the tables of a suite, once each."""
        from p2o_study.benchmark.tables import SuiteTables

        return cache(lambda suite: SuiteTables.read(self.open(suite), self.rows))

    def session(self, as_json: bool = False) -> AbstractContextManager[dict[str, Any]]:
        """Return the context with the words of a session that computes, which shows its progress."""
        from p2o_study.parallel import Workers

        return session_words(
            self.plugins, Workers(self.workers, self.backend, self.address, isolate=None), self.quiet or as_json
        )


_OPTIONS: dict[str, Callable[[Any], Any]] = {
    "suites": click.option("--suites", metavar="DIR", help="Folder of suites (default: those of installed plugins)."),
    "data": data_options,
    "results": click.option(
        "--results", default="benchmarks/results", show_default=True, metavar="DIR", help="Folder of the rows."
    ),
    "workers": click.option(
        "--workers", type=click.IntRange(min=1), default=1, show_default=True, metavar="N", help="Number of processes."
    ),
    "cluster": cluster_options,
    "quiet": click.option("--quiet", is_flag=True, help="No progress."),
}


def _takes(*names: str) -> Callable[[Callable[..., int]], Callable[..., int]]:
    """Return a decorator that adds shared options, and those of plugins, which the command takes as `bench`."""

    def decorate(function: Callable[..., int]) -> Callable[..., int]:
        @functools.wraps(function)
        def command(**words: Any) -> int:
            shared = {name: words.pop(name) for name in _Bench.__dataclass_fields__ if name in words}
            return function(bench=_Bench(**shared), **words)

        return functools.reduce(lambda wrapped, name: _OPTIONS[name](wrapped), names[::-1], plugin_options(command))

    return decorate


_by = click.option("--by", default="anonymous", show_default=True, metavar="NAME", help="Who measures.")
_cards = click.option(
    "--cards", default="benchmarks/cards", show_default=True, metavar="DIR", help="Folder of the cards of data."
)


def _listed(lines: list[str]) -> list[str]:
    """Return the first of many lines, and the number of others."""
    more = [f"  and {len(lines) - _SHOWN} more (--json lists all)"] if len(lines) > _SHOWN else []
    return [*lines[:_SHOWN], *more]


@command.command("run")
@click.argument("suite")
@click.option(
    "--section", "sections", multiple=True, metavar="NAME", help="Measure one section; repeat it for several."
)
@_takes("workers", "cluster", "results", "data", "suites", "quiet")
@_by
@at_most_option
def run(bench: _Bench, suite: str, sections: tuple[str, ...], by: str, at_most: int | None) -> int:
    """Measure the missing and stale rows of a suite and add them to the results.

    Rows that are measurements of the current code, weights, options and data are not computed again. Started again
    after an interruption, it continues.

    \b
    p2o benchmark run smoke
    p2o benchmark run rigs --root DIR --workers 4 --by "A. Name"

    Exit status 1 if a calibration raised or is missing, 130 if interrupted.
    """  # noqa: D301  (click wants a real backspace: the examples keep their lines)
    from p2o_study.benchmark.measure import measure

    file = bench.open(suite)
    with bench.session() as words:
        done = measure(file, bench.rows, measured_by=by, sections=sections, at_most=at_most, **words)
    shared = f" ({done.shared} measured for other suites)" if done.shared else ""
    parts = [
        f"{done.added} rows added{shared}",
        f"{done.fresh} fresh",
        f"{done.crashed} crashed",
        f"{done.missing} missing",
    ]
    parts += [f"{done.unreadable} with unreadable frames"] if done.unreadable else []
    click.echo(f"{file.name}: {', '.join(parts)}; {bench.rows.path(file.name)}")
    if done.interrupted:
        click.echo("p2o: interrupted: the same command continues", err=True)
        return INTERRUPTED
    return 1 if done.crashed or done.missing or done.unreadable else 0


@command.command("status")
@click.argument("suite", required=False)
@_takes("workers", "results", "data", "suites", "quiet")
@json_option
def status(bench: _Bench, suite: str | None, as_json: bool) -> int:
    """List the rows of a suite, or of all, that are missing or whose method or data changed since.

    Nothing is computed. Datasets without a path are not compared: their rows are compared by method only.

    Exit status 1 if a row is missing or stale.
    """
    from p2o_study.benchmark.measure import status_of

    with bench.session(as_json) as words:
        states = [status_of(file, bench.rows, **words) for file in bench.opened(suite)]
    if as_json:
        print_json({"suites": [state.as_dict() for state in states]})
    else:
        click.echo("\n".join(map(_status_text, states)) or "no suites")
    return 1 if any(state.outdated for state in states) else 0


def _status_text(status: SuiteStatus) -> str:
    """Return the counts of a suite, and its missing and stale rows."""
    from p2o_study.benchmark.measure import State

    counts = [f"{status.count(state)} {state.value}" for state in State if status.count(state)]
    counts += [f"{len(status.removable)} surplus rows"] if status.removable else []
    counts += [f"{status.unreadable} with unreadable frames"] if status.unreadable else []
    lines = [f"{status.suite}: {', '.join(counts) or 'no rows'}"]
    if status.unchecked:
        lines.append(f"  without data (--root DIR or --data), compared by method only: {', '.join(status.unchecked)}")
    outdated = [(state, row, row.case.protocol) for row, state in status.outdated]
    lines += _listed([f"  {state}: {row.row}, {row.place}, {start}, seed {row.seed}" for state, row, start in outdated])
    return "\n".join(map(printable, lines))


@command.command("prune")
@click.argument("suite")
@click.option("--dry-run", is_flag=True, help="List the rows and remove none.")
@_takes("workers", "results", "data", "suites", "quiet")
@json_option
def prune(bench: _Bench, suite: str, dry_run: bool, as_json: bool) -> int:
    """Remove the rows that a suite no longer asks for, and those that a later row replaces; sort the others.

    Nothing is computed. Without their data, whether the suite has the frames of a row is unknown: only replaced rows
    are removed. Frames, cases, methods and environments that no row of any suite names are removed, too.

    \b
    p2o benchmark prune rigs --root DIR --dry-run
    """  # noqa: D301  (click wants a real backspace: the examples keep their lines)
    from p2o_study.benchmark.measure import status_of

    file, unused = bench.open(suite), 0
    with bench.session(as_json) as words:
        status = status_of(file, bench.rows, **words)
    rows = status.removable
    if not dry_run:
        bench.rows.rewrite(file.name, status.kept)
        unused = bench.rows.remove_unused()
    if as_json:
        removable = [{**row.named(), "finished": row.finished} for row in rows]
        print_json({"suite": file.name, "dry_run": dry_run, "rows": removable, "unused": unused})
        return 0
    lines = _listed([f"  {row.row}, {row.dataset} {row.place}, {row.case.protocol}, seed {row.seed}" for row in rows])
    counts = f"{len(rows)} rows" + (f" and {unused} unused frames, cases, methods and environments" if unused else "")
    done = "would be removed" if dry_run else "removed"
    click.echo("\n".join(map(printable, [*lines, f"{file.name}: {counts} {done}; {bench.rows.path(file.name)}"])))
    return 0


@command.command("recheck")
@click.argument("suite", required=False)
@click.option(
    "--sample", type=click.IntRange(min=0), default=30, show_default=True, metavar="N", help="Rows of each suite."
)
@click.option(
    "--seed", type=click.IntRange(0, _MAX_SEED), metavar="N", help="Seed of the sample (default: drawn at random)."
)
@_takes("workers", "results", "data", "suites", "quiet")
def recheck(bench: _Bench, suite: str | None, sample: int, seed: int | None) -> int:
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

    drawn, clean = secrets.randbelow(_MAX_SEED) if seed is None else seed, True
    try:
        with bench.session() as words:
            for file in bench.opened(suite):
                outcome = rechecked(file, bench.rows, sample=sample, seed=drawn, **words)
                click.echo("\n".join(map(printable, str(outcome).splitlines())))
                clean &= outcome.clean
    except KeyboardInterrupt:
        click.echo("p2o: interrupted", err=True)
        return INTERRUPTED
    return 0 if clean else 1


def _starts(file: Suite, bench: _Bench, section: str | None) -> Any:
    """Return the initial guesses of a suite, or of one section, by group, protocol and seed; frames are read."""
    from p2o_study.ablate import open_session
    from p2o_study.benchmark.score import starts_of

    with bench.session() as words, open_session(file, **words) as session:
        return starts_of(session.cells(), section)


_section = click.option("--section", metavar="NAME", help="One section of the suite (default: all).")


@command.command("starts")
@click.argument("suite")
@click.option("--out", required=True, metavar="FILE.csv", help="The file to write; with --for a new folder.")
@click.option("--for", "program", metavar="NAME", help="Write the inputs of an external program: a name or FILE.toml.")
@_section
@_takes("data", "suites", "quiet")
def starts(bench: _Bench, suite: str, out: str, program: str | None, section: str | None) -> int:
    """Write the initial guesses of a suite as CSV, or as the inputs of an external program.

    Each line is one calibration: group, protocol, seed, the names of its frames separated by ";", and the initial guess
    camera_from_lidar as m00 to m33 (row by row, metres). With --for, each calibration is a folder with its images,
    sweeps, camera and initial guess in the files that the program reads.

    \b
    p2o benchmark starts smoke --out starts.csv
    p2o benchmark starts smoke --for claim --out FOLDER
    """  # noqa: D301  (click wants a real backspace: the examples keep their lines)
    from p2o.files.whole_file import write_whole

    from p2o_study.benchmark.external_files import find_form, write_inputs
    from p2o_study.benchmark.score import starts_csv

    form = None if program is None else find_form(program, bench.plugins.registry())
    known = _starts(bench.open(suite), bench, section)
    if form is not None:
        count = write_inputs(Path(out), known, form)
        click.echo(printable(f"wrote {out}: {count} folders; in each of them run: {form.run}"))
        return 0
    write_whole(out, starts_csv(known).encode())
    click.echo(f"wrote {out}: {len(known)} initial guesses")
    return 0


@command.command("score")
@click.argument("poses")
@click.option("--suite", required=True, metavar="SUITE", help="The suite of the initial guesses.")
@click.option("--name", required=True, metavar="NAME", help="The name of the method in tables.")
@click.option("--from", "program", metavar="NAME", help="POSES is the folder of `starts --for NAME` with results.")
@click.option("--source", default="", metavar="TEXT", help="Where the method is described: a paper or an address.")
@click.option("--by", default="anonymous", show_default=True, metavar="NAME", help="Who measured; part of each row.")
@_section
@_takes("results", "data", "suites", "quiet")
def score(
    bench: _Bench, poses: str, suite: str, name: str, program: str | None, source: str, by: str, section: str | None
) -> int:
    """Add the poses of a method outside p2o to the results of a suite.

    POSES is a CSV file with the columns group, protocol and seed of `p2o benchmark starts`, and camera_from_lidar as
    m00 to m33 or as qx, qy, qz, qw, tx, ty, tz (scalar last, metres); optionally seconds. An empty pose is a refused
    calibration. Every calibration of the suite needs a line. With --from, the results in the folders of an external
    program are first written to poses.csv in POSES; an empty file is a refused calibration.

    \b
    p2o benchmark score poses.csv --suite smoke --name "PnP on boards"
    p2o benchmark score FOLDER --from claim --suite smoke --name CLAIM
    """  # noqa: D301  (click wants a real backspace: the examples keep their lines)
    from p2o.files.whole_file import write_whole

    from p2o_study.benchmark import score as external
    from p2o_study.benchmark.external_files import find_form, poses_csv

    path = Path(poses)
    if program is not None:
        text = poses_csv(path, find_form(program, bench.plugins.registry()))
        path /= "poses.csv"
        write_whole(path, text.encode())
    file = bench.open(suite)
    known = _starts(file, bench, section)
    labels = [row.label for row in file.all_rows()]
    rows = external.score(path, known, name, source=source, measured_by=by, known=labels)
    stored = bench.rows
    stored.make_folder()
    for row in rows:
        stored.put(file.name, row)
    refused = sum(row.estimate is None for row in rows)
    click.echo(f"{file.name}: {len(rows)} rows of '{name}' added, {refused} refused")
    return 0


@command.command("table")
@click.argument("suite")
@_section
@click.option("--commands", is_flag=True, help="Print the `p2o run` command that repeats one calibration of each row.")
@click.option("--figures", metavar="DIR", help="Also write figures: error over number of frames and initial error.")
@columns_option
@_takes("results", "data", "suites")
def table(
    bench: _Bench, suite: str, section: str | None, commands: bool, figures: str | None, columns: tuple[str, ...]
) -> int:
    """Print the tables of a suite in Markdown, from its rows; no data are needed.

    Means with 95 % intervals by bootstrap over independent groups, medians, refused calibrations, false accepts and
    coverage of the predicted errors. With --commands, --root or --data give the paths in the commands.

    \b
    p2o benchmark table rigs
    p2o benchmark table smoke --commands
    """  # noqa: D301  (click wants a real backspace: the examples keep their lines)
    from p2o_study.benchmark.repeat import repeat_text
    from p2o_study.benchmark.tables import Choice
    from p2o_study.rows import latest
    from p2o_study.tables import NOTES

    tables = bench.tables()(suite)
    if commands:
        rows = [row for row in latest(bench.rows.each(tables.suite.name)) if section in (None, row.section)]
        if not rows:
            expected = f"rows of {suite}" + ("" if section is None else f", section {section}")
            hint = "p2o benchmark run measures them; --results names another folder"
            raise InputError("there are no measured rows", where=Path(bench.results), expected=expected, hint=hint)
        click.echo(repeat_text(tables.suite.all_rows(), rows))
        return 0
    click.echo(tables.markdown(Choice(section=section, columns=columns or ("all",))))
    click.echo("\n".join(NOTES))
    if figures is not None:
        from p2o_study.report import write_figures
        from p2o_study.report.figures import figures_over

        lines = [line for key, line in tables.lines.items() if section in (None, key.section)]
        for path in write_figures(Path(figures), [*figures_over(tables.suite.name, tables.suite.name, lines)]):
            click.echo(path)
    return 0


@command.command("page")
@click.option("--out", required=True, metavar="FOLDER", help="The folder to write: index.html, and its runs in data.")
@_takes("results", "suites", "quiet")
@_cards
def page(bench: _Bench, out: str, cards: str) -> int:
    """Write one page of all suites: tables with top groups, plots, and the runs of each row; no data are needed.

    The page works offline, on a phone and without a server. It has filters by data set, initial error, number of
    frames, family and needs of the methods.

    \b
    p2o benchmark page --out p2o-out/benchmark/page
    """  # noqa: D301  (click wants a real backspace: the examples keep their lines)
    from p2o_study.benchmark.card import read_cards
    from p2o_study.benchmark.page import INDEX, write_page

    registry = bench.plugins.registry()
    tell = (lambda name: None) if bench.quiet else (lambda name: click.echo(f"suite {name}", err=True))
    known = read_cards(Path(cards)).values()
    shown, left_out = write_page(
        list(bench.opened()),
        bench.rows,
        Path(out),
        registry,
        cards=lambda table: {card.title: card.facts for card in known if card.covers(table)},
        on_suite=tell,
    )
    left = f", {left_out} rows left out" if left_out else ""
    click.echo(f"wrote {Path(out) / INDEX}: {len(shown)} rows, {sum(line.count for line in shown)} runs{left}")
    return 0


@command.command("cards")
@click.argument("name", required=False)
@_takes()
@_cards
def cards(bench: _Bench, name: str | None, cards: str) -> int:
    """Print the cards of data in Markdown.

    \b
    p2o benchmark cards waymo
    """  # noqa: D301  (click wants a real backspace: the examples keep their lines)
    from p2o.errors import UnknownNameError

    from p2o_study.benchmark.card import cards_text, read_cards

    known = read_cards(Path(cards))
    if name is not None and name not in known:
        raise UnknownNameError("card", name, known, where=cards)
    click.echo(cards_text(known if name is None else {name: known[name]}), nl=False)
    return 0


@command.command("record", context_settings={"ignore_unknown_options": True})
@click.argument("name")
@click.argument("measuring", nargs=-1, required=True, metavar="COMMAND", type=click.UNPROCESSED)
@_takes("results")
@_by
def record(bench: _Bench, name: str, measuring: tuple[str, ...], by: str) -> int:
    """Run a measuring command and record what it prints, for pages: figures that are no calibrations.

    The record states command, commit, date and machine. A page shows it between `<!-- record: NAME -->` and
    `<!-- /record -->` (`p2o benchmark docs`).

    \b
    p2o benchmark record structure python benchmarks/structure.py
    """  # noqa: D301  (click wants a real backspace: the examples keep their lines)
    from p2o_study.benchmark.record import recorded, write_record

    path = write_record(Path(bench.results), recorded(name, measuring, by))
    click.echo(f"wrote {path}")
    return 0


@command.command("docs")
@click.argument("pages", nargs=-1, metavar="[FILE.md]...")
@click.option("--check", is_flag=True, help="Change nothing; exit status 1 if a page differs from the rows or cards.")
@_takes("results", "suites")
@_cards
def docs(bench: _Bench, pages: tuple[str, ...], check: bool, cards: str) -> int:
    """Write the tables of marked parts of pages from rows and cards of data (default: README.md and docs).

    A table is marked by the lines `<!-- rows: SUITE -->`, or
    `<!-- rows: SUITE, SECTION; data: A, B; methods: X, Y -->`, and `<!-- /rows -->`; a record by
    `<!-- record: NAME -->` and `<!-- /record -->`; the cards by `<!-- cards -->` and `<!-- /cards -->`; figures that a
    suite quotes by `<!-- published: SUITE, SECTION -->` and `<!-- /published -->`; the methods of
    installed packages by `<!-- methods -->` and `<!-- /methods -->`. Without FILE.md it also writes the figures that
    `p2o methods --matrix` prints.
    """
    from p2o.files.input_file import read_text
    from p2o.files.whole_file import write_whole

    from p2o_study.benchmark.card import cards_text, read_cards
    from p2o_study.benchmark.marks import rendered
    from p2o_study.benchmark.overview import overview_files, overview_text
    from p2o_study.benchmark.published import published_text
    from p2o_study.benchmark.record import record_text
    from p2o_study.benchmark.tables import rows_text

    tables, registry = bench.tables(), bench.plugins.registry()
    writers = {
        "rows": rows_text(tables),
        "record": record_text(Path(bench.results)),
        "cards": lambda *_: cards_text(read_cards(Path(cards)), page=True),
        "published": published_text(bench.open),
        "methods": lambda *_: overview_text(registry, tables),
    }
    paths = [Path(page) for page in pages] or [Path("README.md"), *sorted(Path("docs").rglob("*.md"))]
    before = {path: read_text(path, "page") for path in paths}
    after = {path: rendered(text, str(path), writers) for path, text in before.items()}
    for path, text in () if pages else overview_files(registry, tables).items():
        before[path], after[path] = read_text(path, "page") if path.exists() else "", text
    different = 0
    for path, text in after.items():
        if text != before[path]:
            different += 1
            click.echo(f"{path}: {'differs from rows, records or cards' if check else 'written'}")
            if not check:
                write_whole(path, text.encode())
    click.echo(f"{different} pages {'differ' if check else 'changed'}")
    return 1 if check and different else 0
