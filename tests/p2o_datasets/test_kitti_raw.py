from __future__ import annotations

import pickle
from functools import partial
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from p2o import Dataset, se3
from p2o.reading import RadialError
from p2o_datasets.kitti_folder import read_stamps
from p2o_datasets.kitti_raw import KittiRawOptions
from pydantic import ValidationError

from .kitti_files import (
    BASELINE_M,
    DAY,
    HEIGHT,
    IMU_TO_VELO,
    PROJECTIONS,
    R_RECT,
    VELO_TO_CAM,
    WIDTH,
    calib_cam_to_cam,
    numbers,
    stamps,
    sweep,
    write_day,
    write_image,
    write_oxts,
    write_raw_frame,
    write_sweep,
)
from .opened import opened, refused

STILL = "the sweep is raw, and the velocity of the vehicle is unknown"
dataset = partial(opened, "kitti-raw")


def test_frames_of_all_days_and_drives_are_named_and_sorted(tmp_path: Path) -> None:
    day = write_day(tmp_path)
    for drive, frame in (("0011", 3), ("0002", 10), ("0002", 9)):
        write_raw_frame(day, drive, frame)
    found = pickle.loads(pickle.dumps(dataset(tmp_path)))  # noqa: S301  (as it travels to other processes)
    assert isinstance(found, Dataset)
    assert found.names == (f"{DAY}/0002/0000000009", f"{DAY}/0002/0000000010", f"{DAY}/0011/0000000003")
    assert found[2].name == found.names[2]
    assert found.skipped == {}
    assert dataset(day).names == found.names
    assert dataset(day / f"{DAY}_drive_0011_sync").names == found.names[2:]
    write_raw_frame(day, "0002", 4, kind="extract")
    assert dataset(tmp_path).names == found.names, "a synchronised drive wins over its extract"


def test_a_frame_holds_pixels_points_camera_and_exact_extrinsic(tmp_path: Path) -> None:
    folder = write_raw_frame(write_day(tmp_path))
    pixels = write_image(folder / "image_02/data/0000000000.png", seed=7)
    write_image(folder / "image_02/data/0000000000.jpg", seed=2)
    frame = dataset(tmp_path)[0]
    assert np.array_equal(frame.image.rgb, pixels)
    assert np.array_equal(frame.cloud.xyz, sweep()[:, :3])
    assert np.array_equal(frame.cloud.intensity, sweep()[:, 3])
    assert frame.cloud.ring.max() == 63
    assert frame.camera.params == (50, 50, 31, 15.5)
    assert (frame.camera.width, frame.camera.height) == (WIDTH, HEIGHT)
    offset = np.linalg.solve(PROJECTIONS[2][:, :3], PROJECTIONS[2][:, 3])
    assert np.allclose(frame.camera_from_lidar, se3.make(translation=offset) @ R_RECT @ VELO_TO_CAM, atol=1e-11)
    assert frame.start is None


def test_pykitti_compat_shortens_the_offset_and_a_right_camera_has_no_right_picture(tmp_path: Path) -> None:
    write_raw_frame(write_day(tmp_path))
    pose = dataset(tmp_path, pykitti_compat=True)[0].camera_from_lidar
    assert np.allclose(pose, se3.make(translation=[3 / 50, 0, 0]) @ R_RECT @ VELO_TO_CAM, atol=1e-11)
    write_raw_frame(tmp_path / DAY, camera=3)
    image = dataset(tmp_path, camera="3")[0].image
    assert (image.right, image.baseline_m) == (None, None)


@pytest.mark.parametrize(("camera", "baseline_m"), [(0, BASELINE_M), (2, 0.54)])
def test_the_right_picture_comes_with_the_baseline_of_its_pair(tmp_path: Path, camera: int, baseline_m: float) -> None:
    folder = write_raw_frame(write_day(tmp_path), camera=camera)
    assert dataset(tmp_path, camera=camera)[0].image.right is None
    right = write_image(folder / f"image_{camera + 1:02d}/data/0000000000.png", seed=5)
    frame = dataset(tmp_path, camera=camera)[0]
    image = frame.image
    assert np.array_equal(image.right, right)
    assert ("0000000000.png: grey image, repeated on three channels" in frame.warnings) == (camera == 0)
    assert image.baseline_m == pytest.approx(baseline_m)
    assert dataset(tmp_path, camera=camera, right=False)[0].image.right is None


def write_disparity(folder: Path, row: int, column: int) -> None:
    """Write a disparity of 3 px at one pixel."""
    stored = np.zeros((HEIGHT, WIDTH), np.uint16)
    stored[row, column] = 3 * 256
    path = folder / "disparity/data/0000000000.png"
    path.parent.mkdir(parents=True)
    cv2.imwrite(str(path), stored)


