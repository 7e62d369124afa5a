"""What holds for every data set of a rig alike: commands of the docs, cameras, frames by name, and bad input."""

from __future__ import annotations

import json
import re
import shlex
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from p2o import UnknownNameError
from p2o.cli import main

from . import argoverse2_files, kitti_360_files, nuscenes_files, once_files, pandaset_files, waymo_files
from .drive import car
from .opened import opened, refused
from .waymo_record_files import write_records

PAGE = Path(__file__).parents[2] / "docs/datasets.md"


@dataclass(frozen=True)
class Rig:
    """Files of a data set: two cameras in them, a shift of the first camera, and wrong options with their nearest.

    `several` is the word for its parts, `absent` a camera without images, `one` a file that one frame needs. `needed`
    are files that all frames need, with the error of one that is cut off.
    """

    files: Callable[[Path], Any]
    cameras: tuple[str, str]
    slip: Callable[[Any], None]
    frames: int
    title: str
    several: str
    wrong: dict[str, tuple[str, str]]
    absent: str
    needed: dict[str, str]
    one: str = ""
    write: Callable[[Any], Any] = lambda files: files.write()
    data_set: str = ""


def shifted_fisheye(texts: dict[str, str]) -> None:
    name = "calibration/calib_cam_to_pose.txt"
    rows = [line.split() for line in texts[name].splitlines()]
    for row in rows:
        row[4] = str(float(row[4]) + (row[0] == "image_02:"))
    texts[name] = "".join(" ".join(row) + "\n" for row in rows)


def slipped_poses(drive: pandaset_files.Drive) -> None:
    slipped = pandaset_files.CAR_FROM["front_camera"] + np.eye(4)[0][:, None] * [0, 0, 0, 1.0]
    times = [time + pandaset_files.LATER_S["front_camera"] for time in drive.times]
    drive.files["camera/front_camera/poses.json"] = [pandaset_files.pose(car(time) @ slipped) for time in times]


def shifted(values: Any, at: Any, by: float = 1.0) -> None:
    values[at] += by


ARROW = "is not a table of Arrow, or is damaged"
RIGS = {
    "argoverse2": Rig(
        argoverse2_files.Log, ("ring_front_center", "ring_rear_left"), lambda log: shifted(log.mountings["tx_m"], 0), 6,
        "Argoverse 2", "logs", {"cameras": ("ring_front_centre", "ring_front_center"), "logs": ("0267", "")},
        "stereo_front_left", dict.fromkeys(("city_SE3_*", "calibration/intrinsics.feather"), ARROW),
    ),
    "kitti-360": Rig(
        kitti_360_files.Drive, ("image_02", "image_00"), lambda drive: shifted_fisheye(drive.texts), 6,
        "KITTI-360", "drives",
        {"cameras": ("image_04", "image_0"), "sequences": ("2013_05_28_drive_0002_sync", kitti_360_files.DRIVE)},
        "", {"calib_cam_to_velo.txt": "the file is truncated|Tr does not contain 12 finite numbers"}, "0000000004.bin",
    ),
    "nuscenes": Rig(
        nuscenes_files.Tree, ("CAM_FRONT", "CAM_BACK"),
        lambda tree: shifted(tree.tables["calibrated_sensor"][0]["translation"], 0), 8, "nuScenes", "tables",
        {"cameras": ("CAM_FRNT", "CAM_FRONT"), "scenes": ("scene-0062", "scene-0061"),
         "version": ("v1.0-min", r"v1\.0-mini")},
        "CAM_FRONT_LEFT", {"scene.json": "not a list of records|is not JSON"}, "samples/CAM_FRONT/*",
    ),
    "once": Rig(
        once_files.Sequence, ("cam01", "cam09"),
        lambda sequence: shifted(sequence.content["calib"]["cam01"]["cam_to_velo"][0], 3), 6, "ONCE", "sequences",
        {"cameras": ("cam02", "cam0"), "sequences": ("000028", "000027")},
        "cam03", {"000027.json": "is not JSON"}, "lidar_roof/*",
    ),
    "pandaset": Rig(
        pandaset_files.Drive, ("front_camera", "left_camera"), slipped_poses, 8, "PandaSet", "sequences",
        {"cameras": ("front", "front_camera"), "sequences": ("002", "001")}, "back_camera",
        dict.fromkeys(("lidar/poses.json", "front_camera/timestamps.json", "front_camera/intrinsics.json"), "not JSON"),
        "lidar/01.pkl.gz",
    ),
    "waymo": Rig(
        waymo_files.Segment, ("FRONT", "SIDE_LEFT"),
        lambda segment: shifted(segment.components["camera_calibration"][0][waymo_files.EXTRINSIC], 3), 6,
        "Waymo", "segments",
        {"cameras": ("FRONT_LFT", "FRONT_LEFT"), "segments": (waymo_files.SEGMENT[:-1], waymo_files.SEGMENT)},
        "FRONT_LEFT", {"lidar_pose/*.parquet": ARROW},
    ),
}  # fmt: skip
AS_RECORDS = {"absent": "", "needed": {}, "data_set": "waymo", "write": lambda one: write_records(one).parent}
RIGS["waymo-v1"] = Rig(**{**vars(RIGS["waymo"]), **AS_RECORDS})
ON_PAGE = ("argoverse2", "kitti-360", "once", "pandaset", "waymo")
every_rig = pytest.mark.parametrize("name", RIGS)


