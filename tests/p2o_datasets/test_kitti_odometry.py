from __future__ import annotations

from functools import partial
from pathlib import Path

import numpy as np
import pytest
from p2o import UnknownNameError, se3

from .kitti_files import PROJECTIONS, R_RECT, VELO_TO_CAM, numbers, write_image, write_lines, write_sweep
from .opened import opened, refused


def write_frame(root: Path, sequence: str, frame: int, camera: int = 2) -> Path:
    folder = root / "sequences" / sequence
    lines = {f"P{number}": numbers(projection) for number, projection in PROJECTIONS.items()}
    write_lines(folder / "calib.txt", {**lines, "Tr": numbers((R_RECT @ VELO_TO_CAM)[:3])})
    write_sweep(folder / f"velodyne/{frame:06d}.bin")
    write_image(folder / f"image_{camera}/{frame:06d}.png", grey=camera < 2, seed=frame)
    return folder


dataset = partial(opened, "kitti-odometry")


def test_frames_are_named_by_sequence_and_number(tmp_path: Path) -> None:
    for sequence, frame in (("01", 0), ("00", 1), ("00", 0)):
        folder = write_frame(tmp_path, sequence, frame)
    assert dataset(tmp_path).names == dataset(tmp_path / "sequences").names == ("00/000000", "00/000001", "01/000000")
    assert dataset(folder).names == ("00/000000", "00/000001")


@pytest.mark.parametrize("camera", range(4))
def test_every_camera_has_its_exact_extrinsic_and_left_ones_their_right_picture(tmp_path: Path, camera: int) -> None:
    write_frame(tmp_path, "00", 0, camera)
    frame = dataset(tmp_path, camera=camera)[0]
    assert frame.image.right is None
    if camera == 2:
        right = write_image(tmp_path / "sequences/00/image_3/000000.png", seed=4)
        image = dataset(tmp_path)[0].image
        assert np.array_equal(image.right, right)
        assert image.baseline_m == pytest.approx(0.54)
        assert dataset(tmp_path, right=False)[0].image.right is None
    offset = np.linalg.solve(PROJECTIONS[camera][:, :3], PROJECTIONS[camera][:, 3])
    assert np.allclose(frame.camera_from_lidar, se3.make(translation=offset) @ R_RECT @ VELO_TO_CAM, atol=1e-11)
    assert len(frame.warnings) == (1 if camera < 2 else 0)
    # Sweeps are motion-compensated already.
    assert (frame.cloud.ring.max(), frame.cloud.time_s) == (63, None)


def test_missing_sweeps_and_keys_are_named_and_an_empty_folder_says_what_it_should_hold(tmp_path: Path) -> None:
    with refused("no KITTI odometry frames"):
        dataset(tmp_path)
    folder = write_frame(tmp_path, "00", 0)
    write_image(folder / "image_2/000001.png")
    with refused(r"velodyne/000001\.bin is missing"):
        dataset(tmp_path).frame("00/000001")
    write_lines(folder / "calib.txt", {"P2": numbers(PROJECTIONS[2]), "P3": numbers(PROJECTIONS[3])})
    with pytest.raises(UnknownNameError, match=r"00/calib\.txt: unknown key 'Tr'"):
        dataset(tmp_path)[0]


def write_poses(root: Path, poses: list[np.ndarray]) -> None:
    (root / "poses").mkdir(exist_ok=True)
    (root / "poses/00.txt").write_text("".join(numbers(pose[:3]) + "\n" for pose in poses))


def test_frames_tell_sequence_and_time_and_without_files_no_time_and_no_pose(tmp_path: Path) -> None:
    folder = write_frame(tmp_path, "00", 0)
    write_frame(tmp_path, "00", 2)
    first, second = dataset(tmp_path)
    assert (first.sequence, first.time_s, first.camera_world_from_camera) == ("00", None, None)
    (folder / "times.txt").write_text("0.000000e+00\n1.036000e-01\n2.071500e-01\n")
    assert [frame.time_s for frame in dataset(tmp_path)] == [0.0, 0.20715]
    (folder / "times.txt").write_text("0.000000e+00\n")
    assert dataset(tmp_path)[1].time_s is None
    assert second.lidar_world_from_lidar is None


