"""Waymo v2: range images become points where Waymo's own projection has them, while the car moves; bad input."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from p2o import InputError, se3
from pyarrow import parquet

from .drive import car, check_projection, through
from .opened import opened, refused
from .waymo_files import (
    CAMERAS,
    COLUMNS,
    HEIGHT,
    LENS,
    LIDARS,
    READOUT_S,
    ROWS,
    SEGMENT,
    SHUTTER_S,
    START_US,
    WIDTH,
    Segment,
    frame_pose,
    seconds,
    world_points,
)

NUMBER = {"FRONT": 1, "SIDE_LEFT": 4, "TOP": 1, "REAR": 5}
dataset = partial(opened, "waymo")


def middle_s(frame_us: int, camera: int) -> float:
    return seconds(frame_us) + 0.03 + 0.01 * camera + 0.5 * (SHUTTER_S + READOUT_S)


def waymo_pixels(optical: Any) -> Any:
    """Return where Waymo's camera has points of its frame (x forward, y left, z up), counted from the left edge."""
    x = np.where(optical[:, 0] > 0.1, optical[:, 0], np.nan)
    u, v = -optical[:, 1] / x, -optical[:, 2] / x
    r2 = u * u + v * v
    radial = 1 + LENS["k1"] * r2 + LENS["k2"] * r2**2 + LENS["k3"] * r2**3
    du = u * radial + 2 * LENS["p1"] * u * v + LENS["p2"] * (r2 + 2 * u * u)
    dv = v * radial + LENS["p1"] * (r2 + 2 * v * v) + 2 * LENS["p2"] * u * v
    return np.column_stack([du * LENS["f_u"] + LENS["c_u"], dv * LENS["f_v"] + LENS["c_v"]])