def test_disparity_becomes_depth_with_nan_where_unknown(tmp_path: Path) -> None:
    folder = write_raw_frame(write_day(tmp_path))
    write_disparity(folder, 4, 5)
    image = dataset(tmp_path)[0].image
    # Depth is f B / d: 50 px x 0.54 m / 3 px = 9 m.
    assert image.depth_m[4, 5] == pytest.approx(9.0)
    assert np.isnan(image.depth_m).sum() == HEIGHT * WIDTH - 1
    assert image.right is None
    assert dataset(tmp_path, depth=False)[0].image.depth_m is None
    write_raw_frame(tmp_path / DAY, camera=0)
    assert dataset(tmp_path, camera=0)[0].image.depth_m is None


def test_a_known_radial_error_is_corrected_in_camera_and_depth(tmp_path: Path) -> None:
    folder = write_raw_frame(write_day(tmp_path))
    write_disparity(folder, 10, 8)
    plain = dataset(tmp_path)[0]
    frame = dataset(tmp_path, radial_error=(0.1, 0.05))[0]
    error = RadialError(0.1, 0.05)
    assert frame.camera == error.corrected(plain.camera)
    assert frame.camera.params[0] == pytest.approx(1.1 * plain.camera.params[0])
    # The return that the calibration puts at (8, 10) is seen further out, and so is its depth.
    there = error.seen(plain.camera, np.array([8.0, 10.0]))
    assert there[0] < 6
    found = np.argwhere(np.isfinite(frame.image.depth_m))[:, ::-1]
    assert len(found)
    assert np.abs(found - there).max() < 1
    assert np.array_equal(frame.camera_from_lidar, plain.camera_from_lidar)
    assert np.array_equal(frame.image.rgb, plain.image.rgb)


def test_frames_without_sweep_or_image_are_left_out_and_say_which_file(tmp_path: Path) -> None:
    day = write_day(tmp_path)
    folder = write_raw_frame(day, frame=0)
    write_image(folder / "image_02/data/0000000001.png")
    write_sweep(folder / "velodyne_points/data/0000000002.bin")
    found = dataset(tmp_path)
    assert found.names == (f"{DAY}/0001/0000000000",)
    with refused(r"velodyne_points/data/0000000001\.bin is missing"):
        found.frame(f"{DAY}/0001/0000000001")
    with refused(r"image_02/data/0000000002\.png is missing"):
        found.frame(f"{DAY}/0001/0000000002")


def test_with_oxts_the_sweep_is_untwisted_about_straight_ahead(tmp_path: Path) -> None:
    folder = write_raw_frame(write_day(tmp_path))
    write_oxts(folder, 0, ve=10.0, wu=0.2)
    still, moved = (dataset(tmp_path, deskew=deskew, image_delay_s=0.0)[0] for deskew in (False, True))
    assert (still.warnings, moved.warnings) == ((STILL,), ())
    # The unit heads east and turns left; the LiDAR stands away from it by IMU_TO_VELO.
    swing = np.cross([0, 0, 0.2], se3.inverse(IMU_TO_VELO)[:3, 3])
    assert np.allclose(moved.twist, [0, 0, 0.2, 10 + swing[0], swing[1], 0])
    assert np.array_equal(still.twist, moved.twist)
    azimuth = np.arctan2(still.cloud.xyz[:, 1], still.cloud.xyz[:, 0])
    assert np.allclose(moved.cloud.time_s, -azimuth / (2 * np.pi) * 0.1)
    shift = np.linalg.norm(moved.cloud.xyz - still.cloud.xyz, axis=1)
    assert shift[np.abs(azimuth) < 2e-3].max() < 1e-3
    left = np.argmin(np.abs(azimuth - np.pi / 2))
    assert (moved.cloud.xyz - still.cloud.xyz)[left, 0] == pytest.approx(-0.25 + 0.2 * 0.025 * 10, abs=0.01)


