"""Plugins written from docs/plugins.md alone: one short file each, on the author API, that keeps every promise."""

from __future__ import annotations

from pathlib import Path

import p2o
import pytest
from p2o.cli import main

from tests.test_architecture import Source, private_names

FILES = sorted((Path(__file__).parent / "example_plugins").glob("*.py"))


@pytest.mark.parametrize("file", FILES, ids=lambda file: file.stem)
def test_an_example_is_short_and_uses_the_author_api_only(file: Path) -> None:
    text = file.read_text(encoding="utf-8")
    assert len(text.splitlines()) <= 60
    assert list(private_names(Source(file, text, f"p2o_example.{file.stem}"))) == []


@pytest.mark.parametrize("file", FILES, ids=lambda file: file.stem)
def test_an_example_passes_every_check(file: Path, capsys: pytest.CaptureFixture[str]) -> None:
    [offer] = p2o.Registry.load(plugins=[], extra_files=[file]).offers
    assert offer.kind.value == file.stem.replace("_", " ")
    assert main(["plugin", "check", offer.name, "--plugin", str(file)]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[-1] == "every check passed"
    assert all(line.startswith("ok ") for line in lines[:-1])
    assert len(lines) >= 10


def test_the_problem_of_a_matcher_on_the_page_is_solved() -> None:
    """The class that docs/plugins.md prints, posed on the stage and solved by our own solver."""
    from p2o_plugins.solve import lm
    from p2o_testing import stage

    from tests.pages import python_blocks

    [code] = [block.text for block in python_blocks("docs/plugins.md") if "class Nearest(" in block.text]
    names: dict[str, object] = {}
    exec(compile(code, "plugins.md", "exec"), names)  # noqa: S102
    truth = stage.camera_from_lidar()
    start = p2o.se3.exp([0.004, -0.003, 0.002, 0.0, 0.0, 0.0]) @ truth
    problem = names["Nearest"](stage.view(), start, 20.0)  # type: ignore[operator]
    pose = lm.METHOD.build(lm.METHOD.options())(problem, start).camera_from_lidar
    assert p2o.pose_error(pose, truth).rotation_deg < 0.5 * p2o.pose_error(start, truth).rotation_deg
