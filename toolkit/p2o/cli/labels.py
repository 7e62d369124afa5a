"""`p2o labels`: what frames teach a method that learns, as files and as pictures."""

from __future__ import annotations

import click

from p2o.cli.plugin_options import load
from p2o.cli.training_data import training_data_options
from p2o.errors import printable


@click.command("labels")
@training_data_options
@click.option("--draw", is_flag=True, help="Draw the labels on a PNG beside each file.")
def command(
    method: str,
    data: tuple[str, ...],
    frames: tuple[str, ...],
    out: str,
    draw: bool,
    quiet: bool,
    plugin: tuple[str, ...],
    block: tuple[str, ...],
) -> int:
    """Write what frames teach a method that learns, one file a frame, and print the paths.

    \b
    p2o labels p2ornet --data kitti-raw:PATH --frames @splits.json#train --out labels --draw

    Files that are there are kept: an interrupted command goes on. docs/training.md explains labels.
    """  # noqa: D301  (click wants a real backspace: the examples keep their lines)
    from p2o.cli.out_dir import OutDir
    from p2o.cli.training_progress import shown
    from p2o.host.guard import trainer_of
    from p2o.learn.label_files import sources_of, trainable, write_labels

    registry = load(plugin, block)
    offer = trainable(method, registry)
    sources = sources_of(offer, data, frames, registry)
    root = OutDir.prepared(out).root
    with shown(quiet) as show:
        try:
            files = write_labels(trainer_of(offer), sources, root, draw=draw, on_progress=show.label)
        except KeyboardInterrupt:
            click.echo("p2o: interrupted: the same command goes on from here", err=True)
            return 130
    for path in (path for paths in files for path in paths):
        click.echo(printable(path))
    return 0
