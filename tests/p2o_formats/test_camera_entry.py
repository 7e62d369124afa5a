from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from p2o import InputError
from p2o_formats.camera_entry import COUNTS, distortion_model, read_camera, read_camera_entry

from tests.p2o_datasets.opened import refused

WHERE = Path("frame.yaml")
K = [[700.0, 0, 640.0], [0, 705.0, 360.0], [0, 0, 1]]
SIZE = {"width": 1280, "height": 720}
XYZ = np.random.default_rng(0).uniform([-2, -1, 4], [2, 1, 9], (50, 3))


def opencv_pixels(d: list[float], *, fisheye: bool) -> np.ndarray:
    zero = np.zeros(3)
    if fisheye:
        return cv2.fisheye.projectPoints(XYZ[:, None], zero, zero, np.array(K), np.array(d))[0][:, 0]
    return cv2.projectPoints(XYZ, zero, zero, np.array(K), np.array(d))[0][:, 0]


@pytest.mark.parametrize(
    ("name", "d", "model"),
    [
        ("plumb_bob", [-0.28, 0.08, 0.001, -0.002], "OPENCV"),
        ("plumb_bob", [-0.28, 0.08, 0.001, -0.002, 0.0], "OPENCV"),
        ("plumb_bob", [-0.28, 0.08, 0.001, -0.002, 0.01], "FULL_OPENCV"),
        ("plumb_bob", [0.0] * 5, "PINHOLE"),
        ("plumb_bob", [], "PINHOLE"),
        ("rational_polynomial", [0.4, 0.1, 0.001, -0.002, 0.02, 0.6, 0.2, 0.03], "FULL_OPENCV"),
        ("rational_polynomial", [0.4, 0.1, 0.001, -0.002, 0.02, 0.6, 0.2, 0.03, 0, 0, 0, 0], "FULL_OPENCV"),
        ("equidistant", [0.02, -0.006, 0.001, -0.0002], "OPENCV_FISHEYE"),
        ("equidistant", [0.0] * 4, "OPENCV_FISHEYE"),
    ],
)
def test_cameras_of_ros_give_the_pixels_of_opencv(name: str, d: list[float], model: str) -> None:
    camera = read_camera({**SIZE, "K": K, "distortion_model": name, "D": d}, WHERE)
    assert camera.model == model
    expected = opencv_pixels(d or [0.0] * 4, fisheye=name == "equidistant")
    assert np.allclose(camera.project(XYZ), expected, atol=1e-6)


def test_a_matrix_alone_is_a_pinhole_nested_or_in_a_row() -> None:
    for matrix in (K, [number for row in K for number in row]):
        camera = read_camera({**SIZE, "K": matrix}, WHERE)
        assert (camera.model, camera.params) == ("PINHOLE", (700, 705, 640, 360))


@pytest.mark.parametrize(
    ("entry", "message"),
    [
        (None, "the entry is not a camera; expected model, width, height and params; or width, height, K and"),
        ("pinhole", "the entry is not a camera"),
        ({**SIZE}, "the entry is not a camera"),
        ({**SIZE, "K": K, "params": [1, 1, 1, 1]}, "the entry is not a camera"),
        ({"K": K, "width": 1280}, r"camera\.height is missing"),
        ({**SIZE, "K": K, "D": [0.1, 0, 0, 0]}, r"camera\.distortion_model is missing; expected plumb_bob or"),
        ({**SIZE, "K": K, "D": [0.1], "distortion_model": "plumb_bob"}, r"camera\.D does not fit plumb_bob"),
        ({**SIZE, "K": K, "D": [0.1] * 12, "distortion_model": "rational_polynomial"}, "coefficients beyond k6"),
        ({**SIZE, "K": K, "D": [], "distortion_model": "equidistant"}, "k1 k2 k3 k4; got 0 numbers"),
        ({**SIZE, "K": K, "distortion_model": "fov"}, r"the distortion 'fov' is unknown; expected plumb_bob"),
        ({**SIZE, "K": [700, 700, 640, 360]}, r"camera\.K is not an intrinsic matrix"),
        ({**SIZE, "K": K, "fx": 3}, "unknown key of camera 'fx'; .*a camera has model"),
        ({**SIZE, "K": [[-700, 0, 640], [0, 700, 360], [0, 0, 1]]}, "the focal length is not positive"),
        ({"width": 100_000, "height": 10, "K": K}, "the camera has too many pixels"),
        ({"width": 29_000, "height": 29_000, "K": K}, "the camera has too many pixels; .*200 million in total"),
        ({**SIZE, "params": [1e300, 1, 1, 1]}, "a camera parameter is too large"),
        ({**SIZE, "params": [1e-300, 1, 1, 1]}, "the focal length is too short"),
    ],
)
def test_what_is_no_camera_is_refused_in_one_line(entry: Any, message: str) -> None:
    with refused(rf"frame\.yaml: .*{message}"):
        read_camera(entry, WHERE)


