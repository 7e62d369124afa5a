from __future__ import annotations

import numpy as np
import pytest
from p2o import Camera, Cloud, InputError, se3
from p2o_plugins.data.direction import check_direction

from .kitti_files import VELO_TO_CAM

CAMERA = Camera.pinhole(600, 600, 500, 200, 1000, 400)


def cloud(sector_deg: float) -> Cloud:
    rng = np.random.default_rng(0)
    azimuth = np.radians(rng.uniform(-sector_deg, sector_deg, 4000))
    return Cloud(np.column_stack([20 * np.cos(azimuth), 20 * np.sin(azimuth), rng.uniform(-2, 2, 4000)]))


def test_a_right_pose_passes_without_a_word() -> None:
    for sector in (45, 180):
        assert check_direction(cloud(sector), CAMERA, VELO_TO_CAM) == ()


def test_the_inverse_is_refused_where_the_sweep_looks_ahead_only() -> None:
    with pytest.raises(
        InputError, match=r"frame\.yaml: start looks like lidar_from_camera; expected camera_from_lidar"
    ):
        check_direction(cloud(45), CAMERA, se3.inverse(VELO_TO_CAM), where="frame.yaml")


def test_the_inverse_is_doubted_where_the_sweep_goes_all_around() -> None:
    (warning,) = check_direction(cloud(180), CAMERA, se3.inverse(VELO_TO_CAM), name="truth", where="frame.yaml")
    assert warning.startswith("frame.yaml: truth may be lidar_from_camera: its inverse stands upright")


@pytest.mark.parametrize("yaw_deg", [0, 45, 90, 180])
def test_an_upright_camera_that_looks_elsewhere_is_not_doubted(yaw_deg: float) -> None:
    turned = VELO_TO_CAM @ se3.exp(np.array([0, 0, np.radians(yaw_deg), 0, 0, 0]))
    assert check_direction(cloud(180), CAMERA, turned) == ()


def test_a_pose_that_shows_nothing_either_way_is_worth_a_warning() -> None:
    down = se3.make(np.diag([1.0, -1.0, -1.0]))
    (warning,) = check_direction(cloud(180), CAMERA, down)
    assert warning == "no point of the sweep lies in the image at start"
