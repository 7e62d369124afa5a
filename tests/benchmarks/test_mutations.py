from __future__ import annotations

import subprocess
from pathlib import Path

import mutations
import pytest
from mutations import MUTATIONS, Mutation, Sound, Tree, tried

ROOT = Path(__file__).parents[2]
FAULT = Mutation("twice", "wrong unit", "toolkit/p2o/sums.py", "2 * x", "3 * x")


@pytest.fixture
def tree(tmp_path: Path) -> Path:
    """A tree of one module, one test that passes, and one that always fails."""
    root = tmp_path / "source"
    files = {
        "pyproject.toml": "",
        "toolkit/p2o/__init__.py": "",
        "toolkit/p2o/sums.py": "def twice(x):\n    return 2 * x\n",
        "tests/test_a.py": "def test_false():\n    assert False\n",
        "tests/test_sums.py": "from p2o.sums import twice\n\n\ndef test_twice():\n    assert twice(2) == 4\n",
    }
    for name, text in files.items():
        (root / name).parent.mkdir(parents=True, exist_ok=True)
        (root / name).write_text(text)
    for words in (["init", "-q"], ["add", "."]):
        subprocess.run(["git", *words], cwd=root, check=True)
    return root


def trees(source: Path, folder: Path) -> tuple[Tree, Sound]:
    return Tree(source, folder / "1"), Sound(Tree(source, folder / "2"))


def test_every_text_to_replace_is_there_once():
    assert [reason for fault in MUTATIONS if (reason := fault.mismatch(ROOT))] == []


def test_the_faults_are_at_least_thirty_in_every_room_and_package():
    rooms = {path.name for path in (ROOT / "toolkit/p2o").iterdir() if (path / "__init__.py").is_file()}
    packages = {
        path.parent.name for top in ("toolkit", "plugins", "baselines") for path in ROOT.glob(f"{top}/*/__init__.py")
    }
    touched = {part for fault in MUTATIONS for part in Path(fault.path).parts}
    assert len({fault.name for fault in MUTATIONS}) == len(MUTATIONS) >= 30
    assert (rooms | packages) - touched <= {"calibration_files", "runtime"}


def test_a_text_that_is_gone_is_named_and_nothing_runs(tree: Path, monkeypatch, capsys):
    monkeypatch.setattr(mutations, "MUTATIONS", (FAULT, Mutation("gone", "", FAULT.path, "4 * x", "5 * x")))
    assert mutations.main(["--tree", str(tree)]) == 2
    assert capsys.readouterr().err == f"gone: {FAULT.path}: the text is there 0 times instead of once: 4 * x\n"


@pytest.mark.system
def test_a_fault_is_caught_by_the_nearest_test_and_undone(tree: Path, tmp_path: Path):
    copy, sound = trees(tree, tmp_path)
    outcome = tried(FAULT, copy, sound, 2)
    assert (outcome.outcome, outcome.stage, outcome.test) == ("caught", 1, "tests/test_sums.py::test_twice")
    assert (copy.root / FAULT.path).read_text() == (tree / FAULT.path).read_text()


@pytest.mark.system
def test_a_fault_that_no_test_sees_survives_a_test_that_always_fails(tree: Path, tmp_path: Path):
    (tree / "tests/test_sums.py").write_text("def test_nothing():\n    pass\n")
    outcome = tried(FAULT, *trees(tree, tmp_path), 2)
    assert (outcome.outcome, outcome.stage) == ("survived", 2)
