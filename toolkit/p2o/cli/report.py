"""`p2o report`: the tables, figures and page of the studies in a folder, or the page of a run."""

from __future__ import annotations

import click

from p2o.cli.plugin_options import load, plugin_options
from p2o.errors import InputError


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
@plugin_options
def command(
    folder: str,
    studies: tuple[str, ...],
    data: tuple[str, ...],
    out: str | None,
    overlays: int,
    plugin: tuple[str, ...],
    block: tuple[str, ...],
) -> int:
    """Write tables, figures and a page about the studies that `p2o ablate` left in DIR.

    Of a folder that `p2o run --out` has written it writes the page of the run, result.html, anew.

    \b
    report.html    everything in one file that works offline: sort, filter, look at single frames
    report.md      tables with intervals, and the figures
    report.tex     the tables for a paper
    *.png *.svg    errors by axis, convergence, errors by frame

    The page needs plotly: pip install plotly.
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
    for path in write_report(folder, out, studies=studies, data=data, overlays=overlays, registry=registry):
        click.echo(path)
    return 0
