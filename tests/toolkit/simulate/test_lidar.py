"""The simulated LiDAR: points on surfaces, KITTI's beam table and order, noise along the beam."""

from __future__ import annotations

import numpy as np
import pytest
from p2o import InputError, se3
from p2o.simulate import HDL64E, SpinningLidar, sweep

from tests.toolkit.simulate.walls import FLOOR_Z, WALL_X, walls

POSE = se3.exp(np.array([0.02, -0.03, 0.4, 0.0, 0.0, 0.0]))


def _sweep(noise_m: float = 0.0, seed: int = 0, pose: np.ndarray = POSE):
    return sweep(walls(), HDL64E, pose, np.random.default_rng(seed), noise_m=noise_m)


def test_points_without_noise_lie_on_the_surfaces() -> None:
    x, y, z = se3.apply(POSE, _sweep().xyz).T
    in_box = (abs(x - 6) < 1 + 1e-6) & (abs(y) < 1 + 1e-6) & (abs(z) < 1 + 1e-6)
    to_box = np.where(in_box, np.abs(np.abs(np.stack([x - 6, y, z])) - 1).min(axis=0), np.inf)
    away = np.min([abs(x - WALL_X), abs(z - FLOOR_Z), to_box], axis=0)
    assert away.max() < 1e-9
    assert (to_box < 1e-9).sum() > 1000


def test_every_ring_obeys_kittis_law_with_its_own_origin() -> None:
    cloud = _sweep()
    distance = np.hypot(*cloud.xyz[:, :2].T)
    elevation, height = (np.array(v)[cloud.ring] for v in (HDL64E.elevation_deg, HDL64E.height_m))
    np.testing.assert_allclose(cloud.xyz[:, 2], distance * np.tan(np.radians(elevation)) + height, atol=1e-9)
    assert len(HDL64E.elevation_deg) == 64
    assert (np.diff(HDL64E.elevation_deg) < 0).all()


def test_points_come_as_kitti_writes_them_ring_by_ring_counter_clockwise_from_straight_ahead() -> None:
    cloud = _sweep(pose=np.eye(4))
    azimuth = np.degrees(np.arctan2(cloud.xyz[:, 1], cloud.xyz[:, 0])) % 360
    azimuth[azimuth > 360 - 1e-6] = 0.0
    assert (np.diff(cloud.ring) >= 0).all()
    same = np.diff(cloud.ring) == 0
    assert (np.diff(azimuth)[same] > 0).all()
    assert ((np.diff(azimuth) < -180) == ~same).all()


def test_time_is_zero_straight_ahead_and_rises_with_the_turn() -> None:
    cloud = _sweep(pose=np.eye(4))
    azimuth = np.arctan2(cloud.xyz[:, 1], cloud.xyz[:, 0])
    behind = np.abs(azimuth) > np.pi - 1e-6
    np.testing.assert_allclose(cloud.time_s[~behind], azimuth[~behind] / (2 * np.pi) * 0.1, atol=1e-12)


def test_noise_moves_points_along_their_beams_only_with_the_given_deviation() -> None:
    clean, noisy = _sweep(), _sweep(noise_m=0.02)
    np.testing.assert_array_equal(clean.ring, noisy.ring)
    step = noisy.xyz - clean.xyz
    origin = np.column_stack([np.zeros((len(clean), 2)), np.array(HDL64E.height_m)[clean.ring]])
    beam = clean.xyz - origin
    beam /= np.linalg.norm(beam, axis=1, keepdims=True)
    along = (step * beam).sum(axis=1)
    assert np.abs(step - along[:, None] * beam).max() < 1e-9
    # 60 000 samples: the deviation is known to 0.3 %, the mean to 0.1 mm; five sigma either way.
    assert along.std() == pytest.approx(0.02, rel=0.015)
    assert abs(along.mean()) < 5e-4


def test_intensity_is_reflectance_times_the_cosine_of_incidence() -> None:
    cloud = _sweep(pose=np.eye(4))
    beam = cloud.xyz - np.column_stack([np.zeros((len(cloud), 2)), np.array(HDL64E.height_m)[cloud.ring]])
    beam /= np.linalg.norm(beam, axis=1, keepdims=True)
    on_wall = abs(cloud.xyz[:, 0] - WALL_X) < 1e-6
    assert on_wall.any()
    np.testing.assert_allclose(cloud.intensity[on_wall], 0.5 * beam[on_wall, 0], atol=1e-9)


def test_nothing_is_returned_beyond_the_largest_range() -> None:
    short = SpinningLidar("short", HDL64E.elevation_deg, HDL64E.height_m, columns=500, max_range_m=6.0)
    cloud = sweep(walls(), short, np.eye(4), np.random.default_rng(0))
    origin = np.column_stack([np.zeros((len(cloud), 2)), np.array(HDL64E.height_m)[cloud.ring]])
    assert np.linalg.norm(cloud.xyz - origin, axis=1).max() <= 6.0 + 1e-9


def test_a_lidar_that_meets_nothing_says_so() -> None:
    up = SpinningLidar("looks up", (60.0,), (0.0,), columns=100)
    with pytest.raises(InputError, match=r"looks up: the LiDAR meets nothing"):
        sweep(walls(), up, se3.make(translation=(-50.0, 0.0, 0.0)), np.random.default_rng(0))


def test_beams_without_heights_are_refused() -> None:
    with pytest.raises(InputError, match="one height for each"):
        SpinningLidar("half", (1.0, 2.0), (0.1,), columns=100)
