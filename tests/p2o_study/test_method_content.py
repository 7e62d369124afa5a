"""What could change features changes their key, and nothing else does."""

from __future__ import annotations

import importlib
import sys
from functools import partial
from pathlib import Path

import numpy as np
import p2o
import pytest
from p2o import Camera, Image
from p2o.host.registry import Offer
from p2o.run.part import Part
from p2o.run.recipe import Recipe
from p2o_study import sources
from p2o_study.keys import features_key, method_content, named_files
from p2o_study.sources import code_of

IMAGE = Image(np.arange(4 * 6 * 3, dtype=np.uint8).reshape(4, 6, 3), Camera.pinhole(5, 5, 3, 2, 6, 4))


def part(stage: str = "matcher", **options: object):
    words = {"options": {stage: options}} if options else {}
    return Recipe.of(**words).resolve(p2o.Registry.load(environ={})).parts[stage]


def test_the_key_changes_with_data_method_and_options() -> None:
    keys = {
        features_key(part("matcher"), "data"),
        features_key(part("matcher"), "other data"),
        features_key(part("matcher", sides="LR"), "data"),
        features_key(part("solver"), "data"),
    }
    assert len(keys) == 4
    assert features_key(part("matcher", sides="LRUB"), "data") in keys, "a default that is said is the default"


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
    "__init__.py": "from . import loud\n",
    "method.py": "from . import inner\nPLACE = __file__\ndef build(options, x: int = inner.x):\n"
    "    from .late import y\n    return PLACE, y\n",
    "inner.py": "import numpy\nx = 1\nunused = 1\n",
    "late.py": "y = 1\n",
    "loud.py": "import string\nstring.capwords('ignore')\n",
    "apart.py": "z = 1\n",
    "weights.bin": "0",
    "README.md": "words",
}
EDITS = {
    "nothing": ("inner.py", "1", "1", False),
    "a used value": ("inner.py", "x = 1", "x = 2", True),
    "a value that is not used": ("inner.py", "unused = 1", "unused = 2", False),
    "what a function imports": ("late.py", "1", "2", True),
    "what runs on import": ("loud.py", "ignore", "warn", True),
    "a comment and a docstring": ("method.py", "    return", "    'words'  # more\n    return", False),
    "an annotation": ("method.py", "int", "float", False),
    "a module that is not imported": ("apart.py", "1", "2", False),
    "data": ("weights.bin", "0", "1", True),
    "a document": ("README.md", "words", "other words", False),
}


@pytest.mark.parametrize("case", EDITS)
def test_code_counts_where_it_is_used_and_data_where_their_place_is(
    case: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file, old, new, changes = EDITS[case]
    # A package of its own for every case: Python imports a name only once.
    name = f"acme_{case.replace(' ', '_')}"
    contents = []
    for version in ("old", "new"):
        folder = tmp_path / version / name
        folder.mkdir(parents=True)
        for other, text in CODE.items():
            assert other != file or old in text
            (folder / other).write_text(text.replace(old, new) if version == "new" and other == file else text)
        with monkeypatch.context() as patch:
            patch.syspath_prepend(str(folder.parent))
            for cached in (sources._code_of, sources.package_hash, sources.module_named, sources.path_of):
                cached.cache_clear()
            build = importlib.import_module(f"{name}.method").build
            method = p2o.Method(name="acme", build=build, summary="A method.")
            contents.append(method_content(Part(Offer(p2o.Kind.MATCHER, method, "acme", "", ""), p2o.Options())))
            for module in [m for m in sys.modules if m.startswith(name)]:
                del sys.modules[module]
    assert (contents[0] != contents[1]) == changes


def test_what_a_build_function_holds_counts() -> None:
    def hashed(value: object) -> str:
        def build(_: object) -> object:
            return value

        # A module without a source: nothing but the value can differ.
        build.__module__ = "acme_without_source"
        return code_of(build).hash

    assert hashed(1) == hashed(1)
    values = [1, 2, (1, 1), np.sin, np.cos, np.ones(2), np.zeros(2), {1}, {2}, partial(pow, 2), partial(pow, 3), IMAGE]
    assert len({hashed(value) for value in values}) == len(values)


def test_code_of_a_matcher_does_not_count_for_an_extractor() -> None:
    [extractor] = p2o.Registry.load(environ={}).named("canny")
    names = set(code_of(extractor.method.build).definitions)
    assert "p2o_baselines.edges.canny:build" in names
    assert "p2o.features.edges:ImageEdges" in names
    assert not any(name.startswith(("p2o_plugins.match", "p2o_plugins.solve", "p2o.cli")) for name in names)
