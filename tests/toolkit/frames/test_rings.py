"""Rings that no file numbers: told by the order of the points, by their elevations, or not at all."""

from __future__ import annotations

import numpy as np
import pytest
from p2o import Cloud
from p2o.cli.data import ring_count
from p2o.frames.rings import RingsUnknownError, told_rings


def sweep(rings=16, columns=360, lift_m=0.0):
    """Ranges that differ from beam to beam, ring by ring from the highest."""
    rng = np.random.default_rng(0)
    azimuth = np.tile(np.radians(np.arange(columns) * 360 / columns), rings)
    elevation = np.repeat(np.radians(np.linspace(15, -15, rings)), columns)
    range_m = rng.uniform(3, 60, rings * columns)
    cos = np.cos(elevation)
    rays = np.column_stack([cos * np.cos(azimuth), cos * np.sin(azimuth), np.sin(elevation)])
    return Cloud(range_m[:, None] * rays + [0, 0, lift_m], ring=np.repeat(np.arange(rings), columns))


def shuffled(cloud):
    return cloud.select(np.random.default_rng(1).permutation(len(cloud)))


def test_elevations_tell_ring_count_any_order_and_number_them_upwards():
    cloud = shuffled(sweep())
    x, y, z = cloud.xyz.T.astype(np.float32)
    label, by = told_rings(np.mod(np.arctan2(y, x), np.float32(2 * np.pi)), z / np.hypot(x, y))
    assert by == "the elevations of the points"
    np.testing.assert_array_equal(label, 15 - cloud.ring)


def test_beams_that_do_not_cross_in_the_origin_tell_no_rings_by_elevation():
    x, y, z = shuffled(sweep(lift_m=0.2)).xyz.T.astype(np.float32)
    with pytest.raises(RingsUnknownError, match="range-view"):
        told_rings(np.mod(np.arctan2(y, x), np.float32(2 * np.pi)), z / np.hypot(x, y))


def test_a_check_says_how_many_rings_there_are_and_what_tells_them():
    cloud = sweep()
    assert ring_count(cloud) == "16 rings"
    assert ring_count(Cloud(cloud.xyz)) == "16 rings from the order of the points"
    assert ring_count(Cloud(shuffled(cloud).xyz)) == "16 rings from the elevations of the points"
    assert ring_count(Cloud(shuffled(sweep(lift_m=0.2)).xyz)) == "no rings"
    assert ring_count(Cloud([[1.0, 2, 3]])) == "no rings"


def test_scattered_points_tell_no_rings():
    rng = np.random.default_rng(0)
    assert ring_count(Cloud(rng.normal(size=(5000, 3)))) == "no rings"
