"""The author API is frozen: names, fields with types and defaults, and parameters change with PLUGIN_API only."""

from __future__ import annotations

import dataclasses
import enum
import importlib
import inspect
import json
import re
from collections.abc import Iterator
from functools import cached_property
from pathlib import Path
from types import ModuleType
from typing import Any

import p2o
import pytest
from p2o.host import hookspecs
from p2o.run.recipe import STAGES
from pydantic import BaseModel

KNOWN = Path(__file__).with_name("author_api.json")
MODULES = ("p2o", "p2o.solving", "p2o.reading", "p2o_testing")
PROPERTIES = (property, cached_property)
UPDATE = "python -m tests.test_author_api"


def text_of(value: object) -> str:
    """Return a default value or annotation as text that is the same in every process."""
    if inspect.isfunction(value) or inspect.isclass(value):
        return value.__name__
    if isinstance(value, frozenset):
        return f"frozenset({sorted(value)})"
    return re.sub(r" at 0x[0-9a-f]+", "", str(value) if isinstance(value, str) else repr(value))


def parameters(function: Any) -> str:
    """Return the parameters of a function, with annotations and defaults, and what it returns."""
    signature = inspect.signature(function)
    lines, star = [], False
    for parameter in signature.parameters.values():
        text = {"VAR_POSITIONAL": "*", "VAR_KEYWORD": "**"}.get(parameter.kind.name, "") + parameter.name
        if parameter.kind is parameter.KEYWORD_ONLY and not star:
            lines.append("*")
        star = star or parameter.kind in (parameter.KEYWORD_ONLY, parameter.VAR_POSITIONAL)
        if parameter.annotation is not parameter.empty:
            text += f": {text_of(parameter.annotation)}"
        if parameter.default is not parameter.empty:
            text += f" = {text_of(parameter.default)}"
        lines.append(text)
    returned = signature.return_annotation
    return f"({', '.join(lines)})" + ("" if returned is signature.empty else f" -> {text_of(returned)}")


def fields_of(cls: type) -> Iterator[str]:
    """Return the public fields of a dataclass or model, with types and defaults."""
    if issubclass(cls, BaseModel):
        for name, field in cls.model_fields.items():
            yield f"{name}: {text_of(field.annotation)}" + ("" if field.is_required() else f" = {field.default!r}")
    elif dataclasses.is_dataclass(cls):
        for entry in dataclasses.fields(cls):
            if entry.name.startswith("_"):
                continue
            text = f"{entry.name}: {text_of(entry.type)}"
            if entry.default is not dataclasses.MISSING:
                text += f" = {text_of(entry.default)}"
            elif entry.default_factory is not dataclasses.MISSING:
                text += f" = {text_of(entry.default_factory)}()"
            yield text


def described(value: Any) -> Any:
    """Return what a plugin relies on of one public object."""
    if inspect.ismodule(value):
        return {name: described(one) for name, one in own(value)}
    if inspect.isclass(value):
        if issubclass(value, enum.Enum):
            return {member.name: text_of(member.value) for member in value}
        methods = {
            name: parameters(getattr(value, name))
            for name, one in sorted(members(value))
            if not isinstance(one, PROPERTIES)
        }
        properties = [name for name, one in sorted(members(value)) if isinstance(one, PROPERTIES)]
        described_class = {"fields": "; ".join(fields_of(value)), "properties": ", ".join(properties), **methods}
        return {name: text for name, text in described_class.items() if text}
    if inspect.isfunction(value):
        return parameters(value)
    return f"value of type {type(value).__name__}"


def members(cls: type) -> Iterator[tuple[str, Any]]:
    """Return the public attributes that a class and its bases in p2o define, and how it is called."""
    found: dict[str, Any] = {}
    for base in reversed(cls.__mro__):
        if base.__module__.partition(".")[0] in ("p2o", "p2o_testing"):
            found.update(vars(base))
    kept = (*PROPERTIES, staticmethod, classmethod)
    for name, value in found.items():
        public = not name.startswith("_") and (inspect.isfunction(value) or isinstance(value, kept))
        if public or (name == "__call__" and inspect.isfunction(value)):
            yield name, value


def own(module: ModuleType) -> Iterator[tuple[str, Any]]:
    """Return the public functions and classes that a module defines itself."""
    for name, value in sorted(vars(module).items()):
        if not name.startswith("_") and getattr(value, "__module__", None) == module.__name__:
            yield name, value


def current() -> dict[str, Any]:
    """Return everything that plugins rely on."""
    modules = {name: importlib.import_module(name) for name in MODULES}
    lazy = {"p2o": {"reading", "solving"}}
    names: dict[str, Any] = {
        name: {one: described(getattr(module, one)) for one in sorted(set(module.__all__) - lazy.get(name, set()))}
        for name, module in modules.items()
    }
    return {
        "PLUGIN_API": p2o.PLUGIN_API,
        **names,
        "hooks": sorted(name for name in vars(hookspecs) if name.startswith("p2o_")),
        "stages": sorted(STAGES),
        "checks": sorted(check.name for check in modules["p2o_testing"].CHECKS),
    }


