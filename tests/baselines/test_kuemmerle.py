"""Balls: cones and spheres as geometry says, the exact pose without noise, and refusals in words."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from p2o import Camera, Result, Status, pose_error, se3
from p2o.arrays import Float
from p2o_baselines.boards import adjustment
from p2o_baselines.bodies.sphere_in_picture import SphereInPicture, cone_of, spheres_in_picture
from p2o_baselines.bodies.sphere_in_sweep import SphereInSweep, fitted_sphere, spheres_in_sweep
from p2o_baselines.target_method import Sight
from p2o_baselines.targets import kuemmerle
from p2o_baselines.targets.kuemmerle import paired_spheres

from tests.baselines.board_scene import AWAY, CAMERA, FISHEYE, TRUTH, assert_near
from tests.baselines.body_scene import BALL, picture, sweep

RADIUS = BALL.radius_m
PLACES = [np.array(p) for p in ([-0.8, -0.3, 3.0], [0.7, 0.2, 2.5], [0.1, -0.5, 4.5], [-0.5, 0.5, 3.8])]


def touching(centre: Float, count: int = 90) -> Float:
    """Return unit rays (N, 3) from the origin that touch a ball, by the circle of points where they do."""
    far = np.linalg.norm(centre)
    axis = centre / far
    side = np.cross(axis, [0.0, 1.0, 0.0])
    side /= np.linalg.norm(side)
    turn = 2 * np.pi * np.arange(count) / count
    around = np.cos(turn)[:, None] * side + np.sin(turn)[:, None] * np.cross(axis, side)
    points = axis * (far - RADIUS**2 / far) + around * RADIUS * np.sqrt(1 - (RADIUS / far) ** 2)
    return np.asarray(points / np.linalg.norm(points, axis=1)[:, None])


def seen(centre: Float, noise_px: float = 0.0, seed: int = 0) -> SphereInPicture:
    """Return a ball as a picture of 700 px a radian shows it."""
    rays = touching(centre)
    axis = centre / np.linalg.norm(centre)
    out = rays - (rays @ axis)[:, None] * axis
    rays = rays + out / np.linalg.norm(out, axis=1)[:, None] * noise_px / 700 * np.random.default_rng(seed).normal(
        0, 1, (len(rays), 1)
    )
    rays /= np.linalg.norm(rays, axis=1)[:, None]
    axis, half = cone_of(rays)
    return SphereInPicture(BALL, rays, axis, half, max(noise_px, 0.05) / 700, 700.0)


def scanned(centre: Float, noise_m: float = 0.0, seed: int = 0) -> SphereInSweep:
    """Return the same ball as a sweep shows it: returns of a grid of rays on its near side."""
    rng = np.random.default_rng(seed)
    middle = se3.apply(se3.inverse(TRUTH), centre[None])[0]
    towards = -middle / np.linalg.norm(middle)
    cap = rng.normal(size=(400, 3))
    cap /= np.linalg.norm(cap, axis=1)[:, None]
    xyz = middle + RADIUS * cap[cap @ towards > 0.3][:80]
    xyz = xyz * (1 + rng.normal(0, 1, (80, 1)) * noise_m / np.linalg.norm(xyz, axis=1)[:, None])
    sigma = max(noise_m, 0.001)
    found = fitted_sphere(xyz, middle, RADIUS, sigma)
    return SphereInSweep(RADIUS, xyz, found, np.eye(3) * 1e-6, sigma, RADIUS, 0.01)


def sights(places: list[Float], noise_px: float = 0.0, noise_m: float = 0.0, seed: int = 0) -> list[Sight]:
    """Return a frame for each ball."""
    return [
        Sight(f"pose{k}", "a sphere", (seen(place, noise_px, seed + k),), (scanned(place, noise_m, seed + k),))
        for k, place in enumerate(places)
    ]


def solved(found: list[Sight], start: Float = AWAY) -> Result:
    result: Result = kuemmerle.METHOD.build(kuemmerle.METHOD.options()).solve(found, start)
    return result


@pytest.mark.parametrize("centre", [*PLACES, np.array([3.0, 1.0, 1.5])])
def test_rays_that_touch_a_ball_are_a_cone_whose_angle_tells_how_far_it_is(centre: Float) -> None:
    axis, half = cone_of(touching(centre))
    far = np.linalg.norm(centre)
    assert half == pytest.approx(np.arcsin(RADIUS / far), abs=1e-12)
    assert axis == pytest.approx(centre / far, abs=1e-12)
    assert seen(centre).centre == pytest.approx(centre, abs=1e-10)


def test_points_on_a_cap_give_the_centre_of_a_sphere_of_known_radius_and_its_radius_where_that_is_free() -> None:
    ball = scanned(PLACES[1])
    middle = se3.apply(se3.inverse(TRUTH), PLACES[1][None])[0]
    assert ball.centre == pytest.approx(middle, abs=1e-9)
    free = fitted_sphere(ball.xyz, middle + [0.02, 0.01, -0.01], 0.27, 0.01, free=True)
    assert free == pytest.approx([*middle, RADIUS], abs=1e-8)


def test_three_balls_without_noise_give_the_pose_exactly_from_any_start() -> None:
    far = se3.exp(np.array([1.5, -0.8, 1.0, 1.0, -1.0, 2.0])) @ TRUTH
    result = solved(sights(PLACES[:3]), far)
    assert result.status is Status.CONVERGED, result.reason
    assert_near(result.camera_from_lidar, np.degrees(1e-6), 1e-6)
    assert result.matches["spheres"] == 3


def test_noise_moves_a_pose_by_what_its_covariance_says(monkeypatch: pytest.MonkeyPatch) -> None:
    # No errors that all bodies share: noise alone.
    monkeypatch.setattr(adjustment, "RANGE_BIAS_M", 0.0)
    monkeypatch.setattr(adjustment, "CAMERA_PX", 0.0)
    rng = np.random.default_rng(3)
    held, size = 0, []
    for seed in range(12):
        places = [np.array([rng.uniform(-0.3, 0.3) * z, rng.uniform(-0.3, 0.3) * z, z]) for z in rng.uniform(2, 5, 8)]
        result = solved(sights(places, 0.3, 0.02, 100 * seed))
        step = se3.log(result.camera_from_lidar @ se3.inverse(TRUTH))
        size.append(step @ np.linalg.solve(result.covariance, step))
        held += pose_error(result.camera_from_lidar, TRUTH).rotation_deg < result.accuracy.rotation_deg_95
    # A sum of six squares: 6 on average, to 1.0 over 12 draws; a scatter that widens makes it smaller.
    assert 2.0 < np.mean(size) < 9.0
    assert held >= 10


def test_one_wrong_ball_in_a_sweep_is_left_out() -> None:
    found = sights(PLACES)
    wrong = scanned(PLACES[3] + [1.0, 0.5, 0.3])
    found[0] = replace(found[0], in_sweep=(wrong, *found[0].in_sweep))
    result = solved(found)
    assert pose_error(result.camera_from_lidar, TRUTH).translation_m < 1e-6
    pairs, _ = paired_spheres(found)
    assert pairs[0].sweep is found[0].in_sweep[1]


def test_fewer_than_three_balls_and_balls_on_a_line_are_refused() -> None:
    few = solved(sights(PLACES[:2]))
    assert few.status is Status.TOO_FEW_MATCHES
    assert "2 spheres are seen by both sensors in 2 frames, 3 or more that are not on a line are needed" in few.reason
    line = solved(sights([np.array([0.5 * k, 0.1 * k, 3.0 + k]) for k in range(-1, 3)]))
    assert line.status is Status.NOT_OBSERVABLE
    assert "lie on a line" in line.reason
    assert np.array_equal(line.camera_from_lidar, AWAY)


def test_frames_without_balls_are_told_apart() -> None:
    found = sights(PLACES)
    assert "add it to `targets`" in solved([replace(s, asked="none", in_image=()) for s in found]).reason
    assert "none of 4 images shows" in solved([replace(s, in_image=()) for s in found]).reason
    assert "no sweep has" in solved([replace(s, in_sweep=()) for s in found]).reason


def test_balls_of_another_size_than_targets_say_are_told() -> None:
    found = [
        replace(s, in_sweep=(replace(s.in_sweep[0], free_radius_m=0.28, radius_sigma_m=0.004),)) for s in sights(PLACES)
    ]
    result = solved(found)
    assert result.status is Status.TOO_FEW_MATCHES
    assert "112 % of the radius that `targets` say (0.25 m)" in result.reason


@pytest.mark.parametrize("camera", [CAMERA, FISHEYE], ids=["pinhole", "fisheye"])
def test_a_ball_is_found_in_a_picture_of_any_camera(camera: Camera) -> None:
    found = spheres_in_picture(picture(camera, PLACES[:2], BALL, noise=2.0), [BALL])
    assert len(found) == 2
    for centre in PLACES[:2]:
        ball = min(found, key=lambda b: float(np.linalg.norm(b.centre - centre)))
        far = np.linalg.norm(centre)
        off = ball.axis - centre / far
        assert np.linalg.norm(off) * ball.px_per_rad < 0.15
        assert abs(ball.half_rad - np.arcsin(RADIUS / far)) * ball.px_per_rad < 0.15


def test_a_ball_is_found_in_a_sweep_and_one_of_another_size_is_not() -> None:
    there = sweep(PLACES[:2], BALL, 0.015)
    found = spheres_in_sweep(there, [RADIUS], farthest_m=12, sigma_m=0.04)
    for centre in PLACES[:2]:
        middle = se3.apply(se3.inverse(TRUTH), centre[None])[0]
        ball = min(found, key=lambda b: float(np.linalg.norm(b.centre - middle)))
        assert np.abs(ball.centre - middle).max() < 4 * np.sqrt(np.diag(ball.covariance)).max()
        assert abs(ball.free_radius_m - RADIUS) < 4 * ball.radius_sigma_m
    assert len(found) == 2
    assert spheres_in_sweep(sweep([], BALL, 0.015), [RADIUS], farthest_m=12, sigma_m=0.04) == ()
    assert spheres_in_sweep(there, [0.4], farthest_m=12, sigma_m=0.04) == ()
