"""Who may import whom, held by reading the sources. A rule is one test that names every offender."""

from __future__ import annotations

import ast
import importlib
import re
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from functools import cache
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import p2o
import pytest

ROOT = Path(__file__).parents[1]
FOLDERS = {
    "toolkit": ("p2o", "p2o_study", "p2o_fleet", "p2o_rig", "p2o_train", "p2o_testing", "p2o_pages"),
    "plugins": ("p2o_plugins", "p2o_datasets", "p2o_formats", "p2o_sim"),
    "baselines": ("p2o_baselines",),
    "tests/example_plugin": ("p2o_example",),
}
PACKAGES = {package: ROOT / folder / package for folder, packages in FOLDERS.items() for package in packages}
ORDINARY = ("p2o_plugins", "p2o_datasets", "p2o_formats", "p2o_sim", "p2o_baselines", "p2o_example")
"""Packages that use the author API of p2o only, as every installed plugin does."""
BESIDE = {"p2o_datasets": {"p2o_formats"}, "p2o_fleet": {"p2o_study"}}
"""Packages that a package may import besides itself and p2o."""

FLOORS = (
    {"errors"},
    {"runtime"},
    {"arrays", "options"},
    {"files"},
    {"geometry"},
    {"frames", "calibration_files"},
    {"features"},
    {"results"},
    {"problems", "draw"},
    {"page"},
    {"host"},
    {"calibration", "cache", "training_loop"},
    {"confidence"},
    {"run"},
    {"cli"},
)
"""The rooms of p2o, lowest first: a room imports from lower floors only, for type checkers too."""
FLOOR_OF = {room: floor for floor, rooms in enumerate(FLOORS) for room in rooms}
OUTSIDE = {"__init__", "__main__", "reading", "solving"}
"""Modules outside the rooms: the author API with its lazy imports, and `python -m p2o`."""
AUTHOR_API = ("p2o", "p2o.solving", "p2o.reading")
"""The author API: the modules of p2o that plugins import, ours included."""
FOR_COMMANDS = {"p2o.cli.json_output", "p2o.cli.plugin_options", "p2o.run.recipe", "p2o.run.words"}
"""Further modules that the commands of a package (its folder `cli`) may import."""

HEAVY = {
    *("torch", "kornia", "cv2", "pycolmap", "pyceres", "matplotlib", "joblib", "safetensors", "onnxruntime", "cma"),
    *("laspy", "pyarrow", "viser"),
}
NETWORK = "p2o_plugins.p2ornet"
REGRESSORS = "p2o_baselines.regressors"
NETWORKS = (NETWORK, REGRESSORS)
"""The folders that may import heavy packages on import: methods import them when they need them."""
LIGHT = {f"{NETWORK}.{name}" for name in ("design", "graph", "onnx_file", "options", "shipped", "weights")} | {
    f"{REGRESSORS}.{name}" for name in ("design", "method", "network_input", "options", "sample")
}
"""The modules of them that a method's declaration needs, so they must be light."""
MAY_IMPORT = {"image": {"p2ornet"}, "p2ornet": {"cloud"}}
"""Which folders of p2o_plugins use others: the network is of the image side, and learns from sweeps."""


@dataclass(frozen=True)
class Import:
    """`import module` (no name) or `from module import name`."""

    module: str
    name: str
    line: int

    @property
    def loaded(self) -> tuple[str, ...]:
        """What may be a module in it."""
        return (self.module, f"{self.module}.{self.name}") if self.name else (self.module,)


class Source:
    """One file, parsed once."""

    def __init__(self, path: Path, text: str, module: str) -> None:
        self.path, self.text, self.module = path, text, module
        self.package = module.partition(".")[0]
        self.tree = ast.parse(text)
        self.imports = list(_imports(ast.walk(self.tree)))
        self.imports_on_load = list(_imports(_executed(self.tree.body)))
        self.imports_at_runtime = list(_imports(_without_type_checking(self.tree)))

    def __str__(self) -> str:
        return str(self.path.relative_to(ROOT))

    @property
    def of_the_network(self) -> bool:
        return self.module.startswith(tuple(f"{network}." for network in NETWORKS))

    @property
    def light(self) -> bool:
        """Whether importing the file must not load heavy packages."""
        return not self.of_the_network or self.module in LIGHT