def test_the_sweep_is_corrected_to_the_moment_of_the_image(tmp_path: Path) -> None:
    """KITTI's cameras look 4 ms after the LiDAR looks straight ahead: at 10 m/s all is 4 cm nearer then."""
    folder = write_raw_frame(write_day(tmp_path))
    write_oxts(folder, 0, ve=10.0)
    at_once, later = (dataset(tmp_path, image_delay_s=delay)[0].cloud for delay in (0.0, None))
    assert np.allclose(later.xyz - at_once.xyz, [-0.04, 0, 0], atol=1e-9)
    assert np.allclose(later.time_s - at_once.time_s, -0.004)
    assert np.allclose(later.as_measured(), at_once.as_measured(), atol=1e-9)
    for stream in ("image_02", "velodyne_points"):
        (folder / stream / "timestamps.txt").write_text(stamps([1.0]))
    assert np.allclose(dataset(tmp_path)[0].cloud.xyz, at_once.xyz)
    (folder / "image_02/timestamps.txt").write_text(stamps([1.01]))
    assert np.allclose(dataset(tmp_path)[0].cloud.xyz, later.xyz)


def test_the_time_of_a_turn_comes_from_the_stamps_of_the_sweep(tmp_path: Path) -> None:
    folder = write_raw_frame(write_day(tmp_path), frame=1)
    velodyne = folder / "velodyne_points"
    (velodyne / "timestamps_start.txt").write_text(stamps([1.0, 1.1]))
    (velodyne / "timestamps_end.txt").write_text(stamps([1.1, 1.204]))
    time_s = dataset(tmp_path, image_delay_s=0.0)[0].cloud.time_s
    assert np.abs(time_s).max() == pytest.approx(0.052, abs=1e-3)
    # A blank line is a sweep that the sensor lost: nominal 0.1 s.
    (velodyne / "timestamps_start.txt").write_text(stamps([1.0]) + "\n")
    assert np.abs(dataset(tmp_path, image_delay_s=0.0)[0].cloud.time_s).max() == pytest.approx(0.05, abs=1e-3)
    (velodyne / "timestamps_end.txt").write_text("noon\n")
    with refused(r"timestamps_end\.txt: a line is not a time"):
        dataset(tmp_path)[0]


def wrong_size(text: str) -> tuple[str, object]:
    lines = "".join(f"{key}: {value}\n" for key, value in {**calib_cam_to_cam(), "S_rect_02": text}.items())
    return "../calib_cam_to_cam.txt", lines


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize(
    ("file", "content", "message"),
    [
        ("image_02/data/0000000000.png", (WIDTH + 2, HEIGHT), "the image size does not fit .*64x32 px; got 66x32 px"),
        ("image_03/data/0000000000.png", (WIDTH, HEIGHT + 1), "the image size does not fit"),
        ("velodyne_points/data/0000000000.bin", "123", "the point cloud is truncated"),
        ("../calib_cam_to_cam.txt", None, "the calibration file is missing"),
        ("../calib_velo_to_cam.txt", None, "the calibration file is missing"),
        ("../calib_velo_to_cam.txt", f"R: {numbers(-np.eye(3))}\nT: 0 0 0\n", "the rotation of R mirrors space"),
        *((*wrong_size(size), "S_rect_02") for size in ("1e300 4", "64.5 32", "0 32", "-64 32", "nan 3", "64")),
        *(
            ("image_02/timestamps.txt", f"{line}\n", "a line is not a time; expected YYYY")
            for line in (
                *("now", "NaT", "9999-01-01 00:00:00", "2011-09-26 13:02:25Z", "2011-02-30 10:00:00"),
                "²011-09-26 10:00:00",
            )
        ),
    ],
)
def test_a_file_that_is_wrong_or_missing_is_named(tmp_path: Path, file: str, content: Any, message: str) -> None:
    folder = write_raw_frame(write_day(tmp_path))
    write_raw_frame(folder.parent, frame=1)
    path = folder / file
    if content is None:
        path.unlink()
    elif isinstance(content, str):
        path.write_text(content)
    else:
        write_image(path, size=content)
    found = dataset(tmp_path)
    with refused(rf"{path.name}: .*{message}"):
        found[0]
    if "/data/" in file:
        assert found[1].name.endswith("1")


def test_an_extracted_drive_has_the_distorted_camera_and_no_rectification(tmp_path: Path) -> None:
    folder = write_raw_frame(write_day(tmp_path), kind="extract")
    write_image(folder / "image_02/data/0000000000.png", size=(WIDTH + 6, HEIGHT + 4))
    (folder / "image_02/timestamps.txt").write_text(stamps([1.01]))
    (folder / "velodyne_points/timestamps.txt").write_text(stamps([1.0]))
    frame = dataset(tmp_path)[0]
    assert frame.camera.model == "FULL_OPENCV"
    assert frame.camera.params == (60, 61, 34, 17, -0.3, 0.1, 0.001, -0.002, -0.01, 0, 0, 0)
    camera2 = se3.make(se3.exp(np.array([0.02, 0, 0, 0, 0, 0]))[:3, :3], [-0.2, 0.01, 0.02])
    assert np.allclose(frame.camera_from_lidar, camera2 @ VELO_TO_CAM, atol=1e-11)


