from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from p2o import InputError, se3
from p2o_datasets.kitti_oxts import has_fix, lidar_pose, read_packet, twist_of

from .kitti_files import write_oxts


def twist(tmp_path: Path, lidar_from_imu: np.ndarray, **values: float) -> np.ndarray:
    write_oxts(tmp_path, 0, **values)
    return twist_of(read_packet(tmp_path / "oxts/data/0000000000.txt"), lidar_from_imu)


def test_driving_in_any_heading_is_forward(tmp_path: Path) -> None:
    for yaw in (0.0, 1.0, -2.5):
        moved = twist(tmp_path, np.eye(4), yaw=yaw, ve=8 * np.cos(yaw), vn=8 * np.sin(yaw))
        assert np.allclose(moved, [0, 0, 0, 8, 0, 0], atol=1e-12)


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


@pytest.mark.parametrize("text", ["1 2 3", "a b c", "1 " * 29, "1 " * 31, " ".join(["nan"] * 30)])
def test_a_packet_without_its_numbers_is_refused_by_name(tmp_path: Path, text: str) -> None:
    (tmp_path / "0000000003.txt").write_text(text)
    with pytest.raises(InputError, match=r"0000000003\.txt: the oxts packet"):
        read_packet(tmp_path / "0000000003.txt")


def packet(tmp_path: Path, **values: float) -> np.ndarray:
    write_oxts(tmp_path, 0, **values)
    return read_packet(tmp_path / "oxts/data/0000000000.txt")


@pytest.mark.parametrize("yaw", [0.0, 0.7, -2.0])
def test_a_second_of_arc_to_the_north_is_31_metres_at_any_heading(tmp_path: Path, yaw: float) -> None:
    """On the sphere of the development kit: 6378137 m x pi / 648000 = 30.92 m; to the east times cos(latitude)."""
    place = {"lat": 60.0, "lon": 10.0, "alt": 50.0, "yaw": yaw}
    first = packet(tmp_path, **place)
    second_m = 6378137.0 * np.pi / 648000
    for change, north_m, east_m, up_m in (
        ({"lat": 60 + 1 / 3600}, second_m, 0, 0),
        ({"lon": 10 + 1 / 3600}, 0, second_m / 2, 0),
        ({"alt": 53.0}, 0, 0, 3),
    ):
        pose = lidar_pose(packet(tmp_path, **{**place, **change}), first, np.eye(4))
        forward = np.cos(yaw) * east_m + np.sin(yaw) * north_m
        left = -np.sin(yaw) * east_m + np.cos(yaw) * north_m
        assert np.allclose(pose, se3.make(translation=[forward, left, up_m]), atol=1e-3)


def test_turning_on_the_spot_swings_the_lidar_on_a_circle(tmp_path: Path) -> None:
    """The LiDAR stands 0.8 m ahead of the unit: after a quarter turn to the left it is 0.8 m back and 0.8 m left."""
    ahead = se3.inverse(se3.make(translation=[0.8, 0, 0]))
    place = {"lat": 49.0, "lon": 8.4, "alt": 112.0}
    first, turned = packet(tmp_path, **place, yaw=0.4), packet(tmp_path, **place, yaw=0.4 + np.pi / 2)
    pose = lidar_pose(turned, first, ahead)
    assert np.allclose(pose, se3.make([[0, -1, 0], [1, 0, 0], [0, 0, 1]], [-0.8, 0.8, 0]), atol=1e-8)


def test_roll_pitch_and_yaw_are_those_of_the_development_kit(tmp_path: Path) -> None:
    """Rz(yaw) Ry(pitch) Rx(roll), written out: nose down is a positive pitch, left side up a positive roll."""
    place = {"lat": 49.0, "lon": 8.4, "alt": 112.0}
    roll, pitch, yaw = 0.3, -0.2, 1.1
    pose = lidar_pose(packet(tmp_path, **place, roll=roll, pitch=pitch, yaw=yaw), packet(tmp_path, **place), np.eye(4))
    (cr, cp, cy), (sr, sp, sy) = np.cos([roll, pitch, yaw]), np.sin([roll, pitch, yaw])
    rx = np.array([[1, 0, 0], [0, cr, -sr], [0, sr, cr]])
    ry = np.array([[cp, 0, sp], [0, 1, 0], [-sp, 0, cp]])
    rz = np.array([[cy, -sy, 0], [sy, cy, 0], [0, 0, 1]])
    assert np.allclose(pose[:3, :3], rz @ ry @ rx, atol=1e-9)
    assert np.allclose(pose[:3, 3], 0, atol=1e-8)


def test_a_packet_without_place_has_no_fix(tmp_path: Path) -> None:
    assert not has_fix(packet(tmp_path, vn=3.0))
    assert has_fix(packet(tmp_path, lat=49.0))


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("values", [{"lat": 90.0}, {"lat": -1e300}, {"yaw": 1e9}, {"ve": -1e6}, {"wu": 1e200}])
def test_places_and_speeds_that_are_impossible_are_refused_by_name(tmp_path: Path, values: dict[str, float]) -> None:
    with pytest.raises(InputError, match=r"0000000000\.txt: number \d+ of the oxts packet is implausible"):
        twist(tmp_path, np.eye(4), **values)
