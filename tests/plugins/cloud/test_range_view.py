"""Edges of clouds without rings against outlines that are known in closed form."""

from __future__ import annotations

import numpy as np
import pytest
from p2o import Cloud, Side
from p2o_plugins.cloud import rings
from p2o_plugins.cloud.range_view import METHOD, RangeViewOptions
from p2o_plugins.cloud.rings import RingsOptions
from p2o_plugins.cloud.scattered import scattered
from scipy.spatial import cKDTree

from tests.plugins.cloud.casting import GROUND, Box, Lidar, Plane, Pole

WALL = Box((20, 0, 0), (0.2, 60, 60))
# Floats 8 m ahead: y from -0.6 to 1.4, z from -1.0 to 1.0, front at x = 7.9.
BOARD = Box((8, 0.4, 0), (0.2, 2.0, 2.0))
STEP_DEG = 0.25
SIDES = (Side.LEFT, Side.RIGHT, Side.UPPER, Side.BOTTOM)


def edges_of(cloud: Cloud, **options):
    return METHOD.build(RangeViewOptions(**options))(cloud).edges


def scan(*things, seed=0, origin=(0.0, 0.0, 0.0), count=28_000, half_deg=(22.0, 18.0)) -> Cloud:
    """Rays in no order into a window ahead, one at a random place of each cell of a grid."""
    rng = np.random.default_rng(seed)
    across = int(np.sqrt(count * half_deg[0] / half_deg[1]))
    high = count // across
    u, v = (grid.ravel() for grid in np.meshgrid(np.arange(across), np.arange(high)))
    azimuth = np.radians(half_deg[0] * (2 * (u + rng.random(len(u))) / across - 1))
    elevation = np.radians(half_deg[1] * (2 * (v + rng.random(len(u))) / high - 1))
    cos = np.cos(elevation)
    rays = np.column_stack([cos * np.cos(azimuth), cos * np.sin(azimuth), np.sin(elevation)])
    range_m = np.min([thing.hit(np.array(origin), rays) for thing in things], axis=0)
    seen = range_m < 120
    xyz = (np.array(origin) + rays * range_m[:, None])[seen]
    return Cloud(xyz[rng.permutation(len(xyz))])


def as_rows(edges):
    rows = np.column_stack([edges.side, edges.xyz, edges.weight, edges.sigma_m])
    return rows[np.lexsort(np.round(rows.T, 5))]


def outline_error_m(edges, side) -> np.ndarray:
    """How far edges lie outside the board's outline on their side."""
    xyz = edges.xyz[edges.side == side]
    return {
        Side.LEFT: xyz[:, 1] - 1.4,
        Side.RIGHT: -0.6 - xyz[:, 1],
        Side.UPPER: xyz[:, 2] - 1.0,
        Side.BOTTOM: -1.0 - xyz[:, 2],
    }[side]


def alike(xyz, other) -> float:
    """The smaller share of points of either that the other has to the millimetre.

    Not all: the usual spacing is that of a sample of the returns.
    """
    there, back = cKDTree(other).query(xyz)[0], cKDTree(xyz).query(other)[0]
    return min(np.mean(there < 1e-3), np.mean(back < 1e-3))


SWEEPS = {
    "rings": Lidar(np.arange(15, -15, -0.3), STEP_DEG).scan(BOARD, WALL, ring=False),
    "no order": scan(BOARD, WALL),
}


@pytest.mark.parametrize("name", SWEEPS)
def test_a_board_before_a_wall_has_four_sides_where_its_outline_is(name):
    """Without bias together; only at corners may a letter be that of the other outline."""
    edges = edges_of(SWEEPS[name], ground_height_m=0)
    step_m = 8.1 * np.radians(0.3)
    np.testing.assert_allclose(edges.xyz[:, 0], 7.9, atol=0.03)
    across, up = np.abs(edges.xyz[:, 1] - 0.4) - 1.0, np.abs(edges.xyz[:, 2]) - 1.0
    assert np.abs(np.maximum(across, up)).max() < 2 * step_m
    for side in SIDES:
        error = outline_error_m(edges, side)
        assert len(error) >= 20
        assert np.mean(np.abs(error) < 0.75 * step_m) > 0.75
        assert abs(np.median(error)) < 0.5 * step_m


