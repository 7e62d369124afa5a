from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from p2o import InputError, UnknownNameError, se3
from p2o.geometry.pose_text import read_extrinsic, read_pose
from scipy.spatial.transform import Rotation

from tests.p2o_datasets.kitti_files import VELO_TO_CAM

WHERE = Path("frame.yaml")
PLACE = VELO_TO_CAM[:3, 3].tolist()
QUATERNION = Rotation.from_matrix(VELO_TO_CAM[:3, :3]).as_quat()


@pytest.mark.parametrize(
    "pose",
    [
        VELO_TO_CAM.tolist(),
        VELO_TO_CAM[:3].tolist(),
        VELO_TO_CAM.ravel().tolist(),
        VELO_TO_CAM[:3].ravel().tolist(),
        {"rotation_xyzw": QUATERNION.tolist(), "translation_m": PLACE},
        {"rotation_xyzw": (-QUATERNION).tolist(), "translation_m": PLACE},
        {"rotation": VELO_TO_CAM[:3, :3].tolist(), "translation_m": PLACE},
        {"camera_from_lidar": VELO_TO_CAM[:3].tolist()},
        {"lidar_from_camera": se3.inverse(VELO_TO_CAM).tolist()},
        {"lidar_from_camera": {"rotation_xyzw": (QUATERNION * (-1, -1, -1, 1)).tolist(),
                               "translation_m": se3.inverse(VELO_TO_CAM)[:3, 3].tolist()}},
    ],
)  # fmt: skip
def test_one_pose_is_told_in_many_forms(pose: Any) -> None:
    found, warnings = read_extrinsic("start", pose, WHERE)
    assert np.allclose(found, VELO_TO_CAM, atol=1e-12)
    assert warnings == ()


def test_roll_pitch_yaw_are_about_fixed_axes_as_in_ros() -> None:
    """Roll 90 deg takes y to z; then a yaw of 90 deg about the axis that stayed leaves z and takes x to y."""
    pose, _ = read_pose("start", {"rpy_deg": [90, 0, 90], "translation_m": [1, 2, 3]}, WHERE)
    assert np.allclose(pose, [[0, 0, 1, 1], [1, 0, 0, 2], [0, 1, 0, 3], [0, 0, 0, 1]], atol=1e-12)
    radians, _ = read_pose("start", {"rpy_rad": [np.pi / 2, 0, np.pi / 2], "translation_m": [1, 2, 3]}, WHERE)
    assert np.allclose(radians, pose, atol=1e-12)
    # Numbers that YAML takes for texts are numbers.
    pose = yaml.safe_load("{rpy_rad: [1e-3, 0, 0], translation_m: [0, 2e0, 0]}")
    assert pose["rpy_rad"][0] == "1e-3"
    assert np.allclose(read_pose("start", pose, WHERE)[0][:3, 3], [0, 2, 0])


def test_a_quaternion_or_matrix_that_is_rounded_becomes_a_rotation_with_a_word_where_it_is_far_off() -> None:
    for factor, warned in ((1.0009, 0), (1.005, 1), (0.992, 1)):
        given = {"rotation_xyzw": (factor * QUATERNION).tolist(), "translation_m": PLACE}
        pose, warnings = read_pose("start", given, WHERE)
        assert np.allclose(pose, VELO_TO_CAM, atol=1e-12)
        assert warnings == (f"frame.yaml: the quaternion of start has length {factor:.4f} and is normalised",) * warned
    fine, warnings = read_pose("start", VELO_TO_CAM.round(4).tolist(), WHERE)
    assert np.allclose(fine, VELO_TO_CAM, atol=1e-4)
    assert warnings == ()
    coarse, (warning,) = read_pose("start", VELO_TO_CAM.round(2).tolist(), WHERE)
    assert np.allclose(coarse[:3, :3].T @ coarse[:3, :3], np.eye(3), atol=1e-12)
    assert warning.startswith("frame.yaml: the rotation of start is orthonormal to 0.0")


ROWS = "3 or 4 rows of 4 numbers, or translation_m with one of rotation_xyzw, rotation"


@pytest.mark.parametrize(
    ("pose", "message"),
    [
        (np.eye(3).tolist(), f"start is not a pose; expected {ROWS}"),
        ([[1, 0], [0, 1, 0]], "start is not a pose"),
        ("north", "start is not a pose; .*lidar_from_camera, to be inverted; got north"),
        *((value, "start is not a pose") for value in (7, [], {}, [[True, 0, 0, 0]] * 3, [[1, 0, 0, {}]] * 3)),
        ([[float("nan"), 0, 0, 0]] * 3, "start is not a pose"),
        ([10**400] * 12, "start is not a pose"),
        ({"translation_m": [0, 0, 0]}, "start is not a pose"),
        ({"rpy_deg": [0, 0, 0]}, "start is not a pose"),
        ({"rpy_deg": [0, 0, 0], "rpy_rad": [0, 0, 0], "translation_m": [0, 0, 0]}, "start is not a pose"),
        ({"rpy_deg": [0, 0], "translation_m": [0, 0, 0]}, r"start\.rpy_deg is not valid; expected 3 finite numbers"),
        ({"rpy_deg": [0, 0, 0], "translation_m": 5}, r"start\.translation_m is not valid"),
        ({"rpy_rad": [-91, 0, 90], "translation_m": [0, 0, 0]}, "an angle of start is more than a full turn.*rpy_deg"),
        ({"rotation": [1, 0, 0], "translation_m": [0, 0, 0]}, r"start\.rotation is not valid; expected 3x3"),
        ({"lidar_from_camera": 3}, rf"start\.lidar_from_camera is not a pose; expected {ROWS}"),
        ({"rotation_xyzw": [0, 0, 0, 1e300], "translation_m": [0, 0, 0]}, "the quaternion of start is not a rotation"),
        ({"rotation_xyzw": [0, 0, 0, 0], "translation_m": [0, 0, 0]}, "the quaternion of start is not a rotation"),
        ((1e200 * np.eye(4)[:3]).tolist(), "the rotation of start is not orthonormal"),
        ([[1, 0, 0, 1e12], [0, 1, 0, 0], [0, 0, 1, 0]], "the translation of start is too long"),
        ([[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 2]], "the last row of start is wrong"),
        ([[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, -1, 0]], "the rotation of start mirrors space"),
        ([[1, 0.02, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0]], "the rotation of start is not orthonormal"),
    ],
)
@pytest.mark.filterwarnings("error")
def test_what_is_no_pose_is_refused_in_one_line_that_shows_the_forms(pose: Any, message: str) -> None:
    with pytest.raises(InputError, match=rf"frame\.yaml: {message}") as caught:
        read_extrinsic("start", pose, WHERE)
    assert "\n" not in str(caught.value)


def test_a_misspelt_key_is_an_unknown_name() -> None:
    with pytest.raises(UnknownNameError, match=r"unknown key of start 'rotation_xyz'.*did you mean rotation_xyzw"):
        read_pose("start", {"rotation_xyz": [0, 0, 0, 1], "translation_m": [0, 0, 0]}, WHERE)
    # Poses in a world have no direction to turn round.
    with pytest.raises(UnknownNameError, match="lidar_from_camera"):
        read_pose("lidar_world_from_lidar", {"lidar_from_camera": np.eye(4).tolist()}, WHERE)
