"""Who may import whom, held by reading the sources (STYLE sections 2 and 4)."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import p2o
import pytest

ROOT = Path(__file__).parents[1]
PACKAGES = {"p2o": ROOT / "toolkit/p2o", "p2o_plugins": ROOT / "plugins/p2o_plugins"}
PACKAGES["p2o_baselines"] = ROOT / "baselines/p2o_baselines"
HEAVY = {"torch", "kornia", "cv2", "pycolmap", "pyceres", "matplotlib", "joblib", "safetensors"}
NETWORK = "p2o_plugins.p2ornet"
"""The one folder that may import heavy packages on import: methods import it when they need it."""
LIGHT = (f"{NETWORK}.options", f"{NETWORK}.shipped")
"""The module of it that a method's declaration needs, so it must be light."""
MAY_IMPORT = {"image": {"p2ornet"}, "p2ornet": {"cloud"}}
"""Which folders of p2o_plugins use others: the network is of the image side, and learns from sweeps."""
OPEN_MODULES = {
    "arrays",
    "files.whole_file",
    "frames.accumulate",
    "frames.lidar_odometry",
    "host.validation",
    "problems.chart",
    "problems.normal_equations",
    "problems.pairing",
    "results.result_json",
    "simulate",
    "testing",
}
"""Modules of p2o, besides the names in `p2o.__all__`, that plugins may use."""


def sources() -> list[Path]:
    return sorted(path for folder in PACKAGES.values() for path in folder.rglob("*.py"))


def named(path: Path) -> str:
    return str(path.relative_to(ROOT))


def package_of(path: Path) -> str:
    return next(name for name, folder in PACKAGES.items() if folder in path.parents)


