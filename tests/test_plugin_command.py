"""`p2o plugin new`: the package that is written works at once, whatever its slot."""

from __future__ import annotations

import os
import subprocess
import sys
import tomllib
from collections.abc import Callable
from pathlib import Path

import pytest
import yaml
from p2o.cli import main
from p2o.host.registry import Registry
from p2o_testing.cli.plugin_new import SLOTS
from p2o_testing.new_plugin import NewPlugin

from tests.test_architecture import Source, private_names

ROOT = Path(__file__).parents[1]


def written(folder: Path, slot: str, name: str = "acme-thing") -> Path:
    return NewPlugin(name, SLOTS[slot]).write(folder)


@pytest.mark.parametrize("slot", SLOTS)
def test_the_method_of_every_slot_loads_from_its_file_and_keeps_its_promises(
    slot: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = str(written(tmp_path, slot) / "src/acme_thing/plugin.py")
    assert list(private_names(Source(Path(file), Path(file).read_text(), "acme_thing.plugin"))) == []
    registry = Registry.load(plugins=["p2o-calib"], extra_files=[file])
    [offer] = registry.named("acme-thing")
    assert offer.kind == SLOTS[slot]
    assert offer.method.options.model_fields
    bounded = [field for field in offer.method.options.model_fields.values() if field.metadata]
    assert bounded, "no option has bounds"
    assert all(field.description for field in offer.method.options.model_fields.values())
    assert main(["plugin", "check", "acme-thing", "--plugin", file]) == 0
    out = capsys.readouterr().out
    assert "FAIL" not in out
    assert "n/a" not in out
    assert ("ok " in out) == (slot != "dataset")  # one that reads files is checked by its own tests


@pytest.mark.system
@pytest.mark.parametrize("slot", ["image-extractor", "dataset"])
def test_its_own_tests_pass_once_it_is_installed(slot: str, tmp_path: Path) -> None:
    root, site = written(tmp_path, slot), tmp_path / "site"
    words = ["install", "-q", "--no-index", "--no-deps", "--no-build-isolation", "--target", str(site), str(root)]
    done = subprocess.run([sys.executable, "-m", "pip", *words], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    paths = [str(site), *(path for path in sys.path if path)]
    environ = {**os.environ, "PYTHONPATH": os.pathsep.join(paths), "P2O_STRICT": "1"}
    words = ["-m", "pytest", "-q", "-p", "no:randomly", "-p", "no:cacheprovider"]
    done = subprocess.run([sys.executable, *words], capture_output=True, text=True, check=False, cwd=root, env=environ)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "failed" not in done.stdout
    assert "skipped" not in done.stdout


@pytest.mark.parametrize("slot", SLOTS)
def test_every_file_is_filled_in_and_is_what_its_name_says(slot: str, tmp_path: Path) -> None:
    root = written(tmp_path, slot)
    texts = {path.relative_to(root).as_posix(): path.read_text() for path in root.rglob("*") if path.is_file()}
    assert texts == NewPlugin("acme-thing", SLOTS[slot]).files()
    for path, text in texts.items():
        assert "@NAME@" not in text
        assert "@MODULE@" not in text
        assert text.endswith("\n")
        if path.endswith(".py"):
            compile(text, path, "exec")
    project = tomllib.loads(texts["pyproject.toml"])
    assert project["project"]["name"] == "acme-thing"
    assert project["project"]["entry-points"]["p2o"] == {"acme-thing": "acme_thing.plugin"}
    steps = yaml.safe_load(texts[".github/workflows/check.yml"])["jobs"]["check"]["steps"]
    said = [step["run"] for step in steps if "run" in step]
    assert said[-2:] == ["python -m pytest", "p2o plugin check acme-thing"]
    assert "No licence has been chosen yet" in texts["LICENSE"]
    assert slot.replace("-", " ") in texts["README.md"]


def test_the_packages_are_formatted_and_lint_free(tmp_path: Path) -> None:
    for slot in SLOTS:
        written(tmp_path, slot, f"acme-{slot}")
    for words in (["check", "--ignore", "D103,ANN"], ["format", "--check"]):
        command = [sys.executable, "-m", "ruff", *words, "--config", str(ROOT / "pyproject.toml"), str(tmp_path)]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stdout


@pytest.mark.parametrize(
    ("name", "said"),
    [
        *(
            (name, "no name for a plugin")
            for name in ("Acme", "acme_edges", "9lives", "-acme", "acme--edges", "../acme", "", "a" * 61)
        ),
        ("lambda", "Python keeps this word"),
        ("json", "a module json is installed already"),
        ("p2o-plugins", "a module p2o_plugins is installed already"),
    ],
)
def test_names_that_cannot_be_installed_are_refused(
    name: str, said: str, tmp_path: Path, refused: Callable[..., str]
) -> None:
    assert said in refused(["plugin", "new", "--out", str(tmp_path), "--", name])
    assert not list(tmp_path.iterdir())


def test_a_name_that_a_method_of_the_slot_has_is_refused_and_says_whose(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["plugin", "new", "ogm", "--out", str(tmp_path)]
    assert main([*words, "--slot", "matcher"]) == 2
    error = capsys.readouterr().err
    assert "there is a matcher of this name already" in error
    assert "ogm of p2o-calib" in error
    assert not list(tmp_path.iterdir())
    assert main([*words, "--slot", "solver"]) == 0  # another kind of method may be called so


def test_it_says_what_it_wrote_and_what_to_do_next_and_leaves_a_folder_that_is_there_alone(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["plugin", "new", "acme-edges", "--slot", "cloud-extractor", "--out"]
    assert main([*words, str(tmp_path)]) == 0
    out = capsys.readouterr().out
    before = {path: path.stat().st_mtime_ns for path in tmp_path.rglob("*")}
    for folder, said in ((tmp_path, "is there already"), (tmp_path / "none", "no such folder")):
        assert main([*words, str(folder)]) == 2
        assert said in capsys.readouterr().err
    assert {path: path.stat().st_mtime_ns for path in tmp_path.rglob("*")} == before
    for path in (tmp_path / "acme-edges").rglob("*"):
        assert path.is_dir() or str(path.relative_to(tmp_path / "acme-edges")) in out
    assert "p2o run --plugin src/acme_edges/plugin.py --extractor canny/acme-edges --matcher nearest" in out
    assert 'pip install -e ".[test]"' in out
