"""`p2o report`: the tables, figures and page of the studies in a folder."""

from __future__ import annotations

import click

from p2o.cli.plugin_options import load, plugin_options


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

    \b
    report.html    everything in one file that works offline: sort, filter, look at single frames
    report.md      tables with intervals, and the figures
    report.tex     the tables for a paper
    *.png *.svg    errors by axis, convergence, errors by frame

    The page needs plotly: pip install plotly.
    """  # noqa: D301  (click wants a real backspace: the list keeps its lines)
    from p2o.report import write_report

    registry = load(plugin, block) if data else None
    for path in write_report(folder, out, studies=studies, data=data, overlays=overlays, registry=registry):
        click.echo(path)
    return 0