def _imports(nodes: Iterator[ast.AST]) -> Iterator[Import]:
    for node in nodes:
        if isinstance(node, ast.Import):
            yield from (Import(alias.name, "", node.lineno) for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            yield from (Import("." * node.level + (node.module or ""), a.name, node.lineno) for a in node.names)


def _executed(body: list[ast.stmt]) -> Iterator[ast.AST]:
    """Return the statements that run on import: not those of functions, nor those for type checkers."""
    for node in body:
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            continue
        if isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test):
            continue
        yield node
        for inner in ("body", "orelse", "finalbody", "handlers"):
            yield from _executed(getattr(node, inner, []))


def _without_type_checking(node: ast.AST) -> Iterator[ast.AST]:
    """Return a node and the nodes inside it, except blocks for type checkers."""
    yield node
    type_checking = isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test)
    for child in node.orelse if type_checking else ast.iter_child_nodes(node):
        yield from _without_type_checking(child)


@cache
def sources() -> tuple[Source, ...]:
    found = []
    for folder in PACKAGES.values():
        for path in sorted(folder.rglob("*.py")):
            module = ".".join(path.relative_to(folder.parent).with_suffix("").parts).removesuffix(".__init__")
            found.append(Source(path, path.read_text(encoding="utf-8"), module))
    return tuple(found)


def of(*packages: str) -> list[Source]:
    return [source for source in sources() if source.package in packages]


def nobody(offenders: list[str], rule: str) -> None:
    assert not offenders, f"{rule}:\n  " + "\n  ".join(offenders)


# ---- packages and rooms


def test_there_are_sources_to_look_at() -> None:
    assert {source.package for source in sources()} == set(PACKAGES)
    assert len(sources()) > 40


def test_imports_are_absolute() -> None:
    offenders = [f"{s}:{i.line}" for s in sources() for i in s.imports if i.module.startswith(".")]
    nobody(offenders, "imports name the whole module")


def test_packages_import_p2o_and_those_beside_it_only() -> None:
    offenders = [
        f"{source}:{found.line} imports {found.module}"
        for source in sources()
        for found in source.imports
        if found.module.partition(".")[0] in set(PACKAGES) - {source.package, "p2o"} - BESIDE.get(source.package, set())
    ]
    nobody(offenders, "packages import p2o, themselves and what BESIDE allows only")


def rooms(source: Source) -> Iterator[tuple[str, str, int]]:
    """Return (module, imported module, line), all without `p2o.`, of each import of p2o from another room of it."""
    own = source.module.removeprefix("p2o").removeprefix(".")
    for found in source.imports:
        if found.module == "p2o":  # `from p2o import room` or a public name, which is p2o itself
            other = found.name if found.name in FLOOR_OF else ""
        elif found.module.startswith("p2o."):
            other = found.module.removeprefix("p2o.")
        else:
            continue
        if own.partition(".")[0] != other.partition(".")[0]:
            yield own, other, found.line


def goes_down(own: str, other: str) -> bool:
    """Whether a module of p2o stands on a higher floor than what it imports."""
    return bool(other) and FLOOR_OF[own.partition(".")[0]] > FLOOR_OF[other.partition(".")[0]]


MOST_ROOMS, MOST_ARROWS = 24, 120


def test_rooms_and_the_imports_between_them_are_few() -> None:
    inside = [source for source in of("p2o") if source.path.relative_to(PACKAGES["p2o"]).parts[0][:-3] not in OUTSIDE]
    arrows = {(own.partition(".")[0], other.partition(".")[0]) for s in inside for own, other, _ in rooms(s) if other}
    assert len(FLOOR_OF) <= MOST_ROOMS
    assert len(arrows) <= MOST_ARROWS, f"{len(arrows)} pairs of rooms import each other"


def test_the_page_of_the_architecture_names_every_room() -> None:
    page = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")
    table = page.partition("| from top to bottom | contents |")[2].partition("\n\n")[0]
    first = " ".join(line.split("|")[1] for line in table.splitlines() if line.startswith("| `"))
    assert set(re.findall(r"`(\w+)/?`", first)) == set(FLOOR_OF)


def test_every_room_stands_on_one_floor() -> None:
    there = {source.path.relative_to(PACKAGES["p2o"]).parts[0].removesuffix(".py") for source in of("p2o")}
    assert there == set(FLOOR_OF) | OUTSIDE
    assert sum(map(len, FLOORS)) == len(FLOOR_OF)


