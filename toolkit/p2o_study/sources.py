"""Hash the code that a result depends on: definitions that are reachable by name, without what has no effect."""

from __future__ import annotations

import ast
import contextlib
import hashlib
import importlib.util
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import cache, cached_property, lru_cache, partial
from pathlib import Path
from types import CodeType, FunctionType, MethodType
from typing import Any

import numpy as np
from p2o.arrays import parts
from p2o.host.registry import plugin_packages


def _words(text: str) -> frozenset[str]:
    return frozenset(text.split())


_PURE_DECORATORS = _words(
    "abstractmethod cache cached_property classmethod contextmanager dataclass field_validator lru_cache "
    "model_validator overload override property runtime_checkable setter staticmethod"
)
"""Decorators that register nothing and do not read the annotations of a function."""

_PURE_CALLS = _words(
    "abs arange array asarray compile deg2rad diag dict enumerate eye field fields float float32 float64 fromkeys "
    "frozenset getLogger get_args int items join keys len linspace list local max min namedtuple ones partial "
    "product radians range repeat replace round set sorted split sqrt str sum tuple values with_name zeros zip"
)
"""Functions whose call only returns a value; so does a class, whose name begins with a capital letter."""

DYNAMIC = _words("globals locals vars eval exec")
"""Built-in functions that reach names which the source does not spell."""

_LOCATING = _words(
    "__file__ __loader__ __package__ __path__ __spec__ find_spec importlib_resources inspect pkg_resources "
    "pkgutil resources"
)
"""Names by which code finds the folder of its package, and files in it."""

Chain = tuple[str, ...]
Target = tuple[str, str]
"""What an import binds: a module with the name in it; the name is empty for the module itself."""


@dataclass(frozen=True, eq=False)
class Statement:
    """A module-level statement with what it uses: chains of names such as ("se3", "exp"), and imports inside it."""

    node: ast.stmt

    @cached_property
    def _acting(self) -> ast.AST | None:
        """The syntax tree without what has no effect, None where nothing is left."""
        node: ast.AST | None = _Normalised().visit(self.node)
        return node

    @cached_property
    def digest(self) -> str:
        """The hash of the syntax tree without what has no effect."""
        return "" if self._acting is None else hashlib.sha256(ast.dump(self._acting).encode()).hexdigest()

    @cached_property
    def uses(self) -> Uses:
        """The names that the statement uses, without those of annotations that have no effect."""
        uses = Uses()
        if self._acting is not None:
            uses.visit(self._acting)
        return uses


@dataclass(frozen=True, eq=False)
class Module:
    """A module by its source: statements that define a name, those that run on import, and what imports bind.

    `typing` are imports for type checking alone, which also say where a package with `__getattr__` has its names.
    """

    name: str
    package: str
    defined: dict[str, list[Statement]] = field(default_factory=dict)
    running: list[Statement] = field(default_factory=list)
    imports: dict[str, list[Target]] = field(default_factory=dict)
    typing: dict[str, list[Target]] = field(default_factory=dict)
    loads: list[Target] = field(default_factory=list)

    def add(self, node: ast.stmt, *, running: bool = False) -> None:
        """Sort in a module-level statement; `running` inside one that runs on import."""
        if isinstance(node, ast.Import | ast.ImportFrom):
            for bound, target in bound_by(node, self.package):
                self.loads.append(target)
                if bound == "*":
                    self.running.append(Statement(node))
                else:
                    self.imports.setdefault(bound, []).append(target)
        elif isinstance(node, ast.If) and ast.unparse(node.test) in ("TYPE_CHECKING", "typing.TYPE_CHECKING"):
            self.add_typing(node.body)
            for inner in node.orelse:
                self.add(inner, running=running)
        elif isinstance(node, ast.If) and ast.unparse(node.test) == "__name__ == '__main__'":
            pass
        elif names := _names_defined(node):
            for name in names:
                self.defined.setdefault(name, []).append(Statement(node))
            if not (running or _is_plain(node)):
                self.running.append(Statement(node))
        elif not isinstance(node, ast.Pass) and not (
            isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)
        ):
            if not running:
                self.running.append(Statement(node))
            for inner in _inner_statements(node):
                self.add(inner, running=True)

    def add_typing(self, nodes: Iterable[ast.stmt]) -> None:
        """Keep what imports for type checking bind."""
        for node in nodes:
            if isinstance(node, ast.Import | ast.ImportFrom):
                for bound, target in bound_by(node, self.package):
                    self.typing.setdefault(bound, []).append(target)

    @property
    def is_lazy(self) -> bool:
        """True where names are imported when they are first used."""
        return "__getattr__" in self.defined


