"""The ground under sweeps whose ground is known."""

from __future__ import annotations

import numpy as np
import pytest
from p2o import Cloud, se3
from p2o_plugins.cloud.ground_plane import ground_plane
from p2o_plugins.cloud.sweep import order_sweep

from tests.plugins.cloud.casting import GROUND, HDL64, Box, Lidar, Plane

STREET = [GROUND, Box((0, 12, 3), (90, 1, 12)), Box((0, -9, 3), (90, 1, 12)), Box((9, 2, -1), (4, 1.8, 1.5), 20)]


def plane_of(*things, seed=0, turn=None):
    cloud = Lidar(HDL64, step_deg=0.6).scan(*things)
    if turn is not None:
        cloud = Cloud(cloud.xyz @ turn.T, cloud.ring)
    return ground_plane(order_sweep(cloud), seed)


@pytest.mark.parametrize("seed", range(2))
def test_the_street_between_two_walls_is_found_at_its_height(seed):
    np.testing.assert_allclose(plane_of(*STREET, seed=seed), [0, 0, 1, 1.73], atol=0.02)


def test_a_leaning_street_is_found_with_its_slope():
    n = np.array([0.05, -0.08, 1.0]) / np.linalg.norm([0.05, -0.08, 1.0])
    np.testing.assert_allclose(plane_of(Plane(tuple(n), -1.73), *STREET[1:3]), [*n, 1.73], atol=0.02)


def test_heights_are_positive_at_the_sensor_even_upside_down():
    over = se3.exp(np.array([np.pi, 0, 0, 0, 0, 0]))[:3, :3]
    np.testing.assert_allclose(plane_of(*STREET, turn=over), [0, 0, -1, 1.73], atol=0.02)


def test_walls_alone_are_no_ground():
    assert plane_of(*STREET[1:3]) is None


def test_a_cloud_of_a_few_points_has_no_ground():
    assert ground_plane(order_sweep(Cloud(np.eye(3) * 5 + 1, ring=[0, 1, 2])), 0) is None
