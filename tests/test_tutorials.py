"""Every line of the tutorials does what the page says, in the order of the page."""

from __future__ import annotations

import re
import runpy
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import yaml
from p2o.cli import main

from tests.first_day import written
from tests.pages import python_blocks, shell_blocks

FOLDER = Path(__file__).parents[1] / "docs/tutorial"


def page(name: str) -> str:
    return (FOLDER / f"{name}.md").read_text(encoding="utf-8")


def blocks(name: str, language: str) -> list[str]:
    return re.findall(rf"```{language}\n(.*?)```", page(name), re.DOTALL)


@pytest.fixture
def follow(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Callable[[str], str]:
    """Run the lines of a page in an empty folder and return what they print."""
    monkeypatch.chdir(tmp_path)

    def run(name: str) -> str:
        commands = [c for block in shell_blocks(f"docs/tutorial/{name}.md") for c in block.commands()]
        assert commands
        for command in commands:
            if command.words[0] == "p2o":
                assert main(command.words[1:]) == 0, command
            else:
                # The package that p2o has written: tests/test_plugin_command.py installs and tests it.
                assert command.words[0] in ("cd", "pip", "python"), command
        return capsys.readouterr().out

    return run


def test_the_first_calibration(follow: Callable[[str], str], tmp_path: Path) -> None:
    said = follow("first-calibration")
    for word in re.findall(r"^- \*\*(\w+)\*\*", page("first-calibration"), re.MULTILINE):
        assert f"  {word} " in said
    for name in re.findall(r"`([\w-]+\.png)`", page("first-calibration")):
        assert (tmp_path / "first/street" / name).is_file()


def test_your_own_frames(follow: Callable[[str], str], tmp_path: Path) -> None:
    said = follow("your-own-frames")
    assert "64 rings" in said
    [text] = blocks("your-own-frames", "yaml")
    [made] = tmp_path.glob("example/**/frame.yaml")
    wanted, example = yaml.safe_load(text), yaml.safe_load(made.read_text())
    assert set(wanted["camera"]) == set(example["camera"])
    assert np.linalg.norm(wanted["start"]["rotation_xyzw"]) == 1


def test_the_first_study(follow: Callable[[str], str], tmp_path: Path) -> None:
    [text] = blocks("first-study", "toml")
    (tmp_path / "mine.toml").write_text(text)
    follow("first-study")
    assert (tmp_path / "study/report/report.html").is_file()


def test_the_first_plugin(follow: Callable[[str], str], tmp_path: Path) -> None:
    said = follow("first-plugin")
    assert "every check passed" in said
    assert (
        "return p2o.CloudFeatures(edges=p2o.CloudEdges(xyz[rows],"
        in (tmp_path / "acme-edges/src/acme_edges/plugin.py").read_text()
    ), "the page says to break xyz[rows]"


def test_the_first_day(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    """The lines of the page on smaller images; the verdicts of right and wrong intrinsics are those of the page."""
    name = "docs/tutorial/first-day.md"
    monkeypatch.chdir(written(tmp_path / "recordings", width_px=480, height_px=180, frames=6))
    [block] = python_blocks(name)
    commands = [c for shell in shell_blocks(name) for c in shell.commands()]
    assert [c.text for c in commands[:2]] == ["python -m tests.first_day recordings", "cd recordings"]
    said: list[tuple[str, int, str]] = []
    for command in commands:
        if command.words[0] != "p2o" or command.words[1] == "doctor":  # tests/test_doctor_command.py
            continue
        if "wrong" in command.words and not Path("wrong").exists():
            focal_px = yaml.safe_load(Path("mine/scene-0000/frame.yaml").read_text())["camera"]["params"][0]
            Path("wrong.py").write_text(block.text.replace("450.0", str(450 / 464.73 * focal_px)))
            runpy.run_path("wrong.py")
        # `nid` takes ten times as long as `canny`.
        words = ["ours,canny,gmm" if word == "ours,nid,gmm" else word for word in command.words[1:]]
        capsys.readouterr()
        status = main(words)
        printed = capsys.readouterr()
        said.append((command.text, status, printed.out + printed.err))
    for text, status, output in said:
        wrong = "wrong.txt" in text and "--export-anyway" not in text
        assert status == (1 if wrong else 0), f"{text}: {output}"
    outputs = {text: output for text, _, output in said}
    assert "no truth, no start" in outputs["p2o data check mine"]
    assert "no start" not in outputs["p2o data check drive.bag"]
    doubted = next(o for t, o in outputs.items() if "--out doubt" in t)
    assert "intrinsics are in doubt" in doubted
    assert "not exported: wrong.txt" in doubted
    refined = next(o for t, o in outputs.items() if "pipeline.camera=refine" in t)
    assert "cost lower by" not in refined, "rivals are compared with the corrected camera"
    assert "wrote extrinsic.txt (matrix, trusted)" in next(o for t, o in outputs.items() if "--out bag" in t)
    assert "off by about z -" in next(o for t, o in outputs.items() if "--extrinsic wrong.txt" in t)
    assert Path("compared/compare.html").is_file()
