"""The LiDAR side against sweeps whose outlines are known in closed form, and against real sweeps."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from p2o import Cloud, CloudRemarks, InputError, Side
from p2o_plugins.cloud.rings import METHOD, RingsOptions
from p2o_plugins.cloud.sweep import order_sweep

from tests.plugins.cloud.casting import GROUND, HDL32, HDL64, OS128, VLP16, Box, Lidar, Plane, Pole

WALL = Box((20, 0, 0), (0.2, 60, 60))
POLE = Pole(10, 0.7, 0.15)
# Floats 8 m ahead, a little to the left, in front of WALL: y from -0.6 to 1.4, z from -1.0 to -0.4, front at x = 7.9.
SIGN = Box((8, 0.4, -0.7), (0.2, 2.0, 0.6))


def edges_of(cloud: Cloud, **options):
    """The edges, those against the open sky only where a test asks for them: walls end somewhere."""
    return METHOD.build(RingsOptions(**{"open_weight": 0, **options}))(cloud).edges


def azimuth_deg(edges, side):
    xyz = edges.xyz[edges.side == side]
    return np.degrees(np.arctan2(xyz[:, 1], xyz[:, 0]))


def as_rows(edges):
    """Rows of side, xyz, weight and sigma in an order that does not depend on how they came."""
    rows = np.column_stack([edges.side, edges.xyz, edges.weight, edges.sigma_m])
    return rows[np.lexsort(np.round(rows.T, 4))]


def turned(xyz, degrees):
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    return xyz @ np.array([[c, s, 0], [-s, c, 0], [0, 0, 1.0]])


def random_scene(seed: int) -> list:
    rng = np.random.default_rng(seed)
    around = rng.uniform(0, 2 * np.pi, 12)
    far = rng.uniform(6, 25, 12)
    boxes = [
        Box((r * np.cos(a), r * np.sin(a), -1), (1.8, 4.2, 1.5), yaw)
        for a, r, yaw in zip(around[:8], far[:8], rng.uniform(0, 180, 8), strict=True)
    ]
    poles = [Pole(r * np.cos(a), r * np.sin(a), 0.15) for a, r in zip(around[8:], far[8:], strict=True)]
    return [*boxes, *poles, Box((40, 0, 3), (1, 200, 12)), Box((-40, 0, 3), (1, 200, 12)), GROUND]


def test_each_direction_lies_on_its_own_side_of_an_object():
    edges = edges_of(Lidar().scan(SIGN, WALL))
    place = {side: edges.xyz[edges.side == side] for side in Side if side != Side.NONE}
    np.testing.assert_allclose(place[Side.LEFT][:, 1], 1.4, atol=0.03)
    np.testing.assert_allclose(place[Side.RIGHT][:, 1], -0.6, atol=0.03)
    np.testing.assert_allclose(place[Side.UPPER][:, 2], -0.4, atol=0.04)
    np.testing.assert_allclose(place[Side.BOTTOM][:, 2], -1.0, atol=0.04)
    assert min(map(len, place.values())) >= 8
    np.testing.assert_allclose(edges.xyz[:, 0], 7.9, atol=0.02)
    cloud = Lidar().scan(SIGN, WALL)
    assert set(map(tuple, edges_of(cloud, shift_beams=0).xyz)) < set(map(tuple, cloud.xyz)), "returns of the sweep"


def test_edges_of_a_sweep_as_measured_know_when_they_were_seen():
    cloud = Lidar().scan(SIGN, WALL)
    assert not edges_of(cloud).time_s.any()
    time_s = -np.arctan2(cloud.xyz[:, 1], cloud.xyz[:, 0]) / (2 * np.pi) * 0.1
    edges = edges_of(replace(cloud, time_s=time_s))
    # Half a beam from the return that was timed.
    there = -np.arctan2(edges.xyz[:, 1], edges.xyz[:, 0]) / (2 * np.pi) * 0.1
    np.testing.assert_allclose(edges.time_s, there, atol=1e-4)
    assert np.ptp(edges.time_s) > 2e-3
    corrected = replace(cloud, time_s=time_s).untwisted(np.array([0, 0, 0, 1.0, 0, 0]))
    assert len(edges_of(corrected)) == len(edges)
    assert not edges_of(corrected).time_s.any()


@pytest.mark.parametrize("damage", ["none", "dropouts", "two-firings"])
@pytest.mark.parametrize("step_deg", [0.5, 2.0])
def test_sweeps_of_few_columns_show_left_and_right_edges(step_deg, damage):
    """A truck 8 m ahead, whatever the step in azimuth: its sides are met within a step."""
    rng = np.random.default_rng(0)
    scene = [Box((8, 0.4, -1.0), (2.0, 5.0, 2.4)), WALL, GROUND]
    cloud = Lidar(HDL64, step_deg).scan(*scene)
    if damage == "dropouts":
        cloud = cloud.select(rng.random(len(cloud)) < 0.75)
    elif damage == "two-firings":
        second = Lidar(HDL64, step_deg, phase=0.1).scan(*scene)
        cloud = Cloud(np.concatenate([cloud.xyz, second.xyz]), ring=np.concatenate([cloud.ring, second.ring]))
    edges = edges_of(cloud)
    for side, y in ((Side.LEFT, 2.9), (Side.RIGHT, -2.1)):
        off = azimuth_deg(edges, side) - np.degrees(np.arctan2(y, 7.0))
        assert np.sum(np.abs(off) < step_deg) >= 5


def test_rings_without_neighbours_are_named():
    cloud = Lidar(HDL32, 0.36).scan(WALL, Box((-20, 0, 0), (0.2, 60, 60)), GROUND)
    assert METHOD.build(RingsOptions())(cloud).get(CloudRemarks.word) is None
    mixed = Cloud(cloud.xyz, ring=np.random.default_rng(0).permutation(len(cloud)) // 3)
    [text] = METHOD.build(RingsOptions(find_sensor=False))(mixed).get(CloudRemarks.word).texts
    assert "% of the returns have a neighbour on their ring (cloud.max_gap_deg)" in text


def test_the_outline_of_a_pole_is_met_within_half_a_beam_and_without_bias():
    step, half_width = 0.18, np.degrees(np.arcsin(0.15 / np.hypot(10, 0.7)))
    centre = np.degrees(np.arctan2(0.7, 10))
    errors = []
    for phase in np.arange(25) / 25:
        edges = edges_of(Lidar(np.linspace(2, -8, 20), step, phase).scan(POLE, WALL))
        left, right = azimuth_deg(edges, Side.LEFT), azimuth_deg(edges, Side.RIGHT)
        assert len(left) == len(right) == 20
        errors.append([(left - centre - half_width).mean(), (right - centre + half_width).mean()])
        assert np.abs(left - centre - half_width).max() < 0.51 * step
        assert np.abs(right - centre + half_width).max() < 0.51 * step
    np.testing.assert_allclose(np.mean(errors, axis=0), 0, atol=0.02 * step)


def test_sigma_is_the_spread_of_the_outline_over_the_gap():
    """Over all phases of the beams the error is uniform in the gap: its standard deviation is gap / sqrt(12)."""
    errors, sigma = [], []
    for phase in np.arange(40) / 40:
        edges = edges_of(Lidar(np.array([-1.0, 0.0, 1.0]), 0.18, phase).scan(POLE, WALL))
        middle = (edges.side == Side.LEFT) & (np.abs(edges.xyz[:, 2]) < 0.05)
        azimuth = np.arctan2(edges.xyz[middle, 1], edges.xyz[middle, 0])
        errors.append((azimuth[0] - np.arctan2(0.7, 10) - np.arcsin(0.15 / np.hypot(10, 0.7))) * np.hypot(10, 0.7))
        sigma.append(edges.sigma_m[middle][0])
    np.testing.assert_allclose(np.mean(sigma), np.std(errors), rtol=0.05)


@pytest.mark.parametrize("lift_m", [0.0, 0.2], ids=["beams from the origin", "beams from 0.2 m above it"])
def test_the_upper_outline_has_no_bias_wherever_the_beams_cross_the_axis(lift_m):
    """On the HDL-64E a ring's elevation seen from the origin changes with range by more than the gap of two rings."""
    errors = []
    for phase in np.arange(20) / 20:
        low = Box((5, 0, -1.2), (0.002, 3.0, 1.2))  # a thin board, top at -0.6
        lidar = Lidar(np.arange(4, -22, -0.5) + 0.5 * phase, step_deg=0.4, lift_m=lift_m)
        edges = edges_of(lidar.scan(low, WALL))
        upper = edges.xyz[edges.side == Side.UPPER]
        assert len(upper) > 50
        errors.append(np.mean(upper[:, 2] + 0.6))
    assert abs(np.mean(errors)) < 0.05 * 5 * np.radians(0.5)


