"""JSON, TOML and YAML from outside: plain values or a one-line error, in time and memory that fit the text."""

from __future__ import annotations

import json
import tomllib
from functools import cache
from typing import Any

from p2o.errors import InputError

DEEPEST = 64
"""No file of p2o nests deeper; parsers recurse, and what they return is walked by functions that do too."""


def parse_json(text: str | bytes, what: str, where: object = None, *, halves: bool = False) -> Any:
    """Return the value of a JSON text; `what` names it in errors ("file of splits").

    Raises InputError for text that is not JSON, nests too deeply, or holds numbers of more digits than Python takes or
    halves of letters (lone surrogates), which no file can be written with. With `halves` they stay: so Python reads
    names of files that are no UTF-8.
    """
    try:
        value = json.loads(text)
    except (ValueError, RecursionError) as problem:
        raise _not(what, "JSON", where, problem) from problem
    return _shallow(value, what, where, halves=halves)


def parse_toml(text: str, what: str, where: object = None) -> dict[str, Any]:
    """Return the tables of a TOML text; raises InputError as `parse_json`."""
    try:
        value = tomllib.loads(text)
    except (ValueError, RecursionError) as problem:
        raise _not(what, "TOML", where, problem) from problem
    _shallow(value, what, where)
    return value


def parse_yaml(text: str, what: str, where: object = None) -> Any:
    """Return the value of a YAML text made of mappings, lists, numbers, switches and texts; dates stay texts.

    Raises InputError as `parse_json`, for objects (never built), and for aliases: a few lines of them name more values
    than fit in memory.
    """
    import yaml

    loader = _yaml_loader()
    try:
        # Before anything is built: values that name each other grow without bound, and the builder recurses.
        depth = 0
        for event in yaml.parse(text, loader):
            if isinstance(event, yaml.AliasEvent):
                raise InputError(
                    f"the {what} holds an alias (*{event.anchor}), which is never followed",
                    where=where,
                    expected="every value written out",
                )
            if isinstance(event, yaml.ScalarEvent):
                _refuse_halves(event.value, what, where)
            depth += isinstance(event, yaml.CollectionStartEvent) - isinstance(event, yaml.CollectionEndEvent)
            if depth > DEEPEST:
                raise _too_deep(what, where)
        return yaml.load(text, loader)  # noqa: S506  (a safe loader, with less than the usual one)
    except yaml.constructor.ConstructorError as problem:
        raise InputError(
            f"the {what} holds objects, which are never built",
            where=where,
            expected="plain numbers, lists and names",
            got=problem.problem,
        ) from problem
    except (yaml.YAMLError, RecursionError, ValueError) as problem:
        raise _not(what, "YAML", where, problem) from problem


def _not(what: str, kind: str, where: object, problem: Exception) -> InputError:
    got = "too many levels" if isinstance(problem, RecursionError) else str(problem)[:200]
    return InputError(f"the {what} is not {kind}", where=where, got=got)


def _shallow(value: Any, what: str, where: object, *, halves: bool = False) -> Any:
    """Return the value; raises InputError where it nests too deeply, or holds halves of letters that may not be."""
    level = [value]
    for _ in range(DEEPEST + 1):
        for inner in level:
            for text in inner if isinstance(inner, dict) else (inner,):
                if isinstance(text, str) and not halves:
                    _refuse_halves(text, what, where)
        level = [inner for outer in level for inner in _inside(outer)]
        if not level:
            return value
    raise _too_deep(what, where)


def _refuse_halves(text: str, what: str, where: object) -> None:
    if text.isascii():
        return
    try:
        text.encode()
    except UnicodeEncodeError as problem:
        raise InputError(
            f"the {what} holds half of a letter", where=where, expected="whole letters", got=ascii(text[:40])
        ) from problem


def _too_deep(what: str, where: object) -> InputError:
    return InputError(f"the {what} nests too deeply", where=where, expected=f"at most {DEEPEST} levels")


def _inside(value: Any) -> list[Any]:
    if isinstance(value, dict):
        return list(value.values())
    return value if isinstance(value, list) else []


@cache
def _yaml_loader() -> Any:
    import yaml

    # The parser in C, where it is there, is ten times as fast.
    base: Any = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
    resolvers = {
        first: [(tag, pattern) for tag, pattern in known if tag != "tag:yaml.org,2002:timestamp"]
        for first, known in base.yaml_implicit_resolvers.items()
    }
    return type("Loader", (base,), {"yaml_implicit_resolvers": resolvers, "__doc__": "The safe loader without dates."})
