"""Every line of the tutorials does what the page says, in the order of the page."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import yaml
from p2o.cli import main

from tests.pages import shell_blocks

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
        assert (tmp_path / "first/scene-0000" / name).is_file()


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
