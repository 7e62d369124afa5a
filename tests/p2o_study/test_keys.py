"""The keys of rows and features change with what can alter a result of a method, and with nothing outside of it."""

from __future__ import annotations

import importlib
import sys
from collections.abc import Callable
from pathlib import Path

import p2o
import pytest
from p2o.host.registry import Offer
from p2o.run.part import Part
from p2o.run.recipe import Recipe
from p2o_plugins.p2ornet import shipped
from p2o_study import cells, keys, revision
from p2o_study.cells import Method
from p2o_study.keys import features_key, method_content, named_files
from p2o_study.revision import code_of
from p2o_study.study import check_study, parse_study

from tests.p2o_study.source_edits import Edit

STUDY = """
name = "keys"
title = "Keys"
perturb = "1deg 0.05m"
seeds = 1
[[dataset]]
name = "street"
data = "synthetic:"
[[row]]
label = "default"
extractor = "p2ornet/rings"
[[row]]
label = "nearest"
extractor = "canny/rings"
matcher = "nearest"
[[row]]
label = "kitti"
extractor = "p2ornet/rings"
options = { extractor = { weights = "kitti" } }
[[row]]
label = "koo"
calibrator = "koo"
witness = "none"
"""
ALL = {"nearest", "default", "kitti", "koo"}


@pytest.fixture(scope="module")
def registry() -> p2o.Registry:
    return p2o.Registry.load(environ={})


def changed(registry: p2o.Registry, change: Callable[[], object]) -> set[str]:
    """Return the labels of the rows whose key is another one after a change."""

    def row_keys() -> dict[str, str]:
        rows = check_study(parse_study(STUDY), registry)
        return {row.label: Method.of(row, "{}", {}, registry, 0).digest for row in rows}

    before = row_keys()
    change()
    after = row_keys()
    return {label for label in before if before[label] != after[label]}


@pytest.mark.parametrize(
    ("file", "old", "new", "labels"),
    [
        ("p2o_plugins/match/ogm.py", "from __future__", "# a comment\nfrom __future__", set()),
        ("p2o_plugins/match/ogm.py", '"""', '"""Another docstring. ', set()),
        ("p2o_plugins/p2ornet/training.py", "import", "import zlib\nimport", set()),
        ("p2o_plugins/image/p2ornet.py", "return drawn(", "return 1 + drawn(", set()),
        ("p2o_plugins/weights/MODEL_CARD.md", "a", "a word ", set()),
        ("p2o_plugins/hooks.py", "import", "import zlib\nimport", set()),
        ("p2o_formats/kalibr.py", "_KNOWN = ", "_KNOWN = None or ", set()),
        ("p2o_sim/synthetic.py", "BASELINE_M = ", "BASELINE_M = 0.01 + ", set()),
        ("p2o_baselines/edges/nearest.py", "-weight, *place.T", "-2 * weight, *place.T", {"nearest"}),
        ("p2o_plugins/match/ogm.py", '"LRUB", pattern', '"LRU", pattern', ALL - {"koo"}),
        ("p2o_plugins/p2ornet/thinning.py", "import", "import zlib\nimport", ALL - {"koo"}),
        ("p2o_plugins/cloud/scattered.py", "_NEAREST = ", "_NEAREST = 1 + ", ALL - {"koo"}),
        ("p2o_baselines/boards/pairing.py", "import", "import zlib\nimport", {"koo"}),
    ],
)
def test_code_changes_the_keys_of_the_rows_that_use_it(
    registry: p2o.Registry, edit: Edit, file: str, old: str, new: str, labels: set[str]
) -> None:
    assert changed(registry, lambda: edit(file, old, new)) == labels