@pytest.mark.parametrize("camera", [0, 2])
def test_poses_are_those_of_the_chosen_camera_in_its_first_frame(tmp_path: Path, camera: int) -> None:
    """All cameras ride on one car: where camera 0 sees a point, the chosen one sees it at its offset."""
    for frame in range(2):
        write_frame(tmp_path, "00", frame, camera)
    first = se3.exp(np.array([0.0, 0.0, 0.0, 5.0, 6.0, 7.0]))
    moved = se3.exp(np.array([0.01, 0.3, -0.02, 0.1, -0.05, 1.2]))
    write_poses(tmp_path, [first, first @ moved])
    offset = np.linalg.solve(PROJECTIONS[camera][:, :3], PROJECTIONS[camera][:, 3])
    start, end = (frame.camera_world_from_camera for frame in dataset(tmp_path, camera=camera))
    assert np.allclose(start, np.eye(4), atol=1e-9)
    point = np.array([[1.0, 2.0, 10.0]])
    in_first = se3.apply(moved, point) + offset
    assert np.allclose(se3.apply(end, point + offset), in_first, atol=1e-9)
    assert all(frame.lidar_world_from_lidar is None for frame in dataset(tmp_path, camera=camera))


def test_files_of_times_and_poses_that_end_too_early_are_told_and_longer_ones_are_not(tmp_path: Path) -> None:
    folder = write_frame(tmp_path, "00", 2)
    (folder / "times.txt").write_text("0.0\n0.1\n")
    write_poses(tmp_path, [np.eye(4)] * 2)
    short = dataset(tmp_path)[0]
    assert [warning.split("/")[-1] for warning in short.warnings if "ends" in warning] == [
        "times.txt: the file ends before line 3, the line of this frame",
        "00.txt: the file ends before line 3, the line of this frame",
    ]
    (folder / "times.txt").write_text("0.0\n0.1\n0.2\n0.3\n")
    write_poses(tmp_path, [np.eye(4)] * 9)
    frame = dataset(tmp_path)[0]
    assert frame.time_s == 0.2
    assert not any("ends" in warning for warning in frame.warnings)


def test_files_that_are_cut_off_are_refused_or_a_warning(tmp_path: Path) -> None:
    folder = write_frame(tmp_path, "00", 0)
    whole = (folder / "calib.txt").read_text()
    (folder / "calib.txt").write_text(whole[:-1])
    (warning,) = dataset(tmp_path)[0].warnings
    assert "calib.txt: the last line has no line end" in warning
    (folder / "calib.txt").write_text(whole)
    (folder / "times.txt").write_text("0.000000e+00\n1.036224e-0")
    assert dataset(tmp_path)[0].time_s == 0
    write_frame(tmp_path, "00", 1)
    with refused(r"times\.txt: the file is truncated"):
        dataset(tmp_path)[1]


@pytest.mark.parametrize(
    ("file", "text", "message"),
    [
        ("poses/00.txt", "1 2 3\n", "line 1 of the file of poses does not contain 12"),
        ("poses/00.txt", "1 " * 12, "the last row|rotation of line 1"),
        *(
            ("sequences/00/times.txt", f"{line}\n", "line 1 of the file of times does not contain 1 finite")
            for line in ("soon", "", "²", "nan", "1e999", "0.1 0.2")
        ),
    ],
)
def test_poses_and_times_that_are_none_are_refused_by_line(tmp_path: Path, file: str, text: str, message: str) -> None:
    write_frame(tmp_path, "00", 0)
    (tmp_path / "poses").mkdir()
    (tmp_path / file).write_text(text)
    with refused(rf"{Path(file).name}: .*({message})"):
        dataset(tmp_path)[0]
