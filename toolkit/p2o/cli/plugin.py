"""`p2o plugin`: list, create and check plugins."""

from __future__ import annotations

import click

from p2o.cli import SubGroup, plugin_list


@click.group("plugin", cls=SubGroup)
def command() -> None:
    """List the installed plugins, create a package for your own, or check one."""


command.add_command(plugin_list.command)