@dataclass
class Uses(ast.NodeVisitor):
    """What a statement uses: chains of names, `bare` names, imports in it, texts; `fields` are names in annotations."""

    chains: set[Chain] = field(default_factory=set)
    bare: set[str] = field(default_factory=set)
    fields: set[str] = field(default_factory=set)
    imports: list[ast.Import | ast.ImportFrom] = field(default_factory=list)
    texts: set[str] = field(default_factory=set)

    @property
    def locates_files(self) -> bool:
        """True where the folder of a package is found."""
        imported = {name for node in self.imports for _, target in bound_by(node, "") for name in target}
        return not _LOCATING.isdisjoint(imported.union(*self.chains))

    @property
    def imports_by_name(self) -> bool:
        """True where a module is imported by a text."""
        return any(chain[-1] in ("import_module", "__import__") for chain in self.chains)

    def visit_Name(self, node: ast.Name) -> None:
        self.chains.add((node.id,))
        self.bare.add(node.id)

    def visit_Attribute(self, node: ast.Attribute) -> None:
        attributes, value = [node.attr], node.value
        while isinstance(value, ast.Attribute):
            attributes.append(value.attr)
            value = value.value
        if isinstance(value, ast.Name):
            self.chains.add((value.id, *reversed(attributes)))
        else:
            self.visit(value)

    def visit_Global(self, node: ast.Global) -> None:
        self.chains |= {(name,) for name in node.names}

    def visit_Import(self, node: ast.Import) -> None:
        self.imports.append(node)

    def visit_ImportFrom(self, node: ast.ImportFrom) -> None:
        self.imports.append(node)

    def visit_Constant(self, node: ast.Constant) -> None:
        if isinstance(node.value, str):
            self.texts.add(node.value)

    def visit_AnnAssign(self, node: ast.AnnAssign) -> None:
        # Only fields of classes keep their annotation: types of what an instance holds, read by pydantic.
        for inner in ast.walk(node.annotation):
            parsed = _parsed_annotation(inner.value) if isinstance(inner, ast.Constant) else None
            self.fields |= {n.id for n in ast.walk(parsed or inner) if isinstance(n, ast.Name)}
            if parsed is not None:
                self.visit(parsed)
        self.generic_visit(node)


class _Normalised(ast.NodeTransformer):
    """Removes from a syntax tree what has no effect."""

    def __init__(self) -> None:
        self.in_class = False

    def visit_ClassDef(self, node: ast.ClassDef) -> ast.AST:
        outer, self.in_class = self.in_class, True
        self.generic_visit(node)
        self.in_class = outer
        node.body = node.body or [ast.Pass()]
        return node

    def visit_FunctionDef(self, node: ast.FunctionDef | ast.AsyncFunctionDef) -> ast.AST:
        outer, self.in_class = self.in_class, False
        if _names_called(node.decorator_list) <= _PURE_DECORATORS:
            node.returns = None
            for argument in ast.walk(node.args):
                if isinstance(argument, ast.arg):
                    argument.annotation = None
        self.generic_visit(node)
        self.in_class = outer
        node.body = node.body or [ast.Pass()]
        return node

    visit_AsyncFunctionDef = visit_FunctionDef  # noqa: N815

    def visit_Expr(self, node: ast.Expr) -> ast.AST | None:
        self.generic_visit(node)
        return None if isinstance(node.value, ast.Constant) else node

    def visit_AnnAssign(self, node: ast.AnnAssign) -> ast.AST | None:
        self.generic_visit(node)
        if self.in_class:
            return node
        return None if node.value is None else ast.Assign([node.target], node.value)

    def visit_Call(self, node: ast.Call) -> ast.AST:
        self.generic_visit(node)
        if _names_called([node.func]) == {"field"}:
            node.keywords = [keyword for keyword in node.keywords if keyword.arg != "help"]
        return node