def written(name: str, root: Path, change: Callable[[Any], None] = lambda files: None) -> tuple[str, Path]:
    """Return the name of the data set and the root of its files."""
    files = RIGS[name].files(root)
    change(files)
    RIGS[name].write(files)
    return RIGS[name].data_set or name, root


def lines() -> list[str]:
    """Return the commands of the page that name one of these data sets."""
    blocks = re.findall(r"```sh\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)
    return [line for block in blocks for line in block.splitlines() if re.search(rf"\b({'|'.join(ON_PAGE)}):/", line)]


@pytest.mark.parametrize("line", lines())
def test_the_commands_of_the_page_work(tmp_path: Path, line: str, capsys: pytest.CaptureFixture[str]) -> None:
    name = next(name for name in ON_PAGE if f"{name}:/" in line)
    assert all(f"{one}:/" in "".join(lines()) for one in ON_PAGE)
    _, root = written(name, tmp_path)
    words = shlex.split(re.sub(rf"{name}:/\S+", f"{name}:{root}", line))[1:]
    run = words[0] == "run"
    # Nothing is to be seen on these pictures, and the quickest method finds that out.
    quick = ["--extractor", "canny/range-view", "--matcher", "nearest"] if run else []
    assert main([*words, *quick]) == (1 if run else 0)
    said = capsys.readouterr()
    assert "Traceback" not in said.err
    assert said.out.count("\n") > 2


@every_rig
def test_a_run_has_a_result_for_each_camera(tmp_path: Path, name: str, capsys: pytest.CaptureFixture[str]) -> None:
    data_set, root = written(name, tmp_path)
    words = ["--set", f"data.cameras={','.join(RIGS[name].cameras)}", "--rig", "--perturb", "1deg 0.05m", "--json"]
    quick = ["--extractor", "canny/range-view", "--matcher", "nearest"]
    assert main(["run", "--data", f"{data_set}:{root}", *words, *quick]) == 1
    found = json.loads(capsys.readouterr().out)
    assert {result["camera"] for result in found["results"]} == set(RIGS[name].cameras)
    assert found["failed"] == []


@every_rig
def test_unknown_names_and_options_are_told_the_nearest(
    tmp_path: Path, name: str, capsys: pytest.CaptureFixture[str]
) -> None:
    data_set, root = written(name, tmp_path)
    found = opened(data_set, root)
    first, second, *_ = found.names
    assert found.frame(second).name == found[1].name == second
    assert found[1:][0].name == second
    with pytest.raises(UnknownNameError, match="did you mean"):
        found.frame(first[:-1] + "x")
    for option, (value, nearest) in RIGS[name].wrong.items():
        with pytest.raises(UnknownNameError, match=f"did you mean {nearest}" if nearest else "unknown"):
            opened(data_set, root, **{option: value})
    assert main(["data", "check", f"{data_set}:{root}", "--frames", second]) == 0
    assert "1 of 1 frames are good" in capsys.readouterr().out


@every_rig
def test_frames_are_good_and_keep_the_contract(tmp_path: Path, name: str, capsys: pytest.CaptureFixture[str]) -> None:
    data_set, root = written(name, tmp_path)
    cameras, count = ",".join(RIGS[name].cameras), RIGS[name].frames
    assert len(opened(data_set, root, cameras=cameras)) == count
    assert main(["data", "check", f"{data_set}:{root}", "--set", f"data.cameras={cameras}"]) == 0
    assert capsys.readouterr().out.splitlines()[-1] == f"{count} of {count} frames are good"
    assert main(["plugin", "check", data_set, "--set", f"data.root={root}"]) == 0


@every_rig
def test_another_mounting_of_the_camera_changes_nothing_but_the_truth(tmp_path: Path, name: str) -> None:
    (data_set, root), (_, other) = written(name, tmp_path / "a"), written(name, tmp_path / "b", RIGS[name].slip)
    honest, frame = (opened(data_set, at, cameras=RIGS[name].cameras[0])[0] for at in (root, other))
    assert not np.allclose(frame.camera_from_lidar, honest.camera_from_lidar)
    assert np.array_equal(frame.cloud.xyz, honest.cloud.xyz)
    assert np.array_equal(frame.lidar_world_from_lidar, honest.lidar_world_from_lidar)


@pytest.mark.parametrize("name", [name for name, rig in RIGS.items() if rig.absent])
def test_all_cameras_are_chosen_and_one_without_images_has_no_frames(tmp_path: Path, name: str) -> None:
    data_set, root = written(name, tmp_path)
    assert len(opened(data_set, root, cameras="all")) == RIGS[name].frames
    with refused(f"no {RIGS[name].title} frames"):
        opened(data_set, root, cameras=RIGS[name].absent)


@pytest.mark.parametrize("name", [name for name, rig in RIGS.items() if rig.one])
def test_a_frame_without_one_of_its_files_is_left_out_and_named(tmp_path: Path, name: str) -> None:
    _, root = written(name, tmp_path)
    camera = RIGS[name].cameras[0]
    whole = opened(name, root, cameras=camera).names
    gone = min(root.rglob(RIGS[name].one))
    gone.unlink()
    found = opened(name, root, cameras=camera)
    [(left_out, why)] = found.skipped.items()
    assert set(whole) - set(found.names) == {left_out}
    assert why == f"{gone} is missing"
    with refused(rf"is left out.*{gone.name} is missing"):
        found.frame(left_out)


@pytest.mark.parametrize(("name", "file"), [(name, file) for name, rig in RIGS.items() for file in rig.needed])
def test_files_that_are_missing_empty_or_cut_off_are_one_line(tmp_path: Path, name: str, file: str) -> None:
    _, root = written(name, tmp_path)
    path = min(root.rglob(file))
    whole = path.read_bytes()
    for left in (0, 1, 30, len(whole) // 2, len(whole) - 10):
        path.write_bytes(whole[:left])
        with refused(rf"{RIGS[name].needed[file]}|is empty"):
            opened(name, root)[0]
    path.unlink()
    with refused(f"is missing|there are no .*{path.name}"):
        opened(name, root)[0]


@every_rig
def test_other_folders_are_one_line_and_status_2(tmp_path: Path, name: str, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "empty").mkdir()
    rig = RIGS[name]
    for folder, words in (
        ("gone", f"no such folder; expected the folder of {rig.title}"),
        ("empty", f"there are no {rig.several} of {rig.title}"),
    ):
        assert main(["data", "check", f"{rig.data_set or name}:{tmp_path / folder}"]) == 2
        said = capsys.readouterr().err.strip()
        assert words in said
        assert "\n" not in said


@pytest.mark.parametrize("name", ["argoverse2", "waymo"])
def test_without_pyarrow_it_says_what_to_install(tmp_path: Path, name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    data_set, root = written(name, tmp_path)
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    with refused(r'needs pyarrow, which is not installed.*pip install "p2o-calib\[arrow\]"'):
        opened(data_set, root)[0]
