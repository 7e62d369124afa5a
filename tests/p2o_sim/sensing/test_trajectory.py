"""Drives: poses follow the velocity, and the LiDAR's own velocity is that of the car."""

from __future__ import annotations

import numpy as np
import pytest
from p2o import se3
from p2o_sim.sensing.trajectory import LIDAR_HEIGHT_M, SWING_M, drive

TWIST = np.array([0.0, 0.0, 0.08, 12.0, 0.0, 0.0])


def test_without_sway_the_lidar_rides_above_the_arc_of_the_car() -> None:
    moments = drive(TWIST, 5, np.random.default_rng(0), sway=0.0, height_m=2.0)
    radius, last = 12.0 / 0.08, moments[-1]
    angle = 0.08 * 0.4
    assert [m.time_s for m in moments] == pytest.approx([0.0, 0.1, 0.2, 0.3, 0.4])
    expected = [radius * np.sin(angle), radius * (1 - np.cos(angle)), 2.0]
    np.testing.assert_allclose(last.world_from_lidar[:3, 3], expected, atol=1e-9)
    assert se3.angle_deg(last.world_from_lidar) == pytest.approx(np.degrees(angle))


@pytest.mark.parametrize(("swing", "atol"), [({}, 1e-6), ({"swing_deg": 30.0, "tilt_deg": 4.0}, 0.02)])
def test_the_twist_is_the_derivative_of_the_pose_in_the_frame_of_the_lidar(
    swing: dict[str, float], atol: float
) -> None:
    step = 1e-4
    here, there = (drive(TWIST, 2, np.random.default_rng(1), period_s=p, **swing) for p in (1.0, 1.0 + step))
    # The same sway at both times, so only the time differs.
    moved = se3.inverse(here[1].world_from_lidar) @ there[1].world_from_lidar
    np.testing.assert_allclose(se3.log(moved) / step, here[1].twist, atol=atol)


def test_the_car_sways_a_little() -> None:
    still = drive(np.zeros(6), 200, np.random.default_rng(2))
    angles = [se3.angle_deg(m.world_from_lidar) for m in still]
    assert 0.1 < np.median(angles) < 1.0
    assert max(angles) < 2.0


SWING = {"swing_deg": 30.0, "tilt_deg": 4.0}


def test_a_swinging_car_turns_and_tilts_by_as_much_as_is_asked_and_keeps_to_its_road() -> None:
    moments = drive(np.array([0.0, 0, 0, 5.0, 0, 0]), 400, np.random.default_rng(0), sway=0.0, **SWING)
    forward, up = (np.array([m.world_from_lidar[:3, axis] for m in moments]) for axis in (0, 2))
    yaw = np.degrees(np.arctan2(forward[:, 1], forward[:, 0]))
    np.testing.assert_allclose([yaw.min(), yaw.max()], [-30.0, 30.0], atol=0.5)
    lean = np.degrees(np.arccos(up[:, 2]))
    assert 4.0 < lean.max() < 4.0 * np.sqrt(2) + 0.1
    # The car's middle, below the LiDAR, stays on its way.
    middle = np.array([(m.world_from_lidar @ [0, 0, -LIDAR_HEIGHT_M, 1])[:3] for m in moments])
    np.testing.assert_allclose([middle[:, 1].min(), middle[:, 1].max()], [-SWING_M, SWING_M], atol=0.01)
    np.testing.assert_allclose(middle[:, 0], 5.0 * np.array([m.time_s for m in moments]), atol=1e-9)


def test_a_swinging_car_points_where_it_goes() -> None:
    moments = drive(np.array([0.0, 0, 0, 5.0, 0, 0]), 20, np.random.default_rng(1), sway=0.0, swing_deg=30.0)
    for moment in moments:
        assert np.abs(moment.twist[4:]).max() < 1e-3 * moment.twist[3]
