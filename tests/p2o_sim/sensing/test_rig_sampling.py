"""Random rigs: within their bounds, of all kinds, the same for the same seed."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
from p2o import se3
from p2o_sim.sensing.rig_sampling import (
    DRAWN_LIDARS,
    FIELD_DEG,
    FOCAL_PX,
    SIZES_PX,
    random_rig,
    random_vehicle,
)


@cache
def rigs() -> tuple[dict[str, Any], ...]:
    rng = np.random.default_rng(0)
    return tuple(random_rig(rng) for _ in range(400))


def _axes(rig: dict[str, Any]) -> np.ndarray:
    """Return the camera's right, down and forward (3, 3), columns, in axes right, down and forward of the LiDAR."""
    return se3.exp(np.concatenate([np.radians(rig["mount"][3:]), np.zeros(3)]))[:3, :3].T


def test_every_kind_of_camera_and_lidar_is_drawn() -> None:
    assert {rig["lidar"] for rig in rigs()} == set(DRAWN_LIDARS)
    assert {rig["camera"] for rig in rigs()} == {"pinhole", "opencv-distorted", "fisheye"}
    assert {(rig["width_px"], rig["height_px"]) for rig in rigs()} == set(SIZES_PX)


def test_focal_lengths_are_anywhere_in_their_bounds_and_so_are_fields_of_view() -> None:
    focal = np.array([rig["focal_px"] for rig in rigs()])
    assert focal.min() >= FOCAL_PX[0]
    assert focal.max() <= FOCAL_PX[1]
    assert (focal < 600).mean() > 0.15
    assert (focal > 1400).mean() > 0.1
    for rig in rigs():
        half = 0.5 * rig["width_px"] / rig["focal_px"]
        field = np.degrees(2 * (half if rig["camera"] == "fisheye" else np.arctan(half)))
        assert FIELD_DEG[0] - 0.1 < field < FIELD_DEG[1] + 0.1


def test_cameras_look_anywhere_nearly_level_and_some_lie_on_their_side_or_hang() -> None:
    turning = [rig for rig in rigs() if rig["lidar"] != "mid-40"]
    axes = np.stack([_axes(rig) for rig in turning])
    forward, down = axes[:, :, 2], axes[:, :, 1]
    heading = np.degrees(np.arctan2(forward[:, 0], forward[:, 2]))
    assert np.histogram(heading, bins=6, range=(-180, 180))[0].min() > 0.1 * len(turning)
    assert np.abs(np.degrees(np.arcsin(forward[:, 1]))).max() <= 10.001
    upright = (down[:, 1] > 0.95).mean()
    hanging, aside = (down[:, 1] < -0.95).mean(), (np.abs(down[:, 1]) < 0.3).mean()
    assert 0.7 < upright < 0.9
    assert hanging > 0.04
    assert aside > 0.04


def test_with_a_rosette_the_camera_looks_where_it_does() -> None:
    forward = np.stack([_axes(rig)[:, 2] for rig in rigs() if rig["lidar"] == "mid-40"])
    assert len(forward) > 10
    assert forward[:, 2].min() > np.cos(np.radians(10.0))


def test_rigs_of_vehicles_have_rings_and_upright_cameras_most_of_which_look_ahead() -> None:
    rng = np.random.default_rng(0)
    vehicles = [random_vehicle(rng) for _ in range(300)]
    assert "mid-40" not in {rig["lidar"] for rig in vehicles}
    axes = np.stack([_axes(rig) for rig in vehicles])
    assert (axes[:, 1, 1] > 0.95).mean() > 0.95
    ahead = axes[:, 2, 2] > np.cos(np.radians(10.0))
    assert 0.5 < ahead.mean() < 0.7
    assert (axes[~ahead, 0, 2] > 0.3).any()
    assert (axes[~ahead, 0, 2] < -0.3).any()
