"""`p2o report`: the tables, figures and page of the studies in a folder, or the page of a run."""

from __future__ import annotations

import click
from p2o.cli.plugin_options import load, plugin_options
from p2o.cli.progress import status_line
from p2o.errors import InputError

from p2o_study.cli.ablate import columns_option


@click.command("report")
@click.argument("folder", metavar="DIR", type=click.Path())
@click.option("--study", "studies", multiple=True, metavar="NAME", help="Report this study (default: all in DIR).")
@click.option(
    "--data",
    multiple=True,
    metavar="[NAME=]DATASET:PATH",
    help="The data, to draw overlays before and after. NAME selects one of several datasets of the study.",
)
@click.option("--out", type=click.Path(), metavar="DIR", help="Folder to write to (default: report in DIR).")
@click.option(
    "--overlays",
    type=click.IntRange(min=0),
    default=12,
    show_default=True,
    metavar="N",
    help="With --data: draw at most N frames of each row, the worst first.",
)
@columns_option
@click.option("--quiet", is_flag=True, help="No progress.")
@plugin_options
def command(
    folder: str,
    studies: tuple[str, ...],
    columns: tuple[str, ...],
    data: tuple[str, ...],
    out: str | None,
    overlays: int,
    quiet: bool,
    plugin: tuple[str, ...],
    block: tuple[str, ...],
) -> int:
    """Write tables, figures and a page about the studies of `p2o ablate --out DIR`.

    For a folder of `p2o run --out`, write the page of the run, result.html, again.

    \b
    report.html    one file that works offline: sort, filter, inspect the worst runs and single frames
    report.md      tables with intervals, and the figures
    report.tex     the tables for a paper
    *.png *.svg *.pdf    errors by axis, convergence, errors by frame, over the number of frames and the initial error
    """  # noqa: D301  (click wants a real backspace: the list keeps its lines)
    from p2o.files.input_file import expanded
    from p2o.page.run_page import RUN, write_page_of_folder

    from p2o_study.report import write_report
    from p2o_study.rows import Rows

    root = expanded(folder)
    if (root / RUN).exists() and not Rows(root).studies:
        if studies or data:
            option = "--study" if studies else "--data"
            raise InputError("the folder contains a run without studies", where=folder, expected=f"no {option}")
        click.echo(write_page_of_folder(root, None if out is None else expanded(out)))
        return 0
    registry = load(plugin, block) if data else None
    with status_line("reading the studies", quiet=quiet) as show:
        written = write_report(
            folder,
            out,
            studies=studies,
            data=data,
            overlays=overlays,
            columns=columns,
            registry=registry,
            on_progress=lambda name, done, total: show(f"drawing {done + 1} of {total}: {name}"),
        )
    for path in written:
        click.echo(path)
    return 0
