"""The argument DATA, and the options that several commands have: --plugin, --block, and those that name methods."""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import click

from p2o.cli.completion import Completer, complete_data, complete_extractors, complete_methods, complete_settings

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


DATA = "[DATASET:]PATH"
"""How an argument or option for data is shown."""


def data_argument(text: str, default: str | None = None) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    """Return a decorator that adds DATA as an argument and as the option --data, as parameter `data`.

    Without `default`, the data have to be given.
    """

    def decorate(command: Callable[..., Any]) -> Callable[..., Any]:
        @functools.wraps(command)
        def with_data(*, data_argument: str | None, data_option: str | None, **words: Any) -> Any:
            if data_argument is not None and data_option is not None:
                raise click.UsageError("the data are given twice, as DATA and as --data")
            data = data_option if data_argument is None else data_argument
            if data is None and default is None:
                raise click.UsageError(f"Missing argument '{DATA}'")
            return command(data=data or default, **words)

        option = click.option("--data", "data_option", metavar=DATA, shell_complete=complete_data, help=text)(with_data)
        return click.argument("data_argument", required=False, metavar=DATA, shell_complete=complete_data)(option)

    return decorate


def text_option(
    name: str, metavar: str, text: str, complete: Completer | None = None, **words: Any
) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    """Return an option with a value, described by `text`; `complete` completes values, `words` are those of click."""
    return click.option(name, metavar=metavar, help=text, shell_complete=complete, **words)


extractor_option = text_option(
    "--extractor", "IMAGE/CLOUD", "The two extractors (default: p2ornet/rings).", complete_extractors
)
matcher_option = text_option("--matcher", "NAME", "The matcher (default: ogm).", complete_methods("matcher"))
seed_option = text_option("--seed", "N", "Seed of all random numbers (default: 0).", type=click.IntRange(min=0))


def settings_option(text: str = "An option.") -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    """Return the option --set, repeatable, as the parameter `settings`."""
    words: dict[str, Any] = {"metavar": "STAGE.FIELD=VALUE", "shell_complete": complete_settings, "help": text}
    return click.option("--set", "settings", multiple=True, **words)
