from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from p2o import InputError, UnknownNameError, se3
from p2o_formats.kitti_calibration import (
    KittiCalibration,
    baseline_m,
    camera_offset,
    read_calibration,
    rectified_camera,
    rectified_extrinsic,
)

from tests.p2o_datasets.kitti_files import BASELINE_M, PROJECTIONS, R_RECT, VELO_TO_CAM, numbers, write_lines


def calibration(tmp_path: Path, **lines: object) -> KittiCalibration:
    write_lines(tmp_path / "calib.txt", {"calib_time": "02-Jan-2020 10:00:00", **lines})
    return read_calibration(tmp_path / "calib.txt")


def test_the_exact_extrinsic_reproduces_the_projection_chain() -> None:
    points = np.random.default_rng(0).uniform((3, -10, -2), (40, 10, 3), (500, 3))
    for projection in PROJECTIONS.values():
        chain = projection @ R_RECT @ VELO_TO_CAM
        expected = np.column_stack([points, np.ones(500)]) @ chain.T
        extrinsic = rectified_extrinsic(projection, R_RECT @ VELO_TO_CAM)
        uv = rectified_camera(projection, 64, 32).project(se3.apply(extrinsic, points))
        seen = expected[:, 2] > 1
        assert seen.sum() > 400
        assert np.abs(uv - expected[:, :2] / expected[:, 2:])[seen].max() < 1e-9


def test_the_shortcut_of_pykitti_keeps_only_the_first_entry() -> None:
    exact, short = (camera_offset(PROJECTIONS[2], pykitti_compat=compat) for compat in (False, True))
    assert np.allclose(short, [3.0 / 50, 0, 0])
    # K^-1 p4 by hand: z = 0.003, x = (3 - 31 z) / 50, y = (0.2 - 15.5 z) / 50.
    assert np.allclose(exact, [(3 - 31 * 0.003) / 50, (0.2 - 15.5 * 0.003) / 50, 0.003])


def test_the_baseline_of_a_pair_is_positive_for_left_then_right() -> None:
    assert baseline_m(PROJECTIONS[0], PROJECTIONS[1]) == pytest.approx(BASELINE_M)
    assert baseline_m(PROJECTIONS[2], PROJECTIONS[3]) == pytest.approx(0.54)


def test_a_missing_key_is_named_with_the_nearest_ones(tmp_path: Path) -> None:
    found = calibration(tmp_path, P_rect_02=numbers(PROJECTIONS[2]))
    with pytest.raises(UnknownNameError, match=r"calib\.txt: unknown key 'P_rect_03'; .*did you mean P_rect_02"):
        found.projection("P_rect_03")


@pytest.mark.parametrize("value", ["1 2 three", "", "1 2 3", "nan nan nan nan nan nan nan nan nan"])
def test_lines_that_are_not_the_right_numbers_are_refused_by_name(tmp_path: Path, value: str) -> None:
    with pytest.raises(InputError, match=r"calib\.txt: R does not contain"):
        calibration(tmp_path, R=value).rigid("R")


def test_a_rotation_that_is_not_orthonormal_is_refused_by_name(tmp_path: Path) -> None:
    bent = np.eye(3)
    bent[0, 1] = 0.01
    with pytest.raises(InputError, match=r"calib\.txt: the rotation of R is not orthonormal"):
        calibration(tmp_path, R=numbers(bent)).rigid("R")


def test_a_mirror_image_is_refused_by_name(tmp_path: Path) -> None:
    mirror = np.column_stack([np.diag([1.0, 1.0, -1.0]), np.zeros(3)])
    with pytest.raises(InputError, match=r"calib\.txt: the rotation of Tr mirrors space; expected determinant \+1"):
        calibration(tmp_path, Tr=numbers(mirror)).rigid_12("Tr")


def test_a_matrix_that_is_no_projection_is_refused_by_name(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"calib\.txt: P2 is not the projection of a rectified camera"):
        calibration(tmp_path, P2=numbers(VELO_TO_CAM[:3])).projection("P2")