def test_sigma_is_the_spread_of_the_outline_over_the_gap():
    error, sigma = [], []
    for seed in range(4):
        edges = edges_of(scan(BOARD, WALL, seed=seed), ground_height_m=0)
        # Corners apart, where the next return on a side lies past another one.
        inner = (np.abs(edges.xyz[:, 1] - 0.4) < 0.8) & np.isin(edges.side, (Side.UPPER, Side.BOTTOM))
        chosen = edges.select(inner)
        error.append(np.concatenate([outline_error_m(chosen, side) for side in (Side.UPPER, Side.BOTTOM)]))
        sigma.append(chosen.sigma_m)
    error, sigma = np.concatenate(error), np.concatenate(sigma)
    assert abs(error.mean()) < 0.2 * sigma.mean()
    np.testing.assert_allclose(np.sqrt(np.mean(sigma**2)), error.std(), rtol=0.25)


def test_mirroring_left_and_right_swaps_l_and_r_and_leaves_u_and_b():
    cloud = scan(BOARD, WALL, Pole(10, -2.5, 0.2))
    plain, mirrored = edges_of(cloud), edges_of(Cloud(cloud.xyz * [1, -1, 1]))
    for side in SIDES:
        ours = plain.xyz[plain.side == side] * [1, -1, 1]
        theirs = mirrored.xyz[mirrored.side == side.mirrored]
        assert len(ours) > 20
        assert alike(ours, theirs) > 0.9


def test_turning_the_cloud_about_the_upright_axis_turns_its_edges_across_the_seam_too():
    cloud = scan(BOARD, WALL)
    c, s = np.cos(2.9), np.sin(2.9)
    turn = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
    still, turned = edges_of(cloud), edges_of(Cloud(cloud.xyz @ turn.T))
    for side in SIDES:
        assert alike(still.xyz[still.side == side], turned.xyz[turned.side == side] @ turn) > 0.9


def test_points_given_twice_and_second_returns_change_nothing():
    cloud = scan(BOARD, WALL)
    twice = Cloud(np.concatenate([cloud.xyz, cloud.xyz, 1.5 * cloud.xyz]))
    np.testing.assert_allclose(as_rows(edges_of(twice)), as_rows(edges_of(cloud)), atol=1e-3)


def test_what_a_second_sensor_sees_behind_a_surface_makes_no_edges_within_it():
    """A sparse sensor 3 m to the side sees the wall behind the board; without it only the outline is found."""
    beside = scan(BOARD, WALL, seed=1, origin=(0.0, 3.0, 0.0), count=6_000, half_deg=(35.0, 18.0))
    cloud = scan(BOARD, WALL)
    edges = edges_of(Cloud(np.concatenate([cloud.xyz, beside.xyz])), ground_height_m=0)
    inside = (np.abs(edges.xyz[:, 1] - 0.4) < 0.8) & (np.abs(edges.xyz[:, 2]) < 0.8)
    behind = beside.xyz[beside.xyz[:, 0] > 15]
    covered = (np.abs(behind[:, 1] / behind[:, 0] * 7.9 - 0.4) < 0.8) & (np.abs(behind[:, 2] / behind[:, 0]) < 0.1)
    assert covered.sum() > 20
    assert np.count_nonzero(inside) < 0.02 * len(edges)


@pytest.mark.parametrize("yaw_deg", [0, 40, 60, 75])
def test_a_slanted_wall_alone_has_no_edges(yaw_deg):
    n = np.radians(yaw_deg)
    cloud = scan(Plane((np.cos(n), np.sin(n), 0), 4.0))
    assert len(edges_of(cloud, ground_height_m=0, min_neighbours=0)) == 0


def test_flat_ground_has_next_to_no_edges_even_without_ground_removal():
    """Returns far out on grazing ground lie metres apart; of 10,000 hardly one is taken for an edge."""
    cloud = scan(GROUND)
    assert len(cloud) > 10_000
    assert len(edges_of(cloud, ground_height_m=0)) <= 1e-3 * len(cloud)


def test_clouds_whose_beams_start_elsewhere_are_seen_from_there_when_told():
    """As merged clouds in the frame of a vehicle, whose origin lies on the ground."""
    car = (1.5, 0.0, 2.0)
    cloud = scan(Box((9, 0, 1), (0.2, 2, 2)), Box((20, 0, 0), (0.2, 60, 60)), Plane((0, 0, 1), 0.0), origin=car)
    edges = edges_of(cloud, origin_m=car)
    side = edges.xyz[np.isin(edges.side, (Side.LEFT, Side.RIGHT))]
    assert len(side) > 30
    assert np.mean(np.abs(np.abs(side[:, 1]) - 1.0) < 0.05) > 0.9
    moved = edges_of(Cloud(cloud.xyz - car))
    np.testing.assert_allclose(as_rows(moved)[:, 1:4] + car, as_rows(edges)[:, 1:4], atol=1e-4)


