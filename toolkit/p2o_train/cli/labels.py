"""`p2o labels`: write training labels of frames, as files and as images."""

from __future__ import annotations

from typing import Any

import click
from p2o.cli.plugin_options import load
from p2o.errors import printable

from p2o_train.cli.progress import shown, training_data_options


@click.command("labels")
@training_data_options
@click.option("--draw", is_flag=True, help="Also write a PNG image of the labels for each file.")
def command(
    method: str, data: tuple[str, ...], frames: tuple[str, ...], out: str, draw: bool, quiet: bool, **plugins: Any
) -> int:
    """Write the training labels of frames for a method, one file per frame, and print the paths.

    \b
    p2o labels p2ornet --data kitti-raw:PATH --frames @splits.json#train --out labels --draw

    Existing files are kept, so that an interrupted command continues. docs/training.md explains labels.
    """  # noqa: D301  (click wants a real backspace: the examples keep their lines)
    from p2o.cli.out_dir import OutDir

    from p2o_train.guarded_trainer import trainer_of
    from p2o_train.train import sources_of, trainable, write_labels

    registry = load(**plugins)
    offer = trainable(method, registry)
    sources = sources_of(offer, data, frames, registry)
    root = OutDir.prepared(out).root
    with shown(quiet) as show:
        try:
            files = write_labels(trainer_of(offer), sources, root, draw=draw, on_progress=show.label)
        except KeyboardInterrupt:
            click.echo("p2o: interrupted: the same command continues", err=True)
            return 130
    for path in (path for paths in files for path in paths):
        click.echo(printable(path))
    return 0
