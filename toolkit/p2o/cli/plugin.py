"""`p2o plugin new`: a package of your own to begin with."""

from __future__ import annotations

from pathlib import Path

import click

from p2o.cli.plugin_options import load

_SLOTS = (
    "image-extractor",
    "cloud-extractor",
    "matcher",
    "solver",
    "initializer",
    "calibrator",
    "accumulator",
    "dataset",
    "exporter",
)
"""Said here too, so that `p2o plugin new --help` loads nothing."""


@click.group("plugin")
def command() -> None:
    """Write a plugin of your own to begin with: a package with one method."""


@command.command("new")
@click.argument("name")
@click.option("--slot", type=click.Choice(_SLOTS), default=_SLOTS[0], show_default=True, help="What it offers.")
@click.option("--out", default=".", metavar="DIR", help="Folder in which the folder NAME is made; the current one.")
def new(name: str, slot: str, out: str) -> int:
    """Write the package NAME with one small method that works, its tests, and a workflow that checks it.

    NAME is that of the distribution and of the method: a-z, 0-9 and single -, such as acme-edges. A folder that is
    there already is left alone.
    """
    from p2o.cli.new_plugin import SLOT_WORDS, NewPlugin

    plugin = NewPlugin(name, SLOT_WORDS[slot])
    plugin.check_free(load((), ()))
    root = plugin.write(Path(out))
    click.echo(f"wrote {root}:")
    for path in sorted(plugin.files()):
        click.echo(f"  {path}")
    click.echo(f"\ntry it, before it is installed:\n  cd {root}\n  {plugin.tried}")
    click.echo('then:\n  pip install -e ".[test]"\n  python -m pytest')
    click.echo("\nThe method is yours to replace; LICENSE is empty until you choose one.")
    return 0
