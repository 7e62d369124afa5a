"""PandaSet: points of the world are seen where its own toolkit projects them, in the LiDAR's frame; bad input."""

from __future__ import annotations

import gzip
import pickle
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from p2o import InputError

from .drive import SPEED_M_S, car, check_projection, pixels, through
from .opened import opened, refused
from .pandaset_files import (
    CAR_FROM,
    CAR_FROM_LIDAR,
    LATER_S,
    LENS,
    POINTS,
    SEQUENCE,
    SIZE,
    START_S,
    Drive,
    lidar,
    measured,
    pickled,
)

dataset = partial(opened, "pandaset")


def test_images_have_the_sweeps_of_their_numbers(tmp_path: Path) -> None:
    found = dataset(Drive(tmp_path).write(), cameras="front_camera,left_camera")
    assert found.names == tuple(
        f"{SEQUENCE}/{camera}/{number:02d}" for camera in ("front_camera", "left_camera") for number in range(4)
    )
    frame = found[6]
    assert (frame.camera_name, frame.sequence, round(frame.time_s or 0, 6)) == ("left_camera", SEQUENCE, 0.22)
    assert (frame.camera.width, frame.camera.height) == SIZE
    assert frame.camera.params == tuple(LENS.values())
    assert np.abs(frame.image.rgb.astype(int) - 100).max() <= 2
    assert frame.warnings == ()
    assert len(frame.cloud) == 400
    assert frame.cloud.intensity.tolist() == [float(i % 256) for i in range(POINTS) if i % 3 < 2]
    assert dataset(tmp_path / SEQUENCE).names == found.names[:4]


@pytest.mark.parametrize("camera", list(CAR_FROM))
@pytest.mark.parametrize(("sensor", "kinds"), [("pandar64", (0,)), ("pandargt", (1,)), ("both", (0, 1))])
def test_points_are_where_the_toolkit_projects_them(
    tmp_path: Path, camera: str, sensor: str, kinds: tuple[int, ...]
) -> None:
    drive = Drive(tmp_path)
    for number, frame in enumerate(dataset(drive.write(), cameras=camera, lidar=sensor)):
        table = drive.table(number)
        world = np.column_stack([table[axis] for axis in "xyz"])[np.isin(table["d"], kinds)]
        # The public code: from the world to the camera by the camera's own pose.
        camera_pose = car(drive.times[number] + LATER_S[camera]) @ CAR_FROM[camera]
        expected = pixels(through(np.linalg.inv(camera_pose), world), *LENS.values())
        check_projection(frame, expected, 10, 0.01)
        assert np.abs(frame.camera_from_lidar - np.linalg.inv(CAR_FROM[camera]) @ CAR_FROM_LIDAR).max() < 1e-4


def test_the_sweep_can_be_taken_back_to_what_the_lidar_measured_and_may_stay_where_it_was(tmp_path: Path) -> None:
    drive = Drive(tmp_path)
    frame = dataset(drive.write(), lidar="both")[1]
    table = drive.table(1)
    assert np.abs(frame.cloud.time_s - (table["t"] - START_S - 0.145)).max() < 1e-6
    assert np.abs(frame.cloud.as_measured() - measured(table)).max() < 0.01
    assert abs(np.linalg.norm(frame.twist[3:]) - SPEED_M_S) < 0.5
    frame = dataset(tmp_path, moved=False, lidar="both")[1]
    world = np.column_stack([table[axis] for axis in "xyz"])
    assert np.abs(through(lidar(0.1), frame.cloud.xyz) - world).max() < 1e-6
    assert np.abs(frame.lidar_world_from_lidar - lidar(0.1 + LATER_S["front_camera"])).max() < 1e-4


def test_poses_that_are_not_fixed_to_each_other_are_told(tmp_path: Path) -> None:
    drive = Drive(tmp_path)
    drive.files["camera/front_camera/poses.json"][2]["position"]["x"] += 1.0
    assert "the relative pose of camera and LiDAR varies" in dataset(drive.write())[0].warnings[0]


@pytest.mark.parametrize(
    ("file", "content", "words"),
    [
        ("lidar/poses.json", {}, "not a list of poses"),
        ("lidar/poses.json", [{"heading": {"w": 1}}] * 4, "x is not a number"),
        ("lidar/poses.json", [], "numbers of poses and time stamps differ"),
        ("lidar/timestamps.json", ["a"] * 4, "not a list of times"),
        ("lidar/timestamps.json", [5.0] * 4, "the times of the poses do not ascend"),
        ("lidar/timestamps.json", [1.0, 2.0, 3.0, 4.0], "no image has a pose of the LiDAR near"),
        ("camera/front_camera/intrinsics.json", [], "fx is not a number"),
        ("camera/front_camera/intrinsics.json", {**LENS, "cx": 200.0}, "the image size does not fit the camera"),
        ("camera/front_camera/intrinsics.json", {**LENS, "fx": -1.0}, "the focal length is not positive"),
    ],
)
def test_files_that_are_wrong_are_one_line(tmp_path: Path, file: str, content: Any, words: str) -> None:
    drive = Drive(tmp_path)
    drive.files[file] = content
    with refused(words, SEQUENCE):
        dataset(drive.write())[0]


def test_sweeps_of_another_content_are_one_line_and_run_nothing(tmp_path: Path) -> None:
    drive = Drive(tmp_path)
    root = drive.write()
    path = tmp_path / SEQUENCE / "lidar/00.pkl.gz"
    table = drive.table(0)
    for content, words in (
        (pickled({name: values for name, values in table.items() if name != "d"}), "no column d among x, y, z, i, t"),
        (pickled({**table, "d": table["d"] * 0 + 5}), "the sweep has no points of pandar64"),
        (pickled({**table, "x": table["x"] + np.nan}), "the cloud has no valid point"),
        (pickle.dumps([print, "x"]), "other pickles are never loaded"),
    ):
        path.write_bytes(gzip.compress(content))
        with pytest.raises(InputError, match=words):
            dataset(root)[0]


def test_points_without_usable_times_are_read_without(tmp_path: Path) -> None:
    drive = Drive(tmp_path)
    root = drive.write()
    table = drive.table(0)
    for times in (table["t"] * np.nan, table["t"] * 0 + START_S, table["t"] + 5000):
        path = tmp_path / SEQUENCE / "lidar/00.pkl.gz"
        path.write_bytes(gzip.compress(pickled({**table, "t": times})))
        cloud = dataset(root)[0].cloud
        assert cloud.time_s is None
        assert cloud.twist is None


def test_sweeps_that_are_not_packed_are_read(tmp_path: Path) -> None:
    root = Drive(tmp_path).write()
    for path in (tmp_path / SEQUENCE / "lidar").glob("*.pkl.gz"):
        path.with_suffix("").write_bytes(gzip.decompress(path.read_bytes()))
        path.unlink()
    assert len(dataset(root)) == 4
    assert len(dataset(root)[0].cloud) == 400
