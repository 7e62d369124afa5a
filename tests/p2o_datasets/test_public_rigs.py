"""What holds for every data set of a rig alike: the commands of the docs, cameras by name, frames by name."""

from __future__ import annotations

import json
import re
import shlex
from collections.abc import Callable
from pathlib import Path

import pytest
from p2o import Kind, Registry, UnknownNameError
from p2o.cli import main

from . import argoverse2_files, kitti_360_files, once_files, pandaset_files, waymo_files

PAGE = Path(__file__).parents[2] / "docs/datasets.md"
WRITERS: dict[str, Callable[[Path], Path]] = {
    "argoverse2": lambda root: argoverse2_files.Log(root).write(),
    "kitti-360": lambda root: kitti_360_files.Drive(root).write(),
    "once": lambda root: once_files.Sequence(root).write(),
    "pandaset": lambda root: pandaset_files.Drive(root).write(),
    "waymo": lambda root: waymo_files.Segment(root).write(),
}
CAMERAS = {
    "argoverse2": ("ring_front_center", "ring_rear_left"),
    "kitti-360": ("image_00", "image_02"),
    "once": ("cam01", "cam09"),
    "pandaset": ("front_camera", "left_camera"),
    "waymo": ("FRONT", "SIDE_LEFT"),
}


def lines() -> list[str]:
    """Return the commands of the page that name one of these data sets."""
    blocks = re.findall(r"```sh\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)
    return [line for block in blocks for line in block.splitlines() if re.search(rf"\b({'|'.join(WRITERS)}):/", line)]


@pytest.mark.parametrize("line", lines())
def test_the_commands_of_the_page_do_what_they_say(
    tmp_path: Path, line: str, capsys: pytest.CaptureFixture[str]
) -> None:
    name = next(name for name in WRITERS if f"{name}:/" in line)
    root = WRITERS[name](tmp_path)
    words = shlex.split(re.sub(rf"{name}:/\S+", f"{name}:{root}", line))[1:]
    run = words[0] == "run"
    # Nothing is to be seen on these pictures, and the quickest method finds that out.
    quick = ["--extractor", "canny/range-view", "--matcher", "nearest"] if run else []
    assert main([*words, *quick]) == (1 if run else 0)
    said = capsys.readouterr()
    assert "Traceback" not in said.err
    assert said.out.count("\n") > 2


def test_every_data_set_has_a_command_on_the_page() -> None:
    assert {name for name in WRITERS for line in lines() if f"{name}:/" in line} == set(WRITERS)


@pytest.mark.parametrize("name", WRITERS)
def test_a_run_of_the_rig_has_a_result_for_each_camera(
    tmp_path: Path, name: str, capsys: pytest.CaptureFixture[str]
) -> None:
    data = f"{name}:{WRITERS[name](tmp_path)}"
    words = ["--set", f"data.cameras={','.join(CAMERAS[name])}", "--rig", "--perturb", "1deg 0.05m", "--json"]
    quick = ["--extractor", "canny/range-view", "--matcher", "nearest"]
    assert main(["run", "--data", data, *words, *quick]) == 1
    found = json.loads(capsys.readouterr().out)
    assert [result["camera"] for result in found["results"]] == list(CAMERAS[name])
    assert found["failed"] == []


@pytest.mark.parametrize("name", WRITERS)
def test_frames_are_asked_for_by_name_and_unknown_ones_are_told_the_nearest(
    tmp_path: Path, name: str, capsys: pytest.CaptureFixture[str]
) -> None:
    root = WRITERS[name](tmp_path)
    method = Registry.load().find(Kind.DATASET, name).method
    found = method.build(method.options(root=root))
    first, second, *_ = found.names
    assert found.frame(second).name == found[1].name == second
    assert found[1:][0].name == second
    with pytest.raises(UnknownNameError, match="did you mean"):
        found.frame(first[:-1] + "x")
    assert main(["data", "check", f"{name}:{root}", "--frames", second]) == 0
    assert "1 of 1 frames are good" in capsys.readouterr().out
