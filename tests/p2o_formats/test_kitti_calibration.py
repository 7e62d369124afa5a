from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from p2o import se3
from p2o_formats.kitti_calibration import KittiCalibration, read_calibration, rectified_camera, rectified_extrinsic

from tests.p2o_datasets.kitti_files import PROJECTIONS, R_RECT, VELO_TO_CAM, numbers, write_lines
from tests.p2o_datasets.opened import refused


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


BENT = np.eye(3) + [[0, 0.01, 0], [0, 0, 0], [0, 0, 0]]
MIRROR = np.column_stack([np.diag([1.0, 1.0, -1.0]), np.zeros(3)])


def _changed(row: int, column: int, value: float) -> np.ndarray:
    projection = PROJECTIONS[2].copy()
    projection[row, column] = value
    return projection


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize(
    ("key", "value", "message"),
    [
        *(("R", value, "R does not contain") for value in ("1 2 three", "", "1 2 3", " ".join(["nan"] * 9))),
        *(
            ("R", numbers(matrix), "the rotation of R is not orthonormal")
            for matrix in (BENT, *(scale * np.eye(3) for scale in (1e3, 1e200, 1e-200)))
        ),
        ("Tr", numbers(MIRROR), r"the rotation of Tr mirrors space; expected determinant \+1"),
        ("P2", numbers(VELO_TO_CAM[:3]), "P2 is not the projection of a rectified camera"),
        *(
            ("P2", numbers(_changed(*change)), "P2")
            for change in ((0, 0, 0.0), (1, 1, -50.0), (0, 2, 1e300), (0, 3, 1e9), (1, 3, np.inf))
        ),
    ],
)
def test_lines_with_wrong_numbers_are_refused_by_name(tmp_path: Path, key: str, value: str, message: str) -> None:
    found = calibration(tmp_path, **{key: value})
    with refused(rf"calib\.txt: {message}"):
        {"R": found.rigid, "Tr": found.rigid_12, "P2": found.projection}[key](key)


LINE = "Tr: " + " ".join(f"{v:.6e}" for v in (0, -1, 0, 0.02, 0, 0, -1, -0.08, 1, 0, 0, -0.27))


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (None, "the calibration file is missing"),
        ("", "the calibration file is empty"),
        (Path.mkdir, "the calibration file is a folder"),
        ("no colons here\n1 2 3\n", "this is not a KITTI calibration file"),
        ("  \n\n", "this is not a KITTI calibration file"),
        (f"{LINE}\n{LINE[:-1]}8\n", "Tr is given twice with different values"),
        *((LINE[:-cut], "the file is truncated") for cut in (1, 4, 5, 9)),
    ],
)
def test_a_file_that_is_no_calibration_is_refused_by_name(tmp_path: Path, content: Any, message: str) -> None:
    path = tmp_path / "calib.txt"
    if callable(content):
        content(path)
    elif content is not None:
        path.write_text(content)
    with refused(rf"calib\.txt: {message}"):
        read_calibration(path)


def test_a_missing_line_end_and_a_distant_lidar_are_warnings(tmp_path: Path) -> None:
    path = tmp_path / "calib.txt"
    path.write_text(LINE + "\n")
    whole = read_calibration(path)
    assert whole.remarks(whole.rigid_12("Tr")) == ()
    path.write_text(f"R: {numbers(np.eye(3))}\nT: 0.1 0.2")
    with refused(r"calib\.txt: T does not contain 3 finite numbers"):
        read_calibration(path).rigid("R", "T")
    path.write_text(LINE)
    (remark,) = read_calibration(path).remarks(np.eye(4))
    assert "calib.txt: the last line has no line end" in remark
    far = np.eye(4)
    far[0, 3] = 27.0
    (remark,) = whole.remarks(far)
    assert "camera and LiDAR are 27 m apart" in remark