@pytest.mark.parametrize("yaw_deg", [0, 40, 75, 88])
@pytest.mark.parametrize("elevations", [VLP16, HDL64], ids=["16", "64"])
def test_a_slanted_wall_alone_has_no_edges(yaw_deg, elevations):
    n = np.radians(yaw_deg)
    cloud = Lidar(elevations).scan(Plane((np.cos(n), np.sin(n), 0), 4.0))
    assert len(edges_of(cloud, ground_height_m=0, min_neighbours=0)) == 0


@pytest.mark.parametrize("elevations", [VLP16, HDL32, HDL64, OS128], ids=["16", "32", "64", "128"])
def test_flat_ground_has_no_edges_even_without_ground_removal(elevations):
    assert len(edges_of(Lidar(elevations).scan(GROUND), ground_height_m=0, min_neighbours=0)) == 0


def test_edges_near_the_ground_are_dropped_and_the_height_says_how_near():
    cloud = Lidar().scan(Box((9, 0, -1.43), (1, 3, 0.6)), GROUND, WALL)
    assert edges_of(cloud, ground_height_m=0.25).xyz[:, 2].min() > -1.73 + 0.2
    assert edges_of(cloud, ground_height_m=0).xyz[:, 2].min() < -1.6
    assert len(edges_of(cloud, ground_height_m=1.0)) == 0