def flat(value: Any, path: str = "") -> dict[str, Any]:
    """Return {path: leaf} of nested objects; lists of parameters and fields are leaves."""
    if not isinstance(value, dict):
        return {path: value}
    return {k: v for key, one in value.items() for k, v in flat(one, f"{path}/{key}" if path else key).items()}


def changes(known: dict[str, Any], now: dict[str, Any]) -> list[str]:
    """Return what differs between two descriptions of the author API, one line each."""
    before, after = flat(known), flat(now)
    lost = [f"lost: {path}" for path in before if path not in after]
    added = [f"new: {path}" for path in after if path not in before]
    changed = [
        f"{path}: {before[path]} -> {after[path]}" for path in before if after.get(path, before[path]) != before[path]
    ]
    return lost + added + changed


def grows(path: str, before: Any, after: Any) -> bool:
    """Return whether a change only adds: names of a list, properties, fields or parameters with defaults at the end."""
    if isinstance(before, list) or path.endswith("/properties"):
        known, now = (value if isinstance(value, list) else value.split(", ") for value in (before, after))
        return set(known) <= set(now)
    if path.endswith("/fields"):
        end, added = "", after.removeprefix(before).split("; ")
    else:
        (before, _, end), (after, _, end_after) = before.rpartition(")"), after.rpartition(")")
        added = after.removeprefix(before).split(", ") if end == end_after else ["changed"]
    return after.startswith(before) and added[0] == "" and all(" = " in part or part == "*" for part in added[1:])


def incompatible(known: dict[str, Any], now: dict[str, Any]) -> list[str]:
    """Return the changes that need a higher PLUGIN_API: what is lost, and what is changed but for additions."""
    before, after = flat(known), flat(now)
    changed = {path for path in before if path in after and after[path] != before[path]} - {"PLUGIN_API"}
    grown = {path for path in changed if grows(path, before[path], after[path])}
    return [
        line for line in changes(known, now) if line.startswith("lost: ") or line.partition(": ")[0] in changed - grown
    ]


def test_the_author_api_is_written_down() -> None:
    difference = changes(json.loads(KNOWN.read_text()), current())
    assert not difference, f"the author API changed; run `{UPDATE}`:\n  " + "\n  ".join(difference)


@pytest.mark.parametrize("module", MODULES[:3])
def test_every_name_is_imported_from_where_type_checkers_find_it(module: str) -> None:
    public = importlib.import_module(module)
    text = Path(public.__file__ or "").read_text(encoding="utf-8")
    lines = re.findall(r"^    from (p2o[\w.]*) import (.+)$", text, re.MULTILINE)
    declared = [(home, *name.split(" as ")) for home, names in lines for name in names.split(", ")]
    assert sorted(name for _, _, name in declared) == sorted(public.__all__) == sorted(dir(public))
    for home, there, name in declared:
        assert there == name
        assert getattr(public, name) is getattr(importlib.import_module(home), there)


def test_an_unknown_name_is_an_attribute_error() -> None:
    with pytest.raises(AttributeError, match=r"module 'p2o.solving' has no attribute 'Frame'"):
        _ = p2o.solving.Frame  # type: ignore[attr-defined]


@pytest.mark.parametrize(
    ("change", "line"),
    [
        (lambda api: api["p2o"]["Frame"].update(fields="name: str"), "p2o/Frame/fields: name: str; image"),
        (lambda api: api["p2o"]["Frame"].pop("without_truth"), "lost: p2o/Frame/without_truth"),
        (lambda api: api["p2o.solving"].update(linearise="(problem)"), "p2o.solving/linearise: (problem: LeastSquares"),
        (lambda api: api["hooks"].pop(), "hooks: "),
        (lambda api: api["p2o"].update(NewName="()"), ""),
        (lambda api: api["p2o"]["Box"].update(fields=f"{api['p2o']['Box']['fields']}; colour: str = 'red'"), ""),
        (
            lambda api: api["p2o"]["Box"].update(fields=f"{api['p2o']['Box']['fields']}; colour: str"),
            "p2o/Box/fields: ",
        ),
        (lambda api: api["p2o"].update(calibrate=api["p2o"]["calibrate"].replace(") ->", ", more: int = 0) ->")), ""),
        (
            lambda api: api["p2o"].update(calibrate=api["p2o"]["calibrate"].replace("-> Run", "-> int")),
            "p2o/calibrate: ",
        ),
        (lambda api: api["hooks"].append("p2o_new"), ""),
    ],
)
def test_a_change_that_breaks_plugins_is_distinguished_from_an_addition(change: Any, line: str) -> None:
    known, now = current(), current()
    change(now)
    assert len(changes(known, now)) == 1
    assert [text[: len(line)] for text in incompatible(known, now)] == ([line] if line else [])


if __name__ == "__main__":
    now = current()
    if KNOWN.exists():
        known = json.loads(KNOWN.read_text())
        broken = incompatible(known, now)
        if broken and known["PLUGIN_API"] == now["PLUGIN_API"]:
            raise SystemExit("these changes break plugins; raise PLUGIN_API first:\n  " + "\n  ".join(broken))
    KNOWN.write_text(json.dumps(now, indent=1) + "\n")
