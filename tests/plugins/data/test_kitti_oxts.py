from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from p2o import InputError, se3
from p2o_plugins.data.kitti_oxts import has_fix, lidar_pose, read_packet, twist_of

from .kitti_files import write_oxts


def twist(tmp_path: Path, lidar_from_imu: np.ndarray, **values: float) -> np.ndarray:
    write_oxts(tmp_path, 0, **values)
    return twist_of(read_packet(tmp_path / "oxts/data/0000000000.txt"), lidar_from_imu)


def test_driving_in_any_heading_is_forward(tmp_path: Path) -> None:
    for yaw in (0.0, 1.0, -2.5):
        moved = twist(tmp_path, np.eye(4), yaw=yaw, ve=8 * np.cos(yaw), vn=8 * np.sin(yaw))
        assert np.allclose(moved, [0, 0, 0, 8, 0, 0], atol=1e-12)


def test_north_is_left_of_a_car_that_heads_east(tmp_path: Path) -> None:
    assert np.allclose(twist(tmp_path, np.eye(4), vn=2.0), [0, 0, 0, 0, 2, 0])


def test_turning_swings_the_lidar_around_the_unit(tmp_path: Path) -> None:
    # The LiDAR stands 0.8 m ahead of the unit; a left turn of 0.5 rad/s carries it to the left at 0.4 m/s.
    lidar_from_imu = se3.inverse(se3.make(translation=[0.8, 0, 0]))
    assert np.allclose(twist(tmp_path, lidar_from_imu, wu=0.5), [0, 0, 0.5, 0, 0.4, 0])


def test_a_twist_moves_every_point_of_the_body_alike(tmp_path: Path) -> None:
    lidar_from_imu = se3.exp(np.array([0.1, -0.2, 0.3, 0.8, -0.3, 0.9]))
    values = {"ve": 5.0, "vn": -2.0, "vu": 0.2, "wf": 0.1, "wl": -0.05, "wu": 0.4}
    of_imu, of_lidar = (twist(tmp_path, t, **values) for t in (np.eye(4), lidar_from_imu))
    step = lidar_from_imu @ se3.exp(0.05 * of_imu) @ se3.inverse(lidar_from_imu)
    assert np.allclose(se3.exp(0.05 * of_lidar), step, atol=1e-12)


def test_a_car_that_noses_down_and_drives_level_climbs_in_its_own_frame(tmp_path: Path) -> None:
    # Pitch is positive nose down: the level motion then points up in the unit's frame.
    moved = twist(tmp_path, np.eye(4), pitch=0.1, ve=10.0)
    assert np.allclose(moved[3:], [10 * np.cos(0.1), 0, 10 * np.sin(0.1)])


@pytest.mark.parametrize("text", ["1 2 3", "a b c", " ".join(["nan"] * 30)])
def test_a_packet_without_its_numbers_is_refused_by_name(tmp_path: Path, text: str) -> None:
    (tmp_path / "0000000003.txt").write_text(text)
    with pytest.raises(InputError, match=r"0000000003\.txt: the oxts packet"):
        read_packet(tmp_path / "0000000003.txt")
