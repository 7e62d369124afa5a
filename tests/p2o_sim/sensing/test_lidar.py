"""LiDARs as data: beam tables, spin, times, and the sensors by name."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from p2o import InputError
from p2o_sim.sensing.lidar import Lidar, Rosette
from p2o_sim.sensing.sensors import LIDARS

TURNING = [slug for slug, lidar in LIDARS.items() if isinstance(lidar, Lidar)]


@pytest.mark.parametrize("slug", TURNING)
def test_beams_leave_the_axis_as_their_table_says(slug: str) -> None:
    lidar = LIDARS[slug]
    beams = lidar.beams
    assert len(beams.directions) == len(lidar.elevation_deg) * lidar.columns
    np.testing.assert_allclose(np.linalg.norm(beams.directions, axis=1), 1.0, atol=1e-12)
    slope = beams.directions[:, 2] / np.hypot(*beams.directions[:, :2].T)
    np.testing.assert_allclose(slope, np.tan(np.radians(lidar.elevation_deg))[beams.ring], atol=1e-12)
    np.testing.assert_array_equal(beams.origins[:, 2], np.array(lidar.height_m)[beams.ring])
    assert (np.diff(lidar.elevation_deg) < 0).all()
    ahead = beams.column == 0
    azimuth = np.degrees(np.arctan2(beams.directions[ahead, 1], beams.directions[ahead, 0]))
    np.testing.assert_allclose(azimuth, lidar.azimuth_deg, atol=1e-9)


def test_pulses_come_ring_by_ring_counter_clockwise_and_a_velodyne_takes_them_clockwise() -> None:
    lidar = LIDARS["hdl-64e"]
    beams = lidar.beams
    azimuth = np.arctan2(beams.directions[:, 1], beams.directions[:, 0])
    rising = np.mod(azimuth, 2 * np.pi)
    rising[rising > 2 * np.pi - 1e-9] = 0.0
    same = np.diff(beams.ring) == 0
    assert (np.diff(rising)[same] > 0).all()
    behind = np.abs(azimuth) > np.pi - 0.01
    np.testing.assert_allclose(beams.time_s[~behind], -azimuth[~behind] / (2 * np.pi) * 0.1, atol=1e-12)
    other_way = replace(lidar, clockwise=False).beams
    np.testing.assert_array_equal(other_way.time_s, -beams.time_s)


def test_a_beam_with_an_azimuth_offset_fires_with_its_column() -> None:
    beams = LIDARS["pandar64"].beams
    assert np.ptp(beams.time_s.reshape(64, -1), axis=0).max() == 0.0


def cells(lidar: Rosette, sweep_s: float) -> int:
    """Return the number of cells of half a degree that the pulses of a sweep hit."""
    x, y, z = replace(lidar, sweep_s=sweep_s).beams.directions.T
    angles = np.degrees([np.arctan2(y, x), np.arcsin(z)])
    return len(np.unique(np.round(2 * angles), axis=1).T)


@pytest.mark.parametrize(
    ("slug", "wide_deg", "low_deg", "high_deg"),
    [("mid-40", 38.4, -19.2, 19.2), ("avia", 70.4, -38.6, 38.6), ("mid-360", 360.0, -7.0, 52.0)],
)
def test_a_pattern_that_does_not_repeat_fills_the_field_of_view_of_the_data_sheet(
    slug: str, wide_deg: float, low_deg: float, high_deg: float
) -> None:
    lidar = LIDARS[slug]
    assert isinstance(lidar, Rosette)
    x, y, z = replace(lidar, sweep_s=1.0).beams.directions.T
    azimuth, elevation = np.degrees(np.arctan2(y, x)), np.degrees(np.arcsin(z))
    assert np.ptp(azimuth) == pytest.approx(wide_deg, abs=0.5)
    assert (elevation.min(), elevation.max()) == pytest.approx((low_deg, high_deg), abs=0.3)
    short, longer, long = (cells(lidar, sweep_s) for sweep_s in (0.1, 0.5, 2.0))
    assert short * 1.5 < longer < long


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"height_m": (0.1,)}, "one height for each"),
        ({"azimuth_deg": (0.1,)}, "one azimuth offset for each"),
        ({"elevation_deg": ()}, "one height for each"),
        ({"columns": 0}, "at least one column"),
        ({"min_range_m": 200.0}, "ranges of the LiDAR are empty"),
    ],
)
def test_lidars_that_cannot_be_are_refused(wrong: dict[str, object], message: str) -> None:
    with pytest.raises(InputError, match=message):
        Lidar(**{"name": "half", "elevation_deg": (1.0, 2.0), "columns": 100, **wrong})