def test_code_of_p2o_counts_by_the_version_of_the_algorithm(
    registry: p2o.Registry, edit: Edit, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert changed(registry, lambda: edit("p2o/geometry/se3.py", "_FARTHEST_M = ", "_FARTHEST_M = 1 + ")) == set()
    assert cells.ALGORITHM == keys.ALGORITHM == p2o.ALGORITHM
    assert changed(registry, lambda: monkeypatch.setattr(cells, "ALGORITHM", p2o.ALGORITHM + 1)) == ALL
    before = features_key(part(), "data")
    monkeypatch.setattr(keys, "ALGORITHM", p2o.ALGORITHM + 1)
    assert features_key(part(), "data") != before


def test_weights_change_the_keys_of_the_rows_that_read_them(
    registry: p2o.Registry, edit: Edit, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    new_weights = tmp_path / "p2ornet-free.safetensors"
    new_weights.write_bytes(b"1")
    monkeypatch.setattr(shipped, "FOLDER", tmp_path)
    assert changed(registry, lambda: new_weights.write_bytes(b"2")) == {"default", "nearest"}


def test_declared_data_files_are_those_of_the_options(registry: p2o.Registry) -> None:
    def names(method: str, **options: object) -> list[str]:
        [offer] = registry.named(method)
        assert offer.method.data_files is not None
        return [path.name for path in offer.method.data_files(offer.method.options(**options))]

    assert names("p2ornet") == ["p2ornet-free.safetensors"]
    assert names("calibnet") == ["calibnet-small.safetensors"]
    assert names("lccnet", weights="a.safetensors, b.safetensors") == ["a.safetensors", "b.safetensors"]
    assert names("picked") == ["picked-example.yaml"]


def test_every_method_that_locates_its_package_declares_its_data_files(registry: p2o.Registry) -> None:
    """A method without a declaration counts with all data of the package, also with weights that it never reads."""
    methods = [offer.method for offer in registry.offers if offer.kind is not p2o.Kind.DATASET]
    code = {method.name: (method, code_of(method, method.options)) for method in methods}
    locating = {name for name, (_, own) in code.items() if own.locates_files and not own.resolves_methods}
    assert {"p2ornet", "hed", "picked"} <= locating
    assert [name for name in locating if code[name][0].data_files is None] == []


def test_a_method_that_resolves_others_by_name_counts_with_all_plugins(registry: p2o.Registry, edit: Edit) -> None:
    def contents(method: str) -> object:
        return method_content(Recipe(calibrator=method, witness="none").resolve(registry).parts["calibrator"])

    before = [contents(method) for method in ("cues", "line-time", "koo")]
    edit("p2o_plugins/cloud/rings.py", "def ", "def unused() -> None: ...\n\n\ndef ")
    after = [contents(method) for method in ("cues", "line-time", "koo")]
    assert [old == new for old, new in zip(before, after, strict=True)] == [False, False, True]


def part(stage: str = "matcher", **options: object) -> Part:
    words = {"options": {stage: options}} if options else {}
    return Recipe.of(**words).resolve(p2o.Registry.load(environ={})).parts[stage]


def test_keys_of_features_change_with_data_method_options_and_code(edit: Edit) -> None:
    known = [
        features_key(part(), "data"),
        features_key(part(), "other data"),
        features_key(part(sides="LR"), "data"),
        features_key(part("solver"), "data"),
    ]
    assert len(set(known)) == 4
    assert features_key(part(sides="LRUB"), "data") == known[0], "a stated default is the default"
    edit("p2o_plugins/cloud/scattered.py", "_NEAREST = ", "_NEAREST = 1 + ")
    assert features_key(part(), "data") == known[0]
    edit("p2o_plugins/match/ogm.py", '"LRUB", pattern', '"LRU", pattern')
    assert features_key(part(), "data") not in known


def test_files_that_options_name_count_with_their_content(tmp_path: Path) -> None:
    weights = tmp_path / "weights.bin"
    options = {"weights": str(weights), "more": [{"table": str(tmp_path / "none")}, 3, "text", str(tmp_path)]}
    assert named_files(options) == {}
    weights.write_bytes(b"1")
    first = named_files(options)
    weights.write_bytes(b"2")
    assert list(first) == [str(weights)]
    assert named_files(options) != first


CODE = {
    "__init__.py": "",
    "method.py": "from typing import TYPE_CHECKING\nfrom . import inner\nfrom .lazy import late\nPLACE = __file__\n"
    "if TYPE_CHECKING:\n    from .typed import T\n"
    "def build(options, x: int = inner.x):\n    from .inside import y\n    return PLACE, y\n",
    "inner.py": "import numpy\nx = 1\n",
    "inside.py": "y = 1\n",
    "typed.py": "T = 1\n",
    "apart.py": "z = 1\n",
    "lazy/__init__.py": "def __getattr__(name):\n    return name\n",
    "lazy/late.py": "a = 1\n",
    "weights.bin": "1",
    "README.md": "words 1",
    "overview.json": "1",
    "suites/splits.json": "1",
}
EDITS = {
    "nothing": ("inner.py", "x", "x", False),
    "an imported module": ("inner.py", "1", "2", True),
    "what a function imports": ("inside.py", "1", "2", True),
    "what is imported for type checking": ("typed.py", "1", "2", False),
    "a comment and a docstring": ("method.py", "    return", "    'words'  # more\n    return", False),
    "a module that is not imported": ("apart.py", "1", "2", False),
    "a module of a lazy package": ("lazy/late.py", "1", "2", True),
    "data": ("weights.bin", "1", "2", True),
    "a document": ("README.md", "1", "2", False),
    "a list of methods": ("overview.json", "1", "2", False),
    "frames of a suite": ("suites/splits.json", "1", "2", False),
}


@pytest.mark.parametrize("case", EDITS)
def test_imported_modules_count_and_data_where_their_place_is_used(
    case: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file, old, new, changes = EDITS[case]
    # A package of its own for every case: Python imports a name only once.
    name = f"acme_{case.replace(' ', '_')}"
    contents = []
    for version in ("old", "new"):
        folder = tmp_path / version / name
        for other, text in CODE.items():
            assert other != file or old in text
            (folder / other).parent.mkdir(parents=True, exist_ok=True)
            (folder / other).write_text(text.replace(old, new) if version == "new" and other == file else text)
        with monkeypatch.context() as patch:
            patch.syspath_prepend(str(folder.parent))
            for cached in (revision._code_of, revision.data_digest, revision.path_of):
                cached.cache_clear()
            build = importlib.import_module(f"{name}.method").build
            method = p2o.Method(name="acme", build=build, summary="A method.")
            contents.append(method_content(Part(Offer(p2o.Kind.MATCHER, method, "acme", "", ""), p2o.Options())))
            for module in [m for m in sys.modules if m.startswith(name)]:
                del sys.modules[module]
    assert (contents[0] != contents[1]) == changes
