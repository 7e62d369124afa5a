"""`p2o simulate`: synthetic streets written to disk in the layout of a real dataset."""

from __future__ import annotations

import importlib
import os
from pathlib import Path
from typing import TYPE_CHECKING

import click

from p2o.cli.plugin_options import load, plugin_options
from p2o.errors import InputError, printable
from p2o.files.input_file import expanded

if TYPE_CHECKING:
    from types import ModuleType

LAYOUTS = ("kitti-raw", "vkitti2", "folder")


@click.command("simulate")
@click.argument("out", type=click.Path())
@click.option("--layout", required=True, type=click.Choice(LAYOUTS), help="The dataset that shall read it.")
@click.option(
    "--set",
    "settings",
    multiple=True,
    metavar="FIELD=VALUE",
    help="An option of the synthetic streets (`p2o methods synthetic` lists them).",
)
@click.option("--seed", type=click.IntRange(min=0), metavar="N", help="Seed of the streets and of all noise.")
@click.option("--force", is_flag=True, help="Write into a folder that is not empty; other files in it stay.")
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
    """Write synthetic streets to the folder OUT, frame by frame, and print the names of the frames.

    \b
    p2o simulate out --layout kitti-raw --set scenes=20 --seed 1
    p2o run --data kitti-raw:out --perturb "2deg 0.15m"

    They are the frames of the dataset `synthetic`; what a layout has no place for is lost (docs/datasets.md).
    """  # noqa: D301  (click wants a real backspace: the examples keep their lines)
    from p2o.run.recipe import open_dataset
    from p2o.run.words import parse_fields

    fields = [text.strip().removeprefix("data.") for text in settings]
    options = parse_fields(fields, {} if seed is None else {"seed": seed}, example="scenes=40")
    if layout == "kitti-raw" and "deskew" in options:
        # The writer undoes the correction of the sweep, so it has to know that there is one.
        raise InputError(
            "kitti-raw sweeps are written raw in any case", where="--set", expected="no deskew", got="deskew"
        )
    dataset = open_dataset("synthetic:", load(plugin, block), options)
    root = _prepared(expanded(out), force)
    for name in _writer(layout).write((dataset[index] for index in range(len(dataset))), root):
        click.echo(printable(name))
    click.echo(printable(f"{len(dataset)} frames written; read them with --data {layout}:{out}"), err=True)
    return 0


def _writer(layout: str) -> ModuleType:
    return importlib.import_module(f"p2o.simulate.write_{layout.replace('-', '_')}")


def _prepared(root: Path, force: bool) -> Path:
    """Return the folder, made if need be; InputError at once where it is in use or cannot be written."""
    try:
        if not force and root.is_dir() and any(root.iterdir()):
            raise InputError(
                "the folder is not empty",
                where=root,
                expected="a new or an empty folder",
                hint="add --force to write into it",
            )
        root.mkdir(parents=True, exist_ok=True)
        probe = root / f".p2o-{os.getpid()}"
        probe.write_bytes(b"")
        probe.unlink()
    except OSError as problem:
        raise InputError(
            "cannot write the dataset",
            where=problem.filename or root,
            got=problem.strerror or str(problem),
            hint="choose another folder",
        ) from problem
    return root
