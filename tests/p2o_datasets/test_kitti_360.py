"""KITTI-360: raw sweeps are seen where its own scripts project them, in rectified and fisheye cameras; bad input."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from p2o import se3

from .drive import SPEED_M_S, check_projection, pixels, through
from .kitti_360_files import (
    BODY_FROM,
    DRIVE,
    FISHEYE_SIZE,
    MEI,
    P_RECT,
    R_RECT,
    SIZE,
    TURN_S,
    VELO_FROM_CAM0,
    Drive,
    lidar,
    measured,
)
from .opened import opened, refused

FISHEYE = "calibration/image_02.yaml"
dataset = partial(opened, "kitti-360")


def mei_pixels(points: Any) -> Any:
    """Return where the unified model (its published formulas, with p1 and p2) has points of the optical frame."""
    sphere = points / np.sqrt((points**2).sum(axis=1))[:, None]
    x, y = sphere[:, 0] / (sphere[:, 2] + MEI["xi"]), sphere[:, 1] / (sphere[:, 2] + MEI["xi"])
    rho2 = x**2 + y**2
    grown = MEI["k1"] * rho2 + MEI["k2"] * rho2**2
    dx = x * grown + 2 * MEI["p1"] * x * y + MEI["p2"] * (rho2 + 2 * x**2)
    dy = y * grown + 2 * MEI["p2"] * x * y + MEI["p1"] * (rho2 + 2 * y**2)
    uv = np.column_stack([MEI["gamma1"] * (x + dx) + MEI["u0"], MEI["gamma2"] * (y + dy) + MEI["v0"]])
    return np.where(points[:, 2:] > 0.1, uv, np.nan)


def expected_pixels(camera: str, frame: int) -> Any:
    """Return where a camera sees what the sweep of a frame measured, each return at its own time."""
    points, azimuth = measured()
    world = np.empty_like(points, dtype=float)
    for angle in np.unique(azimuth):
        at = azimuth == angle
        # The scanner turns clockwise: what lies left of straight ahead was measured before.
        world[at] = through(lidar(frame - angle / (2 * np.pi)), points[at].astype(float))
    cam0 = through(np.linalg.inv(VELO_FROM_CAM0) @ np.linalg.inv(lidar(frame)), world)
    optical = through(np.linalg.inv(BODY_FROM[camera]) @ BODY_FROM["image_00"], cam0)
    if camera in ("image_02", "image_03"):
        return mei_pixels(optical)
    focal, u, v, _ = P_RECT[camera[-2:]]
    return pixels(optical @ R_RECT[camera[-2:]].T, focal, focal, u, v)


def test_images_have_the_sweeps_of_their_numbers(tmp_path: Path) -> None:
    found = dataset(Drive(tmp_path).write(), cameras="all")
    assert found.names == tuple(f"{DRIVE}/image_0{camera}/{frame:010d}" for camera in range(4) for frame in (3, 4, 5))
    frame = found[2]
    assert (frame.camera_name, frame.sequence, round(frame.time_s or 0, 6)) == ("image_00", DRIVE, round(5 * TURN_S, 6))
    assert (frame.camera.model, frame.camera.width, frame.camera.height) == ("PINHOLE", *SIZE)
    assert (found[9].camera.width, found[9].camera.height) == FISHEYE_SIZE
    assert frame.warnings == ()
    assert np.bincount(frame.cloud.ring).tolist() == [100] * 64


@pytest.mark.parametrize("camera", ["image_00", "image_01", "image_02", "image_03"])
def test_points_are_seen_where_the_data_set_itself_projects_them(tmp_path: Path, camera: str) -> None:
    for frame in dataset(Drive(tmp_path).write(), cameras=camera):
        expected = expected_pixels(camera, int(frame.name[-10:]))
        check_projection(frame, expected, 300, 0.02)


def test_pose_and_velocity_of_the_lidar_come_from_the_poses_of_the_car(tmp_path: Path) -> None:
    frame = dataset(Drive(tmp_path).write())[2]
    assert np.abs(frame.lidar_world_from_lidar - lidar(5)).max() < 1e-6
    step = np.linalg.inv(lidar(5)) @ lidar(5.001)
    assert np.abs(frame.twist - se3.log(step) / (0.001 * TURN_S)).max() < 1e-4
    assert abs(np.linalg.norm(frame.twist[3:]) - SPEED_M_S) < 1
    assert np.abs(frame.cloud.as_measured() - measured()[0]).max() < 1e-4


def test_without_poses_or_far_from_all_of_them_the_sweep_stays_raw_and_says_so(tmp_path: Path) -> None:
    drive = Drive(tmp_path)
    del drive.texts[f"data_poses/{DRIVE}/poses.txt"]
    poses = Drive(tmp_path).texts[f"data_poses/{DRIVE}/poses.txt"]
    frame = dataset(drive.write())[0]
    assert frame.twist is None
    assert frame.lidar_world_from_lidar is None
    assert "the sweep is raw" in frame.warnings[0]
    assert frame.cloud.time_s is not None
    assert np.array_equal(frame.cloud.xyz, measured()[0])
    drive.texts[f"data_poses/{DRIVE}/poses.txt"] = poses.splitlines()[0] + "\n"
    frame = dataset(drive.write())[2]
    assert frame.twist is None
    assert "there is no pose of the vehicle near the requested time (the nearest is 0.414 s away)" in frame.warnings[0]
    Drive(tmp_path).write()
    frame = dataset(tmp_path, deskew=False)[0]
    assert frame.twist is not None
    assert np.array_equal(frame.cloud.xyz, measured()[0])


def test_stamps_that_are_lost_are_counted_in_turns(tmp_path: Path) -> None:
    drive = Drive(tmp_path)
    name = f"data_3d_raw/{DRIVE}/velodyne_points/timestamps.txt"
    lines = drive.texts[name].splitlines()
    lines[4] = ""
    drive.texts[name] = "\n".join(lines) + "\n"
    frame = dataset(drive.write())[1]
    assert np.abs(frame.lidar_world_from_lidar - lidar(4)).max() < 1e-6
    (tmp_path / name).unlink()
    assert dataset(tmp_path)[1].time_s == 0.4


def test_the_delay_of_the_image_moves_times_and_pose(tmp_path: Path) -> None:
    frame = dataset(Drive(tmp_path).write(), image_delay_s=0.01)[0]
    assert np.abs(frame.lidar_world_from_lidar - lidar(3 + 0.01 / TURN_S)).max() < 1e-6
    assert np.abs(frame.cloud.time_s - (-measured()[1] / (2 * np.pi) * TURN_S - 0.01)).max() < 1e-6


@pytest.mark.parametrize(
    ("file", "old", "new", "words"),
    [
        ("calibration/perspective.txt", "P_rect_00", "P_rect_09", "unknown key 'P_rect_00'"),
        ("calibration/perspective.txt", f"S_rect_00: {SIZE[0]:e}", "S_rect_00: 1.3e+02", "does not fit the camera"),
        ("calibration/perspective.txt", "P_rect_00: 55.0", "P_rect_00: x", "P_rect_00 does not contain 12 finite"),
        ("calibration/calib_cam_to_velo.txt", " ", " x ", "Tr does not contain 12 finite numbers"),
        ("calibration/calib_cam_to_pose.txt", "image_00", "image_0", "unknown key 'image_00'"),
        (f"data_poses/{DRIVE}/poses.txt", "1 5", "1.5 5", "line 1 of the file of poses is not a pose"),
        (f"data_poses/{DRIVE}/poses.txt", "1 5.7", "1 9.7", "the rotation of the pose of frame 1"),
        (f"data_poses/{DRIVE}/poses.txt", "\n", " 7\n", "line 1 of the file of poses is not a pose"),
        (f"data_3d_raw/{DRIVE}/velodyne_points/timestamps.txt", "2013", "now", "a line is not a time"),
        (FISHEYE, "MEI", "PINHOLE", "not a fisheye of the unified model"),
        (FISHEYE, "   xi: ", "   yi: ", "mirror_parameters.xi is not a number"),
        (FISHEYE, "   xi: ", "   xi: -", "the mirror parameter of the camera is invalid"),
        (FISHEYE, f"image_width: {FISHEYE_SIZE[0]}", "image_width: 139", "the image size does not fit the camera"),
        (FISHEYE, "   gamma1: ", "   gamma1: -", "the focal length is not positive"),
        (FISHEYE, f"   k1: {MEI['k1']:.16e}", "   k1: -90.0", "no camera model fits the fisheye lens"),
        (FISHEYE, "model_type", "model_type: !!python/object:os.system\nx", "objects, which are not supported"),
    ],
)
def test_wrong_files_are_one_line_that_names_them(tmp_path: Path, file: str, old: str, new: str, words: str) -> None:
    drive = Drive(tmp_path)
    assert old in drive.texts[file]
    drive.texts[file] = drive.texts[file].replace(old, new, 1 if file == FISHEYE else -1)
    with refused(words, "" if "fit" in words else Path(file).name):
        dataset(drive.write(), cameras="image_02" if file == FISHEYE else "image_00")[0]
