"""A LiDAR made from depth measures the surfaces that the camera sees, from where it stands, and invents none."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from p2o import Camera, InputError, se3
from p2o_sim.sensing.depth_lidar import depth_sweep
from p2o_sim.sensing.sensors import LIDARS

from tests.p2o_sim.flat_scene import BOARD, BOARD_M, CAMERA, ROAD_M, WALL_M, depth_m

AXES = np.array([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]])
QUIET = replace(LIDARS["hdl-64e"], range_noise_m=0.0, angle_noise_deg=0.0)
IN_CAMERA = replace(QUIET, height_m=())


def mounted(*place: float) -> np.ndarray:
    """Return camera_from_lidar of a camera that stands at `place` in the LiDAR frame and looks along x."""
    return se3.make(AXES, -AXES @ np.array(place))


def swept(pose: np.ndarray, lidar=QUIET, *, sky: bool = False, seed: int = 0):
    """Return the sweep and its points in the camera frame."""
    cloud = depth_sweep(depth_m(sky=sky), CAMERA, pose, lidar, np.random.default_rng(seed))
    return cloud, se3.apply(pose, cloud.xyz)


def surface_of(xyz: np.ndarray) -> np.ndarray:
    """Return 0 for points on the road, 1 on the wall, 2 on the board, -1 for others."""
    off = np.abs(np.stack([xyz[:, 1] - ROAD_M, xyz[:, 2] - WALL_M, xyz[:, 2] - BOARD_M]))
    return np.where(off.min(axis=0) < 2e-3, off.argmin(axis=0), -1)


@pytest.mark.parametrize("place", [(0.0, 0.0, 0.0), (0.27, 0.06, -0.08), (-0.4, -0.3, 0.2)])
def test_points_lie_on_the_true_surfaces_wherever_the_lidar_is_mounted(place) -> None:
    _, xyz = swept(mounted(*place))
    kind = surface_of(xyz)
    # What is off lies at the wall's foot, where four pixels show two planes.
    assert (kind >= 0).mean() > 0.97
    assert {0, 1, 2} <= set(kind.tolist())
    crease = (np.abs(xyz[:, 2] - WALL_M) < 2.5) & (np.abs(xyz[:, 1] - ROAD_M) < 0.2)
    assert crease[kind < 0].all()


def test_a_lidar_in_the_camera_sees_the_board_where_its_pixels_are_and_half_a_pixel_around() -> None:
    _, xyz = swept(mounted(0.0, 0.0, 0.0), IN_CAMERA)
    board = xyz[surface_of(xyz) == 2]
    left, right, top, bottom = BOARD
    pixel = BOARD_M / 300.0
    column = pixel + np.radians(360 / QUIET.columns) * BOARD_M
    assert left - 1.01 * pixel < board[:, 0].min() < left + column
    assert right - column < board[:, 0].max() < right + 1.01 * pixel
    assert board[:, 1].min() > top - 1.01 * pixel
    assert board[:, 1].max() < bottom + 1.01 * pixel


def test_what_the_camera_cannot_see_is_not_measured() -> None:
    """From 1 m to the left one looks behind the board; the wall there is hidden from the camera."""
    pose = mounted(0.0, -1.0, 0.0)
    cloud, xyz = swept(pose, replace(QUIET, height_m=()))
    wall = xyz[(surface_of(xyz) == 1) & (xyz[:, 1] > BOARD[2] * 2.9) & (xyz[:, 1] < 0.5)]
    seen = WALL_M / BOARD_M * np.array(BOARD[:2])
    assert ((wall[:, 0] < seen[0] + 0.2) | (wall[:, 0] > seen[1] - 0.2)).all()
    # The LiDAR, at x = -1, has a shadow from x = -4 on: what it would meet from -6 to -4 stays a gap.
    azimuth = np.sort(np.arctan2(cloud.xyz[:, 1], cloud.xyz[:, 0])[cloud.ring == 10])
    gaps = np.diff(azimuth)
    assert gaps.max() > 3 * np.median(gaps)


def test_the_sky_what_is_too_far_and_unknown_depth_give_nothing() -> None:
    cloud, xyz = swept(mounted(0.27, 0.06, -0.08), sky=True)
    assert set(np.unique(surface_of(xyz))) <= {0, 2}
    assert np.linalg.norm(cloud.xyz, axis=1).max() <= QUIET.max_range_m
    pose, depth = mounted(0.0, 0.0, 0.0), depth_m()
    cloud, _ = swept(pose, replace(QUIET, max_range_m=20.0))
    assert np.linalg.norm(cloud.xyz, axis=1).max() <= 20.5
    depth[:, 250:] = np.nan
    cloud = depth_sweep(depth, CAMERA, pose, IN_CAMERA, np.random.default_rng(0))
    assert CAMERA.project(se3.apply(pose, cloud.xyz))[:, 0].max() <= 250


def test_every_point_lies_on_its_own_beam() -> None:
    cloud, _ = swept(mounted(0.27, 0.06, -0.08))
    flat = np.hypot(cloud.xyz[:, 0], cloud.xyz[:, 1])
    elevation, height = (np.array(v)[cloud.ring] for v in (QUIET.elevation_deg, QUIET.height_m))
    np.testing.assert_allclose(cloud.xyz[:, 2], flat * np.tan(np.radians(elevation)) + height, atol=1e-9)
    azimuth = np.mod(np.arctan2(cloud.xyz[:, 1], cloud.xyz[:, 0]), 2 * np.pi)
    np.testing.assert_allclose(np.degrees(azimuth), cloud.column * 360 / QUIET.columns, atol=1e-9)
    same = cloud.ring[1:] == cloud.ring[:-1]
    assert (np.diff(cloud.ring) >= 0).all()
    assert (np.diff(cloud.column)[same] > 0).all()


def test_range_noise_has_the_stated_size_and_moves_points_along_their_beams() -> None:
    pose = mounted(0.0, 0.0, 0.0)
    exact, _ = swept(pose, IN_CAMERA)
    noisy, _ = swept(pose, replace(IN_CAMERA, range_noise_m=0.04))
    np.testing.assert_array_equal(exact.column, noisy.column)
    moved = noisy.xyz - exact.xyz
    along = np.einsum("ni,ni->n", moved, exact.xyz / np.linalg.norm(exact.xyz, axis=1, keepdims=True))
    assert np.std(along) == pytest.approx(0.04, rel=0.05)
    assert np.mean(along) == pytest.approx(0.0, abs=0.002)
    np.testing.assert_allclose(np.linalg.norm(moved, axis=1), np.abs(along), atol=1e-9)


def test_angular_noise_changes_the_range_as_the_surface_slants_and_not_the_told_direction() -> None:
    """On a wall straight ahead the range goes as 1 / cos of the beam's true angle."""
    pose = mounted(0.0, 0.0, 0.0)
    exact, xyz = swept(pose, IN_CAMERA)
    astray, _ = swept(pose, replace(IN_CAMERA, angle_noise_deg=0.05))
    key = [c.ring * 10_000 + c.column for c in (exact, astray)]
    both, i, j = np.intersect1d(*key, return_indices=True)
    assert len(both) > 0.95 * len(exact)
    a, b = exact.xyz[i], astray.xyz[j]
    unit = [p / np.linalg.norm(p, axis=1, keepdims=True) for p in (a, b)]
    np.testing.assert_allclose(*unit, atol=1e-12)
    off_road = (surface_of(xyz)[i] == 0) & (np.abs(a[:, 1]) < 1) & (a[:, 0] < 12)
    # Road: range = height / sin(-elevation), so d range = range / tan(-elevation) times the angle.
    slope = np.linalg.norm(a, axis=1) / np.tan(np.arcsin(-unit[0][:, 2]))
    turned = (np.linalg.norm(b, axis=1) - np.linalg.norm(a, axis=1)) / slope
    assert np.degrees(np.std(turned[off_road])) == pytest.approx(0.05, rel=0.1)


@pytest.mark.parametrize(
    ("depth", "camera", "text"),
    [
        (np.full((200, 500), np.inf), CAMERA, "the depth map gives no LiDAR returns"),
        (depth_m(), Camera("OPENCV_FISHEYE", 500, 200, (300, 300, 250, 80, 0, 0, 0, 0)), "pinhole"),
    ],
)
def test_depth_without_surfaces_and_other_cameras_are_refused(depth, camera, text) -> None:
    with pytest.raises(InputError, match=text):
        depth_sweep(depth, camera, mounted(0.0, 0.0, 0.0), QUIET, np.random.default_rng(0))
