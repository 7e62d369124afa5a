"""`p2o report`: the tables, figures and page of the studies in a folder, or the page of a run."""

from __future__ import annotations

import contextlib
import sys
from collections.abc import Callable, Iterator

import click

from p2o.cli.plugin_options import load, plugin_options
from p2o.errors import InputError, printable


@click.command("report")
@click.argument("folder", metavar="DIR", type=click.Path())
@click.option("--study", "studies", multiple=True, metavar="NAME", help="Report this study (default: all in DIR).")
@click.option(
    "--data",
    multiple=True,
    metavar="[NAME=]DATASET:PATH",
    help="Where the frames are: draws them before and after. NAME tells which dataset of the study, if it has several.",
)
@click.option("--out", type=click.Path(), metavar="DIR", help="Write here (default: report in DIR).")
@click.option(
    "--overlays",
    type=click.IntRange(min=0),
    default=12,
    show_default=True,
    metavar="N",
    help="With --data: draw at most N frames of each row, the worst first.",
)
@click.option("--quiet", is_flag=True, help="No progress.")
@plugin_options
def command(
    folder: str,
    studies: tuple[str, ...],
    data: tuple[str, ...],
    out: str | None,
    overlays: int,
    quiet: bool,
    plugin: tuple[str, ...],
    block: tuple[str, ...],
) -> int:
    """Write tables, figures and a page about the studies that `p2o ablate` left in DIR.

    Of a folder that `p2o run --out` has written it writes the page of the run, result.html, anew.

    \b
    report.html    everything in one file that works offline: sort, filter, look at the worst runs and at single frames
    report.md      tables with intervals, and the figures
    report.tex     the tables for a paper
    *.png *.svg    errors by axis, convergence, errors by frame

    The plots of the page need plotly (pip install "plotly>=6"); all the rest is written without it.
    """  # noqa: D301  (click wants a real backspace: the list keeps its lines)
    from p2o.files.input_file import expanded
    from p2o.report import write_report
    from p2o.report.run_page import RUN, write_page_of_folder
    from p2o.study.store import FILE

    root = expanded(folder)
    if (root / RUN).exists() and not (root / FILE).exists():
        if studies or data:
            said = "--study" if studies else "--data"
            raise InputError(
                "this folder holds a run, and a run has no studies", where=folder, expected=f"no {said} beside it"
            )
        click.echo(write_page_of_folder(root, None if out is None else expanded(out)))
        return 0
    registry = load(plugin, block) if data else None
    with _progress(quiet) as shown:
        written = write_report(
            folder,
            out,
            studies=studies,
            data=data,
            overlays=overlays,
            registry=registry,
            on_progress=shown,
            on_warning=lambda text: click.echo(f"p2o: {text}", err=True),
        )
    for path in written:
        click.echo(path)
    return 0


@contextlib.contextmanager
def _progress(quiet: bool) -> Iterator[Callable[[str, int, int], None]]:
    """Yield what shows what is drawn: a line on stderr when it is a terminal, nothing otherwise."""
    if quiet or not sys.stderr.isatty():
        yield lambda what, done, total: None
        return
    from rich.console import Console
    from rich.markup import escape

    with Console(stderr=True).status("reading the studies") as status:
        yield lambda what, done, total: status.update(f"drawing {done + 1} of {total}: {escape(printable(what))}")
