"""The keys of rows and features change with what can alter a result, and with nothing else."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import p2o
import pytest
from p2o.run.recipe import Recipe
from p2o_plugins.p2ornet import shipped
from p2o_study import sources
from p2o_study.cells import CANNOT_ALTER_A_POSE, Method, calibration_code
from p2o_study.keys import features_key, method_content
from p2o_study.sources import code_of
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
label = "kitti"
extractor = "p2ornet/rings"
[[row]]
label = "nearest"
extractor = "canny/rings"
matcher = "nearest"
[[row]]
label = "synthetic"
extractor = "p2ornet/rings"
options = { extractor = { weights = "synthetic" } }
[[row]]
label = "koo"
calibrator = "koo"
witness = "none"
"""
ALL = {"nearest", "kitti", "synthetic", "koo"}


@pytest.fixture(scope="module")
def registry() -> p2o.Registry:
    return p2o.Registry.load(environ={})


def keys(registry: p2o.Registry) -> dict[str, str]:
    """Return the key of each row of the study by its label."""
    rows = check_study(parse_study(STUDY), registry)
    return {row.label: Method.of(row, 0, "{}", {}, registry).key for row in rows}


def changed(registry: p2o.Registry, *edits: Callable[[], object]) -> set[str]:
    """Return the labels of the rows whose key is another one after the edits."""
    before = keys(registry)
    for change in edits:
        change()
    after = keys(registry)
    return {label for label in before if before[label] != after[label]}


@pytest.mark.parametrize(
    ("file", "old", "new"),
    [
        ("p2o_formats/kalibr.py", "from __future__", "# a comment\nfrom __future__"),
        ("p2o_formats/kalibr.py", "_KNOWN = ", "_KNOWN = None or "),
        ("p2o_plugins/weights/MODEL_CARD.md", "a", "a word "),
        ("p2o/run/pipeline.py", '"""', '"""Another docstring. '),
        ("p2o/run/pipeline.py", "class Pipeline(Algorithm):\n", "class Pipeline(Algorithm):\n\n    # a comment\n"),
        ("p2o/geometry/se3.py", "def inverse(", "def unused() -> int:\n    return 7\n\n\ndef inverse("),
        ("p2o/geometry/se3.py", ") -> Float:", ") -> object:"),
        ("p2o_plugins/match/ogm.py", 'help="', 'help="Words. '),
        ("p2o_plugins/match/ogm.py", 'summary="', 'summary="Words. '),
        ("p2o_plugins/p2ornet/training.py", "import", "import zlib\nimport"),
        ("p2o_study/report/page.py", "import", "import zlib\nimport"),
        ("p2o/__init__.py", "__getattr__, ", "_MORE = 1\n__getattr__, "),
    ],
)
def test_what_cannot_alter_a_result_changes_no_key(
    registry: p2o.Registry, edit: Edit, file: str, old: str, new: str
) -> None:
    assert changed(registry, lambda: edit(file, old, new)) == set()


@pytest.mark.parametrize(
    ("file", "old", "new", "labels"),
    [
        ("p2o_baselines/edges/nearest.py", "-weight, *place.T", "-2 * weight, *place.T", {"nearest"}),
        ("p2o_plugins/match/ogm.py", '"LRUB", pattern', '"LRU", pattern', {"nearest", "kitti", "synthetic"}),
        ("p2o_plugins/cloud/scattered.py", "_NEAREST = ", "_NEAREST = 1 + ", ALL - {"koo"}),
        ("p2o/geometry/se3.py", "_FARTHEST_M = ", "_FARTHEST_M = 1 + ", ALL),
        ("p2o/geometry/pose_error.py", "AXES = ", "AXES = () + ", ALL),
        ("p2o/host/guard.py", "    check_features(offer, features)\n", "    pass\n", ALL),
        ("p2o/frames/frame.py", "_LONGEST_CAMERA = ", "_LONGEST_CAMERA = 1 + ", ALL),
        ("p2o/runtime/native.py", "import os\n", "import os\nos.environ['OMP_DYNAMIC'] = '1'\n", ALL),
    ],
)
def test_code_changes_the_keys_of_the_rows_that_use_it(
    registry: p2o.Registry, edit: Edit, file: str, old: str, new: str, labels: set[str]
) -> None:
    assert changed(registry, lambda: edit(file, old, new)) == labels


