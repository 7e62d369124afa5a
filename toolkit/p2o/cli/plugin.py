"""`p2o plugin`: list, create and check plugins."""

from __future__ import annotations

import json

import click

from p2o.cli import SubGroup
from p2o.cli.plugin_options import load, plugin_options


@click.group("plugin", cls=SubGroup)
def command() -> None:
    """List the installed plugins, create a package for your own, or check one."""


@command.command("list")
@plugin_options
def list_plugins(plugin: tuple[str, ...], block: tuple[str, ...]) -> int:
    """List the plugins as JSON: name, version, methods; broken ones with reasons.

    P2O_PLUGINS="a,b" loads only these (empty: none), --block leaves one out. P2O_STRICT=1 makes broken ones errors.
    """
    registry = load(plugin, block)
    plugins = []
    for loaded in registry.plugins:
        methods = [{"kind": offer.kind.value, "name": offer.name} for offer in loaded.offers]
        plugins.append({"name": loaded.name, "version": loaded.version, "methods": methods})
    shown = {
        "plugins": plugins,
        "broken": [{"name": b.name, "version": b.version, "error": b.error} for b in registry.broken],
        "left_out": list(registry.blocked),
    }
    click.echo(json.dumps(shown, indent=2))
    return 0