def test_rooms_import_from_lower_floors_only() -> None:
    inside = [
        source for source in of("p2o") if source.path.parent != PACKAGES["p2o"] or source.path.stem not in OUTSIDE
    ]
    upward = [(source, *link) for source in inside for link in rooms(source) if not goes_down(*link[:2])]
    offenders = [f"{source}:{line} imports p2o.{other}".rstrip(".") for source, own, other, line in upward]
    nobody(offenders, "rooms of p2o import from lower floors only (FLOORS)")


# ---- cycles


def module_cycle(sources: Iterable[Source], *, types: bool = False) -> list[str]:
    """Return a cycle of modules that import one another, on load, inside functions or for type checkers, or nothing."""
    imports = {source.module: source.imports if types else source.imports_at_runtime for source in sources}
    modules = {
        module: {next((name for name in reversed(found.loaded) if name in imports), "") for found in links} - {""}
        for module, links in imports.items()
    }
    try:
        TopologicalSorter(modules).prepare()
    except CycleError as problem:
        cycle: list[str] = problem.args[1]
        return cycle[::-1]
    return []


def test_modules_do_not_import_one_another_in_cycles() -> None:
    inside = [source for source in of("p2o") if source.path.stem != "__init__"]
    cycle = module_cycle(sources()) or module_cycle(inside, types=True)
    assert not cycle, " imports ".join(cycle)


SIMULATOR = {"world": set(), "things": {"world"}, "places": {"world", "things"}, "sensing": {"world"}, "write": set()}
"""Which folders of the simulator import which others."""


def test_folders_of_the_simulator_import_lower_ones_only() -> None:
    offenders = []
    for source in of("p2o_sim"):
        own = next(iter(source.module.split(".")[1:2]), "")
        for found in source.imports_at_runtime:
            package, *inside = found.module.split(".")
            if package == "p2o_sim" and own in SIMULATOR and not {*inside[:1]} <= {own, *SIMULATOR[own]}:
                offenders.append(f"{source}:{found.line} imports {found.module}")
    nobody(offenders, "folders of p2o_sim import those below them only (SIMULATOR)")


# ---- what plugins may use of p2o


def private_names(source: Source) -> Iterator[str]:
    """Return what a package uses of p2o that is not in the author API, with its line."""
    public = {module: set(importlib.import_module(module).__all__) for module in AUTHOR_API}
    for found in source.imports:
        in_commands = source.module.split(".")[1:2] == ["cli"] and found.module in FOR_COMMANDS
        if found.module.partition(".")[0] != "p2o" or in_commands:
            continue
        if found.module not in public or (found.name and found.name not in public[found.module]):
            yield f"{source}:{found.line} {found.module}.{found.name}".rstrip(".")
    for node in ast.walk(source.tree):
        module, _, name = ast.unparse(node).rpartition(".") if isinstance(node, ast.Attribute) else ("", "", "")
        if module in public and name not in public[module]:
            yield f"{source}:{node.lineno} {module}.{name}"


def test_plugins_use_the_author_api_only() -> None:
    offenders = [name for source in of(*ORDINARY) for name in private_names(source)]
    nobody(offenders, "plugins import p2o, p2o.solving and p2o.reading only")


@pytest.mark.parametrize(
    ("code", "found"),
    [
        ("from p2o import Frame, solving", []),
        ("from p2o.solving import PointToLine", []),
        ("import p2o\np2o.se3.apply(p2o.solving.consensus)", []),
        ("from p2o.solving import _hidden", ["1 p2o.solving._hidden"]),
        ("import p2o\np2o._hidden", ["2 p2o._hidden"]),
        ("from p2o.problems.pairing import pair", ["1 p2o.problems.pairing.pair"]),
        ("from p2o import run", ["1 p2o.run"]),
        ("import p2o.run.run", ["1 p2o.run.run"]),
        ("from p2o.run.recipe import open_dataset", ["1 p2o.run.recipe.open_dataset"]),
    ],
)
def test_a_private_name_is_found(code: str, found: list[str]) -> None:
    source = Source(PACKAGES["p2o_plugins"] / "new.py", code, "p2o_plugins.new")
    assert list(private_names(source)) == [f"{source}:{place}" for place in found]


def test_commands_of_packages_may_use_the_recipe_and_the_options_of_the_command_line() -> None:
    code = "from p2o.run.recipe import open_dataset\nfrom p2o.run.run import calibrate"
    source = Source(PACKAGES["p2o_sim"] / "cli/new.py", code, "p2o_sim.cli.new")
    assert list(private_names(source)) == [f"{source}:2 p2o.run.run.calibrate"]