def test_weights_change_the_keys_of_the_rows_that_read_them(
    registry: p2o.Registry, edit: Edit, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    for name in shipped.SHIPPED.values():
        (tmp_path / name).write_bytes(b"1")
    monkeypatch.setattr(shipped, "FOLDER", tmp_path)
    new_weights = tmp_path / shipped.SHIPPED["synthetic"]
    assert changed(registry, lambda: new_weights.write_bytes(b"2")) == {"synthetic"}


def test_declared_data_files_are_those_of_the_options(registry: p2o.Registry) -> None:
    def names(method: str, **options: object) -> list[str]:
        [offer] = registry.named(method)
        assert offer.method.data_files is not None
        return [path.name for path in offer.method.data_files(offer.method.options(**options))]

    assert names("p2ornet") == ["p2ornet-kitti.safetensors"]
    assert names("calibnet") == ["calibnet-small.safetensors"]
    assert names("lccnet", weights="a.safetensors, b.safetensors") == ["a.safetensors", "b.safetensors"]
    assert names("picked") == ["picked-example.yaml"]


def test_every_method_that_locates_its_package_declares_its_data_files(registry: p2o.Registry) -> None:
    """A method without a declaration counts with all data of the package, also with weights that it never reads."""
    for name in ("p2ornet", "hed", "calibnet", "calibrcnn", "lccnet", "regnet", "rggnet", "picked"):
        [offer] = registry.named(name)
        assert code_of(offer.method.build).locates_files, name
        assert offer.method.data_files is not None, name


def test_a_method_that_resolves_others_by_name_counts_with_all_plugins(registry: p2o.Registry, edit: Edit) -> None:
    def code(method: str) -> object:
        part = Recipe(calibrator=method, witness="none").resolve(registry).parts["calibrator"]
        return {name: value for name, value in method_content(part).items() if name != "name"}

    before = code("cues"), code("koo")
    edit("p2o_plugins/cloud/rings.py", "def ", "def unused() -> None: ...\n\n\ndef ")
    assert code("cues") != before[0]
    assert code("koo") == before[1]


def test_keys_of_features_change_with_the_extractor_and_its_input_alone(registry: p2o.Registry, edit: Edit) -> None:
    def key() -> str:
        return features_key(
            Recipe(extractor="canny/rings", matcher="nearest").resolve(registry).parts["extractor"], "data"
        )

    before = key()
    for file, old, new in (
        ("p2o/calibration/algorithm.py", "_FAR_DEG, _FAR_M = ", "_FAR_DEG, _FAR_M = 7.0, 0.5  # "),
        ("p2o_plugins/cloud/scattered.py", "_NEAREST = ", "_NEAREST = 1 + "),
        ("p2o_plugins/weights/MODEL_CARD.md", "a", "a word "),
    ):
        edit(file, old, new)
        assert key() == before, file
    edit("p2o/frames/scale.py", "LONGEST_FOCAL_PX = ", "LONGEST_FOCAL_PX = 1 + ")
    assert key() != before


def test_the_calibration_itself_counts_and_what_shows_or_exchanges_results_does_not() -> None:
    modules = {name.partition(":")[0] for name in calibration_code().definitions}
    rooms = {".".join(module.split(".")[:2]) for module in modules}
    assert {"p2o.calibration", "p2o.features", "p2o.geometry", "p2o.problems", "p2o.results"} <= rooms
    assert {"p2o.run.assembly", "p2o.host.guard", "p2o.frames.image", "p2o_study.worker"} <= modules
    for left in CANNOT_ALTER_A_POSE:
        assert not any(module == left or module.startswith(f"{left}.") for module in modules)
        assert sources.path_of(left) is not None, f"{left} is no module any more"
