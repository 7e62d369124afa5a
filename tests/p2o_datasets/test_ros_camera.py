from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from p2o import Camera, InputError, se3
from p2o.calibration_files.calibration import Calibration
from p2o_datasets.bags.messages import CameraInfoMessage, Header
from p2o_datasets.ros_camera import camera_of_file, camera_of_info
from p2o_formats.formats import FORMATS

from .opened import refused

K = np.array([[700.0, 0, 320], [0, 710, 240], [0, 0, 1]])
P = np.array([[650.0, 0, 315, 0], [0, 650, 238, 0], [0, 0, 1, 0]])
INFO = CameraInfoMessage(
    Header(0, "camera"), 480, 640, "plumb_bob", np.zeros(5), K, np.eye(3), P, binning=(0, 0), roi=(0, 0, 0, 0)
)
WHERE = Path("drive.bag: /camera_info")


def camera_of(rectified: bool = False, **change: Any) -> Camera:
    return camera_of_info(replace(INFO, **change), WHERE, rectified=rectified).camera


@pytest.mark.parametrize(
    ("model", "d", "expected"),
    [
        ("", [], ("PINHOLE", ())),
        ("plumb_bob", [0.1, 0.2, 0.003, 0.004, 0], ("OPENCV", (0.1, 0.2, 0.003, 0.004))),
        ("equidistant", [], ("OPENCV_FISHEYE", (0, 0, 0, 0))),
        ("Brown-Conrady", [0.1, 0.2, 0.003, 0.004, 0], ("OPENCV", (0.1, 0.2, 0.003, 0.004))),
    ],
)
def test_the_models_of_ros_become_those_of_p2o(model: str, d: list[float], expected: tuple[str, Any]) -> None:
    camera = camera_of(distortion_model=model, D=np.array(d, float))
    assert camera == Camera(expected[0], 640, 480, (700, 710, 320, 240, *expected[1]))


def test_rectified_pictures_have_p_without_distortion_and_are_turned_by_r() -> None:
    turn = se3.exp(np.array([0.02, -0.01, 0.03, 0, 0, 0]))[:3, :3]
    found = camera_of_info(replace(INFO, D=np.full(5, 0.1), R=turn), WHERE, rectified=True)
    assert found.camera == Camera.pinhole(650, 650, 315, 238, 640, 480)
    assert np.allclose(found.rotation, turn)
    assert found.warnings == ()
    assert np.array_equal(camera_of_info(replace(INFO, R=turn), WHERE, rectified=False).rotation, np.eye(3))


@pytest.mark.parametrize(
    ("matrix", "at", "value", "words"),
    [
        ("K", (0, 1), 1.0, "the skew 1 of camera.K is neglected; its largest effect in the image is 0.34 px"),
        ("P", (0, 3), -78.0, "second camera of a stereo pair"),
    ],
)
def test_what_is_neglected_or_assumed_is_stated(matrix: str, at: Any, value: float, words: str) -> None:
    changed = getattr(INFO, matrix).copy()
    changed[at] = value
    (warning,) = camera_of_info(replace(INFO, **{matrix: changed}), WHERE, rectified=matrix == "P").warnings
    assert words in warning


def test_a_part_of_the_picture_that_is_binned_sees_the_same_rays() -> None:
    whole, part = camera_of(), camera_of(roi=(100, 60, 240, 320), binning=(2, 4))
    assert (part.width, part.height) == (160, 60)
    ray = np.array([0.05, -0.02, 1.0])
    u, v = whole.project(ray)
    assert np.allclose(part.project(ray), [(u - 100 + 0.5) / 2 - 0.5, (v - 60 + 0.5) / 4 - 0.5])
    with pytest.raises(InputError, match="ROI and binning do not fit"):
        camera_of(roi=(400, 0, 100, 400))
    with pytest.raises(InputError, match="ROI and binning do not fit"):
        camera_of(binning=(7, 1))


@pytest.mark.parametrize(
    ("change", "rectified", "words"),
    [
        ({"K": np.zeros((3, 3))}, False, r"not calibrated: K is zero.*--set data.camera=FILE"),
        ({"P": np.zeros((3, 4))}, True, "not calibrated: P is zero"),
        ({"distortion_model": "double_sphere", "D": np.ones(2)}, False, "double_sphere.* is unknown"),
        ({"D": np.ones(3)}, False, "does not fit plumb_bob"),
        ({"K": np.full((3, 3), np.nan)}, False, "K is not an intrinsic matrix|finite"),
        ({"width": 0}, False, "width|pixels|ROI"),
        ({"R": -np.eye(3)}, True, "mirrors space"),
    ],
)
def test_a_camera_info_that_is_none_is_refused(change: dict[str, Any], rectified: bool, words: str) -> None:
    with refused(words, "/camera_info"):
        camera_of(rectified, **change)


@pytest.mark.parametrize("indent", ["camera:\n  ", ""])
def test_a_file_tells_the_camera_as_frame_yaml_does(tmp_path: Path, indent: str) -> None:
    step = "\n  " if indent else "\n"
    lines = ["width: 640", "height: 480", "K: [700, 0, 320, 0, 710, 240, 0, 0, 1]"]
    (tmp_path / "camera.yaml").write_text(indent + step.join(lines))
    assert camera_of_file(tmp_path / "camera.yaml").camera == Camera.pinhole(700, 710, 320, 240, 640, 480)
    with pytest.raises(InputError, match="calibration file is missing"):
        camera_of_file(tmp_path / "gone.yaml")


def test_a_camera_may_come_from_a_calibration_file_of_another_tool(tmp_path: Path) -> None:
    path = tmp_path / "camchain.yaml"
    path.write_bytes(FORMATS["kalibr"].written(Calibration(Camera.pinhole(700, 710, 320, 240, 640, 480))))
    assert camera_of_file(Path(f"{path}#cam0")).camera == Camera.pinhole(700, 710, 320, 240, 640, 480)
