"""`p2o benchmark`: measure suites, list and confirm stale rows, score other methods, verify bundles, write tables."""

from __future__ import annotations

import json
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
from p2o.cli.json_output import json_option, print_json
from p2o.cli.plugin_options import plugin_options
from p2o.errors import printable

from p2o_study.cli.ablate import at_most_option, progress_shown

if TYPE_CHECKING:
    from p2o_study.benchmark.status import SuiteStatus
    from p2o_study.benchmark.suite import SuiteFile
    from p2o_study.benchmark.tables import SuiteTables
    from p2o_study.worker import Plugins

_SHOWN = 20
_MAX_SEED = 2**32 - 1


@click.group("benchmark")
def command() -> None:
    """Measure suites as rows of data, score external methods, verify bundles, write tables and a page.

    A suite is a file in benchmarks/suites, its rows are lines of JSON in benchmarks/results. docs/how-to/benchmark.md
    explains how to run a suite and how to enter a method.
    """


_results = click.option(
    "--results", default="benchmarks/results", show_default=True, metavar="DIR", help="Folder of the rows."
)
_suites = click.option(
    "--suites", default="benchmarks/suites", show_default=True, metavar="DIR", help="Folder of the suites."
)
_cards = click.option(
    "--cards", default="benchmarks/cards", show_default=True, metavar="DIR", help="Folder of the cards of data."
)
_quiet = click.option("--quiet", is_flag=True, help="No progress.")
_by = click.option("--by", default="anonymous", show_default=True, metavar="NAME", help="Who measures.")
_workers = click.option(
    "--workers", type=click.IntRange(min=1), default=1, show_default=True, metavar="N", help="Number of processes."
)


def _data_options(function: Callable[..., Any]) -> Callable[..., Any]:
    """Add the options that name the data of a suite."""
    many = "Run on these data; NAME selects one of several datasets."
    function = click.option("--data", multiple=True, metavar="[NAME=]DATASET:PATH", help=many)(function)
    text = "Folder with the data; the suite names the path of each dataset in it."
    return click.option("--root", metavar="DIR", help=text)(function)


def _opened(
    name: str, suites: str, data: tuple[str, ...], root: str | None, plugin: tuple[str, ...], block: tuple[str, ...]
) -> tuple[SuiteFile, Plugins]:
    """Return a suite on its data, and the plugins."""
    from p2o_study.benchmark.suite import find_suite
    from p2o_study.worker import Plugins

    plugins = Plugins.of(block, plugin)
    return find_suite(name, plugins.registry(), Path(suites)).on(data, root), plugins


def _names(suite: str | None, suites: str, data: tuple[str, ...]) -> list[str]:
    """Return the name of a suite, or those of all."""
    from p2o_study.benchmark.suite import suite_names

    if suite is None and data:
        raise click.UsageError("--data needs the name of a suite; --root is for all")
    return suite_names(Path(suites)) if suite is None else [suite]