def test_a_cloud_seen_from_the_wrong_place_says_so():
    things = Box((6, 1, 0.6), (2, 2, 1.2)), Box((9, -3, 0.8), (2, 2, 1.6)), WALL, Plane((0, 0, 1), 0.0)
    cloud = scan(*things, origin=(1.5, 0.0, 2.0))

    def remarks(origin):
        found = METHOD.build(RangeViewOptions(origin_m=origin))(cloud).get("cloud-remarks")
        return () if found is None else found.texts

    assert remarks((1.5, 0.0, 2.0)) == ()
    assert [text for text in remarks((0.0, 0.0, -1.0)) if "cloud.origin_m" in text]


@pytest.mark.parametrize(
    "xyz",
    [
        [[10.0, 0, 0]],
        [[10.0, 0, 0], [4, 3, 0]],
        [[10.0, 0, 0], [4, 3, 0], [0, 0, 1]],
        [[0.0, 0, 3], [0, 0, -2]],
        [[r, 0.1 * r, 0.2 * r] for r in range(1, 60)],
        [[5.0, 1, 1]] * 40,
    ],
    ids=["one", "two", "three", "on the axis", "one direction", "one place"],
)
def test_clouds_that_hold_no_surface_have_no_edges(xyz):
    features = METHOD.build(RangeViewOptions())(Cloud(xyz))
    assert len(features.edges) == 0
    assert features.edges.sigma_m.shape == (0,)
    assert len(features.points) <= len(xyz)


def test_edges_of_a_sweep_as_measured_know_when_they_were_seen():
    cloud = scan(BOARD, WALL)
    time_s = -np.arctan2(cloud.xyz[:, 1], cloud.xyz[:, 0]) / (2 * np.pi) * 0.1
    edges = edges_of(Cloud(cloud.xyz, time_s=time_s))
    there = -np.arctan2(edges.xyz[:, 1], edges.xyz[:, 0]) / (2 * np.pi) * 0.1
    np.testing.assert_allclose(edges.time_s, there, atol=2e-4)
    corrected = Cloud(cloud.xyz, time_s=time_s).untwisted(np.array([0, 0, 0, 1.0, 0, 0]))
    assert not edges_of(corrected).time_s.any()


@pytest.mark.parametrize(("rise_deg", "step_deg"), [(2.0, 0.2), (0.4, 0.2), (0.3, 0.9)])
def test_the_spacing_of_rings_is_told_by_the_points(rise_deg, step_deg):
    cloud = Lidar(np.arange(15, -15, -rise_deg), step_deg).scan(WALL, Box((-20, 0, 0), (0.2, 90, 90)), ring=False)
    np.testing.assert_allclose(np.degrees(scattered(cloud, (0, 0, 0)).spacing), [step_deg, rise_deg], rtol=0.05)


def test_rings_falls_back_to_it_where_a_cloud_does_not_tell_its_rings_and_says_so():
    cloud = scan(BOARD, WALL)
    found = rings.METHOD.build(RingsOptions(min_jump_m=0.7))(cloud)
    np.testing.assert_array_equal(as_rows(found.edges), as_rows(edges_of(cloud, min_jump_m=0.7)))
    assert "range-view" in found.get("cloud-remarks").texts[0]
    assert rings.METHOD.build(RingsOptions())(SWEEPS["rings"]).get("cloud-remarks") is None


def test_every_option_changes_the_outcome():
    rng = np.random.default_rng(7)
    boxes = [
        Box((d, y, -1), (1.8, 1.2, 1.4), yaw) for d, y, yaw in ((7, -2, 10), (12, 3, 50), (16, -4, 80), (9, 1, 30))
    ]
    poles = [Pole(10, -3.5, 0.1), Pole(14, 4.5, 0.1)]
    clean = scan(*boxes, *poles, GROUND, Box((40, 0, 3), (1, 200, 12)))
    rough = Cloud(clean.xyz * (1 + 0.01 * rng.standard_normal((len(clean), 1))))
    changes = {
        "min_jump_m": 2.0,
        "ground_height_m": 1.0,
        "min_support": 0.9,
        "min_neighbours": 6,
        "shift_beams": 0.0,
        "origin_m": (0.0, 0.0, 0.5),
    }
    assert set(changes) == set(RangeViewOptions.model_fields)

    def outcome(**options):
        features = METHOD.build(RangeViewOptions(**options))(rough)
        return as_rows(features.edges).tobytes() + features.points.tobytes()

    plain = outcome()
    same = [name for name, value in changes.items() if outcome(**{name: value}) == plain]
    assert not same
