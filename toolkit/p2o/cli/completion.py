"""Shell completion of commands, options, and names of methods and data sets (`_P2O_COMPLETE=bash_source p2o`)."""

from __future__ import annotations

import contextlib
import glob
import io
import os
from collections.abc import Callable, Iterable, Iterator
from typing import TYPE_CHECKING

import click

from p2o.errors import InputError, P2OError

if TYPE_CHECKING:
    from p2o.host.registry import Registry

VARIABLE = "_P2O_COMPLETE"
"""Environment variable that asks for a script (bash_source) or for completions (bash_complete)."""
_SHELLS = ("bash", "zsh", "fish")
_BREAKS = (":", "=")
_MANY = ","

Completer = Callable[[click.Context, click.Parameter, str], list[str]]


def answer_shell(command: click.Command, instruction: str) -> int:
    """Print a completion script, or the completions of a line; raises InputError for another shell."""
    from click.shell_completion import BashComplete, CompletionItem, add_completion_class, shell_complete

    class Bash(BashComplete):
        """Bash divides words at colons and equals signs, and replaces only the part after the last of them."""

        def get_completion_args(self) -> tuple[list[str], str]:
            args, last = super().get_completion_args()
            words = [""]
            for word in [*args, last]:
                joined = word in _BREAKS or words[-1].endswith(_BREAKS)
                words = [*words[:-1], words[-1] + word] if joined else [*words, word]
            *args, last = words[1:]
            value = last.partition("=")[2] if last.startswith("-") else last
            self.kept = max(value.rfind(mark) for mark in _BREAKS) + 1
            return args, last

        def format_completion(self, item: CompletionItem) -> str:
            return f"{item.type},{item.value[self.kept :]}"

    add_completion_class(Bash)
    shell, _, action = instruction.partition("_")
    if shell not in _SHELLS or action not in ("source", "complete"):
        expected = ", ".join(f"{name}_source" for name in _SHELLS)
        raise InputError("completion is not available", where=VARIABLE, expected=expected, got=instruction)
    # Warnings about plugins would be written into the line that is being edited.
    with contextlib.redirect_stderr(io.StringIO()):
        return shell_complete(command, {}, "p2o", VARIABLE, instruction)


def complete_methods(*kinds: str, published: bool = False, many: bool = False) -> Completer:
    """Complete names of methods of these kinds, and of published methods; with `many` a list with commas."""

    def names(registry: Registry, before: str) -> Iterator[str]:
        yield from _published(registry) if published else ()
        yield from _named(registry, *kinds)

    return _completer(names, _MANY if many else "")


def _extractors(registry: Registry, before: str) -> Iterator[str]:
    if before:
        return _named(registry, "cloud extractor")
    return (f"{name}/" for name in _named(registry, "image extractor"))


def _settings(registry: Registry, before: str) -> Iterator[str]:
    from p2o.calibration.options import PipelineOptions
    from p2o.host.slots import SLOT_OF

    yield from (f"pipeline.{field}=" for field in PipelineOptions.model_fields)
    for offer in registry.offers:
        yield from (f"{SLOT_OF[offer.kind].stage}.{field}=" for field in offer.method.option_names)


def _data(registry: Registry, before: str) -> Iterator[str]:
    yield from (f"{name}:" for name in _named(registry, "dataset"))


def _exports(registry: Registry, before: str) -> Iterator[str]:
    yield from (f"{name}:" for name in _named(registry, "exporter"))


def complete_protocols(context: click.Context, parameter: click.Parameter, word: str) -> list[str]:
    """Complete names of protocols."""
    from p2o.run.protocol import PROTOCOLS

    return [name for name in PROTOCOLS if name.startswith(word)]


def _published(registry: Registry) -> Iterable[str]:
    from p2o.run.presets import presets

    return presets(registry)


def _named(registry: Registry, *kinds: str) -> Iterator[str]:
    return (offer.name for offer in registry.offers if not kinds or offer.kind.value in kinds)


def _completer(names: Callable[[Registry, str], Iterable[str]], separator: str, *, paths: bool = False) -> Completer:
    """Return a completer of the last part of a word; with `paths` a part after a separator is a file or folder."""

    def complete(context: click.Context, parameter: click.Parameter, word: str) -> list[str]:
        from p2o.host.registry import Registry

        before, split, last = word.rpartition(separator) if separator else ("", "", word)
        if paths and (split or last.startswith((".", "~", os.sep))):
            return _paths(before + split, last)
        try:
            plugin, block = (context.params.get(name) or () for name in ("plugin", "block"))
            registry = Registry.load(block=block, extra_files=plugin)
            known = list(dict.fromkeys(names(registry, before)))
        except P2OError:
            known = []
        return [before + split + name for name in known if name.startswith(last)] + (_paths("", last) if paths else [])

    return complete


def _paths(before: str, start: str) -> list[str]:
    paths = sorted(glob.glob(f"{glob.escape(os.path.expanduser(start))}*"))
    return [f"{before}{path}{os.sep if os.path.isdir(path) else ''}" for path in paths]


complete_extractors = _completer(_extractors, "/")
complete_settings = _completer(_settings, "")
complete_data = _completer(_data, ":", paths=True)
complete_exports = _completer(_exports, ":", paths=True)