def test_each_image_has_the_sweep_of_its_frame(tmp_path: Path) -> None:
    found = dataset(Segment(tmp_path).write(), cameras="SIDE_LEFT,FRONT")
    assert found.names == tuple(
        f"{SEGMENT}/{camera}/{START_US + number * 100_000}" for camera in ("SIDE_LEFT", "FRONT") for number in range(3)
    )
    frame = found[4]
    assert (frame.camera_name, frame.sequence, frame.time_s) == ("FRONT", SEGMENT, 0.1)
    assert (frame.camera.model, frame.camera.width, frame.camera.height) == ("FULL_OPENCV", WIDTH, HEIGHT)
    assert frame.camera.params[2:4] == (47.1, 30.7)
    assert np.abs(frame.image.rgb.astype(int) - ((START_US // 100_000 + 1) * 7 + 40) % 256).max() <= 2
    assert frame.warnings == ()
    assert set(frame.cloud.intensity.tolist()) == {0.25}
    assert set(frame.cloud.ring.tolist()) == set(range(ROWS))


@pytest.mark.parametrize(("camera", "lidar"), [("FRONT", "TOP"), ("SIDE_LEFT", "TOP"), ("SIDE_LEFT", "REAR")])
def test_points_are_seen_where_waymo_itself_projects_them(tmp_path: Path, camera: str, lidar: str) -> None:
    for frame in dataset(Segment(tmp_path).write(), cameras=camera, lidar=lidar):
        frame_us = int(frame.name.rpartition("/")[2])
        world = world_points(NUMBER[lidar], frame_us).reshape(-1, 3)
        world = world[np.isfinite(world[:, 0])]
        pose = car(middle_s(frame_us, NUMBER[camera]))
        expected = waymo_pixels(through(np.linalg.inv(pose @ CAMERAS[NUMBER[camera]]), world)) - 0.5
        check_projection(frame, expected, 100, 0.01)


def test_a_sweep_that_stays_lies_where_the_frame_has_its_pose(tmp_path: Path) -> None:
    frame = dataset(Segment(tmp_path).write(), moved=False)[1]
    frame_us = START_US + 100_000
    world = world_points(1, frame_us).reshape(-1, 3)
    world = world[np.isfinite(world[:, 0])]
    assert np.abs(through(frame_pose(frame_us) @ LIDARS[1], frame.cloud.xyz) - world).max() < 1e-3


def test_velocity_and_pose_of_the_lidar_are_those_of_the_image(tmp_path: Path) -> None:
    frame = dataset(Segment(tmp_path).write())[0]
    at_s = middle_s(START_US, 1)
    now, later = (car(time) @ LIDARS[1] for time in (at_s, at_s + 1e-3))
    assert np.abs(frame.lidar_world_from_lidar - now).max() < 1e-3
    assert np.abs(frame.twist - se3.log(np.linalg.inv(now) @ later) / 1e-3).max() < 0.01


def test_frames_without_a_sweep_are_left_out_and_named(tmp_path: Path) -> None:
    segment = Segment(tmp_path)
    del segment.components["lidar"][0]
    found = dataset(segment.write())
    assert len(found) == 2
    with pytest.raises(InputError, match=rf"is left out.*{SEGMENT}.parquet has no sweep of TOP"):
        found.frame(f"{SEGMENT}/FRONT/{START_US}")


def test_the_folder_above_gets_a_hint(tmp_path: Path) -> None:
    Segment(tmp_path / "waymo" / "training").write()
    with pytest.raises(InputError, match=r"there are no segments of Waymo.*folder of components: .*training"):
        dataset(tmp_path / "waymo")


@pytest.mark.parametrize(
    ("component", "column", "value", "words"),
    [
        ("camera_calibration", "key.camera_name", 2, "a sensor has no calibration; expected FRONT"),
        ("camera_calibration", "key.camera_name", 4, "two rows have the same key; expected one; got 4"),
        ("camera_image", "key.frame_timestamp_micros", START_US + 100_000, "two rows have the same key"),
        ("vehicle_pose", "key.frame_timestamp_micros", START_US + 100_000, "two rows have the same key"),
        ("lidar_pose", "range_image_return1.values", [0.0] * (6 * ROWS * COLUMNS), "the vehicle jumps"),
        ("camera_calibration", "intrinsic.f_u", None, "f_u is not a number"),
        ("camera_calibration", "width", 0, "camera.width is out of bounds"),
        ("camera_calibration", "extrinsic.transform", [2.0] * 16, "extrinsic of the camera"),
        ("lidar_calibration", "extrinsic.transform", None, "the extrinsic of the LiDAR is not"),
        ("lidar_calibration", "beam_inclination.values", [0.1], "inclinations do not fit"),
        ("camera_image", "image", None, "the image is missing"),
        ("camera_image", "image", b"\xff\xd8\xff", "the image cannot be decoded"),
        ("camera_image", "pose.transform", None, "the pose of the image is not a pose"),
        ("camera_image", "pose_timestamp", float("nan"), "pose_timestamp is not a number"),
        ("vehicle_pose", "key.frame_timestamp_micros", 5, "there is no pose of the vehicle"),
        ("lidar_pose", "key.frame_timestamp_micros", 5, "there are no poses of the pixels"),
        ("lidar_pose", "range_image_return1.shape", [ROWS, COLUMNS, 5], "not a range image"),
        ("lidar", "range_image_return1.values", None, "not a range image"),
        ("lidar", "range_image_return1.shape", [-1, -1, 4], "not a range image"),
        ("lidar", "range_image_return1.values", [0.0] * (4 * ROWS * COLUMNS), "has no returns"),
    ],
)
def test_wrong_rows_are_one_line(tmp_path: Path, component: str, column: str, value: Any, words: str) -> None:
    segment = Segment(tmp_path)
    row = segment.components[component][0]
    row[next(name for name in row if name.endswith(column))] = value
    with refused(words, component):
        dataset(segment.write())[0]


def test_a_component_of_another_table_is_one_line_and_only_sweeps_of_top_have_poses_of_pixels(tmp_path: Path) -> None:
    root = Segment(tmp_path).write()
    path = root / "lidar_pose" / f"{SEGMENT}.parquet"
    path.write_bytes((root / "lidar_calibration" / f"{SEGMENT}.parquet").read_bytes())
    with pytest.raises(InputError, match="the component lidar_pose lacks a column"):
        dataset(root)[0]
    path.unlink()
    assert len(dataset(root, lidar="REAR")[0].cloud) > 100


@pytest.mark.parametrize(
    ("component", "column", "value", "words"),
    [
        ("lidar_calibration", "beam_inclination.values", "a", "the inclinations do not fit the range image"),
        ("camera_image", "key.frame_timestamp_micros", float(START_US), "has another type; expected integers"),
    ],
)
def test_columns_of_other_types_are_refused(
    tmp_path: Path, component: str, column: str, value: Any, words: str
) -> None:
    path = Segment(tmp_path).write() / component / f"{SEGMENT}.parquet"
    table = parquet.read_table(path)
    place = next(number for number, name in enumerate(table.column_names) if name.endswith(column))
    parquet.write_table(table.set_column(place, table.column_names[place], [[value] * len(table)]), path)
    with refused(words, component):
        dataset(tmp_path)[0]


def test_an_image_of_another_size_is_refused(tmp_path: Path) -> None:
    segment = Segment(tmp_path)
    segment.components["camera_calibration"][0]["[CameraCalibrationComponent].width"] = WIDTH - 1
    with pytest.raises(InputError, match=r"camera_image.*the image size does not fit the camera; expected 95x64 px"):
        dataset(segment.write())[0]


def test_times_that_cannot_be_leave_the_image_at_its_pose(tmp_path: Path) -> None:
    segment = Segment(tmp_path)
    segment.components["camera_image"][0]["[CameraImageComponent].pose_timestamp"] = 0.0
    frame = dataset(segment.write())[0]
    assert "which is implausible" in frame.warnings[0]
    assert np.abs(frame.lidar_world_from_lidar - car(seconds(START_US) + 0.05) @ LIDARS[1]).max() < 1e-6