@pytest.mark.parametrize("degrees", [37.0, 180.0])
def test_a_turned_sweep_has_the_same_edges_turned(degrees):
    cloud = Lidar(step_deg=0.36, phase=0.3).scan(*random_scene(1))
    moved = edges_of(Cloud(turned(cloud.xyz, degrees), cloud.ring))
    still = edges_of(cloud)
    assert len(still) > 300
    back = np.column_stack([moved.side, turned(moved.xyz, -degrees), moved.weight, moved.sigma_m])
    back = back[np.lexsort(np.round(back.T, 4))]
    np.testing.assert_allclose(back[:, 0], as_rows(still)[:, 0])
    np.testing.assert_allclose(back, as_rows(still), atol=2e-3)


def test_with_a_ring_per_point_the_order_of_points_and_the_numbering_of_rings_do_not_matter():
    cloud = Lidar(step_deg=0.36).scan(*random_scene(2))
    wanted = as_rows(edges_of(cloud))
    shuffled = cloud.select(np.random.default_rng(0).permutation(len(cloud)))
    np.testing.assert_allclose(as_rows(edges_of(shuffled)), wanted, atol=1e-6)
    scattered = np.random.default_rng(1).permutation(64) * 1000 - 7
    for ring in (63 - cloud.ring, cloud.ring + 500, scattered[cloud.ring]):
        np.testing.assert_allclose(as_rows(edges_of(Cloud(cloud.xyz, ring))), wanted, atol=1e-6)


@pytest.mark.parametrize(("degrees", "clockwise"), [(0.0, True), (123.0, False), (180.0, True)])
def test_points_in_file_order_need_no_ring(degrees, clockwise):
    """Whichever way the sensor turns and wherever it starts a ring, and if it is cut to the view ahead."""
    cloud = Lidar(step_deg=0.36, phase=0.4).scan(*random_scene(3))
    mirror = [1, -1 if clockwise else 1, 1]
    cloud = Cloud(turned(cloud.xyz * mirror, degrees), cloud.ring)
    wanted = as_rows(edges_of(cloud))
    np.testing.assert_allclose(as_rows(edges_of(Cloud(cloud.xyz))), wanted, atol=1e-6)
    ahead = cloud.select(np.abs(cloud.xyz[:, 1]) < cloud.xyz[:, 0])
    np.testing.assert_allclose(as_rows(edges_of(Cloud(ahead.xyz))), as_rows(edges_of(ahead)), atol=1e-6)