def imports(path: Path, *, top_level: bool = False) -> Iterator[tuple[str, str]]:
    """Return (module, name) of each import of a file; `top_level`: only what importing the file imports."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    nodes = list(_executed(tree.body)) if top_level else list(ast.walk(tree))
    for node in nodes:
        if isinstance(node, ast.Import):
            yield from ((alias.name, "") for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: relative import"
            yield from ((node.module or "", alias.name) for alias in node.names)


def _executed(body: list[ast.stmt]) -> Iterator[ast.stmt]:
    """Return the statements that run on import: not those of functions, nor those for type checkers."""
    for node in body:
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            continue
        if isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test):
            continue
        yield node
        for inner in ("body", "orelse", "finalbody"):
            yield from _executed(getattr(node, inner, []))


def test_there_are_sources_to_look_at() -> None:
    assert {package_of(path) for path in sources()} == set(PACKAGES)
    assert len(sources()) > 40


@pytest.mark.parametrize("path", sources(), ids=named)
def test_packages_import_downwards_only(path: Path) -> None:
    own = package_of(path)
    used = {module.partition(".")[0] for module, _ in imports(path)} & set(PACKAGES)
    allowed = {"p2o": {"p2o"}, "p2o_plugins": {"p2o_plugins", "p2o"}, "p2o_baselines": {"p2o_baselines", "p2o"}}
    assert used <= allowed[own], f"{own} imports {used - allowed[own]}"


@pytest.mark.parametrize("path", [p for p in sources() if package_of(p) != "p2o"], ids=named)
def test_plugins_use_public_names_of_p2o_only(path: Path) -> None:
    public = set(p2o.__all__)
    for module, name in imports(path):
        head, _, tail = module.partition(".")
        if head != "p2o":
            continue
        if tail:
            assert any(tail == m or tail.startswith(f"{m}.") for m in OPEN_MODULES | public), f"{module} is not public"
        elif name:
            assert name in public | OPEN_MODULES, f"p2o.{name} is not public"
    tree = ast.parse(path.read_text(encoding="utf-8"))
    attributes = {
        node.attr
        for node in ast.walk(tree)
        if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name) and node.value.id == "p2o"
    }
    assert attributes <= public | OPEN_MODULES, f"p2o.{attributes - public} is not public"


def of_the_network(path: Path) -> bool:
    return path.parent == PACKAGES["p2o_plugins"] / "p2ornet"


def light(path: Path) -> bool:
    """Whether importing the file must not load heavy packages."""
    return not of_the_network(path) or path.stem in (*(module.rpartition(".")[2] for module in LIGHT), "__init__")


@pytest.mark.parametrize("path", [p for p in sources() if light(p)], ids=named)
def test_heavy_packages_are_imported_inside_functions(path: Path) -> None:
    loaded = {module.partition(".")[0] for module, _ in imports(path, top_level=True)}
    assert not loaded & HEAVY


@pytest.mark.parametrize("path", [p for p in sources() if light(p)], ids=named)
def test_the_network_is_imported_inside_functions(path: Path) -> None:
    for module, name in imports(path, top_level=True):
        for loaded in (module, f"{module}.{name}"):
            inside = loaded == NETWORK or loaded.startswith(f"{NETWORK}.")
            assert not inside or any(loaded == m or loaded.startswith(f"{m}.") for m in LIGHT), f"{loaded} is heavy"


def test_the_network_is_where_the_rules_look() -> None:
    assert sum(of_the_network(path) for path in sources()) > 5
    assert set(LIGHT) <= {
        ".".join(p.relative_to(ROOT / "plugins").with_suffix("").parts)
        for p in sources()
        if light(p) and of_the_network(p)
    }


@pytest.mark.parametrize("path", [p for p in sources() if package_of(p) == "p2o_plugins"], ids=named)
def test_stage_folders_do_not_import_one_another(path: Path) -> None:
    own = path.relative_to(PACKAGES["p2o_plugins"]).parts[0]
    if own == "hooks.py":
        return
    for module, _ in imports(path):
        parts = module.split(".")
        if parts[0] == "p2o_plugins" and len(parts) > 1:
            assert parts[1] in {own, *MAY_IMPORT.get(own, ())}, f"{own} imports {module}"


def test_only_the_method_of_the_network_uses_it() -> None:
    users = {p for p in sources() if any(m.startswith(NETWORK) for m, _ in imports(p)) and not of_the_network(p)}
    assert users == {PACKAGES["p2o_plugins"] / "image/p2ornet.py"}


@pytest.mark.parametrize("path", [p for p in sources() if package_of(p) == "p2o"], ids=named)
def test_click_is_for_the_command_line_only(path: Path) -> None:
    if "cli" in path.relative_to(PACKAGES["p2o"]).parts:
        return
    assert not any(module.partition(".")[0] == "click" for module, _ in imports(path))
    assert not any(module.startswith("p2o.cli") for module, _ in imports(path)) or path.name == "__main__.py"


@pytest.mark.parametrize("path", sources(), ids=named)
def test_files_are_named_for_what_they_hold(path: Path) -> None:
    assert not re.fullmatch(r"(utils?|helpers?|common|managers?|misc|base|core)\.py", path.name)
    assert path.read_text(encoding="utf-8").startswith(('"""', 'r"""')) or not path.read_text().strip()


@pytest.mark.parametrize("path", [p for p in sources() if package_of(p) == "p2o_plugins"], ids=named)
def test_a_method_is_found_by_its_file(path: Path) -> None:
    """A file that defines METHOD is offered by the hooks, and its name is in the name of the method or the reverse."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    if not any(isinstance(n, ast.Assign) and ast.unparse(n.targets[0]) == "METHOD" for n in tree.body):
        return
    module = ".".join(path.relative_to(PACKAGES["p2o_plugins"].parent).with_suffix("").parts)
    offered = {o.method.build.__module__: o.name for o in p2o.Registry.load(environ={}).offers if o.dist == "p2o-calib"}
    assert module in offered, "METHOD is defined, but no hook offers it"
    assert offered[module].replace("-", "_") in path.stem


@pytest.mark.parametrize("path", sources(), ids=named)
def test_nothing_is_left_undone(path: Path) -> None:
    text = path.read_text(encoding="utf-8")
    assert not re.search(r"\b(TODO|FIXME|XXX|HACK|TEMPORARY)\b|raise NotImplementedError", text)
