"""`p2o plugins`: what is installed and what is broken, as JSON."""

from __future__ import annotations

import json

import click

from p2o.cli.plugin_options import load, plugin_options


@click.command("plugins")
@plugin_options
def command(plugin: tuple[str, ...], block: tuple[str, ...]) -> int:
    """List the plugins as JSON: name, version, methods; the broken ones with reasons.

    P2O_PLUGINS="a,b" loads only these (empty: none), --block leaves one out. P2O_STRICT=1 makes a broken one an error.
    """
    registry = load(plugin, block)
    shown = {
        "plugins": [
            {
                "name": found.name,
                "version": found.version,
                "methods": [{"kind": offer.kind.value, "name": offer.name} for offer in found.offers],
            }
            for found in registry.plugins
        ],
        "broken": [{"name": b.name, "version": b.version, "error": b.error} for b in registry.broken],
        "left_out": list(registry.blocked),
    }
    click.echo(json.dumps(shown, indent=2))
    return 0