@lru_cache(maxsize=4096)
def module_named(name: str) -> Module | None:
    """Return a module by its name, or None where there is no source: a name in a module, or compiled code."""
    path = path_of(name)
    if path is None:
        return None
    stub = path.with_suffix(".pyi")
    return _parsed(name, path.name == "__init__.py", read_source(path), read_source(stub) if stub.is_file() else b"")


def read_source(path: Path) -> bytes:
    """Return the content of a file of a package."""
    return path.read_bytes()


@lru_cache(maxsize=4096)
def _parsed(name: str, is_package: bool, source: bytes, stub: bytes = b"") -> Module:
    module = Module(name, name if is_package else name.rpartition(".")[0])
    for node in ast.parse(source).body:
        module.add(node)
    module.add_typing(ast.parse(stub).body)
    return module


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


def bound_by(node: ast.Import | ast.ImportFrom, package: str) -> Iterator[tuple[str, Target]]:
    """Return the names that an import binds, each with what it means."""
    if isinstance(node, ast.Import):
        for alias in node.names:
            top = alias.name.partition(".")[0]
            yield alias.asname or top, (alias.name if alias.asname else top, "")
            if not alias.asname and "." in alias.name:
                yield "", (alias.name, "")
        return
    base = node.module or ""
    if node.level:
        parts = package.split(".")
        base = ".".join(parts[: len(parts) - node.level + 1] + ([base] if base else []))
    for alias in node.names:
        yield alias.asname or alias.name, (base, alias.name)


def _names_defined(node: ast.stmt) -> list[str]:
    """Return the names that a function, a class or an assignment to plain names defines, or none."""
    if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
        return [node.name]
    targets = node.targets if isinstance(node, ast.Assign) else [node.target] if isinstance(node, ast.AnnAssign) else []
    flat = [name for t in targets for name in (t.elts if isinstance(t, ast.Tuple) else [t])]
    names = [name.id for name in flat if isinstance(name, ast.Name)]
    return names if len(names) == len(flat) else []


def _is_plain(node: ast.stmt) -> bool:
    """Return whether running a definition has no effect but to bind its name."""
    if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
        return _names_called(node.decorator_list) <= _PURE_DECORATORS
    if isinstance(node, ast.ClassDef):
        return not node.keywords and _names_called(node.decorator_list) <= _PURE_DECORATORS
    called = _names_called(call.func for call in ast.walk(node) if isinstance(call, ast.Call))
    if isinstance(value := getattr(node, "value", None), ast.Call) and _names_called([value]) == {"Method"}:
        # The declaration of a method acts through the options and stages that the host builds.
        return True
    return all(name in _PURE_CALLS or name.lstrip("_")[:1].isupper() for name in called)


def _names_called(nodes: Iterable[ast.expr]) -> set[str]:
    """Return the last names of functions or decorators; an empty one for what has no name."""
    names = set()
    for node in nodes:
        called = node.func if isinstance(node, ast.Call) else node
        names.add(called.attr if isinstance(called, ast.Attribute) else getattr(called, "id", ""))
    return names


def _inner_statements(node: ast.stmt) -> Iterator[ast.stmt]:
    """Return the statements in the blocks of a compound statement."""
    for child in ast.iter_child_nodes(node):
        if isinstance(child, ast.stmt):
            yield child
        elif isinstance(child, ast.ExceptHandler | ast.match_case):
            yield from child.body


def _parsed_annotation(text: Any) -> ast.expr | None:
    try:
        return ast.parse(text, mode="eval").body if isinstance(text, str) else None
    except SyntaxError:
        return None


@dataclass(frozen=True)
class Code:
    """The definitions that can alter a result: the hash of each syntax tree by "module:name".

    `locates_files` are the packages whose definitions find files of their package by its place.
    """

    definitions: Mapping[str, str]
    locates_files: frozenset[str] = frozenset()

    @property
    def hash(self) -> str:
        """The hash of all definitions."""
        digest = hashlib.sha256()
        for name, content in sorted(self.definitions.items()):
            digest.update(f"{name} {content}\n".encode())
        return digest.hexdigest()