# ---- what is heavy


def test_heavy_packages_are_imported_inside_functions() -> None:
    offenders = [
        f"{source}:{found.line} {found.module}"
        for source in sources()
        for found in source.imports_on_load
        if source.light and found.module.partition(".")[0] in HEAVY
    ]
    nobody(offenders, "heavy packages are imported where they are used")


def test_the_network_is_imported_inside_functions() -> None:
    def is_heavy(module: str) -> bool:
        inside = module == NETWORK or module.startswith(tuple(f"{network}." for network in NETWORKS))
        return inside and not any(module == light or module.startswith(f"{light}.") for light in LIGHT)

    offenders = [
        f"{source}:{found.line} {found.module}"
        for source in sources()
        for found in source.imports_on_load
        if source.light and any(is_heavy(module) for module in found.loaded)
    ]
    nobody(offenders, "the network is imported where it is used")


def test_the_network_is_where_the_rules_look() -> None:
    network = {source.module for source in sources() if source.of_the_network}
    assert len(network) > 5
    assert network > LIGHT


def test_only_the_method_of_the_network_uses_it() -> None:
    users = {s.module for s in sources() if any(i.module.startswith(NETWORK) for i in s.imports)}
    assert {user for user in users if not user.startswith(NETWORK)} == {"p2o_plugins.image.p2ornet"}


def test_click_is_for_the_command_line_only() -> None:
    offenders = [
        f"{source}:{found.line}"
        for source in sources()
        for found in source.imports
        if found.module.partition(".")[0] == "click" and source.module.split(".")[1:2] != ["cli"]
    ]
    nobody(offenders, "click stays in the folders cli")


# ---- files


def test_stage_folders_do_not_import_one_another() -> None:
    offenders = []
    for source in of("p2o_plugins"):
        own = source.module.split(".")[1:2]
        if not own or own == ["hooks"]:
            continue
        for found in source.imports:
            parts = found.module.split(".")
            if parts[0] == "p2o_plugins" and parts[1:2] and parts[1] not in {*own, *MAY_IMPORT.get(own[0], ())}:
                offenders.append(f"{source}:{found.line} imports {found.module}")
    nobody(offenders, "folders of stages stand alone")


def offenders_of(rule: Callable[[Source], object]) -> list[str]:
    return [str(source) for source in sources() if not rule(source)]


def test_files_are_named_for_what_they_hold() -> None:
    vague = re.compile(r"(utils?|helpers?|common|managers?|misc|base|core)\.py")
    nobody(offenders_of(lambda source: not vague.fullmatch(source.path.name)), "a file is named for what it holds")


def test_files_say_what_they_hold() -> None:
    nobody(offenders_of(lambda source: ast.get_docstring(source.tree) or not source.text.strip()), "no docstring")


MAX_LINES = 80


def test_functions_are_at_most_80_lines_long() -> None:
    too_long = {
        (source.module, node.name): node.end_lineno - node.lineno + 1
        for source in sources()
        for node in ast.walk(source.tree)
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef)
        and node.end_lineno is not None
        and node.end_lineno - node.lineno >= MAX_LINES
    }
    new = [f"{module}.{name}: {lines} lines" for (module, name), lines in too_long.items()]
    nobody(new, f"functions have at most {MAX_LINES} lines")


def test_nothing_is_left_undone() -> None:
    undone = re.compile(r"\b(TODO|FIXME|XXX|HACK|TEMPORARY)\b|raise NotImplementedError")
    nobody(offenders_of(lambda source: not undone.search(source.text)), "something is left undone")


def test_a_method_is_found_by_its_file() -> None:
    """A file that defines METHOD is offered by the hooks, and its name is in the name of the method or the reverse."""
    offered = {o.method.build.__module__: o.name for o in p2o.Registry.load(environ={}).offers if o.dist == "p2o-calib"}
    methods = [
        source
        for source in of("p2o_plugins", "p2o_baselines")
        if any(isinstance(n, ast.Assign) and ast.unparse(n.targets[0]) == "METHOD" for n in source.tree.body)
    ]
    assert len(methods) > 10
    nobody([str(s) for s in methods if s.module not in offered], "METHOD is defined, but no hook offers it")
    odd = [f"{s}: {offered[s.module]}" for s in methods if offered[s.module].replace("-", "_") not in s.path.stem]
    nobody(odd, "the file of a method has its name")
