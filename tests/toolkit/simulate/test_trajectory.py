"""Drives: poses follow the velocity, and the LiDAR's own velocity is that of the car."""

from __future__ import annotations

import numpy as np
import pytest
from p2o import se3
from p2o.simulate import drive

TWIST = np.array([0.0, 0.0, 0.08, 12.0, 0.0, 0.0])


def test_without_sway_the_lidar_rides_above_the_arc_of_the_car() -> None:
    moments = drive(TWIST, 5, np.random.default_rng(0), sway=0.0, height_m=2.0)
    radius, last = 12.0 / 0.08, moments[-1]
    angle = 0.08 * 0.4
    assert [m.time_s for m in moments] == pytest.approx([0.0, 0.1, 0.2, 0.3, 0.4])
    expected = [radius * np.sin(angle), radius * (1 - np.cos(angle)), 2.0]
    np.testing.assert_allclose(last.world_from_lidar[:3, 3], expected, atol=1e-9)
    assert se3.angle_deg(last.world_from_lidar) == pytest.approx(np.degrees(angle))


def test_the_twist_is_the_derivative_of_the_pose_in_the_frame_of_the_lidar() -> None:
    step = 1e-4
    here, there = (drive(TWIST, 2, np.random.default_rng(1), period_s=p) for p in (1.0, 1.0 + step))
    # The same sway at both times, so only the time differs.
    moved = se3.inverse(here[1].world_from_lidar) @ there[1].world_from_lidar
    np.testing.assert_allclose(se3.log(moved) / step, here[1].twist, atol=1e-6)


def test_the_car_sways_a_little() -> None:
    still = drive(np.zeros(6), 200, np.random.default_rng(2))
    angles = [se3.angle_deg(m.world_from_lidar) for m in still]
    assert 0.1 < np.median(angles) < 1.0
    assert max(angles) < 2.0