def code_of(*starts: Callable[..., Any], leave_out: Iterable[str] = ()) -> Code:
    """Return the definitions that functions and classes depend on.

    A module-level function, class or assignment counts if a definition that counts uses its name; a module that is used
    as a value (`getattr(module, name)`) counts as a whole. Other module-level statements run on import and count for
    every imported module ("module:#number"). Docstrings, comments, formatting, help texts of options and annotations
    have no effect; imports for type checking are followed only for fields of classes. Followed are p2o, the packages
    of plugins and of the starts, without modules in `leave_out`. Names that are put together at run time are not seen.
    """
    targets, values = set[Target](), list[str]()
    for start in starts:
        _take_apart(start, targets, values, {})
    packages = plugin_packages() | {_package_of(start) for start in starts}
    code = _code_of(tuple(sorted(targets)), packages, tuple(leave_out))
    return Code({**code.definitions, "values": repr(values)}, code.locates_files)


@cache
def package_hash(package: str, *, code: bool) -> str:
    """Return the hash of the data files of a package, or of its Python files; documents (.md) count for neither."""
    path = path_of(package)
    if path is None or path.name != "__init__.py":
        return ""
    digest, ignored = hashlib.sha256(), (".py", ".pyc", ".pyi", ".toml", ".md")
    for file in sorted(path.parent.rglob("*")):
        if file.is_file() and (file.suffix == ".py" if code else file.suffix not in ignored):
            digest.update(f"{file.relative_to(path.parent)} {hashlib.sha256(read_source(file)).hexdigest()}\n".encode())
    return digest.hexdigest()


def _take_apart(value: Any, targets: set[Target], values: list[str], seen: dict[int, Any]) -> None:
    """Add the definitions behind a function, a class or an instance to `targets`, and what they hold to `values`."""
    if value is None or isinstance(value, str | bytes | bool | int | float):
        values.append(repr(value))
        return
    if id(value) in seen:
        return
    # Kept alive, so that no other object takes its place in memory.
    seen[id(value)] = value
    values.append(type(value).__name__)
    contents: list[Any] = []
    if isinstance(value, partial):
        contents = [value.func, *value.args, value.keywords]
    elif isinstance(value, FunctionType | type):
        name, module = value.__qualname__.partition(".")[0], module_named(value.__module__)
        if name == "<lambda>" and isinstance(value, FunctionType) and module is not None:
            # No definition has the name of a lambda: what it computes, and the definitions that it uses.
            names, computed = _names_and_code(value.__code__)
            values.append(computed)
            known = {*module.defined, *module.imports}
            targets.update((value.__module__, used) for used in names & known)
        else:
            targets.add((value.__module__, name.replace("<lambda>", "")))
        with contextlib.suppress(ValueError):  # an empty cell
            contents = [cell.cell_contents for cell in getattr(value, "__closure__", None) or ()]
    elif isinstance(value, MethodType):
        contents = [value.__func__, value.__self__]
    elif isinstance(value, np.ndarray):
        values.append(f"{value.dtype} {value.shape} {hashlib.sha256(value.tobytes()).hexdigest()}")
    elif isinstance(value, set | frozenset):
        contents = sorted(value, key=repr)
    else:
        values.append(getattr(value, "__name__", ""))
        inner = parts(value)
        pairs = getattr(value, "__dict__", {}).items() if inner is None else inner
        contents = [type(value), *(part for pair in pairs for part in pair)]
    for part in contents:
        _take_apart(part, targets, values, seen)


def _names_and_code(code: CodeType) -> tuple[set[str], str]:
    """Return the global names that a code object uses, and its instructions with its constants as a text."""
    names, constants = set(code.co_names), []
    text = code.co_code.hex()
    for constant in code.co_consts:
        if isinstance(constant, CodeType):
            inner, computed = _names_and_code(constant)
            names, text = names | inner, text + computed
        else:
            constants.append(repr(constant))
    return names, f"{text} {constants} {code.co_names}"


def _package_of(start: Any) -> str:
    """Return the top-level package of a function, a class or an instance."""
    while isinstance(start, partial):
        start = start.func
    return str(getattr(start, "__module__", None) or type(start).__module__).partition(".")[0]