@pytest.mark.parametrize(
    ("model", "names"),
    [
        ("plumb_bob", "plumb_bob Plumb-Bob radtan RADTAN pinhole+radtan brown_conrady Brown-Conrady radial-tangential"),
        ("plumb_bob", "modified_brown_conrady opencv pinhole-opencv PinholeRadtan"),
        ("rational_polynomial", "rational_polynomial rational RationalPolynomial full_opencv pinhole-radtan8"),
        ("equidistant", "equidistant equi pinhole-equi fisheye kannala_brandt kannala_brandt4 KannalaBrandt8 KB4 kb4"),
        ("equidistant", "opencv_fisheye Opencv-Fisheye"),
        ("", "none None NONE no_distortion rectified"),
    ],
)
def test_the_names_of_other_tools_are_those_of_ros(model: str, names: str) -> None:
    assert {distortion_model(name) for name in names.split()} == {model}


@pytest.mark.parametrize(
    "name", ["pinhole", "omni", "double_sphere", "ftheta", "fov", "kannala", "brown conrady 9", "?"]
)
def test_other_distortion_models_are_refused(name: str) -> None:
    with pytest.raises(InputError, match=f"expected {' or '.join(COUNTS)}; .*such as radtan"):
        distortion_model(name)


@pytest.mark.parametrize("name", ["inverse_brown_conrady", "Inverse Brown-Conrady", "INVERSE_PLUMB_BOB"])
def test_the_inverse_of_a_distortion_is_refused_unless_it_is_none(name: str) -> None:
    entry = {**SIZE, "K": K, "distortion_model": name, "D": [-0.05, 0.06, 0.0003, -0.0002, -0.02]}
    with pytest.raises(InputError, match=r"frame\.yaml: .*maps image pixels to rays.*calibrate the camera with OpenCV"):
        read_camera(entry, WHERE)
    assert read_camera({**entry, "D": [0.0] * 5}, WHERE).model == "PINHOLE"


@pytest.mark.parametrize("skew", [-0.2359, 1.0, 1.9])
def test_a_small_skew_is_neglected_and_its_largest_effect_is_stated(skew: float) -> None:
    """The effect in px is the distance to the projection with skew, at the row furthest from the principal point."""
    with_skew = np.array(K)
    with_skew[0, 1] = skew
    camera, (remark,) = read_camera_entry({**SIZE, "K": with_skew.tolist()}, WHERE)
    corners = np.array([[u, v] for u in (0.0, 1279.0) for v in (0.0, 719.0)])
    rays = np.column_stack([corners, np.ones(4)]) @ np.linalg.inv(with_skew).T
    effect_px = np.abs(camera.project(rays) - corners).max()
    assert f"its largest effect in the image is {effect_px:.2g} px" in remark
    assert remark.startswith("frame.yaml: the skew")


@pytest.mark.parametrize("skew", [4.26, -50.0])
def test_a_large_skew_is_refused_with_its_effect(skew: float) -> None:
    matrix = [[1133.1, skew, 960.7], [0, 1128.0, 600.8], [0, 0, 1]]
    effect_px = abs(skew) * 600.8 / 1128.0
    with refused(rf"K has a skew.* by up to {effect_px:.2g} px; .*calibrate the camera without"):
        read_camera({"width": 1920, "height": 1200, "K": matrix}, WHERE)


@pytest.mark.parametrize("skew", [0.0, 2.0])
def test_a_transposed_matrix_of_matlab_is_named(skew: float) -> None:
    matrix = np.array(K).T
    matrix[1, 0] = skew
    for value in (matrix.tolist(), matrix.ravel().tolist()):
        with pytest.raises(InputError, match=r"camera\.K is not an intrinsic matrix; .*transpose it, as MATLAB's"):
            read_camera({**SIZE, "K": value}, WHERE)
