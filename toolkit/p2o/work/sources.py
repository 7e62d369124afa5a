"""Which code a result depends on, as a hash: what was computed with other code is computed again."""

from __future__ import annotations

import ast
import hashlib
import importlib.util
import sys
from collections.abc import Callable, Iterable, Iterator
from functools import cache, partial
from pathlib import Path
from typing import Any

import p2o


def code_hash(*starts: Callable[..., Any] | str) -> str:
    """Return the hash of the source files that functions (or modules, by name) are made of.

    Followed are the imports that stand in those files, also inside functions, as far as they stay in the package of
    the function or in p2o; of other packages the version counts. Files of the package that are not Python (weights,
    tables) count as a whole. What is imported by a name put together at run time is not seen.
    """
    modules = {start if isinstance(start, str) else _module_of(start) for start in starts}
    digest = hashlib.sha256()
    for name, content in sorted(_closure(frozenset(modules))):
        digest.update(f"{name} {content}\n".encode())
    return digest.hexdigest()


def _module_of(function: Any) -> str:
    while isinstance(function, partial):
        function = function.func
    return str(getattr(function, "__module__", None) or type(function).__module__)


@cache
def _closure(modules: frozenset[str]) -> frozenset[tuple[str, str]]:
    """Return names and hashes of all files that the modules need."""
    packages = {name.partition(".")[0] for name in modules} | {"p2o"}
    waiting, seen = sorted(modules), set[str]()
    found: set[tuple[str, str]] = set()
    while waiting:
        name = waiting.pop()
        path = _path_of(name)
        if name in seen or path is None:
            continue
        seen.add(name)
        content = path.read_bytes()
        found.add((name, hashlib.sha256(content).hexdigest()))
        waiting += [used for used in _imports(name, path, content) if used.partition(".")[0] in packages]
    # p2o itself has no data that a calibration reads; a plugin's package may hold its weights.
    for package in {name.partition(".")[0] for name in seen} - {"p2o"}:
        found |= _data_files(package)
    return frozenset(found)


def _path_of(name: str) -> Path | None:
    """Return the source file of a module, or None where there is none: a name in a module, or compiled code."""
    module = sys.modules.get(name)
    try:
        origin = module.__file__ if module is not None else getattr(importlib.util.find_spec(name), "origin", None)
    except (ImportError, AttributeError, ValueError):
        return None
    path = None if origin is None else Path(origin)
    return path if path is not None and path.suffix == ".py" and path.is_file() else None


def _imports(name: str, path: Path, content: bytes) -> Iterator[str]:
    """Return the modules that a file imports; of `from a import b` both a and a.b, which may be one."""
    package = name if path.name == "__init__.py" else name.rpartition(".")[0]
    for node in ast.walk(ast.parse(content)):
        if isinstance(node, ast.Import):
            for alias in node.names:
                # p2o imports a module of its own when a name of it is first used.
                yield from _used_of_p2o(alias.asname or "p2o", content) if alias.name == "p2o" else [alias.name]
        elif isinstance(node, ast.ImportFrom):
            base = node.module or ""
            if node.level:
                parts = package.split(".")
                base = ".".join(parts[: len(parts) - node.level + 1] + ([base] if base else []))
            yield from _named(base, (alias.name for alias in node.names))


def _used_of_p2o(called: str, content: bytes) -> Iterator[str]:
    """Return the modules behind the names that a file uses as `p2o.Name`."""
    nodes = ast.walk(ast.parse(content))
    yield from _named("p2o", (n.attr for n in nodes if isinstance(n, ast.Attribute) and ast.unparse(n.value) == called))


def _named(base: str, names: Iterable[str]) -> Iterator[str]:
    """Return the modules that `from base import names` may mean; a name that is none has no file."""
    if base != "p2o":
        yield base
    for name in names:
        home = {**p2o._MODULE_OF, **p2o._MODULES}.get(name, name) if base == "p2o" else name
        yield f"{base}.{home}"


@cache
def _data_files(package: str) -> frozenset[tuple[str, str]]:
    path = _path_of(package)
    if path is None or path.name != "__init__.py":
        return frozenset()
    files = (p for p in path.parent.rglob("*") if p.is_file() and p.suffix not in (".py", ".pyc", ".pyi", ".toml"))
    return frozenset((str(p.relative_to(path.parent)), hashlib.sha256(p.read_bytes()).hexdigest()) for p in files)
