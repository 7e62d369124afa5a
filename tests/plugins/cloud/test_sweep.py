"""Rings, their order and their neighbours, against the sensor that made the sweep."""

from __future__ import annotations

import numpy as np
import pytest
from p2o import Cloud
from p2o.geometry.motion import moved
from p2o_plugins.cloud.sweep import across_rings, order_sweep

from tests.plugins.cloud.casting import GROUND, HDL32, HDL64, Box, Lidar


def room(lidar: Lidar) -> Cloud:
    """The inside of a closed room, seen from within: every beam comes back."""
    return lidar.scan(*(Box(c, s) for c, s in WALLS))


WALLS = [
    ((32, 0, 0), (1, 90, 90)),
    ((-29, 0, 0), (1, 90, 90)),
    ((0, 21, 0), (90, 1, 90)),
    ((0, -19, 0), (90, 1, 90)),
    ((0, 0, -12), (90, 90, 1)),
]


def test_rings_come_from_the_highest_to_the_lowest_and_each_turns_once():
    lidar = Lidar(HDL64, step_deg=0.6)
    cloud = room(lidar)
    shuffled = cloud.select(np.random.default_rng(0).permutation(len(cloud)))
    for sweep in (order_sweep(cloud), order_sweep(shuffled), order_sweep(Cloud(cloud.xyz))):
        np.testing.assert_array_equal(np.diff(sweep.start), 600)
        np.testing.assert_allclose(np.degrees(np.arctan(sweep.slope)), HDL64, atol=1e-3)
        assert (np.diff(sweep.azimuth.reshape(64, 600), axis=1) > 0).all()
        np.testing.assert_allclose(sweep.range_m, np.linalg.norm(sweep.xyz(slice(None)), axis=1), rtol=1e-6)


def test_the_height_at_which_the_beams_cross_the_axis_is_found():
    sweep = order_sweep(room(Lidar(HDL64, step_deg=0.6, lift_m=0.2)))
    np.testing.assert_allclose(sweep.offset, 0.2, atol=0.01)
    np.testing.assert_allclose(np.degrees(np.arctan(sweep.slope)), HDL64, atol=0.02)


def test_a_ring_at_one_distance_is_given_no_height():
    """Slope and offset cannot be told apart on a circle; an offset far from zero would be a guess."""
    azimuth = np.radians(np.arange(360))
    xyz = np.column_stack([10 * np.cos(azimuth), 10 * np.sin(azimuth), np.ones(360)])
    sweep = order_sweep(Cloud(xyz, ring=np.zeros(360, int)))
    assert abs(sweep.offset[0]) < 0.05
    assert sweep.slope[0] == pytest.approx(0.1, abs=0.005)


@pytest.mark.parametrize("elevations", [HDL32, HDL64])
@pytest.mark.parametrize("told", [True, False])
def test_correcting_a_sweep_for_motion_keeps_its_rings(elevations: np.ndarray, told: bool):
    """On flat ground a corrected ring lies in a plane, not on its cone; the sweep may say what it was corrected for."""
    cloud = Lidar(elevations, step_deg=0.6).scan(GROUND, Box((32, 0, 0), (1, 90, 90)), Box((0, 15, 0), (90, 1, 12)))
    azimuth = np.arctan2(cloud.xyz[:, 1], cloud.xyz[:, 0])
    time_s, twist = -azimuth / (2 * np.pi) * 0.1, np.array([0.0, 0.0, 0.1, 15.0, 0.0, 0.0])
    corrected = Cloud(moved(twist, time_s, cloud.xyz), ring=cloud.ring, time_s=time_s, twist=twist if told else None)
    measured, sweep = order_sweep(cloud), order_sweep(corrected)
    rings = corrected.ring[sweep.point]
    assert (np.diff(rings[sweep.start[:-1]]) > 0).all()
    gap, wanted = (np.degrees(across_rings(s, 1, 0.3, 3.0).gap[s.start[:-2]]) for s in (sweep, measured))
    np.testing.assert_allclose(gap, wanted, atol=1e-6 if told else 0.35)
    if told:
        np.testing.assert_allclose(sweep.range_m, measured.range_m, rtol=1e-5)
        np.testing.assert_array_equal(sweep.xyz(slice(None)), corrected.xyz[sweep.point])


@pytest.mark.parametrize("step", [1, -1])
def test_neighbours_across_rings_are_those_of_a_search_over_all_pairs(step):
    """Rings of different phase with gaps, so that nearest is not the same column, at the seam as well."""
    rng = np.random.default_rng(3)
    ring = np.repeat(np.arange(6), 300)
    azimuth = rng.uniform(-np.pi, np.pi, len(ring))
    azimuth[ring == 4] = np.abs(azimuth[ring == 4]) * 0.2
    elevation = np.radians(-0.7 * ring)
    xyz = 10 * np.column_stack([np.cos(azimuth), np.sin(azimuth), np.tan(elevation)])
    sweep = order_sweep(Cloud(xyz, ring=ring))
    found = across_rings(sweep, step, 1.0, 3.0)
    apart = np.abs(sweep.azimuth[:, None].astype(float) - sweep.azimuth[None])
    apart = np.minimum(apart, 2 * np.pi - apart)
    apart[sweep.ring[None] != sweep.ring[:, None] + step] = np.inf
    best = apart.min(axis=1)
    np.testing.assert_array_equal(found.known, best <= np.radians(1.0))
    rows = np.flatnonzero(found.known)
    assert 0.3 * len(sweep) < len(rows) < len(sweep)
    np.testing.assert_allclose(apart[rows, found.row[rows]], best[rows], atol=1e-6)
    np.testing.assert_allclose(np.degrees(found.gap[rows]), 0.7, atol=1e-3)
    assert not across_rings(sweep, step, 1.0, 0.5).known.any()


def test_of_returns_of_one_ray_only_the_nearest_stays():
    xyz = np.array([[10.0, 0, 0], [5, 0, 0], [20, 0, 0], [9, 1, 0], [0, 0, 3]])
    sweep = order_sweep(Cloud(xyz, ring=[0, 0, 0, 0, 0]))
    np.testing.assert_allclose(sweep.xyz(slice(None)), [[5, 0, 0], [9, 1, 0]])
