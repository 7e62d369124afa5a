from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from p2o_datasets.velodyne_file import raise_elevation, read_sweep, rings_from_azimuth, times_from_azimuth

from .kitti_files import sweep, write_sweep


def azimuths(points: np.ndarray) -> np.ndarray:
    return np.arctan2(points[:, 1], points[:, 0])


def test_a_full_sweep_has_its_64_rings_from_the_highest_down(tmp_path: Path) -> None:
    write_sweep(tmp_path / "a.bin")
    cloud, warnings = read_sweep(tmp_path / "a.bin", sweep_s=0.1)
    assert np.array_equal(cloud.ring, np.repeat(np.arange(64), 120))
    assert (np.diff([cloud.xyz[cloud.ring == r, 2].mean() for r in range(64)]) < 0).all()
    assert warnings == ()
    assert read_sweep(tmp_path / "a.bin", sweep_s=None)[0].time_s is None


def test_a_sweep_cut_to_a_sector_ahead_keeps_its_rings() -> None:
    points = sweep()
    ahead = np.abs(azimuths(points)) < np.radians(60)
    assert np.array_equal(rings_from_azimuth(azimuths(points[ahead])), np.repeat(np.arange(64), 120)[ahead])


def test_a_sweep_in_another_order_has_no_rings_and_says_so(tmp_path: Path) -> None:
    write_sweep(tmp_path / "a.bin", np.random.default_rng(0).permutation(sweep()))
    cloud, warnings = read_sweep(tmp_path / "a.bin", sweep_s=0.1)
    assert cloud.ring is None
    assert warnings == ("a.bin: rings not recovered: the points are not in the order of the LiDAR",)


def test_the_unit_spins_clockwise_so_left_comes_first_and_ahead_is_time_zero() -> None:
    left, ahead, right = times_from_azimuth(np.radians([90.0, 0.0, -90.0]), 0.1)
    assert (left, ahead, right) == pytest.approx((-0.025, 0.0, 0.025), abs=1e-15)


def test_raising_elevations_keeps_ranges_and_azimuths() -> None:
    xyz = np.random.default_rng(8).uniform(-30, 30, (100, 3))
    raised = raise_elevation(xyz, 0.2)
    elevation = [np.degrees(np.arctan2(p[:, 2], np.hypot(p[:, 0], p[:, 1]))) for p in (xyz, raised)]
    assert np.allclose(elevation[1] - elevation[0], 0.2, atol=1e-10)
    assert np.allclose(np.linalg.norm(raised, axis=1), np.linalg.norm(xyz, axis=1))
    assert np.allclose(azimuths(raised), azimuths(xyz))
