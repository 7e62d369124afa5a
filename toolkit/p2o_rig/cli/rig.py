"""`p2o rig`: consistent extrinsics of all LiDARs and cameras of a body."""

from __future__ import annotations

import click
from p2o.cli.json_output import json_option, print_json
from p2o.cli.plugin_options import load, plugin_options
from p2o.errors import printable
from p2o.files.input_file import expanded
from p2o.files.whole_file import write_errors


@click.command("rig")
@click.argument("sensors", metavar="FILE")
@click.option("--out", type=click.Path(), metavar="DIR", help="Folder for rig.json, extrinsics.yaml and a figure.")
@json_option
@plugin_options
def command(sensors: str, out: str | None, as_json: bool, plugin: tuple[str, ...], block: tuple[str, ...]) -> int:
    """Combine results, sweeps of several LiDARs and known transforms to consistent extrinsics.

    FILE (YAML, JSON) lists LiDARs with their results of `p2o run` and data sets of their sweeps, and known transforms.
    Sweeps of each pair of LiDARs are aligned. All relative poses are edges of one graph, whose loops show which edge is
    wrong (docs/how-to/several-lidars.md).

    \b
    p2o run --data folder:top --rig --json > top.json
    p2o run --data folder:left --rig --json > left.json
    p2o rig sensors.yaml --out out

    Exit status 0 if all sensors have a pose and the verdict is trusted, 1 if not or if an edge was excluded, 2 for
    wrong input.
    """  # noqa: D301  (click wants a real backspace: the examples keep their lines)
    from p2o_rig.extrinsics import estimate_extrinsics
    from p2o_rig.outputs import as_dict, as_text, write_folder
    from p2o_rig.sensors_file import read_sensors

    folder = None if out is None else expanded(out)
    if folder is not None:
        with write_errors("the results", folder, "choose another folder"):
            folder.mkdir(parents=True, exist_ok=True)
    rig = estimate_extrinsics(read_sensors(sensors), load(plugin, block))
    print_json(as_dict(rig)) if as_json else click.echo(as_text(rig))
    if folder is not None:
        for path in write_folder(rig, folder):
            click.echo(printable(f"wrote {path}"), err=as_json)
    return 0 if rig.verdict.trusted and not rig.graph.contradictions else 1