def test_mirroring_left_and_right_swaps_l_and_r_and_leaves_u_and_b():
    cloud = Lidar(step_deg=0.36, phase=0.5).scan(*random_scene(4))
    plain, mirrored = edges_of(cloud), edges_of(Cloud(cloud.xyz * [1, -1, 1], cloud.ring))
    for side in (Side.LEFT, Side.RIGHT):
        ours = plain.xyz[plain.side == side] * [1, -1, 1]
        theirs = mirrored.xyz[mirrored.side == side.mirrored]
        assert len(ours) > 100
        np.testing.assert_allclose(np.sort(ours, axis=0), np.sort(theirs, axis=0), atol=1e-3)
    for side in (Side.UPPER, Side.BOTTOM):
        assert np.count_nonzero(plain.side == side) == np.count_nonzero(mirrored.side == side)


def test_a_missing_return_makes_no_edge_but_one_lost_beam_does_not_hide_one():
    cloud = Lidar().scan(POLE, WALL)
    azimuth = np.degrees(np.arctan2(cloud.xyz[:, 1], cloud.xyz[:, 0]))
    edge = np.degrees(np.arctan2(0.7, 10)) + np.degrees(np.arcsin(0.15 / np.hypot(10, 0.7)))
    gone = (azimuth > edge) & (azimuth < edge + 0.7)
    assert np.unique(edges_of(cloud.select(~gone)).side).tolist() == [Side.RIGHT]
    gone = (azimuth > edge) & (azimuth < edge + 0.18)
    assert np.unique(edges_of(cloud.select(~gone)).side).tolist() == [Side.LEFT, Side.RIGHT]


def test_points_firing_by_firing_without_rings_have_the_edges_of_their_rings_where_beams_start_beside_the_origin():
    """Velodyne packets hold column after column: azimuth hardly ever falls, but each ring has its own cone."""
    cloud = Lidar(step_deg=0.72, lift_m=0.2).scan(*random_scene(5))
    azimuth = np.arctan2(cloud.xyz[:, 1], cloud.xyz[:, 0]) % (2 * np.pi)
    by_column = np.lexsort((cloud.ring, np.round(azimuth, 6)))
    own = as_rows(edges_of(Cloud(cloud.xyz[by_column]), without_rings="refuse"))
    np.testing.assert_array_equal(own, as_rows(edges_of(cloud)))


def test_points_that_do_not_tell_their_rings_are_refused_with_the_way_out():
    cloud = Lidar(step_deg=0.72, lift_m=0.2).scan(*random_scene(5), ring=False)
    shuffled = cloud.select(np.random.default_rng(0).permutation(len(cloud)))
    for unknown in (shuffled, Cloud([[1.0, 2, 3]])):
        with pytest.raises(InputError, match=r"rings of the cloud are not observable.*ring.*Cloud\.ring.*range-view"):
            edges_of(unknown, without_rings="refuse")


@pytest.mark.parametrize("xyz", [[[10.0, 0, 0]], [[10.0, 0, 0], [4, 3, 0], [0, 0, 1]], [[0.0, 0, 3], [0, 0, -2]]])
def test_a_handful_of_points_has_no_edges(xyz):
    features = METHOD.build(RingsOptions())(Cloud(xyz, ring=np.arange(len(xyz))))
    assert (len(features.edges), features.edges.sigma_m.shape) == (0, (0,))


def test_double_points_and_second_returns_change_nothing():
    """Of two returns of one ray the nearer is the surface; the farther one is not beside it but behind it."""
    cloud = Lidar(step_deg=0.36).scan(*random_scene(6))
    wanted = as_rows(edges_of(cloud))
    for behind in (1.0, 1.5):
        twice = Cloud(np.concatenate([cloud.xyz, cloud.xyz * behind]), np.concatenate([cloud.ring, cloud.ring]))
        np.testing.assert_allclose(as_rows(edges_of(twice)), wanted, atol=1e-5)


