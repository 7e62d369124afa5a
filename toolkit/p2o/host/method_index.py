"""Methods of a package that are listed from an index, so that a module is imported when its method is used.

`python -m p2o.host.method_index PACKAGE ...` writes the indices of packages whose hooks use `methods_at`.
"""

from __future__ import annotations

import dataclasses
import importlib
import json
import pkgutil
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping
from functools import cache, partial
from operator import attrgetter
from pathlib import Path
from typing import Any

from p2o.errors import LONGEST, P2OError, PluginError, one_line
from p2o.host.method import Method
from p2o.host.slots import Kind

FILE = "method_index.json"
"""The index in the folder of a package: what `stated` returns, by the place of the method."""
_STATED = ("name", "summary", "needs", "gives", "cite", "extra", "expected_failures", "parallel")
_ABSENT = ("trainer", "example", "data_files", "data_licence", "rings", "recognises")
"""Fields of which the index states only that they are None."""


class _OnFirstUse:
    """A field that the index does not state: the first access loads the method."""

    def __init__(self, name: str) -> None:
        self.name = name

    def __get__(self, method: IndexedMethod | None, owner: type | None = None) -> Any:
        if method is None:
            return self
        loaded = method.loaded()
        vars(method).update({field: getattr(loaded, field) for field in FIELDS})
        return vars(method)[self.name]


class IndexedMethod(Method):
    """A method at a place, MODULE or MODULE:NAME in a package; fields that the index lacks are loaded on first use."""

    loaded: Callable[[], Method]
    place: str

    @classmethod
    def at(cls, place: str, load: Callable[[], Method], facts: Mapping[str, Any]) -> IndexedMethod:
        """Return the method of a place with the fields that are known; `load` returns it with all of them."""
        method = object.__new__(cls)
        vars(method).update(facts, place=place, loaded=load)
        return method


FIELDS = tuple(each.name for each in dataclasses.fields(Method))
for _name in FIELDS:
    setattr(IndexedMethod, _name, _OnFirstUse(_name))


def changed(method: Method, change: Callable[[Method], Method]) -> Method:
    """Return a method with a change of its options, which an indexed one makes on first use."""
    if not isinstance(method, IndexedMethod):
        return change(method)
    facts = {name: value for name, value in vars(method).items() if name in (*_STATED, *_ABSENT)}
    return IndexedMethod.at(method.place, lambda: change(method.loaded()), facts)


def methods_at(package: str, places: Iterable[str]) -> Iterator[Method]:
    """Yield the methods of files of a package, MODULE or MODULE:NAME; NAME is METHOD unless it is given.

    Those in the file method_index.json of the package are imported on first use, others at once. Raises PluginError,
    on first use, for a module that cannot be imported and for an index that is not current.
    """
    index = _index(package)
    for place in places:
        facts = index.get(place, {})
        yield IndexedMethod.at(place, partial(_loaded, package, place, facts), facts)


@cache
def _index(package: str) -> dict[str, dict[str, Any]]:
    try:
        content: dict[str, dict[str, Any]] = json.loads(pkgutil.get_data(package, FILE) or b"{}")
    except FileNotFoundError:
        return {}
    for facts in content.values():
        facts |= {"needs": frozenset(facts["needs"]), "gives": frozenset(facts["gives"])}
        facts |= {"expected_failures": tuple(map(tuple, facts["expected_failures"]))}
        facts |= {"option_names": tuple(facts["option_names"])}
    return content


def _loaded(package: str, place: str, facts: Mapping[str, Any]) -> Method:
    try:
        method = _imported(package, place)
    except P2OError:
        raise
    except Exception as problem:
        if not facts:
            raise
        got = f"{type(problem).__name__}: {one_line(problem, LONGEST)}"
        raise PluginError(f"method '{facts['name']}' cannot be imported from {package}.{place}", got=got) from problem
    if facts and stated(method) != facts:
        hint = f"run: python -m p2o.host.method_index {package}"
        raise PluginError(f"{FILE} of {package} is not current: '{method.name}' has changed", hint=hint)
    return method


def _imported(package: str, place: str) -> Method:
    """Return the method of a place; a NAME may be a path of attributes, and a function of no arguments is called."""
    module, _, name = place.partition(":")
    value = attrgetter(name or "METHOD")(importlib.import_module(f"{package}.{module}"))
    method: Method = value if isinstance(value, Method) else value()
    return method


def stated(method: Method) -> dict[str, Any]:
    """Return what the index states of a method: fields for lists of methods, fields that are None, option names."""
    facts = {name: getattr(method, name) for name in (*_STATED, "option_names")}
    return facts | {name: None for name in _ABSENT if getattr(method, name) is None}


def index_text(package: str) -> str:
    """Return the content of the index of a package whose hooks use `methods_at`; all its modules are imported."""
    hooks = importlib.import_module(f"{package}.hooks")
    offered = [method for kind in Kind for method in getattr(hooks, kind.hook, tuple)()]
    facts = {method.place: stated(_imported(package, method.place)) for method in offered}
    lines = [f"{json.dumps(place)}: {json.dumps(facts[place], default=sorted)}" for place in sorted(facts)]
    return "{\n" + ",\n".join(lines) + "\n}\n"


if __name__ == "__main__":
    for _package in sys.argv[1:]:
        Path(importlib.import_module(_package).__path__[0], FILE).write_text(index_text(_package), encoding="utf-8")
