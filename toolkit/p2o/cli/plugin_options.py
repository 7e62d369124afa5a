"""The options --plugin and --block of all commands that load plugins."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import click

if TYPE_CHECKING:
    from p2o.host.registry import Registry


def plugin_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """Add --plugin and --block to a command, as parameters `plugin` and `block`."""
    left_out = "Leave out a plugin: distribution, entry point, or both as a:b."
    command = click.option("--block", multiple=True, metavar="NAME", help=left_out)(command)
    file, text = click.Path(dir_okay=False), "Also load a plugin from a file that is not installed."
    return click.option("--plugin", multiple=True, type=file, metavar="FILE.py", help=text)(command)


def load(plugin: tuple[str, ...], block: tuple[str, ...]) -> Registry:
    """Return the registry according to these options and P2O_PLUGINS."""
    from p2o.host.registry import Registry

    return Registry.load(block=block, extra_files=plugin)
