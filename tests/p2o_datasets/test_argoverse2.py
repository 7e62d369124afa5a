"""Argoverse 2: true projections while the car moves, both LiDARs, and bad input in one line."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from p2o import InputError, UnknownNameError

from .argoverse2_files import BEAMS_DEG, EGO_FROM, FOCAL, LOG, START_NS, Log, measured, save, seconds
from .drive import SPEED_M_S, TURN_RAD_S, car, check_projection, pixels, through
from .opened import opened, refused

NO_ROWS = dict.fromkeys(("x", "y", "z"), np.zeros(0))
NO_ROWS |= dict.fromkeys(("intensity", "laser_number", "offset_ns"), np.zeros(0, int))
POSES = "city_SE3_egovehicle.feather"
dataset = partial(opened, "argoverse2")


def test_each_sweep_has_the_nearest_image_of_each_camera(tmp_path: Path) -> None:
    found = dataset(Log(tmp_path).write(), cameras="ring_front_center,ring_rear_left")
    times = [START_NS + 7_000_000 + number * 100_000_000 for number in range(3)]
    assert found.names == tuple(
        f"{LOG}/{camera}/{time}" for camera in ("ring_front_center", "ring_rear_left") for time in times
    )
    frame = found[4]
    assert (frame.camera_name, frame.sequence, frame.time_s) == ("ring_rear_left", LOG, 0.107)
    assert frame.camera.model == "PINHOLE"
    assert (frame.camera.width, frame.camera.height, *frame.camera.params) == (41, 31, FOCAL, FOCAL, 20.3, 15.4)
    assert np.abs(frame.image.rgb.astype(int) - 80).max() <= 2
    assert frame.warnings == ()
    assert len(dataset(tmp_path, between=True)) == 5
    assert np.allclose(found[2].lidar_world_from_lidar, car(seconds(times[2])) @ EGO_FROM["up_lidar"])


@pytest.mark.parametrize("camera", ["ring_front_center", "ring_rear_left"])
@pytest.mark.parametrize("lidar", ["up_lidar", "down_lidar", "both"])
def test_points_are_seen_where_the_data_set_itself_projects_them(tmp_path: Path, camera: str, lidar: str) -> None:
    log = Log(tmp_path)
    found = dataset(log.write(), cameras=camera, lidar=lidar, between=True)
    for frame in found:
        image_ns = int(frame.name.rpartition("/")[2])
        sweep_ns = min(log.sweeps, key=lambda time: abs(time - image_ns))
        stored = log.sweep(sweep_ns)
        used = {"up_lidar": stored["laser_number"] < 32, "down_lidar": stored["laser_number"] >= 32}.get(lidar, ...)
        ego = np.column_stack([stored[axis][used].astype(float) for axis in "xyz"])
        # The public code: from the car then to the city, to the car now, to the camera.
        car_now_from_then = np.linalg.inv(car(seconds(image_ns))) @ car(seconds(sweep_ns))
        optical = through(np.linalg.inv(EGO_FROM[camera]) @ car_now_from_then, ego)
        expected = pixels(optical, FOCAL, FOCAL, *found[0].camera.params[2:])
        check_projection(frame, expected, 50, 1e-6)


@pytest.mark.parametrize(("lidar", "low_is_up"), [("up_lidar", True), ("down_lidar", True), ("up_lidar", False)])
def test_rings_tell_which_lasers_are_of_which_lidar(tmp_path: Path, lidar: str, low_is_up: bool) -> None:
    frame = dataset(Log(tmp_path, low_is_up=low_is_up).write(), lidar=lidar)[1]
    first = 0 if (lidar == "up_lidar") == low_is_up else 32
    assert np.unique(frame.cloud.ring).tolist() == list(range(first, first + 32))
    assert np.allclose(frame.camera_from_lidar, np.linalg.inv(EGO_FROM["ring_front_center"]) @ EGO_FROM[lidar])


def test_the_sweep_can_be_taken_back_to_what_the_lidar_measured_and_may_stay_where_it_was(tmp_path: Path) -> None:
    log = Log(tmp_path, dtype=np.float32)
    frame = dataset(log.write())[1]
    cloud = frame.cloud
    points, beam, offset_ns = measured("up_lidar", 0)
    assert np.abs(cloud.time_s - (offset_ns * 1e-9 - 0.007)).max() < 1e-9
    assert np.abs(cloud.as_measured() - points).max() < 1e-3
    x, y, z = cloud.as_measured().T
    assert np.abs(np.degrees(np.arctan2(z, np.hypot(x, y))) - BEAMS_DEG[beam]).max() < 0.01
    assert abs(np.linalg.norm(frame.twist[3:]) - np.hypot(SPEED_M_S, 0.2)) < 0.5
    assert abs(np.linalg.norm(frame.twist[:3]) - TURN_RAD_S) < 1e-6
    cloud, stored = dataset(tmp_path, moved=False)[1].cloud, log.sweep(log.sweeps[1])
    ego = np.column_stack([stored[axis][stored["laser_number"] < 32].astype(float) for axis in "xyz"])
    assert np.abs(through(EGO_FROM["up_lidar"], cloud.xyz) - ego).max() < 1e-5
    assert np.abs(cloud.as_measured() - points).max() < 1e-3


def test_one_log_or_a_folder_of_them_is_read(tmp_path: Path) -> None:
    for name in ("a", "b"):
        Log(tmp_path / "val", name).write()
    assert len(dataset(tmp_path / "val")) == 6
    assert len(dataset(tmp_path / "val", logs="b")) == 3
    assert dataset(tmp_path / "val" / "b").names == dataset(tmp_path / "val", logs=["b"]).names
    with pytest.raises(UnknownNameError, match="unknown log 'c'"):
        dataset(tmp_path / "val", logs="c")
    with pytest.raises(InputError, match=r"there are no logs of Argoverse 2.*give the folder of logs: .*val"):
        dataset(tmp_path)


def test_rings_that_do_not_tell_the_lidar_leave_a_remark(tmp_path: Path) -> None:
    log = Log(tmp_path)
    for name in ("qw", "qx", "qy", "qz", "tx_m", "ty_m", "tz_m"):
        log.mountings[name][3] = log.mountings[name][2]
    assert "rings do not show which LiDAR has lasers 0 to 31" in dataset(log.write())[0].warnings[0]


@pytest.mark.parametrize(
    ("table", "change", "words"),
    [
        (POSES, {"qw": None}, "the table of poses lacks a column; expected qw"),
        (POSES, {"timestamp_ns": ["a"] * 9}, "column timestamp_ns has another type"),
        (POSES, {"timestamp_ns": range(0, 9 * 10**9, 10**9)}, "there is no pose of the vehicle near"),
        (POSES, {"timestamp_ns": [np.nan] * 9}, "column timestamp_ns has another type"),
        (POSES, {"tx_m": [*[0.0] * 8, 1e5]}, "the vehicle jumps between two poses"),
        (POSES, {"qw": [9.0] * 9}, "the pose of row 0 is invalid"),
        (POSES, {"tx_m": [None, *[0.0] * 8]}, "column tx_m has empty cells"),
        ("calibration/egovehicle_SE3_sensor.feather", {"qw": [np.nan] * 4}, "the pose of ring_front_center is invalid"),
        ("calibration/egovehicle_SE3_sensor.feather", {"sensor_name": list("abcd")}, "a sensor has no extrinsic"),
        ("calibration/intrinsics.feather", {"sensor_name": ["a", "b"]}, "a camera has no intrinsics"),
        ("calibration/intrinsics.feather", {"fx_px": [0.0, 0.0]}, "the focal length is not positive"),
        ("calibration/intrinsics.feather", {"width_px": [32, 32]}, "does not fit the camera"),
        ("calibration/intrinsics.feather", {"width_px": [np.nan, 31]}, "the camera parameters are not numbers"),
        (f"sensors/lidar/{START_NS}.feather", {"laser_number": None}, "the sweep lacks a column"),
        (f"sensors/lidar/{START_NS}.feather", {"x": [np.nan] * 5760}, "the cloud has no valid point"),
        (f"sensors/lidar/{START_NS}.feather", {"laser_number": [40] * 5760}, "has no points of up_lidar"),
        (f"sensors/lidar/{START_NS}.feather", {"laser_number": [64] * 5760}, "laser_number is out of range"),
        (f"sensors/lidar/{START_NS}.feather", {"laser_number": [np.nan] * 5760}, "laser_number has another type"),
        (f"sensors/lidar/{START_NS}.feather", {"offset_ns": [10**9] * 5760}, "offset_ns is out of range"),
        (f"sensors/lidar/{START_NS}.feather", NO_ROWS, "has no points of up_lidar"),
    ],
)
def test_wrong_tables_are_one_line_that_names_the_file(tmp_path: Path, table: str, change: Any, words: str) -> None:
    log = Log(tmp_path)
    root = log.write()
    content = {
        POSES: log.poses,
        "calibration/egovehicle_SE3_sensor.feather": log.mountings,
        "calibration/intrinsics.feather": log.intrinsics,
    }.get(table, log.sweep(START_NS))
    save(log.folder / table, {name: value for name, value in {**content, **change}.items() if value is not None})
    with refused(words, log.folder.name):
        dataset(root, lidar="up_lidar")[0]