def test_an_image_that_does_not_hold_the_principal_point_is_refused() -> None:
    with pytest.raises(InputError, match=r"the image size does not fit the camera; .*got 20x32 px"):
        rectified_camera(PROJECTIONS[2], 20, 32)


@pytest.mark.parametrize("text", ["no colons here\n1 2 3\n", "  \n\n"])
def test_a_file_of_another_format_is_refused_by_name(tmp_path: Path, text: str) -> None:
    (tmp_path / "calib.txt").write_text(text)
    with pytest.raises(InputError, match=r"calib\.txt: this is not a KITTI calibration file"):
        read_calibration(tmp_path / "calib.txt")


def test_missing_empty_and_folder_are_refused_by_name(tmp_path: Path) -> None:
    path = tmp_path / "calib.txt"
    with pytest.raises(InputError, match=r"calib\.txt: the calibration file is missing"):
        read_calibration(path)
    path.touch()
    with pytest.raises(InputError, match=r"calib\.txt: the calibration file is empty"):
        read_calibration(path)
    path.unlink()
    path.mkdir()
    with pytest.raises(InputError, match=r"calib\.txt: the calibration file is a folder"):
        read_calibration(path)


def test_a_file_cut_inside_a_line_is_refused_by_name(tmp_path: Path) -> None:
    write_lines(tmp_path / "calib.txt", {"R": numbers(np.eye(3)), "T": "0.1 0.2 0.3"})
    text = (tmp_path / "calib.txt").read_text()
    (tmp_path / "calib.txt").write_text(text[:-5])
    with pytest.raises(InputError, match=r"calib\.txt: T does not contain 3 finite numbers"):
        read_calibration(tmp_path / "calib.txt").rigid("R", "T")


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize(
    ("change", "value"), [((0, 0), 0.0), ((1, 1), -50.0), ((0, 2), 1e300), ((0, 3), 1e9), ((1, 3), float("inf"))]
)
def test_projections_that_no_camera_has_are_refused_by_name(
    tmp_path: Path, change: tuple[int, int], value: float
) -> None:
    projection = PROJECTIONS[2].copy()
    projection[change] = value
    with pytest.raises(InputError, match=r"calib\.txt: P2"):
        calibration(tmp_path, P2=numbers(projection)).projection("P2")


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("scale", [1e3, 1e200, 1e-200])
def test_a_rotation_of_another_size_is_refused_by_name(tmp_path: Path, scale: float) -> None:
    with pytest.raises(InputError, match=r"calib\.txt: the rotation of R is not orthonormal"):
        calibration(tmp_path, R=numbers(scale * np.eye(3))).rigid("R")


LINE = "Tr: " + " ".join(f"{v:.6e}" for v in (0, -1, 0, 0.02, 0, 0, -1, -0.08, 1, 0, 0, -0.27))


@pytest.mark.parametrize("cut", [1, 4, 5, 9])
def test_a_file_that_ends_within_a_number_is_refused(tmp_path: Path, cut: int) -> None:
    path = tmp_path / "calib.txt"
    path.write_text(LINE[:-cut])
    with pytest.raises(InputError, match="the file is truncated"):
        read_calibration(path)


def test_a_missing_line_end_and_a_distant_lidar_are_warnings(tmp_path: Path) -> None:
    path = tmp_path / "calib.txt"
    path.write_text(LINE + "\n")
    whole = read_calibration(path)
    assert whole.remarks(whole.rigid_12("Tr")) == ()
    path.write_text(LINE)
    (remark,) = read_calibration(path).remarks(np.eye(4))
    assert "calib.txt: the last line has no line end" in remark
    far = np.eye(4)
    far[0, 3] = 27.0
    (remark,) = whole.remarks(far)
    assert "camera and LiDAR are 27 m apart" in remark
