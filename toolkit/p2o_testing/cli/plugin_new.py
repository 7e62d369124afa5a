"""`p2o plugin new`: create a package with a small working method."""

from __future__ import annotations

from pathlib import Path

import click
from p2o.cli.plugin_options import load
from p2o.host.slots import Kind

SLOTS = {kind.value.replace(" ", "-"): kind for kind in Kind}
"""Kinds of methods by their words on the command line."""


@click.command("new")
@click.argument("name")
@click.option(
    "--slot",
    type=click.Choice(list(SLOTS)),
    default=next(iter(SLOTS)),
    show_default=True,
    help="The slot of its method.",
)
@click.option("--out", default=".", metavar="DIR", help="Parent of the new folder NAME (default: the current folder).")
def command(name: str, slot: str, out: str) -> int:
    """Create the package NAME with a small working method, its tests, and a workflow that checks it.

    NAME is that of the distribution and of the method: a-z, 0-9 and single -, such as acme-edges. An existing folder is
    not changed.
    """
    from p2o_testing.new_plugin import NewPlugin

    plugin = NewPlugin(name, SLOTS[slot])
    plugin.check_free(load((), ()))
    root = plugin.write(Path(out))
    click.echo(f"wrote {root}:")
    for path in sorted(plugin.files()):
        click.echo(f"  {path}")
    click.echo(f"\ntest it before it is installed:\n  cd {root}\n  {plugin.tried}")
    click.echo('then:\n  pip install -e ".[test]"\n  python -m pytest')
    click.echo("\nReplace the method by your own, and choose a license (LICENSE is empty).")
    return 0
