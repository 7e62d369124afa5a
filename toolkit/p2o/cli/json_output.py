"""The option --json: standard output is reserved for one JSON object, whatever other code writes to descriptor 1."""

from __future__ import annotations

import contextlib
import json
import os
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from typing import Any

import click

STDOUT, _STDERR = 1, 2
OPTION = "--json"

_writers: list[Callable[[str], object]] = []
"""Writes to the standard output that is reserved; at most one."""


def json_option(command: Callable[..., Any]) -> Callable[..., Any]:
    """Add --json to a command, as parameter `as_json`; the command writes its object with `print_json`."""
    text = "Print one JSON object and nothing else on stdout."
    return click.option(OPTION, "as_json", is_flag=True, help=text)(command)


def print_json(value: Mapping[str, Any]) -> None:
    """Write an object to standard output as JSON; raises ValueError for NaN and BrokenPipeError for a closed pipe."""
    write = _writers[-1] if _writers else partial(click.echo, nl=False)
    write(json.dumps(value, allow_nan=False) + "\n")


def wants_json(words: Sequence[str]) -> bool:
    """Return whether the words of a command line contain --json as an option."""
    return OPTION in words[: words.index("--") if "--" in words else None]


@contextlib.contextmanager
def reserved_stdout(*, restored: bool) -> Iterator[None]:
    """Reserve standard output for `print_json`: descriptor 1 and `sys.stdout` write to stderr.

    Native libraries, child processes and forks inherit the descriptor, so this comes before any other work. It is
    `restored` only for callers in the same process, because libraries also write when a process ends.
    """
    python, replaced = sys.stdout, _is_replaced(sys.stdout)
    if python is None:  # the descriptor was closed before this process began, and may be that of any file
        yield
        return
    python.flush()
    before = os.dup(STDOUT)
    try:
        os.dup2(_STDERR, STDOUT)
    except OSError:  # stderr is closed
        with open(os.devnull, "wb") as null:
            os.dup2(null.fileno(), STDOUT)
    _writers.append(python.write if replaced else lambda text: _write(before, text))
    sys.stdout = sys.stderr
    try:
        yield
    finally:
        _writers.pop()
        if restored:
            sys.stdout = python
            _flush_native()
            os.dup2(before, STDOUT)
        os.close(before)


def _is_replaced(stream: Any) -> bool:
    """Return whether Python code has replaced `sys.stdout` by a stream that does not write to descriptor 1."""
    try:
        return bool(stream.fileno() != STDOUT)
    except (OSError, ValueError, AttributeError):
        return True


def _write(descriptor: int, text: str) -> None:
    data = text.encode()
    while data:
        data = data[os.write(descriptor, data) :]


def _flush_native() -> None:
    """Write what C libraries have buffered while descriptor 1 writes to stderr."""
    with contextlib.suppress(OSError, AttributeError, ImportError, TypeError):
        import ctypes

        ctypes.CDLL(None).fflush(None)
