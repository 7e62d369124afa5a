"""Parse untrusted JSON, TOML and YAML to plain values, with limited time and memory and errors of one line."""

from __future__ import annotations

import json
import tomllib
from functools import cache
from pathlib import Path
from typing import Any

from p2o.errors import InputError
from p2o.files.input_file import read_text

DEEPEST = 64
"""Maximum nesting: parsers and the functions that use their values are recursive."""
_MAX_BITS = 1000
"""Maximum length of integers: larger ones than 1024 bits do not fit a float."""


def parse_json(text: str | bytes, what: str, where: object = None, *, halves: bool = False) -> Any:
    """Return the value of a JSON text; `what` names it in errors ("file of splits").

    Raises InputError for text that is not JSON, is nested too deeply, or contains integers beyond 1000 bits or,
    without `halves`, lone surrogates, which cannot be written to files. Python represents file names that are not UTF-8
    with lone surrogates.
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
    """Return the value of a YAML text of mappings, lists, numbers, booleans and texts; dates are texts.

    Raises InputError as `parse_json`, for objects (which are not constructed), for keys that a mapping repeats, and for
    aliases, a few of which can expand to more values than fit in memory.
    """
    import yaml

    loader = _yaml_loader()
    try:
        # Checked before construction, which is recursive and expands aliases.
        depth = 0
        for event in yaml.parse(text, loader):
            if isinstance(event, yaml.AliasEvent):
                message = f"the {what} contains an alias (*{event.anchor}), which is not supported"
                raise InputError(message, where=where, expected="values without aliases")
            if isinstance(event, yaml.ScalarEvent):
                _refuse_halves(event.value, what, where)
            depth += isinstance(event, yaml.CollectionStartEvent) - isinstance(event, yaml.CollectionEndEvent)
            if depth > DEEPEST:
                raise _too_deep(what, where)
        value = yaml.load(text, loader)  # noqa: S506  (derived from the safe loader)
        return _shallow(value, what, where)
    except yaml.constructor.ConstructorError as problem:
        message, expected = f"the {what} contains objects, which are not supported", "plain numbers, lists and names"
        raise InputError(message, where=where, expected=expected, got=problem.problem) from problem
    except (yaml.YAMLError, RecursionError, ValueError) as problem:
        raise _not(what, "YAML", where, problem) from problem


def read_plain(path: Path, what: str) -> Any:
    """Return the value of a file: JSON if its name ends in .json, else YAML; raises InputError as the parsers."""
    parse = parse_json if path.suffix.lower() == ".json" else parse_yaml
    return parse(read_text(path, what), what, path)


def _not(what: str, kind: str, where: object, problem: Exception) -> InputError:
    got = "too many levels" if isinstance(problem, RecursionError) else str(problem)[:200]
    return InputError(f"the {what} is not {kind}", where=where, got=got)


def _shallow(value: Any, what: str, where: object, *, halves: bool = False) -> Any:
    """Return the value; raises InputError if it is nested too deeply or, without `halves`, has lone surrogates."""
    level = [value]
    for _ in range(DEEPEST + 1):
        for inner in level:
            for text in () if halves else inner if isinstance(inner, dict) else (inner,):
                if isinstance(text, str):
                    _refuse_halves(text, what, where)
            if isinstance(inner, int) and inner.bit_length() > _MAX_BITS:
                fault, expected = f"the {what} contains too large a number", f"integers of at most {_MAX_BITS} bits"
                raise InputError(fault, where=where, expected=expected, got=f"{inner.bit_length()} bits")
        nested = [outer for outer in level if isinstance(outer, dict | list)]
        level = [inner for outer in nested for inner in (outer.values() if isinstance(outer, dict) else outer)]
        if not level:
            return value
    raise _too_deep(what, where)


def _refuse_halves(text: str, what: str, where: object) -> None:
    if text.isascii():
        return
    try:
        text.encode()
    except UnicodeEncodeError as problem:
        message = f"the {what} contains a lone surrogate"
        raise InputError(message, where=where, expected="valid Unicode", got=ascii(text[:40])) from problem


def _too_deep(what: str, where: object) -> InputError:
    return InputError(f"the {what} is nested too deeply", where=where, expected=f"at most {DEEPEST} levels")


@cache
def _yaml_loader() -> Any:
    import yaml

    # The parser in C, if available, is ten times as fast.
    base: Any = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
    resolvers = {
        first: [(tag, pattern) for tag, pattern in known if tag != "tag:yaml.org,2002:timestamp"]
        for first, known in base.yaml_implicit_resolvers.items()
    }

    def construct_mapping(self: Any, node: Any, deep: bool = False) -> Any:
        keys = [(key.tag, key.value) for key, _ in node.value if isinstance(key.value, str)]
        if len(set(keys)) < len(keys):
            twice = next(key for number, key in enumerate(keys) if key in keys[:number])
            raise yaml.YAMLError(f"key {twice[1][:40]!r} is given twice{node.start_mark}")
        return base.construct_mapping(self, node, deep)

    members = {"yaml_implicit_resolvers": resolvers, "construct_mapping": construct_mapping}
    return type("Loader", (base,), {**members, "__doc__": "The safe loader without dates and without repeated keys."})
