from __future__ import annotations

import json
import tracemalloc
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from p2o import InputError, se3
from p2o_datasets.nuscenes import CAMERAS
from p2o_datasets.nuscenes_tables import by_token, records

from .nuscenes_files import CAMERA, EGO_FROM, START_US, WORLD, Tree, points_of, world_from_ego
from .opened import opened, refused

dataset = partial(opened, "nuscenes")


def test_key_frames_of_the_front_camera_are_read_with_their_sweeps(tmp_path: Path) -> None:
    found = dataset(Tree(tmp_path).write())
    assert found.names == tuple(
        f"{scene}/CAM_FRONT/{START_US + later + 12_000}"
        for scene, first in (("scene-0061", 0), ("scene-0103", 60_000_000))
        for later in (first, first + 500_000)
    )
    frame = found[1]
    assert frame.camera == CAMERA
    assert (frame.camera_name, frame.sequence, frame.time_s) == ("CAM_FRONT", "scene-0061", 0.5)
    assert frame.warnings == ()
    assert frame.cloud.ring.tolist() == [i % 32 for i in range(300)]
    assert frame.cloud.intensity.tolist() == [i % 256 for i in range(300)]
    assert np.abs(frame.image.rgb.astype(int) - (START_US + 512_000) // 1000 % 256).max() <= 2


@pytest.mark.parametrize("camera", ["CAM_FRONT", "CAM_BACK"])
def test_the_true_extrinsic_shows_the_moved_sweep_where_the_world_is(tmp_path: Path, camera: str) -> None:
    found = dataset(Tree(tmp_path).write(), cameras=camera, between=True)
    for frame in found:
        time_us = int(frame.name.rpartition("/")[2])
        camera_from_world = se3.inverse(world_from_ego(time_us) @ EGO_FROM[camera])
        expected = se3.apply(camera_from_world, WORLD + [411, 1180, 0])
        assert np.abs(se3.apply(frame.camera_from_lidar, frame.cloud.xyz) - expected).max() < 1e-4
        assert np.allclose(frame.camera_from_lidar, se3.inverse(EGO_FROM[camera]) @ EGO_FROM["LIDAR_TOP"])
        assert np.allclose(frame.lidar_world_from_lidar, world_from_ego(time_us) @ EGO_FROM["LIDAR_TOP"])


def test_scenes_cameras_and_what_lies_between_are_chosen(tmp_path: Path) -> None:
    root = Tree(tmp_path).write()
    assert len(dataset(root, scenes="scene-0061")) == 2
    both = dataset(root, cameras="CAM_BACK,CAM_FRONT", scenes=["scene-0103"])
    assert [name.split("/")[1] for name in both.names] == ["CAM_BACK", "CAM_BACK", "CAM_FRONT", "CAM_FRONT"]
    assert dataset(root, cameras="all").names == dataset(root, cameras=CAMERAS).names
    between = dataset(root, between=True, scenes="scene-0061")
    assert [int(name[-6:]) for name in between.names] == [612_000, 692_000, 112_000, 192_000]
    # The nearest sweep is the one 5 ms later, not that of the key frame.
    assert np.array_equal(dataset(root, between=True, moved=False)[1].cloud.xyz, points_of(START_US + 97_000))


def test_one_of_several_versions_is_chosen(tmp_path: Path) -> None:
    root = Tree(tmp_path).write()
    Tree(tmp_path).write("v1.0-test")
    with refused(r"several folders of tables.*data.version=NAME.*v1.0-mini, v1.0-test"):
        dataset(root)


@pytest.mark.parametrize(
    ("table", "key", "value", "words"),
    [
        ("calibrated_sensor", "camera_intrinsic", [], "a record has a wrong 'camera_intrinsic'"),
        ("calibrated_sensor", "rotation", [1, 0, 0], "a record has a wrong 'rotation'"),
        ("calibrated_sensor", "rotation", [0, 0, 0, 0], "the pose of calibrated-CAM_FRONT"),
        ("calibrated_sensor", "sensor_token", "gone", "refers to a missing record"),
        ("sample_data", "filename", 7, "a record has a wrong 'filename'"),
        ("sample_data", "timestamp", -1, "a record has a wrong 'timestamp'"),
        ("sample_data", "sample_token", "gone", "refers to a missing record"),
        ("sample_data", "width", 31, "does not fit the camera"),
        ("sample_data", "ego_pose_token", "gone", "refers to a missing record"),
        ("ego_pose", "translation", ["a", 0, 0], "the pose of pose-CAM_FRONT"),
        ("ego_pose", "translation", [9e4, 0, 0], "the vehicle jumps between two poses"),
        ("ego_pose", "token", [], "a record has a wrong 'token'"),
        ("sample_data", "is_key_frame", 1, "a record has a wrong 'is_key_frame'; expected true or false"),
        ("sample_data", "calibrated_sensor_token", "gone", "refers to a missing record"),
    ],
)
def test_records_that_are_wrong_are_one_line(tmp_path: Path, table: str, key: str, value: Any, words: str) -> None:
    tree = Tree(tmp_path)
    tree.tables[table][0][key] = value
    with refused(words):
        dataset(tree.write()).frame(f"scene-0061/CAM_FRONT/{START_US + 12_000}")


def test_a_mounting_in_millimetres_is_remarked(tmp_path: Path) -> None:
    tree = Tree(tmp_path)
    tree.tables["calibrated_sensor"][0]["translation"] = [1700, 0, 1500]
    [remark] = dataset(tree.write())[0].warnings
    assert "camera and LiDAR are 2.27e+03 m apart" in remark


def test_files_outside_of_the_folder_are_refused(tmp_path: Path) -> None:
    tree = Tree(tmp_path / "data")
    first = tree.tables["sample_data"][0]
    (tmp_path / "data" / first["filename"]).rename(tmp_path / "outside.jpg")
    first["filename"] = "../outside.jpg"
    found = dataset(tree.write())
    with pytest.raises(InputError, match="leaves the folder of the data set"):
        found[0]
    first["filename"] = "x" * 5000
    assert len(dataset(tree.write())) == 3


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "the table is empty"),
        ("{}", "not a list of records"),
        ('[{"token": "a", "scene_token": "s1"}', "or is truncated"),
        ('[{"token": "a", "scene_token": "s1"} {}]', "or is truncated"),
        ("[1]", "is not a record"),
        ("[{]", "is not JSON"),
        ("[" * 100_000, "is not JSON"),
        ('[{"token": "' + "a" * (3 << 20), "is not JSON"),
        ('[{"token": "a", "scene_token": "s1"}' + " " * (3 << 20) + "x]", "expected ',' at character 3145764; got x"),
    ],
)
def test_tables_that_are_no_lists_of_records_are_refused(tmp_path: Path, text: str, words: str) -> None:
    root = Tree(tmp_path).write()
    (root / "v1.0-mini/sample.json").write_text(text)
    with pytest.raises(InputError, match=words):
        dataset(root)


def test_a_table_is_read_in_parts(tmp_path: Path) -> None:
    """Records cross the borders of the parts, and the memory of the records that are kept is the only one."""
    path = tmp_path / "ego_pose.json"
    entries = [{"token": str(number), "text": "ä" * 1000} for number in range(20_000)]
    path.write_text(json.dumps(entries, ensure_ascii=False))
    tracemalloc.start()
    tokens = list(by_token(tmp_path, "ego_pose", lambda token: token.endswith("77")))
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert tokens == [str(number) for number in range(77, 20_000, 100)]
    assert path.stat().st_size > 40_000_000
    assert peak < 16_000_000


def test_a_sparse_table_of_gigabytes_is_refused_without_reading_it(tmp_path: Path) -> None:
    for size in (2 << 30, 1 << 40):
        with (tmp_path / "sensor.json").open("wb") as file:
            file.truncate(size)
        with pytest.raises(InputError, match=r"not a list of records|too large"):
            next(records(tmp_path, "sensor"))
