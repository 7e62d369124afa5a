"""`p2o pick`: pairs of pixels and LiDAR points, clicked on a page that is served to this machine."""

from __future__ import annotations

from pathlib import Path

import click
from p2o.cli.plugin_options import data_argument, load, plugin_options


@click.command("pick")
@data_argument("The data.")
@click.option("--frames", default="all", metavar="SPEC", help="Which frames, as in `p2o run` (default: all).")
@click.option(
    "--out",
    required=True,
    type=click.Path(),
    metavar="FILE",
    help="File of pairs, .yaml or .json; extended if present.",
)
@click.option("--port", default=0, type=click.IntRange(0, 65535), metavar="N", help="Port (default: any free one).")
@click.option("--no-browser", is_flag=True, help="Do not open a browser; the address is printed either way.")
@click.option("--set", "settings", multiple=True, metavar="data.FIELD=VALUE", help="An option of the dataset.")
@plugin_options
def command(
    data: str,
    frames: str,
    out: str,
    port: int,
    no_browser: bool,
    settings: tuple[str, ...],
    plugin: tuple[str, ...],
    block: tuple[str, ...],
) -> int:
    """Pick points in image and sweep by hand, on a page in the browser.

    \b
    p2o pick kitti-raw:PATH --frames 0 --out pairs.yaml
    p2o run kitti-raw:PATH --frames 0 --calibrator picked --set calibrator.pairs=pairs.yaml

    The page is served to this machine alone. The file is written after every change; "done" on the page, or Ctrl-C
    here, ends it. Exit status 1 if there are no pairs. Needs viser: pip install "viser>=1.1".
    """  # noqa: D301  (click wants a real backspace: the examples keep their lines)
    from p2o.frames.selection import select
    from p2o.run.recipe import open_dataset
    from p2o.run.words import parse_settings

    from p2o_pages.pick.server import PickServer
    from p2o_pages.pick.session import PickSession
    from p2o_pages.server import require_viser

    require_viser("p2o pick")
    dataset = open_dataset(data, load(plugin, block), parse_settings(settings).get("data", {}))
    indices = select(dataset.names, frames, where="--frames", skipped=dataset.skipped)
    session = PickSession(dataset, [dataset.names[index] for index in indices], indices, Path(out))
    with PickServer(session, port) as server:
        server.serve(f"pick at {server.url} (done there, or Ctrl-C here, ends it)", browser=not no_browser)
    click.echo(f"{session.count} pairs of {len(session.names)} frames in {session.path}")
    if session.count:
        click.echo(f"next: p2o run --data {data} --calibrator picked --set calibrator.pairs={session.path}")
    return 0 if session.count else 1