def test_an_extracted_drive_is_paired_by_time(tmp_path: Path) -> None:
    day = write_day(tmp_path)
    for number in range(3):
        folder = write_raw_frame(day, frame=number, kind="extract")
        write_image(folder / f"image_02/data/{number:010d}.png", size=(WIDTH + 6, HEIGHT + 4))
        (folder / f"velodyne_points/data/{number:010d}.bin").unlink()
        np.savetxt(folder / f"velodyne_points/data/{number:010d}.txt", sweep() * (1 + number), fmt="%.4f")
    # The sensor started one turn late: image 1 belongs to sweep 0; image 0 to none; sweep 2 to none.
    (folder / "image_02/timestamps.txt").write_text(stamps([1.01, 1.11, 1.21]))
    (folder / "velodyne_points/timestamps.txt").write_text(stamps([1.1, 1.2, 1.3]))
    for number in range(30):
        write_oxts(folder, number, ve=float(number))
    (folder / "oxts/timestamps.txt").write_text(stamps(1 + np.arange(30) / 100))
    found = dataset(tmp_path, deskew=False)
    assert found.names == (f"{DAY}/0001/0000000001", f"{DAY}/0001/0000000002")
    assert [np.linalg.norm(frame.cloud.xyz[0, :2]) for frame in found] == pytest.approx([10, 20], rel=1e-4)
    assert [frame.twist[3] for frame in found] == pytest.approx([11, 21])
    [(name, reason)] = found.skipped.items()
    assert name == f"{DAY}/0001/0000000000"
    assert "0000000000.png: no sweep within 0.03 s of the image" in reason


def test_a_folder_without_frames_says_what_it_should_hold(tmp_path: Path) -> None:
    with refused(r"no KITTI raw frames; expected DATE/DATE_drive_NNNN_sync .*; got no drive"):
        dataset(tmp_path)
    with refused("nowhere: no such folder; expected the folder of KITTI raw drives"):
        dataset(tmp_path / "nowhere")


def write_drive(root: Path, seconds: list[float], packets_late_s: list[float], speed_m_s: float = 10.0) -> Path:
    """Write a drive straight to the east at constant speed; packet k comes `packets_late_s[k]` after sweep k."""
    day = write_day(root)
    for number, (at_s, late_s) in enumerate(zip(seconds, packets_late_s, strict=True)):
        folder = write_raw_frame(day, frame=number)
        lon = 8.4 + np.degrees((at_s + late_s) * speed_m_s / (6378137.0 * np.cos(np.radians(49.0))))
        write_oxts(folder, number, lat=49.0, lon=lon, alt=112.0, ve=speed_m_s)
    (folder / "velodyne_points/timestamps.txt").write_text(stamps(seconds))
    (folder / "image_02/timestamps.txt").write_text(stamps(np.add(seconds, 0.01)))
    (folder / "oxts/timestamps.txt").write_text(stamps(np.add(seconds, packets_late_s)))
    return folder


def test_a_frame_without_stamps_has_no_time_and_one_without_oxts_or_its_mounting_no_motion(tmp_path: Path) -> None:
    folder = write_raw_frame(write_day(tmp_path))
    frame = dataset(tmp_path)[0]
    assert (frame.twist, frame.warnings) == (None, (f"{STILL}: no oxts data",))
    assert (frame.time_s, frame.lidar_world_from_lidar, frame.camera_world_from_camera) == (None, None, None)
    assert (frame.sequence, frame.targets) == (f"{DAY}/0001", ())
    write_oxts(folder, 0, ve=10.0)
    (tmp_path / DAY / "calib_imu_to_velo.txt").unlink()
    frame = dataset(tmp_path)[0]
    assert (frame.twist, frame.lidar_world_from_lidar) == (None, None)
    assert frame.warnings == (f"{STILL}: no calib_imu_to_velo.txt",)
    assert dataset(tmp_path, deskew=False)[0].warnings == (STILL,)


def test_time_and_pose_are_those_of_the_moment_of_the_image_however_late_the_packet(tmp_path: Path) -> None:
    """At 10 m/s the world begins at the first packet; each image sees the scene 4 ms after its sweep is half done."""
    write_drive(tmp_path, [1.0, 1.1, 1.25], [0.020, 0.003, 0.014])
    frames = list(dataset(tmp_path))
    assert [frame.sequence for frame in frames] == [f"{DAY}/0001"] * 3
    assert [frame.time_s for frame in frames] == pytest.approx([0, 0.1, 0.25], abs=1e-9)
    for delay_s in (0.004, 0.0):
        poses = [frame.lidar_world_from_lidar for frame in dataset(tmp_path, image_delay_s=delay_s)]
        for pose, at_s in zip(poses, (1.0, 1.1, 1.25), strict=True):
            east_m = 10 * (at_s + delay_s - 1.020)
            assert np.allclose(pose, se3.make(translation=[east_m, 0, 0]), atol=1e-6)