@command.command("run")
@click.argument("suite")
@click.option(
    "--section", "sections", multiple=True, metavar="NAME", help="Measure one section; repeat it for several."
)
@_data_options
@_workers
@click.option(
    "--backend", type=click.Choice(["loky", "dask", "ray"]), default="loky", help="Backend that runs the jobs."
)
@click.option("--address", metavar="ADDRESS", help="Scheduler of an existing dask or ray cluster.")
@_by
@click.option("--store", metavar="DIR", help="Folder of unfinished work (default: p2o-out/benchmark/SUITE).")
@_results
@_suites
@at_most_option
@_quiet
@plugin_options
def run(
    suite: str,
    sections: tuple[str, ...],
    data: tuple[str, ...],
    root: str | None,
    workers: int,
    backend: Any,
    address: str | None,
    by: str,
    store: str | None,
    results: str,
    suites: str,
    at_most: int | None,
    quiet: bool,
    plugin: tuple[str, ...],
    block: tuple[str, ...],
) -> int:
    """Measure the missing and stale rows of a suite and add them to the results.

    Rows that are measurements of the current code, weights, options and data are not computed again. Started again
    after an interruption, it continues. After a change of code that cannot alter results, run p2o benchmark confirm
    first.

    \b
    p2o benchmark run smoke
    p2o benchmark run rigs --root DIR --workers 4 --by "A. Name"

    Exit status 1 if a calibration raised or is missing, 130 if interrupted.
    """  # noqa: D301  (click wants a real backspace: the examples keep their lines)
    from p2o_study.benchmark.measure import measure
    from p2o_study.benchmark.results import Results
    from p2o_study.parallel import Workers

    file, plugins = _opened(suite, suites, data, root, plugin, block)
    folder = Path("p2o-out") / "benchmark" / file.name if store is None else Path(store)
    with progress_shown(quiet) as (say, warn):
        done = measure(
            file,
            Results(Path(results)),
            folder,
            measured_by=by,
            sections=sections,
            plugins=plugins,
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
    click.echo(f"{file.name}: {', '.join(parts)}; {Results(Path(results)).path(file.name)}")
    if done.interrupted:
        click.echo("p2o: interrupted: the same command continues", err=True)
        return 130
    return 1 if done.crashed or done.missing or done.unreadable else 0


@command.command("status")
@click.argument("suite", required=False)
@_data_options
@_workers
@_results
@_suites
@json_option
@_quiet
@plugin_options
def status(
    suite: str | None,
    data: tuple[str, ...],
    root: str | None,
    workers: int,
    results: str,
    suites: str,
    as_json: bool,
    quiet: bool,
    plugin: tuple[str, ...],
    block: tuple[str, ...],
) -> int:
    """List the rows of a suite, or of all, that are missing or whose method or data changed since.

    Nothing is computed. Datasets without a path are not compared: their rows are compared by method only. Rows of an
    earlier version of their method are fresh if a sample confirmed that the outcomes are the same (p2o benchmark
    confirm); their number is stated.

    Exit status 1 if a row is missing or stale.
    """
    from p2o_study.ablate import ReadOptions
    from p2o_study.benchmark.results import Results
    from p2o_study.benchmark.status import status_of
    from p2o_study.parallel import Workers

    states = []
    with progress_shown(quiet or as_json) as (say, _):
        for name in _names(suite, suites, data):
            file, plugins = _opened(name, suites, data, root, plugin, block)
            known = Results(Path(results))
            options = ReadOptions(
                plugins=plugins, workers=Workers(workers), on_progress=say, on_warning=lambda text: None
            )
            states.append(status_of(file, known, options))
    if as_json:
        print_json({"suites": [state.as_dict() for state in states]})
    else:
        click.echo("\n".join(map(_status_text, states)) or f"no suites in {suites}")
    return 1 if any(state.outdated for state in states) else 0


def _status_text(status: SuiteStatus) -> str:
    """Return the counts of a suite, and its missing and stale rows."""
    from p2o_study.benchmark.plan import State

    counts = [f"{status.count(state)} {state.value}" for state in State if status.count(state)]
    if status.samples:
        low, high = min(status.samples), max(status.samples)
        size = f"a sample of {low}" if low == high else f"samples of {low} to {high}"
        counts[0] += f" (of them {len(status.samples)} confirmed by {size} rows)"
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
@_data_options
@_workers
@_results
@_suites
@json_option
@_quiet
@plugin_options
def prune(
    suite: str,
    dry_run: bool,
    data: tuple[str, ...],
    root: str | None,
    workers: int,
    results: str,
    suites: str,
    as_json: bool,
    quiet: bool,
    plugin: tuple[str, ...],
    block: tuple[str, ...],
) -> int:
    """Remove the rows that a suite no longer asks for, stale ones that were measured again, and unused methods.

    Nothing is computed, and fresh rows are never removed. A stale or crashed row is removed only if a later row of the
    same calibration did not crash. Without their data, rows are compared by label, initial error, seed and method:
    whether the suite has their frames is unknown. Methods that no row of any suite names are removed from
    methods.jsonl.

    \b
    p2o benchmark prune rigs --root DIR --dry-run
    """  # noqa: D301  (click wants a real backspace: the examples keep their lines)
    from p2o_study.ablate import ReadOptions
    from p2o_study.benchmark.prune import prunable
    from p2o_study.benchmark.results import Results
    from p2o_study.parallel import Workers

    file, plugins = _opened(suite, suites, data, root, plugin, block)
    known = Results(Path(results))
    with progress_shown(quiet or as_json) as (say, warn):
        options = ReadOptions(plugins=plugins, workers=Workers(workers), on_progress=say, on_warning=warn)
        rows = prunable(file, known, options)
    unused = known.unused_methods(one.row for one in rows)
    if rows and not dry_run:
        known.remove(file.name, (one.row for one in rows))
    if unused and not dry_run:
        known.remove_methods(unused)
    if as_json:
        removable = {"rows": [one.as_dict() for one in rows], "methods": sorted(unused)}
        content = {"suite": file.name, "dry_run": dry_run, **removable}
        print_json(content)
        return 0
    lines = [f"  {f.why.value}: {f.row.row}, {f.row.place}, {f.row.protocol}, seed {f.row.seed}" for f in rows[:_SHOWN]]
    lines += [f"  and {len(rows) - _SHOWN} more (--json lists all)"] if len(rows) > _SHOWN else []
    counts = f"{len(rows)} rows" + (f" and {len(unused)} unused methods" if unused else "")
    done = "would be removed" if dry_run else "removed"
    click.echo("\n".join(map(printable, [*lines, f"{file.name}: {counts} {done}; {known.path(file.name)}"])))
    return 0


@command.command("confirm")
@click.argument("suite", required=False)
@click.option(
    "--sample", type=click.IntRange(min=1), default=30, show_default=True, metavar="N", help="Rows of each method."
)
@click.option(
    "--seed", type=click.IntRange(0, _MAX_SEED), metavar="N", help="Seed of the sample (default: drawn at random)."
)
@_data_options
@_workers
@_by
@_results
@_suites
@_quiet
@plugin_options
def confirm(
    suite: str | None,
    sample: int,
    seed: int | None,
    data: tuple[str, ...],
    root: str | None,
    workers: int,
    by: str,
    results: str,
    suites: str,
    quiet: bool,
    plugin: tuple[str, ...],
    block: tuple[str, ...],
) -> int:
    """Confirm by samples that changed code of methods alters no result, so that their rows need no new measurement.

    For each method whose rows are stale only because its code changed, a random sample of its rows, spread over suites,
    data sets and sections, is computed again. If every outcome is the same (status, verdict, pose within 1e-6 rad and
    1e-6 m, predicted errors within 1e-6), the equivalence of the two versions is recorded, and the rows of the method
    on these suites and data sets are fresh. With no difference among n rows, at most 3/n of the rows differ (95 %).

    \b
    p2o benchmark confirm smoke
    p2o benchmark confirm --root DIR --sample 60 --workers 4

    Exit status 1 if a row differs, which is named: p2o benchmark run measures the rows of its method again. 130 if
    interrupted; the same command continues.
    """  # noqa: D301  (click wants a real backspace: the examples keep their lines)
    import secrets

    from p2o_study.ablate import ReadOptions
    from p2o_study.benchmark.confirm import confirmations
    from p2o_study.benchmark.results import Results
    from p2o_study.parallel import Workers
    from p2o_study.worker import Plugins

    files = [_opened(name, suites, data, root, plugin, block)[0] for name in _names(suite, suites, data)]
    confirmed = different = rows = 0
    try:
        with progress_shown(quiet) as (say, warn):
            options = ReadOptions(
                plugins=Plugins.of(block, plugin), workers=Workers(workers), on_progress=say, on_warning=warn
            )
            drawn = secrets.randbelow(_MAX_SEED) if seed is None else seed
            known = Results(Path(results))
            for outcome in confirmations(files, known, options, sample=sample, seed=drawn, measured_by=by):
                click.echo("\n".join(map(printable, str(outcome).splitlines())))
                different += bool(outcome.difference)
                confirmed += not outcome.difference
                rows += 0 if outcome.difference else outcome.of
    except KeyboardInterrupt:
        click.echo("p2o: interrupted: confirmed methods are kept, and the same command continues", err=True)
        return 130
    click.echo(f"{confirmed} methods with {rows} rows confirmed, {different} differ")
    return 1 if different else 0


def _starts(file: SuiteFile, plugins: Plugins, quiet: bool) -> Any:
    """Return the initial guesses of a suite by group, protocol and seed; frames are read."""
    from p2o_study.ablate import ReadOptions, read_cells
    from p2o_study.benchmark.entry import starts_of
    from p2o_study.benchmark.plan import Task

    with progress_shown(quiet) as (say, warn):
        cells = read_cells(file.study, ReadOptions(plugins=plugins, on_progress=say, on_warning=warn))
        # Poses of a rig need the transforms between its cameras.
        tasks = (Task.of(file.name, cell) for cell in cells if not cell.group.rig)
        return starts_of(task for task in tasks if task is not None)


@command.command("starts")
@click.argument("suite")
@click.option("--out", required=True, metavar="FILE.csv", help="The file to write.")
@_data_options
@_suites
@_quiet
@plugin_options
def starts(
    suite: str,
    out: str,
    data: tuple[str, ...],
    root: str | None,
    suites: str,
    quiet: bool,
    plugin: tuple[str, ...],
    block: tuple[str, ...],
) -> int:
    """Write the initial guesses of a suite as CSV, for a method outside p2o.

    Each line is one calibration: group, protocol, seed, the names of its frames separated by ";", and the initial guess
    camera_from_lidar as m00 to m33 (row by row, metres).

    \b
    p2o benchmark starts smoke --out starts.csv
    """  # noqa: D301  (click wants a real backspace: the examples keep their lines)
    from p2o.files.whole_file import write_whole

    from p2o_study.benchmark.entry import starts_csv

    file, plugins = _opened(suite, suites, data, root, plugin, block)
    known = _starts(file, plugins, quiet)
    write_whole(out, starts_csv(known).encode())
    click.echo(f"wrote {out}: {len(known)} initial guesses")
    return 0


@command.command("score")
@click.argument("poses")
@click.option("--suite", required=True, metavar="SUITE", help="The suite of the initial guesses.")
@click.option("--name", required=True, metavar="NAME", help="The name of the method in tables.")
@click.option("--source", default="", metavar="TEXT", help="Where the method is described: a paper or an address.")
@click.option("--by", default="anonymous", show_default=True, metavar="NAME", help="Who measured; part of each row.")
@_data_options
@_results
@_suites
@_quiet
@plugin_options
def score(
    poses: str,
    suite: str,
    name: str,
    source: str,
    by: str,
    data: tuple[str, ...],
    root: str | None,
    results: str,
    suites: str,
    quiet: bool,
    plugin: tuple[str, ...],
    block: tuple[str, ...],
) -> int:
    """Add the poses of a method outside p2o to the results of a suite.

    POSES is a CSV file with the columns group, protocol and seed of `p2o benchmark starts`, and camera_from_lidar as
    m00 to m33 or as qx, qy, qz, qw, tx, ty, tz (scalar last, metres); optionally seconds. An empty pose is a refused
    calibration. Every calibration of the suite needs a line.

    \b
    p2o benchmark score poses.csv --suite smoke --name "PnP on boards"
    """  # noqa: D301  (click wants a real backspace: the examples keep their lines)
    from p2o_study.benchmark import entry
    from p2o_study.benchmark.results import Results

    file, plugins = _opened(suite, suites, data, root, plugin, block)
    known = _starts(file, plugins, quiet)
    labels = [row.label for row in file.rows]
    rows = entry.score(Path(poses), known, name, source=source, measured_by=by, known=labels)
    frames = {frame.line: frame for start in known.values() for frame in start.task.frames}
    Results(Path(results)).add(file.name, rows, frames.values())
    refused = sum(row.estimate is None for row in rows)
    click.echo(f"{file.name}: {len(rows)} rows of '{name}' added, {refused} refused")
    return 0


@command.command("bundle")
@click.argument("suite")
@click.option("--out", metavar="FILE.zip", help="The file to write (default: SUITE.zip).")
@_results
@_suites
@_quiet
@plugin_options
def bundle(
    suite: str, out: str | None, results: str, suites: str, quiet: bool, plugin: tuple[str, ...], block: tuple[str, ...]
) -> int:
    """Pack the last measured rows of a suite: poses, frame digests, errors and environment in one zip file.

    Equivalences of earlier versions of the methods (p2o benchmark confirm) are packed with the rows that need them.
    """
    from p2o_study.benchmark.bundle import pack
    from p2o_study.benchmark.results import Results

    file, _ = _opened(suite, suites, (), None, plugin, block)
    path = Path(f"{file.name}.zip" if out is None else out)
    count = pack(Results(Path(results)), file.name, path)
    if not quiet:
        click.echo(f"wrote {path}: {count} rows")
    return 0


@command.command("verify")
@click.argument("bundle")
@click.option("--suite", metavar="SUITE", help="The suite (default: that of the bundle, if it is in --suites).")
@click.option(
    "--sample", type=click.IntRange(min=0), default=5, show_default=True, metavar="N", help="Rows to compute."
)
@_data_options
@_workers
@_suites
@_quiet
@plugin_options
def verify(
    bundle: str,
    suite: str | None,
    sample: int,
    data: tuple[str, ...],
    root: str | None,
    workers: int,
    suites: str,
    quiet: bool,
    plugin: tuple[str, ...],
    block: tuple[str, ...],
) -> int:
    """Verify a bundle and print its certificate.

    Every error is computed again from its pose. Where the data are on this machine, frame digests and initial guesses
    are compared with them, and a random sample of rows is computed again. Rows of earlier versions of a method that the
    bundle declares equal to the version here are part of the sample.

    \b
    p2o benchmark verify smoke.zip --sample 10

    Exit status 1 if the bundle is refused, 2 if it is not a bundle.
    """  # noqa: D301  (click wants a real backspace: the examples keep their lines)
    from p2o_study.benchmark import bundle as bundles
    from p2o_study.benchmark.suite import suite_names
    from p2o_study.parallel import Workers
    from p2o_study.worker import Plugins

    name = bundles.read_bundle(Path(bundle)).manifest.suite if suite is None else suite
    file, plugins = None, Plugins.of(block, plugin)
    if suite is not None or name in suite_names(Path(suites)):
        file, plugins = _opened(name, suites, data, root, plugin, block)
    with progress_shown(quiet) as (say, warn):
        certificate = bundles.verify(
            Path(bundle),
            file,
            sample=sample,
            plugins=plugins,
            workers=Workers(workers),
            on_progress=say,
            on_warning=warn,
        )
    click.echo("\n".join(map(printable, str(certificate).splitlines())))
    return 1 if certificate.failures else 0


def _tables(suites: str, results: str, plugins: Plugins) -> Callable[[str], SuiteTables]:
    """Return the function that reads the tables of a suite, once each."""
    from p2o_study.benchmark.results import Results
    from p2o_study.benchmark.suite import find_suite
    from p2o_study.benchmark.tables import SuiteTables

    @cache
    def tables(suite: str) -> SuiteTables:
        return SuiteTables.read(find_suite(suite, plugins.registry(), Path(suites)), Results(Path(results)))

    return tables


@command.command("table")
@click.argument("suite")
@click.option("--section", metavar="NAME", help="One section of the suite (default: all).")
@_results
@_suites
@plugin_options
def table(
    suite: str, section: str | None, results: str, suites: str, plugin: tuple[str, ...], block: tuple[str, ...]
) -> int:
    """Print the tables of a suite in Markdown, from its rows; no data are needed.

    Means with 95 % intervals by bootstrap over independent groups, medians, refused calibrations, false accepts and
    coverage of the predicted errors.
    """
    from p2o_study.benchmark.tables import NOTE, Choice
    from p2o_study.worker import Plugins

    tables = _tables(suites, results, Plugins.of(block, plugin))(suite)
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
@plugin_options
def page(
    out: str,
    overlays: bool,
    results: str,
    suites: str,
    cards: str,
    quiet: bool,
    plugin: tuple[str, ...],
    block: tuple[str, ...],
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
    from p2o_study.benchmark.results import Results
    from p2o_study.benchmark.suite import find_suite, suite_names
    from p2o_study.worker import Plugins

    registry = Plugins.of(block, plugin).registry()
    files = [find_suite(name, registry, Path(suites)) for name in suite_names(Path(suites))]
    tell = (lambda name: None) if quiet else (lambda name: click.echo(f"suite {name}", err=True))
    drawing = Overlays(registry) if overlays else None
    known = read_cards(Path(cards)).values()
    written = write_page(
        files,
        Results(Path(results)),
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
@plugin_options
def docs(
    pages: tuple[str, ...],
    check: bool,
    results: str,
    suites: str,
    cards: str,
    plugin: tuple[str, ...],
    block: tuple[str, ...],
) -> int:
    """Write the tables of marked parts of pages from rows and cards of data (default: README.md and docs).

    A table is marked by the lines `<!-- rows: SUITE -->`, or
    `<!-- rows: SUITE, SECTION; data: A, B; methods: X, Y -->`, and `<!-- /rows -->`; one figure by
    `<!-- value: SUITE; SECTION; METHOD; DATA; NAME -->` and `<!-- /value -->`; a record by `<!-- record: NAME -->` and
    `<!-- /record -->`; the cards by `<!-- cards -->` and `<!-- /cards -->`.
    """
    from p2o.files.whole_file import write_whole

    from p2o_study.benchmark.card import read_cards, with_cards
    from p2o_study.benchmark.record import with_records
    from p2o_study.benchmark.tables import pages_with_marks, rendered
    from p2o_study.worker import Plugins

    paths = [Path(page) for page in pages] or [Path("README.md"), *sorted(Path("docs").rglob("*.md"))]
    tables = _tables(suites, results, Plugins.of(block, plugin))
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
