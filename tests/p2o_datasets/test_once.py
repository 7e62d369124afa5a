"""ONCE: sweeps are seen where OpenCV's distortion has them; poses; bad input in one line."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from p2o import InputError

from .drive import check_projection, pixels, through
from .once_files import CAR_FROM, CAR_FROM_LIDAR, SEQUENCE, SIZE, START_MS, D, K, Sequence, points, world_from_lidar
from .opened import opened, refused

dataset = partial(opened, "once")


def test_frames_are_those_of_the_file_in_the_order_of_time(tmp_path: Path) -> None:
    sequence = Sequence(tmp_path)
    sequence.content["frames"].reverse()
    found = dataset(sequence.write(), cameras="cam01,cam09")
    assert found.names == tuple(
        f"{SEQUENCE}/{camera}/{START_MS + 500 * number}" for camera in ("cam01", "cam09") for number in range(3)
    )
    frame = found[4]
    assert (frame.camera_name, frame.sequence, frame.time_s) == ("cam09", SEQUENCE, 0.5)
    assert (frame.camera.model, frame.camera.width, frame.camera.height) == ("FULL_OPENCV", *SIZE)
    assert np.abs(frame.image.rgb.astype(int) - 50).max() <= 2
    assert frame.cloud.intensity.tolist() == [float(i % 256) for i in range(600)]
    assert dataset(tmp_path / "data").names == found.names[:3]


@pytest.mark.parametrize("camera", ["cam01", "cam09"])
def test_points_are_seen_where_opencv_projects_them(tmp_path: Path, camera: str) -> None:
    for frame in dataset(Sequence(tmp_path).write(), cameras=camera):
        stored = points(int(frame.name.rpartition("/")[2])).astype(float)
        optical = through(np.linalg.inv(np.linalg.inv(CAR_FROM_LIDAR) @ CAR_FROM[camera]), stored)
        ahead = (optical[:, 2] > 1) & (np.hypot(optical[:, 0], optical[:, 1]) < optical[:, 2])
        zero = np.zeros(3)
        expected = cv2.projectPoints(optical[ahead], zero, zero, np.array(K), np.array(D[camera]))[0][:, 0]
        check_projection(frame, expected, 20, 1e-4, ahead)


def test_pictures_may_be_undistorted(tmp_path: Path) -> None:
    frame = dataset(Sequence(tmp_path).write(), distorted=False)[0]
    optical = through(np.linalg.inv(CAR_FROM["cam01"]) @ CAR_FROM_LIDAR, points(START_MS).astype(float))
    expected = pixels(optical, 60.0, 61.0, 47.2, 25.1)
    assert frame.camera.is_pinhole
    check_projection(frame, expected, 20, 1e-4)


def test_poses_are_relative_to_the_first_frame_and_may_be_missing(tmp_path: Path) -> None:
    sequence = Sequence(tmp_path)
    sequence.content["frames"][0]["pose"] = [0.0] * 7
    del sequence.content["frames"][1]["pose"]
    found = dataset(sequence.write())
    assert found[0].lidar_world_from_lidar is None
    assert found[1].lidar_world_from_lidar is None
    expected = np.linalg.inv(world_from_lidar(START_MS)) @ world_from_lidar(START_MS + 1000)
    assert np.allclose(found[2].lidar_world_from_lidar, expected)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda content: content.pop("calib"), "not a sequence of ONCE"),
        (lambda content: content["frames"].append(1), "a frame of the sequence is not an object"),
        (lambda content: content["frames"][0].update(frame_id="../../secret"), "a frame_id is not a number"),
        (lambda content: content["frames"][0].update(frame_id=True), "a frame_id is not a number"),
        (lambda content: content["frames"][0].update(pose=[1, 2]), "the pose of 1616100800400 is invalid"),
        (lambda content: content["frames"][0].update(pose=[2.0] * 7), "the pose of 1616100800400 is invalid"),
        (lambda content: content["calib"].pop("cam01"), "unknown camera 'cam01'"),
        (lambda content: content["calib"].update(cam01=[]), "calib.cam01 is not an object"),
        (lambda content: content["calib"]["cam01"].pop("cam_to_velo"), "calib.cam01.cam_to_velo is not a pose"),
        (lambda content: content["calib"]["cam01"].update(cam_intrinsic=[1]), "camera.K is not an intrinsic matrix"),
        (lambda content: content["calib"]["cam01"].update(distortion=[1]), "calib.cam01.distortion is invalid"),
        (lambda content: content["calib"]["cam01"]["cam_intrinsic"][0].__setitem__(2, 97), "does not fit the camera"),
    ],
)
def test_files_that_are_wrong_are_one_line(tmp_path: Path, change: Any, words: str) -> None:
    sequence = Sequence(tmp_path)
    change(sequence.content)
    with refused(words, SEQUENCE):
        dataset(sequence.write())[0]


def test_links_that_leave_the_folder_and_sweeps_that_are_cut_off_are_refused(tmp_path: Path) -> None:
    root = Sequence(tmp_path / "a").write()
    sweep = root / "data" / SEQUENCE / "lidar_roof" / f"{START_MS}.bin"
    whole = sweep.read_bytes()
    sweep.write_bytes(whole[:-3])
    with pytest.raises(InputError, match="the point cloud is truncated"):
        dataset(root)[0]
    (tmp_path / "outside.bin").write_bytes(whole)
    sweep.unlink()
    sweep.symlink_to(tmp_path / "outside.bin")
    with pytest.raises(InputError, match="leaves the folder of the data set"):
        dataset(root)[0]
    assert len(dataset(root)[1].cloud) == 600
