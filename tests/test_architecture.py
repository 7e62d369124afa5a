"""Who may import whom, held by reading the sources. A rule is one test that names every offender."""

from __future__ import annotations

import ast
import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import p2o
import pytest

ROOT = Path(__file__).parents[1]
PACKAGES = {
    "p2o": ROOT / "toolkit/p2o",
    "p2o_plugins": ROOT / "plugins/p2o_plugins",
    "p2o_baselines": ROOT / "baselines/p2o_baselines",
    "p2o_example": ROOT / "tests/example_plugin/p2o_example",
}
ORDINARY = ("p2o_plugins", "p2o_baselines", "p2o_example")
"""Packages that are to p2o what everyone's plugins are."""

FLOORS = (
    {"errors", "moved", "native"},
    {"arrays", "files", "options", "threads"},
    {"geometry"},
    {"frames", "bags"},
    {"features"},
    {"results"},
    {"problems", "draw", "simulate"},
    {"host"},
    {"calibration", "formats"},
    {"run", "picks", "viewer"},
    {"work", "learn"},
    {"study", "testing"},
    {"report"},
    {"cli"},
)
"""The rooms of p2o, lowest first: a room imports from lower floors only, for type checkers too."""
FLOOR_OF = {room: floor for floor, rooms in enumerate(FLOORS) for room in rooms}
OUTSIDE = {"__init__", "__main__"}
"""The doors of p2o: the table of public names, and `python -m p2o`."""
UPWARD = {
    # Reads the table of public names, to find the module behind `p2o.Name` in a source file.
    ("work.sources", ""),
}
"""Imports that go upwards all the same: (module, imported module), "" for p2o itself."""

OPEN_MODULES = {
    "arrays",
    "bags.bag",
    "bags.choice",
    "bags.frame_tree",
    "bags.messages",
    "bags.overview",
    "bags.point_columns",
    "features.maps",
    "files.file_names",
    "geometry.motion",
    "geometry.pose_text",
    "geometry.rough_start",
    "files.array_file",
    "files.input_file",
    "files.parsed_text",
    "files.whole_file",
    "formats.calibration",
    "formats.camera_entry",
    "formats.files",
    "formats.format",
    "formats.kitti_calibration",
    "frames.direction",
    "frames.accumulate",
    "frames.lidar_odometry",
    "frames.rings",
    "host.validation",
    "native",
    "picks.pairs",
    "picks.solve",
    "problems.chart",
    "problems.line_fit",
    "problems.normal_equations",
    "problems.pairing",
    "problems.points_on_rays",
    "problems.swarm",
    "results.result_json",
    "simulate",
    "testing",
}
"""Modules of p2o, besides the names in `p2o.__all__`, that plugins may use."""

