"""The revision of code: a digest of the modules of plugins that a method imports, without comments and docstrings.

Changes of p2o itself are counted by `p2o.ALGORITHM`.
"""

from __future__ import annotations

import ast
import hashlib
import importlib.util
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache, lru_cache, partial
from pathlib import Path
from typing import Any

from p2o.host.method import Method
from p2o.host.method_index import FILE as METHOD_INDEX
from p2o.host.registry import plugin_packages
from p2o.options import Options
from p2o.run.overview import FILE as OVERVIEW

_LOCATING = {"__file__", "__loader__", "__package__", "__path__", "__spec__", "find_spec", "importlib_resources"}
_LOCATING |= {"inspect", "pkg_resources", "pkgutil", "resources"}
"""Names by which code finds the folder of its package, and files in it."""
_NOT_READ = {".py", ".pyc", ".pyi", ".toml", ".md"}
_LISTS = {METHOD_INDEX, OVERVIEW, "studies", "suites"}
"""Files and folders of a package that state which methods, rows and frames there are; no method reads them."""


@dataclass(frozen=True)
class Code:
    """The digest of all modules; `locates_files` are the packages whose modules find files of their package.

    With `resolves_methods` a module uses the `Registry`: the modules of all plugins are counted.
    """

    digest: str
    locates_files: frozenset[str]
    resolves_methods: bool


def code_of(method: Method, options: type[Options]) -> Code:
    """Return the code of a method: the modules of `build` and options, and the modules of plugins that these import.

    Imports inside functions count, those for type checking and those of the trainer's functions, which act through
    weights, do not. A package that imports its names on first use (`__getattr__`) counts as a whole. Modules that are
    imported by a computed name are not seen.
    """
    modules = tuple(sorted({_module_name(method.build), options.__module__}))
    packages = plugin_packages() | {module.partition(".")[0] for module in modules}
    trainer = method.trainer
    training = () if trainer is None else (trainer.label, trainer.draw, trainer.train)
    left_out = {(_module_name(function), getattr(function, "__qualname__", "")) for function in training}
    return _code_of(modules, packages - {"p2o"}, frozenset((home, name.partition(".")[0]) for home, name in left_out))


@cache
def data_digest(package: str) -> str:
    """Return the digest of the data files of a package.

    Documents (.md), configuration (.toml) and lists of methods, rows and frames do not count.
    """
    path, digest = path_of(package), hashlib.sha256()
    if path is None or path.name != "__init__.py":
        return ""
    for file in sorted(path.parent.rglob("*")):
        name = file.relative_to(path.parent)
        if file.is_file() and file.suffix not in _NOT_READ and not _LISTS.intersection(name.parts):
            digest.update(f"{name} {hashlib.sha256(file.read_bytes()).hexdigest()}\n".encode())
    return digest.hexdigest()


def read_source(path: Path) -> bytes:
    """Return the content of a module."""
    return path.read_bytes()


@lru_cache(maxsize=8192)
def path_of(name: str) -> Path | None:
    """Return the source file of a module without importing it, or None where there is none."""
    package, _, leaf = name.rpartition(".")
    if name in sys.modules or not package:
        try:
            module = sys.modules.get(name)
            origin = module.__file__ if module is not None else getattr(importlib.util.find_spec(name), "origin", None)
        except (ImportError, AttributeError, ValueError):
            return None
        path = None if origin is None else Path(origin)
        return path if path is not None and path.suffix == ".py" and path.is_file() else None
    home = path_of(package)
    if home is None or home.name != "__init__.py":
        return None
    return next((p for p in (home.parent / f"{leaf}.py", home.parent / leaf / "__init__.py") if p.is_file()), None)


def _module_name(function: Any) -> str:
    """Return the name of the module of a function, a class or an instance."""
    while isinstance(function, partial):
        function = function.func
    return str(getattr(function, "__module__", None) or type(function).__module__)


@lru_cache(maxsize=1024)
def _code_of(modules: tuple[str, ...], packages: frozenset[str], left_out: frozenset[tuple[str, str]]) -> Code:
    sources: dict[str, _Source] = {}
    waiting, resolves_methods = list(modules), False
    while waiting:
        name = waiting.pop()
        path = None if name in sources or name.partition(".")[0] not in packages else path_of(name)
        if path is None:
            continue
        is_package = path.name == "__init__.py"
        package, skipped = name.rpartition(".")[0], frozenset(function for home, function in left_out if home == name)
        sources[name] = source = _parsed(name if is_package else package, read_source(path), skipped)
        waiting += [package, *source.imports]
        if is_package and "__getattr__" in source.names:
            waiting += _modules_in(name)
        if "Registry" in source.names and not resolves_methods:
            resolves_methods = True
            waiting += [module for package in packages for module in _modules_in(package)]
    digest = hashlib.sha256()
    for name, source in sorted(sources.items()):
        digest.update(f"{name} {source.digest}\n".encode())
    locating = (name.partition(".")[0] for name, source in sources.items() if source.names & _LOCATING)
    return Code(digest.hexdigest(), frozenset(locating), resolves_methods)


@dataclass(frozen=True)
class _Source:
    """A module: the digest of its code, what may be modules among its imports, and all names in it."""

    digest: str
    imports: frozenset[str]
    names: frozenset[str]


@lru_cache(maxsize=4096)
def _parsed(package: str, content: bytes, left_out: frozenset[str]) -> _Source:
    tree = _Executed().visit(ast.parse(content))
    tree.body = [node for node in tree.body if getattr(node, "name", None) not in left_out]
    nodes, names = list(ast.walk(tree)), set[str]()
    for node in nodes:
        if isinstance(node, ast.Name):
            names.add(node.id)
        elif isinstance(node, ast.Attribute):
            names.add(node.attr)
        elif isinstance(node, ast.alias):
            names.update(node.name.split("."))
    names.update(node.name for node in tree.body if isinstance(node, ast.FunctionDef))
    imports = frozenset(name for node in nodes for name in _imported(node, package))
    # Source text, because the form of a dump differs between versions of Python.
    return _Source(hashlib.sha256(ast.unparse(tree).encode()).hexdigest(), imports, frozenset(names))


class _Executed(ast.NodeTransformer):
    """Removes docstrings and blocks for type checking."""

    def visit_Expr(self, node: ast.Expr) -> ast.AST | None:
        return None if isinstance(node.value, ast.Constant) else node

    def visit_If(self, node: ast.If) -> ast.AST | list[ast.stmt]:
        self.generic_visit(node)
        return node.orelse if ast.unparse(node.test) in ("TYPE_CHECKING", "typing.TYPE_CHECKING") else node


def _imported(node: ast.AST, package: str) -> Iterator[str]:
    """Return what may be modules in an import of a module of this package."""
    if isinstance(node, ast.Import):
        yield from (alias.name for alias in node.names)
    elif isinstance(node, ast.ImportFrom):
        above = package.split(".")[: len(package.split(".")) - node.level + 1] if node.level else []
        home = ".".join([*above, *([node.module] if node.module else [])])
        yield home
        yield from (f"{home}.{alias.name}" for alias in node.names)


def _modules_in(package: str) -> list[str]:
    """Return the names of all modules of a package."""
    path = path_of(package)
    if path is None or path.name != "__init__.py":
        return [package]
    files = (file.relative_to(path.parent).with_suffix("") for file in path.parent.rglob("*.py"))
    return [".".join((package, *file.parts)).removesuffix(".__init__") for file in files]
