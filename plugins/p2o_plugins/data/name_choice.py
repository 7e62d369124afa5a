"""Names that a user chooses among those that a dataset has: cameras, scenes, drives."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Annotated

from p2o import UnknownNameError
from pydantic import BeforeValidator


def _words(value: object) -> object:
    """Return words that commas join as a list of them; all else as it is."""
    return [word.strip() for word in value.split(",") if word.strip()] if isinstance(value, str) else value


Words = Annotated[tuple[str, ...], BeforeValidator(_words)]
"""Names of an option, as a list or joined by commas."""


def chosen(kind: str, wanted: Iterable[str], known: Iterable[str], where: Path | None = None) -> tuple[str, ...]:
    """Return the wanted names, each once; "all" alone, and none at all, means every known one.

    Raises UnknownNameError, which tells the nearest ones, for a name that is not among the known.
    """
    names, known = tuple(dict.fromkeys(wanted)), tuple(known)
    if names in ((), ("all",)):
        return known
    unknown = next((name for name in names if name not in known), None)
    if unknown is not None:
        raise UnknownNameError(kind, unknown, known, where=where, hint="or all")
    return names
