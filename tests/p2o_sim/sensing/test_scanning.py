"""Sweeps: ranges in closed form, noise, divergence, dropouts, motion."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from p2o import InputError, se3
from p2o.geometry.motion import moved, pose_at
from p2o_sim.sensing.lidar import Lidar, Rosette
from p2o_sim.sensing.scanning import sweep
from p2o_sim.sensing.sensors import LIDARS
from p2o_sim.world.scene import Material, Mover, Part, Scene

from tests.p2o_sim.walls import FLOOR_Z, GREY, WALL_X, box, walls

ROSETTES = [slug for slug, lidar in LIDARS.items() if isinstance(lidar, Rosette)]
EXACT = {"range_noise_m": 0.0, "divergence_mrad": 0.0}
POSE = se3.exp(np.array([0.02, -0.03, 0.4, 0.0, 0.0, 0.0]))
COARSE = Lidar(name="coarse", elevation_deg=tuple(np.linspace(4.0, -24.0, 57)), columns=720, **EXACT)


def _rng() -> np.random.Generator:
    return np.random.default_rng(0)


def _plane(reflectance: float, gloss: float = 0.0, x: float = 10.0) -> Scene:
    material = Material("plane", (0.5, 0.5, 0.5), reflectance=reflectance, gloss=gloss)
    return Scene((Part(box(1.0, 400.0, -60.0, 60.0).moved(x + 0.5), material),))


@pytest.mark.parametrize("slug", LIDARS)
def test_points_of_every_lidar_lie_on_the_surfaces(slug: str) -> None:
    cloud = sweep(walls(), replace(LIDARS[slug], **EXACT), POSE, _rng())
    x, y, z = se3.apply(POSE, cloud.xyz).T
    in_box = (abs(x - 6) < 1 + 1e-6) & (abs(y) < 1 + 1e-6) & (abs(z) < 1 + 1e-6)
    to_box = np.where(in_box, np.abs(np.abs(np.stack([x - 6, y, z])) - 1).min(axis=0), np.inf)
    away = np.min([abs(x - WALL_X), abs(z - FLOOR_Z), to_box], axis=0)
    assert away.max() < 1e-9
    assert (abs(x - WALL_X) < 1e-9).sum() > 100


def test_range_noise_moves_points_along_their_beams_with_its_deviation() -> None:
    clean, noisy = (sweep(walls(), replace(COARSE, range_noise_m=n), POSE, _rng()) for n in (0.0, 0.05))
    np.testing.assert_array_equal(clean.column, noisy.column)
    beam = clean.xyz / np.linalg.norm(clean.xyz, axis=1, keepdims=True)
    step = noisy.xyz - clean.xyz
    along = (step * beam).sum(axis=1)
    assert np.abs(step - along[:, None] * beam).max() < 1e-9
    # Some 20 000 samples: the deviation is known to 0.5 %; five sigma.
    assert along.std() == pytest.approx(0.05, rel=0.025)
    assert abs(along.mean()) < 0.002


def test_angular_noise_is_unknown_to_the_sensor_and_shows_as_range_on_a_slanted_plane() -> None:
    cloud = sweep(walls(with_box=False), replace(COARSE, angle_noise_deg=0.1), np.eye(4), _rng())
    floor = cloud.xyz[:, 2] < -1.0
    beam = cloud.xyz[floor] / np.linalg.norm(cloud.xyz[floor], axis=1, keepdims=True)
    steep = beam[:, 2] < -0.3
    assert steep.sum() > 500
    # At depression a the floor is at h / sin(a): an error e of a moves the point by h cos(a) / sin(a)^2 e.
    sine = -beam[steep, 2]
    error = np.linalg.norm(cloud.xyz[floor][steep], axis=1) - 1.5 / sine
    scaled = error * sine**2 / (1.5 * np.sqrt(1 - sine**2))
    assert np.degrees(scaled.std()) == pytest.approx(0.1, rel=0.1)


def test_intensity_is_reflectance_times_the_cosine_of_incidence() -> None:
    cloud = sweep(walls(), COARSE, np.eye(4), _rng())
    on_wall = abs(cloud.xyz[:, 0] - WALL_X) < 1e-6
    facing = WALL_X / np.linalg.norm(cloud.xyz[on_wall], axis=1)
    np.testing.assert_allclose(cloud.intensity[on_wall], 0.5 * facing, atol=0.0051)


def test_nothing_is_returned_beyond_the_largest_or_before_the_smallest_range() -> None:
    short = replace(COARSE, min_range_m=4.0, max_range_m=6.0)
    distance = np.linalg.norm(sweep(walls(), short, np.eye(4), _rng()).xyz, axis=1)
    assert 4.0 <= distance.min() < distance.max() <= 6.0


def test_dark_paint_is_seen_to_its_range_and_no_farther() -> None:
    ahead = Lidar(name="ahead", elevation_deg=(0.5, 0.0, -0.5), columns=7200, dark_range_m=50.0, **EXACT)

    def share(x: float) -> float:
        try:
            cloud = sweep(_plane(0.1, x=x), ahead, np.eye(4), _rng())
        except InputError:
            return 0.0
        return (np.abs(cloud.xyz[:, 1]) < 0.05 * x).sum() / (3 * 2 * np.arctan(0.05) / (2 * np.pi) * 7200)

    # Energy scatters by a quarter and falls with the square: twice the threshold at 0.7 of the range, half at 1.4.
    assert share(35.0) > 0.98
    assert 0.25 < share(50.0) < 0.75
    assert share(70.0) < 0.02


def test_glass_returns_head_on_only() -> None:
    cloud = sweep(_plane(0.02, gloss=0.75), LIDARS["hdl-64e"], np.eye(4), _rng())
    off_axis = np.degrees(np.arctan2(np.hypot(cloud.xyz[:, 1], cloud.xyz[:, 2]), cloud.xyz[:, 0]))
    plain = sweep(_plane(0.5), LIDARS["hdl-64e"], np.eye(4), _rng())
    assert len(cloud) < 0.7 * len(plain)
    assert off_axis.max() < 80
    assert cloud.intensity.max() <= 0.02


def test_divergence_makes_mixed_returns_at_edges_and_nowhere_else() -> None:
    # A screen 40 cm before a wall: their echoes melt. Far from its outline nothing changes.
    screen = Part(box(0.1, 4.0, -1.0, 3.0).moved(9.65), GREY, 1)
    scene = Scene((Part(box(1.0, 400.0, -60.0, 60.0).moved(10.5), GREY), screen))
    wide = replace(COARSE, columns=3600, divergence_mrad=6.0)
    cloud = sweep(scene, wide, np.eye(4), _rng())
    mixed = (cloud.xyz[:, 0] > 9.6 + 1e-3) & (cloud.xyz[:, 0] < 10.0 - 1e-3)
    assert mixed.sum() > 20
    y, z = (cloud.xyz[mixed, i] / cloud.xyz[mixed, 0] * 9.6 for i in (1, 2))
    to_outline = np.minimum(abs(abs(y) - 2.0), np.minimum(abs(z + 1.0), abs(z - 3.0)))
    assert to_outline.max() < 9.6 * 0.004
    thin = sweep(scene, replace(wide, divergence_mrad=0.0), np.eye(4), _rng())
    assert (np.minimum(abs(thin.xyz[:, 0] - 9.6), abs(thin.xyz[:, 0] - 10.0))[abs(thin.xyz[:, 1]) < 1.9] < 1e-9).all()


def test_the_first_return_prefers_the_foreground_and_the_strongest_the_brighter() -> None:
    dark = Material("dark", (0.1, 0.1, 0.1), reflectance=0.03)
    screen = Part(box(0.1, 4.0, -1.0, 3.0).moved(5.0), dark, 1)
    bright = Part(box(1.0, 400.0, -60.0, 60.0).moved(10.5), Material("bright", (0.9, 0.9, 0.9), reflectance=0.95), 0)
    wide = replace(COARSE, columns=3600, divergence_mrad=6.0)
    near = {
        keeps: int((sweep(Scene((bright, screen)), replace(wide, keeps=keeps), np.eye(4), _rng()).xyz[:, 0] < 6).sum())
        for keeps in ("first", "strongest")
    }
    assert near["first"] > near["strongest"] + 20


@pytest.mark.parametrize("slug", ROSETTES)
def test_a_rosette_has_no_rings_and_its_times_rise(slug: str) -> None:
    cloud = sweep(walls(), LIDARS[slug], np.eye(4), _rng())
    assert cloud.ring is None
    assert (np.diff(cloud.time_s) > 0).all()
    assert (np.diff(cloud.column) > 0).all()


TWIST = np.array([0.02, -0.05, 0.4, 9.0, 0.5, -0.2])


@pytest.mark.parametrize("slug", ["hdl-64e", "os1-64", "mid-40"])
def test_points_of_a_moving_sweep_brought_to_its_middle_lie_on_the_still_surfaces(slug: str) -> None:
    cloud = sweep(walls(with_box=False), replace(LIDARS[slug], **EXACT), POSE, _rng(), twist=TWIST)
    raw, straight = cloud.xyz, moved(TWIST, cloud.time_s, cloud.xyz)

    def worst(points: np.ndarray) -> float:
        x, _, z = se3.apply(POSE, points).T
        return float(np.minimum(abs(x - WALL_X), abs(z - FLOOR_Z)).max())

    assert worst(straight) < 1e-9
    assert worst(raw) > 0.05


@pytest.mark.parametrize("slug", ROSETTES)
@pytest.mark.parametrize("twist", [None, 0.1 * TWIST])
def test_a_long_dwell_at_rest_or_on_the_move_is_exact_and_denser(slug: str, twist: np.ndarray | None) -> None:
    lidar = replace(LIDARS[slug], **EXACT, sweep_s=2.0, points_per_s=20_000.0)
    cloud = sweep(walls(with_box=False), lidar, POSE, _rng(), twist=twist)
    straight = cloud.xyz if twist is None else moved(twist, cloud.time_s, cloud.xyz)
    x, _, z = se3.apply(POSE, straight).T
    assert np.minimum(abs(x - WALL_X), abs(z - FLOOR_Z)).max() < 1e-9
    assert np.ptp(cloud.time_s) == pytest.approx(2.0, abs=0.1)


def test_moving_points_in_closed_form_are_those_of_the_exponential() -> None:
    rng = np.random.default_rng(3)
    points, times = rng.normal(size=(20, 3)), rng.uniform(-0.5, 2.0, 20)
    expected = [se3.apply(se3.exp(TWIST * t), p[None])[0] for p, t in zip(points, times, strict=True)]
    np.testing.assert_allclose(moved(TWIST, times, points), expected, atol=1e-12)
    rotated = [pose_at(TWIST, t)[:3, :3] @ p for p, t in zip(points, times, strict=True)]
    np.testing.assert_allclose(moved(TWIST, times, points, directions=True), rotated, atol=1e-12)


def test_what_drives_is_met_where_it_is_at_the_time_of_each_pulse() -> None:
    plate = Part(box(0.2, 30.0, -5.0, 5.0).moved(8.1), GREY, 0)
    speed = np.array([0.0, 0.0, 0.0, -12.0, 0.0, 0.0])
    scene = Scene((Part(box(1.0, 1.0, -90.0, -89.0), GREY, 1),), movers=(Mover((plate,), speed),))
    cloud = sweep(scene, COARSE, np.eye(4), _rng(), time_s=0.1)
    ahead = (np.abs(cloud.xyz[:, 1]) < 4) & (cloud.xyz[:, 0] > 1)
    np.testing.assert_allclose(cloud.xyz[ahead, 0], 8.0 - 12.0 * (0.1 + cloud.time_s[ahead]), atol=1e-9)


def test_a_lidar_that_meets_nothing_says_so() -> None:
    up = Lidar(name="looks up", elevation_deg=(60.0,), columns=100)
    with pytest.raises(InputError, match=r"looks up: the LiDAR has no returns"):
        sweep(walls(), up, se3.make(translation=(-50.0, 0.0, 0.0)), _rng())


def test_noise_of_one_point_does_not_depend_on_what_the_others_meet() -> None:
    noisy = replace(COARSE, range_noise_m=0.05)
    with_box, without = (sweep(walls(with_box=b), noisy, np.eye(4), _rng()) for b in (True, False))
    same = {(r, c): tuple(p) for r, c, p in zip(with_box.ring, with_box.column, with_box.xyz, strict=True)}
    floor = without.xyz[:, 0] < -2
    for r, c, p in zip(without.ring[floor][:200], without.column[floor][:200], without.xyz[floor][:200], strict=True):
        assert same[r, c] == tuple(p)
