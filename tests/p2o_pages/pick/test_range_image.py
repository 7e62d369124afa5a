"""Every pixel of a range image is one point of the sweep, in its direction; corners show in bearing angles."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from p2o import Camera, Cloud, Frame, Image, se3
from p2o_pages.pick.range_image import (
    LAYERS,
    RangeImage,
    Sector,
    bearing_angles,
    range_image,
    sector_of,
)
from p2o_testing import stage

WHOLE = Sector()


def sweep(ranges_m: np.ndarray, step_deg: float = 0.5) -> Cloud:
    """Return a sweep of ranges (rings, beams): rings 2 deg apart from +3 deg down, the middle beam straight ahead."""
    rings, beams = ranges_m.shape
    turn = np.radians((beams / 2 - np.arange(beams) - 0.5) * step_deg)  # to the left first
    up = np.radians(3.0 - 2 * np.arange(rings))[:, None]
    ray = np.stack([np.cos(up) * np.cos(turn), np.cos(up) * np.sin(turn), np.sin(up) + 0 * turn], axis=-1)
    ring = np.repeat(np.arange(rings), beams)
    return Cloud((ray * ranges_m[..., None]).reshape(-1, 3), ring=ring, intensity=np.arange(rings * beams) / 100)


@pytest.mark.parametrize("rings", [True, False])
def test_every_pixel_is_the_point_in_its_direction(rings: bool) -> None:
    cloud = stage.frame().cloud
    cloud = cloud if rings else replace(cloud, ring=None)
    found = range_image(cloud, WHOLE)
    row, column = np.nonzero(found.index >= 0)
    number = found.index[row, column]
    assert len(np.unique(number)) == len(number) > 1000, "no point is shown twice"
    x, y, z = cloud.as_measured()[number].T
    step_deg = 360 / found.index.shape[1]
    to_the_right = 180 - np.degrees(np.arctan2(y, x))
    assert (np.abs(to_the_right / step_deg - (column + 0.5)) < 2).all()
    elevation = np.degrees(np.arctan2(z, np.hypot(x, y)))
    mean = np.array([elevation[row == r].mean() for r in np.unique(row)])
    assert (np.diff(mean) < 0).all(), "higher is further up"
    if rings:
        assert all(len(np.unique(cloud.ring[number[row == r]])) == 1 for r in np.unique(row))


def test_rows_are_rings_whatever_their_numbers_and_left_is_left() -> None:
    ranges = np.full((4, 40), 5.0)
    cloud = sweep(ranges)
    shuffled = np.random.default_rng(0).permutation(len(cloud))
    renamed = replace(cloud, ring=np.array([7, 2, 9, 0])[cloud.ring]).select(shuffled)
    found = range_image(renamed, Sector(0, 30))
    assert found.index.shape == (4, 60)
    assert found.stretch == 4  # 2 deg a row, 0.5 deg a column
    filled = found.index[:, 10:50]
    np.testing.assert_array_equal(shuffled[filled], np.arange(160).reshape(4, 40))


def test_only_the_sector_is_shown_also_across_the_back_and_the_nearest_point_of_a_pixel() -> None:
    near = Cloud(np.array([[10.0, 0, 0], [4.0, 0, 0], [7.0, 0, 0]]), ring=np.zeros(3))
    shown = range_image(near, Sector(0, 10)).index
    assert shown[shown >= 0].tolist() == [1]
    empty = range_image(near, Sector(180.0, 20.0))
    assert empty.nearest(0, 0) is None
    assert [empty.drawn(layer).shape for layer in LAYERS] == [(1, 1, 3)] * 3
    cloud = sweep(np.full((2, 720), 5.0))
    found = range_image(cloud, Sector(180.0, 60.0))
    azimuth = np.degrees(np.arctan2(*cloud.xyz[found.index[found.index >= 0], 1::-1].T))
    assert (np.abs(azimuth) >= 149.9).all()
    assert (found.index >= 0).mean() > 0.95


def test_a_corrected_sweep_is_shown_as_measured_and_points_are_the_corrected_ones() -> None:
    cloud = replace(sweep(np.full((2, 60), 5.0)), time_s=np.linspace(0, 0.1, 120))
    corrected = cloud.untwisted(np.array([0, 0, 0.5, 5.0, 0, 0]))
    found = range_image(corrected, Sector(0, 40))
    np.testing.assert_array_equal(found.index, range_image(cloud, Sector(0, 40)).index)
    np.testing.assert_array_equal(found.xyz, corrected.xyz)


def test_the_nearest_filled_pixel_is_found_within_reach() -> None:
    index = np.full((6, 20), -1)
    index[2, 5], index[3, 9] = 4, 7
    found = RangeImage(index, np.ones((8, 3)), None, stretch=3)
    assert found.nearest(5, 2) == (5, 2)
    assert found.nearest(6.4, 2) == (5, 2)
    assert found.nearest(8, 3) == (9, 3)
    assert found.nearest(5, 4) is None, "two rows are six columns"
    assert found.nearest(15, 2) is None


def test_a_corner_shows_in_bearing_angles_and_a_wall_does_not() -> None:
    turn = (50 - np.arange(100) - 0.5) * 0.5
    left = 5.0 / np.cos(np.radians(turn - 30))
    right = 5.0 / np.cos(np.radians(turn + 30))
    angles = bearing_angles(range_image(sweep(np.maximum(left, right)[None]), Sector(0, 50)), apart=1)[0]
    seen = np.degrees(angles[np.isfinite(angles)])
    jump = np.abs(np.diff(seen))
    # A wall turns by the beam's half degree from pixel to pixel; the corner by 60, half of it before and half after
    # the two beams that it lies between.
    assert np.sort(jump)[-2:] == pytest.approx(30, abs=1)
    assert np.sort(jump)[-3] < 1


def test_the_sector_is_about_what_the_camera_sees() -> None:
    """90 deg wide and 15 deg more on either side; where it looks is known to 10 deg only."""
    camera = Camera.pinhole(200.0, 200.0, 199.5, 100.0, 400, 200)
    image = Image(np.zeros((200, 400, 3), np.uint8), camera)
    ahead = se3.make(np.array([[0.0, -1, 0], [0, 0, -1], [1, 0, 0]]))
    turned = ahead @ se3.exp(np.array([0, 0, np.radians(-53.0), 0, 0, 0]))
    cloud = Cloud(np.ones((1, 3)))
    found = sector_of(Frame("f", image, cloud, start=turned))
    assert found.middle_deg == 50.0
    assert found.width_deg == pytest.approx(120, abs=0.5)
    again = sector_of(Frame("f", image, cloud, camera_from_lidar=turned))
    assert again == found
    assert sector_of(Frame("f", image, cloud)) == Sector()
