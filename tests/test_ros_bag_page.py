"""The page on bags: its shell lines do what it says, on a bag as it shows."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import pytest
from p2o import Registry
from p2o.cli import main
from p2o.run.recipe import open_dataset

from .bag_files import messages_of, write_bag
from .pages import shell_blocks

PAGE = (Path(__file__).parents[1] / "docs/how-to/ros-bag.md").read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("bags")
    data = "synthetic:?scenes=3&width_px=320&height_px=120&right=false&lidar=vlp-16&seed=1"
    write_bag(root, messages_of(list(open_dataset(data, Registry.load()))), "ros1")
    return root


def lines() -> list[str]:
    found = [command.text for block in shell_blocks("docs/how-to/ros-bag.md") for command in block.commands()]
    assert found[0] == 'pip install "rosbags>=0.11,<0.12"', "the extra `ros` of pyproject.toml"
    return found[1:]


def without_points(text: str) -> str:
    """Return a text without numbers of points, which a better simulator changes."""
    return re.sub(r"\d+ points", "N points", text)


@pytest.mark.parametrize("line", lines())
def test_the_shell_lines_of_the_page_run(
    line: str, folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(folder)
    program, *words = shlex.split(line)
    assert program == "p2o"
    # A calibration may be refused on such small frames: that is its answer, too.
    assert main(words) in ((0, 1) if words[0] == "run" else (0,))
    said = capsys.readouterr()
    if words[1] == "topics":
        assert without_points(said.out) in without_points(PAGE)
    assert "Traceback" not in said.err
