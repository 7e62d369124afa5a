"""A third party's package is built, installed, used and uninstalled, without a network."""

from __future__ import annotations

import json
import os
import re
import runpy
import shlex
import shutil
import site
import subprocess
import sys
import venv
from pathlib import Path

import numpy as np
import p2o
import pytest
from p2o.cli import main
from p2o.host import hookspecs

from tests.pages import python_blocks

SOURCE = Path(__file__).parent / "example_plugin"


class Machine:
    """A virtual environment that sees the packages of this one, and into which wheels are installed."""

    def __init__(self, root: Path) -> None:
        venv.create(root, with_pip=False, symlinks=True)
        self.python = root / ("Scripts" if os.name == "nt" else "bin") / "python"
        [packages] = root.glob("[Ll]ib/**/site-packages")
        ours = [path for path in [*site.getsitepackages(), *sys.path] if path.endswith("site-packages")]
        lines = [f"import site; site.addsitedir({path!r})" for path in dict.fromkeys(ours)]
        (packages / "parent.pth").write_text("\n".join(lines) + "\n")

    def pip(self, *words: str) -> None:
        command = [sys.executable, "-m", "pip", "--python", str(self.python), "--disable-pip-version-check", *words]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr

    def p2o(self, *words: str) -> subprocess.CompletedProcess[str]:
        command = [str(self.python), "-m", "p2o", *words]
        return subprocess.run(command, capture_output=True, text=True, check=False, cwd=self.python.parent)

    def methods(self) -> set[str]:
        listed = json.loads(self.p2o("plugin", "list").stdout)
        return {method["name"] for plugin in listed["plugins"] for method in plugin["methods"]}


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The wheel of the example, built from a copy of its source."""
    folder = tmp_path_factory.mktemp("wheel")
    source = shutil.copytree(SOURCE, folder / "source", ignore=shutil.ignore_patterns("__pycache__"))
    words = ["wheel", "--no-index", "--no-deps", "--no-build-isolation", "--wheel-dir", str(folder), str(source)]
    done = subprocess.run([sys.executable, "-m", "pip", *words], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    [built] = folder.glob("*.whl")
    return built


def test_a_third_partys_plugin_is_there_when_installed_and_gone_when_not(wheel: Path, tmp_path: Path) -> None:
    machine = Machine(tmp_path / "machine")
    theirs = {"grey-steps", "gauss-newton"}
    assert not theirs & machine.methods()

    machine.pip("install", "--no-index", "--no-deps", str(wheel))
    assert theirs <= machine.methods()
    assert "p2o-example 0.3.1" in machine.p2o("methods", "grey-steps").stdout

    words = ["--extractor", "grey-steps/rings", "--matcher", "nearest", "--solver", "gauss-newton", "--init", "given"]
    done = machine.p2o("run", *words, "--set", "extractor.threshold=25", "--perturb", "0.3deg 0.02m", "--json")
    assert done.returncode == 0, done.stderr
    [result] = json.loads(done.stdout)["results"]
    assert result["error"]["rotation_deg"] < result["start_error"]["rotation_deg"]
    assert result["recipe"]["options"]["extractor"] == {"threshold": 25.0, "sigma_px": 1.0}
    assert result["versions"]["p2o-example"] == "0.3.1"
    assert any(turn["stage"] == "refine" and sum(turn["matches"].values()) > 100 for turn in result["rounds"])

    blocked = machine.p2o("methods", "grey-steps", "--block", "p2o-example")
    assert blocked.returncode == 2
    assert "left out on request: p2o-example:example" in blocked.stderr

    machine.pip("uninstall", "--yes", "p2o-example")
    assert not theirs & machine.methods()


def test_the_example_keeps_every_contract(wheel: Path, tmp_path: Path) -> None:
    machine = Machine(tmp_path / "machine")
    machine.pip("install", "--no-index", "--no-deps", str(wheel))
    done = machine.p2o("plugin", "check", "p2o-example")
    assert done.returncode == 0, done.stdout + done.stderr
    lines = done.stdout.splitlines()
    assert lines[-1] == "every check passed"
    assert all(line.startswith("ok ") for line in lines[:-1])
    assert any("gauss-newton: solver_returns_to_the_truth" in line for line in lines)


def block_with(text: str) -> str:
    """Return the block of the page on plugins that holds a text."""
    [found] = [block.text for block in python_blocks("docs/plugins.md") if text in block.text]
    return found


def test_the_smallest_plugin_of_the_docs_works(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    code = block_with('name="hello"')
    file = tmp_path / "hello.py"
    file.write_text(code)
    assert main(["methods", "hello", "--plugin", str(file)]) == 0
    assert "threshold  30.0  float > 0, <= 255" in capsys.readouterr().out
    assert main(["plugin", "check", "hello", "--plugin", str(file)]) == 0
    assert "ok    image extractor hello: image_edges_lie_on_outlines" in capsys.readouterr().out


def test_the_page_on_plugins_names_every_hook_with_its_signature() -> None:
    page = (Path(__file__).parents[1] / "docs" / "plugins.md").read_text(encoding="utf-8")
    for kind in p2o.Kind:
        hook = getattr(hookspecs, kind.hook)
        signature = re.search(r"`(.+?)`", hook.__doc__)
        assert f"| `{kind.hook}` |" in page
        if signature is not None:
            assert signature[1].split(" -> ")[0] in page


def test_the_kind_of_feature_on_the_page_moves_as_it_should(tmp_path: Path) -> None:
    (tmp_path / "poles.py").write_text(block_with("class Poles"))
    [kind] = [v for v in runpy.run_path(str(tmp_path / "poles.py")).values() if getattr(v, "word", "") == "cloud-poles"]
    move = p2o.se3.exp(np.array([0.1, 0.2, 0.3, 1.0, 2.0, 3.0]))
    poles = p2o.CloudFeatures(features=[kind(np.eye(3), np.eye(3))]).moved(move).get("cloud-poles")
    np.testing.assert_allclose(poles.foot, p2o.se3.apply(move, np.eye(3)))
    np.testing.assert_allclose(poles.axis, move[:3, :3].T)


def test_the_method_that_learns_on_the_page_learns_and_is_used(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    page = (Path(__file__).parents[1] / "docs" / "plugins.md").read_text(encoding="utf-8")
    code = block_with('name="learned-steps"')
    lines = re.findall(r"^    p2o (.* --plugin learned\.py .*|run --plugin learned\.py .*)$", page, re.MULTILINE)
    assert len(lines) == 2
    monkeypatch.chdir(tmp_path)
    (tmp_path / "learned.py").write_text(code)
    for line in lines:
        assert main(shlex.split(line)) == 0, line
    level = json.loads((tmp_path / "trained/weights.json").read_text())["level"]
    assert 5 <= level < 100
    said = capsys.readouterr().out
    assert "extractor.weights=trained/weights.json" in said
    assert "street" in said
    assert main(["plugin", "check", "learned-steps", "--plugin", "learned.py"]) == 0


def test_the_problem_of_a_matcher_on_the_page_is_solved() -> None:
    """The class that docs/plugins.md prints, posed on the stage and solved by our own solver."""
    from p2o_plugins.solve import lm
    from p2o_testing import stage

    code = block_with("class Nearest(")
    names: dict[str, object] = {}
    exec(compile(code, "plugins.md", "exec"), names)  # noqa: S102
    truth = stage.camera_from_lidar()
    start = p2o.se3.exp([0.004, -0.003, 0.002, 0.0, 0.0, 0.0]) @ truth
    problem = names["Nearest"](stage.view(), start, 20.0)  # type: ignore[operator]
    pose = lm.METHOD.build(lm.METHOD.options())(problem, start).camera_from_lidar
    assert p2o.pose_error(pose, truth).rotation_deg < 0.5 * p2o.pose_error(start, truth).rotation_deg