def test_leaves_weigh_less_than_a_wall_edge_and_go_first():
    """A ball of scattered returns before a wall has edges everywhere; few of them go on like an outline."""
    cloud = Lidar().scan(SIGN, WALL)
    xyz, azimuth = cloud.xyz.copy(), np.degrees(np.arctan2(cloud.xyz[:, 1], cloud.xyz[:, 0]))
    bush = (azimuth > -40) & (azimuth < -25)
    leaf = bush & (np.random.default_rng(0).random(len(xyz)) < 0.5)
    xyz[leaf] *= np.random.default_rng(1).uniform(0.3, 0.7, (leaf.sum(), 1))
    edges = edges_of(Cloud(xyz, cloud.ring), min_support=0)
    in_bush = edges.xyz[:, 1] < -1
    assert in_bush.sum() > 500
    assert edges.weight[~in_bush].mean() > 0.9
    assert edges.weight[in_bush].mean() < 0.4
    kept = edges_of(Cloud(xyz, cloud.ring), min_support=0.65)
    assert np.count_nonzero(kept.xyz[:, 1] < -1) < 0.05 * in_bush.sum()
    assert np.count_nonzero(kept.xyz[:, 1] > -1) > 0.9 * np.count_nonzero(~in_bush)


def test_an_outline_that_few_rings_meet_is_kept_where_rings_are_far_apart():
    """A car's length of box, 25 m away: three rings of an HDL-32E meet its sides."""
    box, wall = Box((25, 0, -1), (2, 4, 1.5)), Box((60, 0, 0), (1, 120, 30))
    edges = edges_of(Lidar(HDL32, step_deg=0.17).scan(GROUND, box, wall))
    for side, azimuth in ((Side.LEFT, np.degrees(np.arctan2(2, 24))), (Side.RIGHT, -np.degrees(np.arctan2(2, 24)))):
        near = np.abs(azimuth_deg(edges, side) - azimuth) < 0.2
        assert near.sum() >= 2


def test_every_option_changes_the_outcome():
    """On one rich sweep, so that no option is only there to be read."""
    rng = np.random.default_rng(7)
    cloud = Lidar(step_deg=0.36).scan(*random_scene(7))
    rough = Cloud(cloud.xyz * (1 + 0.01 * rng.standard_normal((len(cloud), 1))), cloud.ring)
    rough = rough.select(rng.random(len(rough)) < 0.9)
    changes = {
        "min_jump_m": 2.0,
        "max_gap_deg": 1.5,
        "ground_height_m": 1.0,
        "min_support": 0.9,
        "min_neighbours": 6,
        "shift_beams": 0.0,
    }
    # The others are of clouds that this one is not: without rings, in another frame than its sensor's, under the sky.
    others = {"without_rings", "find_sensor", "open_weight", "open_wider_beams"}
    assert set(changes) | others == set(RingsOptions.model_fields)

    def outcome(**options):
        features = METHOD.build(RingsOptions(**options))(rough)
        return as_rows(features.edges).tobytes() + features.points.tobytes()

    plain = outcome()
    same = [name for name, value in changes.items() if outcome(**{name: value}) == plain]
    assert not same


@pytest.mark.real
def test_real_sweeps_have_64_rings_and_edges_in_all_four_directions(kitti_raw):
    files = sorted(kitti_raw.glob("*/*/velodyne_points/data/*.bin"))
    whole = [path for path in files if path.stat().st_size >= 16 * 100_000]
    assert len(whole) >= 24
    for path in whole[:: len(whole) // 8]:
        cloud = Cloud(np.fromfile(path, np.float32).reshape(-1, 4)[:, :3])
        sweep = order_sweep(cloud)
        assert len(sweep.slope) == 64, path
        # The upper beams cross the axis 0.20 m, the lower ones 0.12 m above the origin, half a degree apart at most.
        assert sweep.offset[0] == pytest.approx(0.209, abs=0.01), path
        elevation = np.degrees(np.arctan(sweep.slope))
        assert elevation[0] == pytest.approx(1.94, abs=0.05), path
        assert elevation[-1] == pytest.approx(-25.0, abs=0.3), path
        features = METHOD.build(RingsOptions())(cloud)
        assert (np.bincount(features.edges.side, minlength=4) >= 100).all(), path
        assert 20_000 < len(features.points) <= 40_000