def test_without_stamps_the_packet_counts_as_taken_with_the_image(tmp_path: Path) -> None:
    folder = write_drive(tmp_path, [1.0, 1.1], [0.0, 0.0])
    (folder / "oxts/timestamps.txt").unlink()
    assert np.allclose(dataset(tmp_path)[1].lidar_world_from_lidar[:3, 3], [1, 0, 0], atol=1e-6)


def test_a_packet_of_another_moment_and_one_without_a_place_give_no_pose(tmp_path: Path) -> None:
    folder = write_drive(tmp_path, [1.0, 1.1, 1.2], [0.0, 0.0, 0.0])
    (folder / "oxts/timestamps.txt").write_text(stamps([1.0, 1.9, 1.2]))
    write_oxts(folder, 2, ve=10.0)
    first, late, lost = dataset(tmp_path)
    assert first.lidar_world_from_lidar is not None
    assert (late.lidar_world_from_lidar, lost.lidar_world_from_lidar) == (None, None)
    assert late.twist == pytest.approx([0, 0, 0, 10, 0, 0])


def test_a_radial_error_that_no_camera_has_is_refused_at_once() -> None:
    with pytest.raises(ValidationError, match=r"at most 0\.2"):
        KittiRawOptions(radial_error=(0.5, 0.0))


@pytest.mark.parametrize("stem", ["copy", "²", "00000000\uff11", "1e3", "-1", "0x1"])
@pytest.mark.parametrize("kind", ["sync", "extract"])
def test_files_whose_names_are_no_numbers_are_left_out_and_named(tmp_path: Path, stem: str, kind: str) -> None:
    day = write_day(tmp_path)
    folder = write_raw_frame(day, kind=kind)
    for stream in ("image_02", "velodyne_points"):
        (folder / stream / "timestamps.txt").write_text(stamps([1.0]))
    write_image(folder / f"image_02/data/{stem}.png")
    write_sweep(folder / f"velodyne_points/data/{stem}.bin")
    write_image(folder / "image_02/data/._0000000000.png")
    found = dataset(tmp_path)
    assert found.names == (f"{DAY}/0001/0000000000",)
    assert list(found.skipped) == [f"{DAY}/0001/{stem}"]
    with refused(rf"{stem}\.png: the name of the file is not a number"):
        found.frame(f"{DAY}/0001/{stem}")


@pytest.mark.parametrize("kind", ["sync", "extract"])
def test_blank_time_stamps_leave_frames_without_what_they_tell(tmp_path: Path, kind: str) -> None:
    day = write_day(tmp_path)
    for number in range(2):
        folder = write_raw_frame(day, frame=number, kind=kind)
        if kind == "extract":
            write_image(folder / f"image_02/data/{number:010d}.png", size=(WIDTH + 6, HEIGHT + 4))
        write_oxts(folder, number, ve=5.0)
    later = stamps([1.0, 1.1]).splitlines()[1]
    for stream in ("image_02", "velodyne_points", "oxts"):
        (folder / stream / "timestamps.txt").write_text(f"\n{later}\n")
    found = dataset(tmp_path, deskew=False)
    assert found.names == tuple(f"{DAY}/0001/{n:010d}" for n in ((0, 1) if kind == "sync" else (1,)))
    assert found[-1].time_s == 0.0
    assert np.allclose(found[-1].twist[3:], [5, 0, 0], atol=1)
    for stream in ("image_02", "velodyne_points", "oxts"):
        (folder / stream / "timestamps.txt").write_text("\n \n")
    if kind == "extract":
        with refused("no KITTI raw frames"):
            dataset(tmp_path)
    else:
        assert [frame.time_s for frame in dataset(tmp_path, deskew=False)] == [None, None]


@pytest.mark.parametrize("cut", [1, 6, 9, 15, 21])
def test_a_file_of_stamps_that_ends_within_a_time_is_refused(tmp_path: Path, cut: int) -> None:
    path = tmp_path / "timestamps.txt"
    path.write_text(stamps([1.0, 1.1]).rstrip("\n")[:-cut])
    with refused(r"timestamps\.txt: (the file is truncated|a line is not a time)"):
        read_stamps(path)
