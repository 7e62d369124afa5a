"""`p2o simulate`: write synthetic frames to disk in the layout of a real data set."""

from __future__ import annotations

import importlib
import os
from pathlib import Path

import click
from p2o import InputError
from p2o.cli.plugin_options import load, plugin_options
from p2o.reading import expanded, printable

LAYOUTS = ("kitti-raw", "vkitti2", "folder")


@click.command("simulate")
@click.argument("out", type=click.Path())
@click.option("--layout", required=True, type=click.Choice(LAYOUTS), help="Data set whose layout is written.")
@click.option(
    "--set",
    "settings",
    multiple=True,
    metavar="FIELD=VALUE",
    help="Option of the data set `synthetic` (`p2o methods synthetic` lists them).",
)
@click.option("--seed", type=click.IntRange(min=0), metavar="N", help="Seed of the scenes and of all noise.")
@click.option("--force", is_flag=True, help="Write into a folder that is not empty; its other files are kept.")
@plugin_options
def command(
    out: str,
    layout: str,
    settings: tuple[str, ...],
    seed: int | None,
    force: bool,
    plugin: tuple[str, ...],
    block: tuple[str, ...],
) -> int:
    """Write synthetic frames to the folder OUT and print their names.

    \b
    p2o simulate out --layout kitti-raw --set scenes=20 --seed 1
    p2o run --data kitti-raw:out --perturb "2deg 0.15m"

    The frames are those of the data set `synthetic`; data that a layout cannot store are lost (docs/datasets.md).
    """  # noqa: D301  (click wants a real backspace: the examples keep their lines)
    from p2o.run.recipe import open_dataset
    from p2o.run.words import parse_fields

    fields = [text.strip().removeprefix("data.") for text in settings]
    options = parse_fields(fields, {} if seed is None else {"seed": seed}, example="scenes=40")
    if layout == "kitti-raw" and "deskew" in options:
        # The writer reverses the motion compensation, so that it must not be disabled.
        raise InputError("kitti-raw sweeps are always written raw", where="--set", expected="no deskew", got="deskew")
    dataset = open_dataset("synthetic:", load(plugin, block), options)
    root = _prepared(expanded(out), force)
    writer = importlib.import_module(f"p2o_sim.write.{layout.replace('-', '_')}")
    for name in writer.write((dataset[index] for index in range(len(dataset))), root):
        click.echo(printable(name))
    click.echo(printable(f"{len(dataset)} frames written; read them with --data {layout}:{out}"), err=True)
    return 0


def _prepared(root: Path, force: bool) -> Path:
    """Create the folder if necessary; raises InputError if it is not empty or not writable."""
    try:
        if not force and root.is_dir() and any(root.iterdir()):
            hint = "add --force to write into it"
            raise InputError("the folder is not empty", where=root, expected="a new or an empty folder", hint=hint)
        root.mkdir(parents=True, exist_ok=True)
        probe = root / f".p2o-{os.getpid()}"
        probe.write_bytes(b"")
        probe.unlink()
    except OSError as problem:
        got = problem.strerror or str(problem)
        hint = "choose another folder"
        raise InputError("cannot write the data set", where=problem.filename or root, got=got, hint=hint) from problem
    return root