@lru_cache(maxsize=1024)
def _code_of(targets: tuple[Target, ...], packages: frozenset[str], leave_out: tuple[str, ...]) -> Code:
    walk = _Walk(packages, leave_out)
    for module, name in targets:
        walk.use(module, (name,) if name else ())
    return walk.run()


class _Walk:
    """Follows names from definition to definition; `use` adds to what waits, `run` returns all that was reached."""

    def __init__(self, packages: Iterable[str], leave_out: Iterable[str]) -> None:
        self.packages, self.leave_out = frozenset(packages), tuple(leave_out)
        self.hashes: dict[str, str] = {}
        self.locating: set[str] = set()
        self.loaded: set[str] = set()
        self.waiting: list[tuple[Module, Statement]] = []
        self.seen: set[Target] = set()
        self.asked: set[tuple[str, Chain]] = set()

    def run(self) -> Code:
        """Return all definitions that are reached."""
        while self.waiting:
            module, statement = self.waiting.pop()
            uses = statement.uses
            inside: dict[str, list[Target]] = {}
            for node in uses.imports:
                for bound, (home, name) in bound_by(node, module.package):
                    inside.setdefault(bound, []).append((home, name))
                    self.load(home)
                    if name:
                        self.use(home, () if name == "*" else (name,))
            if uses.locates_files:
                self.locating.add(module.name.partition(".")[0])
            if DYNAMIC & uses.bare:
                self.use(module.name, ())
            for text in uses.texts if uses.imports_by_name else ():
                self.use(text, ())
            for chain in uses.chains:
                for home, name in inside.get(chain[0], []):
                    self.use(home, ((name,) if name else ()) + chain[1:])
                self.look_up(module, chain, typing=chain[0] in uses.fields)
        return Code(self.hashes, frozenset(self.locating) - {"p2o"})

    def module(self, name: str) -> Module | None:
        """Return a module that is followed, None for any other name."""
        if name.partition(".")[0] not in self.packages:
            return None
        if any(name == left or name.startswith(f"{left}.") for left in self.leave_out):
            return None
        return module_named(name)

    def load(self, name: str) -> Module | None:
        """Count what runs when a module is imported, with its packages and all that it imports."""
        waiting = [name]
        while waiting:
            name_here = waiting.pop()
            if name_here in self.loaded:
                continue
            self.loaded.add(name_here)
            module = self.module(name_here)
            if "." in name_here:
                waiting.append(name_here.rpartition(".")[0])
            if module is None:
                continue
            for number, statement in enumerate(module.running):
                self.count(module, f"#{number}", statement)
            for home, inner in module.loads:
                waiting += [home, f"{home}.{inner}"] if inner else [home]
        return self.module(name)

    def count(self, module: Module, name: str, statement: Statement) -> None:
        """Count a statement, and have what it uses followed."""
        key = f"{module.name}:{name}"
        self.hashes[key] = self.hashes.get(key, "") + statement.digest
        self.waiting.append((module, statement))

    def use(self, home: str, chain: Chain) -> None:
        """Count what `chain` (a name and its attributes) means in a module; without any name the whole module."""
        if (home, chain) in self.asked:
            return
        self.asked.add((home, chain))
        module = self.load(home)
        if module is None or (chain and self.look_up(module, chain, typing=module.is_lazy)):
            return
        if chain and self.module(f"{home}.{chain[0]}") is not None:
            self.use(f"{home}.{chain[0]}", chain[1:])
            return
        for name in [*module.defined, *module.imports, *(module.typing if module.is_lazy else ())]:
            self.look_up(module, (name,), typing=module.is_lazy)

    def look_up(self, module: Module, chain: Chain, *, typing: bool) -> bool:
        """Count what a name means in its own module, with `typing` also by imports for type checking."""
        name = chain[0]
        if name in module.defined and (module.name, name) not in self.seen:
            self.seen.add((module.name, name))
            for statement in module.defined[name]:
                self.count(module, name, statement)
        targets = module.imports.get(name, [])
        if typing and name not in module.defined:
            targets = [*targets, *module.typing.get(name, [])]
        for home, inner in targets:
            self.use(home, ((inner,) if inner else ()) + chain[1:])
        return bool(targets) or name in module.defined
