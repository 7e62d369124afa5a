"""Edges against the open sky: what stands before nothing has an outline, what only swallows light has none."""

from dataclasses import replace

import numpy as np
import pytest
from p2o import Cloud, Side
from p2o_plugins.cloud.rings import METHOD, RingsOptions

from tests.plugins.cloud.casting import GROUND, HDL32, OS128, Box, Lidar, Pole

POLE = Pole(10.0, 0.0, 0.15)
HOUSE = Box((15.0, 0.0, 1.0), (4.0, 8.0, 6.0))


def edges_of(cloud: Cloud, **options):
    return METHOD.build(RingsOptions(**options))(cloud).edges


def new(cloud: Cloud, **options):
    """Return the edges that there would not be without the open sky."""
    with_sky, without = edges_of(cloud, **options), edges_of(cloud, open_weight=0)
    known = {tuple(row) for row in np.round(without.xyz, 6)}
    return with_sky.select([tuple(row) not in known for row in np.round(with_sky.xyz, 6)])


def only(cloud: Cloud, keep: np.ndarray) -> Cloud:
    return Cloud(cloud.xyz[keep], ring=cloud.ring[keep])


@pytest.mark.parametrize("elevations", [HDL32, OS128])
def test_a_pole_before_the_sky_has_both_outlines_where_they_are(elevations):
    lidar = Lidar(elevations_deg=elevations)
    cloud = lidar.scan(POLE, GROUND)
    edges = new(cloud, open_wider_beams=0)
    high = edges.xyz[:, 2] > 0
    for side, sign in ((Side.LEFT, 1), (Side.RIGHT, -1)):
        azimuth = np.degrees(np.arctan2(*edges.xyz[high & (edges.side == side)].T[1::-1]))
        assert len(azimuth) >= 0.7 * (elevations[elevations > 0.5] < 45).sum() > 3
        assert azimuth == pytest.approx(sign * np.degrees(np.arcsin(0.15 / 10)), abs=0.6 * lidar.step_deg)
    assert (edges_of(cloud, open_weight=0).xyz[:, 2] < 0).all()


def test_the_roof_of_a_house_is_an_upper_edge_half_a_ring_above_its_highest_returns():
    cloud = Lidar(elevations_deg=OS128).scan(HOUSE, GROUND)
    edges = new(cloud, open_wider_beams=0)
    roof = edges.xyz[edges.side == Side.UPPER]
    assert len(roof) > 50
    step_m = 13.0 * np.radians(45 / 127)
    assert roof[:, 2] == pytest.approx(4.0, abs=step_m)


def test_grazing_beams_still_show_the_thing_so_its_outline_is_moved_less():
    cloud = Lidar(elevations_deg=OS128).scan(POLE, GROUND)
    wide, narrow = (new(cloud, open_wider_beams=share) for share in (0.0, 0.5))
    for side, sign in ((Side.LEFT, 1), (Side.RIGHT, -1)):
        apart = wide.xyz[wide.side == side][:, 1].mean() - narrow.xyz[narrow.side == side][:, 1].mean()
        assert sign * apart == pytest.approx(10 * np.radians(0.09), rel=0.1)


def test_a_window_that_swallows_beams_is_no_sky():
    cloud = Lidar(elevations_deg=OS128).scan(HOUSE, GROUND)
    azimuth = np.degrees(np.arctan2(cloud.xyz[:, 1], cloud.xyz[:, 0]))
    window = (np.abs(azimuth) < 4) & (np.abs(cloud.xyz[:, 2]) < 1.0) & (cloud.xyz[:, 0] < 14)
    edges = new(only(cloud, ~window))
    beside = (np.abs(edges.xyz[:, 1]) < 1.5) & (np.abs(edges.xyz[:, 2]) < 1.5)
    assert not beside.any()


def test_a_black_car_before_the_ground_is_no_sky_even_where_nothing_lies_behind_it():
    cloud = Lidar(elevations_deg=OS128).scan(POLE, GROUND)
    black = (cloud.xyz[:, 1] > 0.2) & (cloud.xyz[:, 1] < 3) & (np.hypot(*cloud.xyz[:, :2].T) > 8)
    edges = new(only(cloud, ~(black & (cloud.xyz[:, 0] > 0))))
    # Below the horizon the beams beside the pole would have met the ground.
    left = edges.xyz[edges.side == Side.LEFT]
    assert (np.degrees(np.arctan2(left[:, 2], np.hypot(*left[:, :2].T))) > -2.0).all()


def test_the_rim_of_a_sweep_that_was_cut_is_no_outline():
    cloud = Lidar(elevations_deg=OS128).scan(HOUSE, GROUND)
    ahead = np.abs(np.degrees(np.arctan2(cloud.xyz[:, 1], cloud.xyz[:, 0]))) < 10
    edges = new(only(cloud, ahead))
    assert not np.isin(edges.side, (Side.LEFT, Side.RIGHT)).any()


def test_a_road_that_fades_away_is_no_outline():
    edges = new(replace(Lidar(elevations_deg=OS128), max_range_m=50.0).scan(GROUND, POLE), ground_height_m=0)
    far = np.hypot(*edges.xyz[:, :2].T) > 12
    assert not far.any()


def test_far_things_are_left_out_and_weights_are_as_asked():
    near, far = POLE, Pole(0.0, 70.0, 0.5)
    cloud = Lidar(elevations_deg=OS128).scan(near, far, GROUND)
    edges = new(cloud, open_weight=1)
    assert len(edges)
    assert (np.hypot(*edges.xyz[:, :2].T) < 60).all()
    half = new(cloud, open_weight=0.5)
    np.testing.assert_allclose(half.weight, 0.5 * edges.weight)


def test_a_sensor_that_hardly_looks_up_has_none():
    cloud = Lidar().scan(POLE, GROUND)  # an HDL-64E: 2 deg
    assert len(new(cloud)) == 0
