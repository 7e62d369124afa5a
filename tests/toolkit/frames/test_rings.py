"""Rings that no file numbers: told by the order of the points, by their elevations, or not at all."""

from __future__ import annotations

import numpy as np
import pytest
from p2o import Cloud
from p2o.cli.data import ring_count
from p2o.frames.rings import RingsUnknownError, azimuth_gaps, neighbour_gap, rings_of, told_rings


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


def test_elevations_tell_rings_in_any_order_upwards_but_not_of_beams_that_do_not_cross_in_the_origin():
    cloud = shuffled(sweep())
    x, y, z = cloud.xyz.T.astype(np.float32)
    label, by = told_rings(np.mod(np.arctan2(y, x), np.float32(2 * np.pi)), z / np.hypot(x, y))
    assert by == "the elevations of the points"
    np.testing.assert_array_equal(label, 15 - cloud.ring)
    x, y, z = shuffled(sweep(lift_m=0.2)).xyz.T.astype(np.float32)
    with pytest.raises(RingsUnknownError, match="range-view"):
        told_rings(np.mod(np.arctan2(y, x), np.float32(2 * np.pi)), z / np.hypot(x, y))


def test_a_check_says_how_many_rings_there_are_and_what_tells_them():
    cloud = sweep()
    assert ring_count(cloud) == "16 rings"
    assert ring_count(Cloud(shuffled(cloud).xyz)) == "16 rings from the elevations of the points"
    assert ring_count(Cloud(sweep(lift_m=0.2).xyz)) == "16 rings from the order of the points"
    assert ring_count(Cloud(shuffled(sweep(lift_m=0.2)).xyz)) == "no rings"
    assert ring_count(Cloud([[1.0, 2, 3]])) == "no rings"
    assert ring_count(Cloud(np.random.default_rng(0).normal(size=(5000, 3)))) == "no rings"


def spinning(rings, *, noise_deg, seam_deg=0.0, missing_deg=0.0, clockwise=False, upwards=False):
    """Xyz and ring of a scanner in a hall, ring by ring, whose beams start at the azimuths of an Ouster OS1."""
    rng, columns = np.random.default_rng(rings), 720
    ring = np.repeat(np.arange(rings), columns)
    start = np.resize([3.1, 0.9, -1.2, -3.4], rings)[ring] + rng.uniform(-0.5, 0.5, rings)[ring]
    turn = np.tile(np.arange(columns) * 360 / columns, rings)
    azimuth = np.radians(seam_deg + start + (-turn if clockwise else turn) + rng.normal(0, 0.02, len(ring)))
    elevation = np.radians(np.linspace(20, -20, rings)[ring] + rng.normal(0, noise_deg, len(ring)))
    cos = np.cos(elevation)
    rays = np.column_stack([cos * np.cos(azimuth), cos * np.sin(azimuth), np.sin(elevation)])
    range_m = 1 / np.max(np.abs(rays) / [14, 9, 2.5], axis=1)
    lost = rng.uniform(0, missing_deg, (rings, 2))[ring]
    kept = (turn >= lost[:, 0]) & (turn < 360 - lost[:, 1]) & (rng.random(len(ring)) < 0.9)
    order = np.argsort(-ring if upwards else ring, kind="stable")
    order = order[kept[order]]
    return (range_m[:, None] * rays)[order], ring[order]


@pytest.mark.parametrize("rings", [16, 40, 128])
@pytest.mark.parametrize(
    "order",
    [
        {},
        {"seam_deg": 90.0, "clockwise": True},
        {"seam_deg": -50.0, "upwards": True},
        {"seam_deg": 180.0, "missing_deg": 30.0},
        {"missing_deg": 20.0, "clockwise": True, "upwards": True},
    ],
    ids=["ahead", "left-clockwise", "right-upwards", "behind-missing", "missing-clockwise-upwards"],
)
@pytest.mark.parametrize("noise", [0.0, 1 / 7])
def test_rings_are_those_of_the_sensor_where_they_start_at_different_azimuths(rings, order, noise):
    xyz, ring = spinning(rings, noise_deg=noise * 40 / (rings - 1), **order)
    label, by = rings_of(Cloud(xyz))
    assert by == f"the {'order' if noise else 'elevations'} of the points"
    assert len(set(label.tolist())) == rings
    wrong = sum(np.sum(label[ring == k] != np.bincount(label[ring == k]).argmax()) for k in range(rings))
    assert wrong < 0.01 * len(ring)


@pytest.mark.parametrize("rings", [16, 128])
def test_elevations_of_a_sweep_column_by_column_may_be_noisy(rings):
    xyz, ring = spinning(rings, noise_deg=2.5 / rings)
    order = np.argsort(np.arctan2(xyz[:, 1], xyz[:, 0]), kind="stable")
    label, by = rings_of(Cloud(xyz[order]))
    assert by == "the elevations of the points"
    assert np.mean(label == rings - 1 - ring[order]) > 0.999


def test_rings_of_a_sector_are_counted_where_they_start_ahead_or_at_its_side():
    cloud = sweep(64, 720, lift_m=0.2)
    ahead = np.hypot(cloud.xyz[:, 0], cloud.xyz[:, 1]) * np.cos(np.radians(60)) < cloud.xyz[:, 0]
    cut = cloud.select(ahead)
    assert ring_count(Cloud(cut.xyz)) == "64 rings from the order of the points"
    side = np.lexsort((np.arctan2(cut.xyz[:, 1], cut.xyz[:, 0]), cut.ring))
    label, _ = rings_of(Cloud(cut.xyz[side]))
    np.testing.assert_array_equal(label, cut.ring[side])


@pytest.mark.parametrize(
    ("step_deg", "expected_deg"), [(0.1, 0.6), (0.18, 0.6), (0.42, 0.6), (0.703125, 0.984375), (3.0, 4.2)]
)
@pytest.mark.parametrize("damage", ["none", "dropouts", "sector", "two-firings"])
def test_neighbours_are_up_to_1_4_steps_apart_and_at_least_0_6_deg(step_deg, expected_deg, damage):
    azimuth = np.radians(np.tile(np.arange(0, 360 - 1e-9, step_deg), 8))
    ring = np.repeat(np.arange(8), len(azimuth) // 8)
    if damage == "two-firings":
        azimuth, ring = np.concatenate([azimuth, azimuth + np.radians(0.1 * step_deg)]), np.tile(ring, 2)
        expected_deg = max(0.6, 0.9 * expected_deg)
    kept = np.ones(len(azimuth), bool)
    if damage == "dropouts":
        kept = np.random.default_rng(0).random(len(azimuth)) < 0.7
    elif damage == "sector":
        kept = (azimuth < 1.0) | (ring > 3)
    widest = neighbour_gap(azimuth_gaps(azimuth[kept], ring[kept]))
    assert np.degrees(widest) == pytest.approx(expected_deg, rel=0.01)
