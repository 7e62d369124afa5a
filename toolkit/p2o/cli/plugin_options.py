"""The options --plugin and --block, which every command that loads plugins has."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import click

if TYPE_CHECKING:
    from p2o.host.registry import Registry


def plugin_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """Add --plugin and --block to a command; it gets them as `plugin` and `block`."""
    command = click.option(
        "--block", multiple=True, metavar="NAME", help="Leave out a plugin: distribution, entry point, or both as a:b."
    )(command)
    return click.option(
        "--plugin",
        multiple=True,
        type=click.Path(dir_okay=False),
        metavar="FILE.py",
        help="Load one more plugin from a file that is not installed.",
    )(command)


def load(plugin: tuple[str, ...], block: tuple[str, ...]) -> Registry:
    """Return the registry as these options and P2O_PLUGINS want it."""
    from p2o.host.registry import Registry

    return Registry.load(block=block, extra_files=plugin)