HEAVY = {
    "torch",
    "kornia",
    "cv2",
    "pycolmap",
    "pyceres",
    "matplotlib",
    "joblib",
    "safetensors",
    "onnx",
    "onnxruntime",
    "cma",
    "laspy",
    "pyarrow",
    "viser",
}
NETWORK = "p2o_plugins.p2ornet"
REGRESSORS = "p2o_baselines.regressors"
NETWORKS = (NETWORK, REGRESSORS)
"""The folders that may import heavy packages on import: methods import them when they need them."""
LIGHT = {f"{NETWORK}.{name}" for name in ("design", "graph", "options", "shipped", "weights")} | {
    f"{REGRESSORS}.{name}"
    for name in ("decalibration", "design", "glance", "lesson", "method", "options", "sample", "sweep_map")
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


def test_p2o_knows_no_plugin_and_plugins_know_only_p2o() -> None:
    offenders = [
        f"{source}:{found.line} imports {found.module}"
        for source in sources()
        for found in source.imports
        if found.module.partition(".")[0] in set(PACKAGES) - {source.package, "p2o"}
    ]
    nobody(offenders, "packages import p2o and themselves only")


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


def test_the_page_of_the_architecture_names_every_room_and_counts_them() -> None:
    page = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")
    named = set(re.findall(r"`(\w+)/?`", page.partition("| floor | room |")[2].partition("\n\n")[0]))
    named |= {"moved"} & set(re.findall(r"`p2o/(\w+)\.py`", page))
    assert set(FLOOR_OF) <= named, f"the table of rooms lacks {sorted(set(FLOOR_OF) - named)}"
    assert f"({len(FLOOR_OF)} rooms on {len(FLOORS)} floors," in page


def test_every_room_stands_on_one_floor() -> None:
    there = {source.path.relative_to(PACKAGES["p2o"]).parts[0].removesuffix(".py") for source in of("p2o")}
    assert there == set(FLOOR_OF) | OUTSIDE
    assert sum(map(len, FLOORS)) == len(FLOOR_OF)


def test_rooms_import_from_lower_floors_only() -> None:
    inside = [
        source for source in of("p2o") if source.path.parent != PACKAGES["p2o"] or source.path.stem not in OUTSIDE
    ]
    upward = [(source, *link) for source in inside for link in rooms(source) if not goes_down(*link[:2])]
    offenders = [
        f"{source}:{line} imports p2o.{other}".rstrip(".")
        for source, own, other, line in upward
        if (own, other) not in UPWARD
    ]
    nobody(offenders, "rooms of p2o import from lower floors only (FLOORS)")
    over = UPWARD - {(own, other) for _, own, other, _ in upward}
    assert not over, f"UPWARD holds what is no longer so: {sorted(over)}"


@pytest.mark.parametrize(
    ("code", "found"),
    [
        ("from p2o.geometry import se3", []),
        ("from p2o.frames.cloud import Cloud", []),
        ("from p2o.features import side", [("features", 1)]),
        ("import p2o.host.registry", [("host.registry", 1)]),
        ("import p2o", [("", 1)]),
        ("from p2o import Frame", [("", 1)]),
        ("if TYPE_CHECKING:\n    from p2o.run.run import Run", [("run.run", 2)]),
        ("def f():\n    from p2o import study", [("study", 2)]),
        ("import numpy", []),
    ],
)
def test_an_upward_import_is_seen(code: str, found: list[tuple[str, int]]) -> None:
    source = Source(PACKAGES["p2o"] / "frames/image.py", code, "p2o.frames.image")
    assert [(other, line) for own, other, line in rooms(source) if not goes_down(own, other)] == found


# ---- what plugins may use of p2o


def hidden_names(source: Source) -> Iterator[str]:
    """Return what a plugin uses of p2o that is neither a public name nor in an open module, with its line."""
    public = set(p2o.__all__) | OPEN_MODULES
    ways = {module[:at] for module in OPEN_MODULES for at, letter in enumerate(module) if letter == "."}
    for found in source.imports:
        head, _, module = found.module.partition(".")
        path = f"{module}.{found.name}".strip(".")
        of_an_open_module = module in OPEN_MODULES and found.name and not found.name.startswith("_")
        if head == "p2o" and path and path not in public and not of_an_open_module:
            yield f"{source}:{found.line} p2o.{path}"
    for node in ast.walk(source.tree):
        head, _, path = ast.unparse(node).partition(".") if isinstance(node, ast.Attribute) else ("", "", "")
        inside = any(path == name or path.startswith(f"{name}.") for name in public)
        if head == "p2o" and path not in ways and (not inside or "._" in path):
            yield f"{source}:{node.lineno} p2o.{path}"


def test_plugins_use_public_names_of_p2o_only() -> None:
    offenders = [name for source in of(*ORDINARY) for name in hidden_names(source)]
    nobody(offenders, "plugins use p2o.__all__ and OPEN_MODULES only")


@pytest.mark.parametrize(
    ("code", "found"),
    [
        ("import p2o\np2o.Frame", []),
        ("from p2o import Frame, simulate", []),
        ("from p2o.arrays import Float", []),
        ("from p2o.problems import pairing", []),
        ("import p2o.problems.pairing\np2o.problems.pairing.pair", []),
        ("from p2o.problems.pairing import _spread", ["1 p2o.problems.pairing._spread"]),
        ("from p2o.problems import directed_cost", ["1 p2o.problems.directed_cost"]),
        ("from p2o import study", ["1 p2o.study"]),
        ("import p2o\np2o.study", ["2 p2o.study"]),
        ("import p2o\np2o.problems.directed_cost", ["2 p2o.problems.directed_cost"]),
        ("import p2o\np2o.se3.apply(p2o.problems.chart.pose_at)", []),
        ("from p2o.simulate import lidar", []),
        ("from p2o.simulate.lidar import Lidar", ["1 p2o.simulate.lidar.Lidar"]),
        ("import p2o.run.run", ["1 p2o.run.run"]),
    ],
)
def test_a_name_that_is_not_public_is_seen(code: str, found: list[str]) -> None:
    source = Source(PACKAGES["p2o_plugins"] / "new.py", code, "p2o_plugins.new")
    assert list(hidden_names(source)) == [f"{source}:{place}" for place in found]


def test_open_modules_are_there() -> None:
    assert {f"p2o.{module}" for module in OPEN_MODULES} <= {source.module for source in of("p2o")}


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
        if found.module.partition(".")[0] == "click" and not source.module.startswith("p2o.cli")
    ]
    nobody(offenders, "click stays in p2o.cli")


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
