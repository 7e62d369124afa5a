"""Methods at places are listed from the index of their package, which is current, and imported when they are used."""

from __future__ import annotations

import dataclasses
import json
import sys
from pathlib import Path

import p2o
import pytest
from p2o.host import method_index
from p2o.host.method_index import FILE, IndexedMethod, index_text, methods_at
from p2o.host.registry import plugin_packages

OURS = ("p2o_baselines", "p2o_datasets", "p2o_formats", "p2o_plugins", "p2o_sim")
METHOD = """
import p2o
class Wide(p2o.Options):
    reach_px: int = p2o.field(3, help="Reach.")
def build(options): return options.reach_px
def method(): return METHOD
METHOD = p2o.Method(name="{name}", summary="A test.", needs={{"pairs"}}, build=build, options=Wide, data_files=None)
"""


@pytest.mark.parametrize("package", OURS)
def test_the_index_of_a_package_is_current(package: str) -> None:
    written = Path(__import__(package).__path__[0], FILE).read_text(encoding="utf-8")
    assert written == index_text(package), f"run: python -m p2o.host.method_index {package}"


def test_every_package_of_plugins_has_an_index() -> None:
    assert {package for package in plugin_packages() if package.startswith("p2o_")} >= set(OURS)
    offers = [offer for offer in p2o.Registry.load(environ={}).offers if offer.dist == "p2o-calib"]
    assert all(isinstance(offer.method, IndexedMethod) for offer in offers)


@pytest.fixture
def package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, request: pytest.FixtureRequest) -> Path:
    """A package with the methods `near` and `far` and a module that raises, and hooks that offer them."""
    name = f"acme_{request.node.name.partition('[')[0].removeprefix('test_')}"
    folder = tmp_path / name
    folder.mkdir()
    (folder / "__init__.py").write_text("")
    (folder / "near.py").write_text(METHOD.format(name="near"))
    (folder / "far.py").write_text(METHOD.format(name="far"))
    hooks = f"import p2o\n@p2o.hookimpl\ndef p2o_matchers(): return p2o.methods_at('{name}', ['near', 'far:method'])"
    (folder / "hooks.py").write_text(hooks)
    monkeypatch.syspath_prepend(str(tmp_path))
    forget(name)
    return folder


def forget(package: str) -> None:
    """Forget a package and its modules, as in a process that has not imported them."""
    for module in [module for module in sys.modules if module.partition(".")[0] == package]:
        del sys.modules[module]
    method_index._index.cache_clear()


def indexed(package: Path) -> dict[str, p2o.Method]:
    """Return the methods of a package that are read from its index in a process that has not imported them."""
    (package / FILE).write_text(index_text(package.name), encoding="utf-8")
    forget(package.name)
    return {method.name: method for method in methods_at(package.name, ["near", "far:method"])}


def test_a_method_is_imported_when_a_field_is_used_that_the_index_lacks(package: Path) -> None:
    methods = indexed(package)
    lines = (package / FILE).read_text().splitlines()
    assert json.loads("".join(lines)).keys() == {"near", "far:method"}
    assert len(lines) == 4, "one for each method"
    near = methods["near"]
    assert (near.summary, near.needs, near.option_names) == ("A test.", {"pairs"}, ("reach_px",))
    assert near.data_files is None
    assert not {f"{package.name}.near", f"{package.name}.far"} & sys.modules.keys()
    assert near.build(near.options(reach_px=5)) == 5
    assert f"{package.name}.near" in sys.modules
    assert f"{package.name}.far" not in sys.modules
    far = dataclasses.replace(methods["far"], gives={"right"})
    assert (far.name, far.gives, far.build(far.options())) == ("far", {"right"}, 3)


def test_without_an_index_methods_are_imported_at_once(package: Path) -> None:
    hooks = __import__(f"{package.name}.hooks").hooks
    offers = p2o.Registry.of(hooks).offers
    assert [offer.name for offer in offers] == ["far", "near"]
    assert [offer.method.option_names for offer in offers] == [("reach_px",)] * 2


def test_an_index_that_is_not_current_is_reported_on_use(package: Path) -> None:
    near = indexed(package)["near"]
    (package / "near.py").write_text(METHOD.format(name="near").replace('{"pairs"}', '{"objective"}'))
    with pytest.raises(p2o.PluginError, match=rf"not current: 'near' .*method_index {package.name}$"):
        _ = near.options


@pytest.mark.parametrize("fault", ["import no_such_package", "raise RuntimeError('no licence server')"])
def test_a_module_that_cannot_be_imported_costs_its_own_method(package: Path, fault: str) -> None:
    methods = indexed(package)
    (package / "near.py").write_text(fault)
    with pytest.raises(
        p2o.PluginError, match=rf"^method 'near' cannot be imported from {package.name}.near; got \w+: [Nn]o "
    ):
        _ = methods["near"].options
    assert methods["far"].options().reach_px == 3  # type: ignore[attr-defined]
