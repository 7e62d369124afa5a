"""The algebra of hand-eye calibration: exact motion tells X exactly, planar motion leaves the height open."""

from __future__ import annotations

import numpy as np
import p2o
import pytest
from p2o_baselines.motion.hand_eye_equations import Steps, first_guess, lengths, solved

TRUTH = p2o.se3.exp(np.array([0.1, -0.05, 0.08, 0.0, 0.0, 0.0])) @ p2o.se3.make(
    [[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]], [0.06, -0.35, -0.27]
)


def steps(
    tangents: np.ndarray, *, metric: bool = True, turn_rad: float = 0.0, move_m: float = 0.0, seed: int = 0
) -> Steps:
    """What cameras and LiDARs do while the LiDAR goes by tangents (N, 6); noise an axis of the camera's steps."""
    rng, count = np.random.default_rng(seed), len(tangents)
    lidar = p2o.se3.exp(tangents)
    noise = rng.normal(size=(count, 6)) * np.repeat([turn_rad, move_m], 3)
    camera = p2o.se3.exp(noise) @ TRUTH @ lidar @ p2o.se3.inverse(TRUTH)
    if not metric:
        camera[:, :3, 3] /= np.linalg.norm(camera[:, :3, 3], axis=1)[:, None]
    covariance = np.diag(np.repeat([max(turn_rad, 1e-5), max(move_m, 1e-4)], 3) ** 2)
    return Steps(
        camera,
        lidar,
        np.full(count, metric),
        np.repeat(covariance[None], count, axis=0),
        np.full(count, 1e-6),
        np.full(count, 1e-6),
    )


def random_motion(count: int = 12, seed: int = 0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return np.concatenate([rng.uniform(-0.3, 0.3, (count, 3)), rng.uniform(-1, 1, (count, 3))], axis=1)


def planar_motion(count: int = 20, seed: int = 0) -> np.ndarray:
    """A car on flat ground: turns about z, goes along x."""
    rng = np.random.default_rng(seed)
    out = np.zeros((count, 6))
    out[:, 2], out[:, 3] = rng.uniform(-0.15, 0.15, count), rng.uniform(0.5, 1.5, count)
    return out


@pytest.mark.parametrize("metric", [True, False], ids=["metric", "up to scale"])
def test_exact_motion_tells_the_extrinsic_exactly(metric: bool) -> None:
    made = steps(random_motion(), metric=metric)
    found = solved(made, first_guess(made)[0])
    off = p2o.se3.log(found.camera_from_lidar @ p2o.se3.inverse(TRUTH))
    assert np.abs(off).max() < 1e-6
    np.testing.assert_allclose(
        lengths(found.camera_from_lidar, made),
        np.linalg.norm((TRUTH @ made.lidar @ p2o.se3.inverse(TRUTH))[:, :3, 3], axis=1),
        atol=1e-6,
    )
    assert found.open_directions(over_deg=1.0, over_m=0.1) == ()


@pytest.mark.parametrize("metric", [True, False], ids=["metric", "up to scale"])
def test_a_car_on_flat_ground_leaves_the_height_open_and_nothing_else(metric: bool) -> None:
    made = steps(planar_motion(), metric=metric, turn_rad=1e-4, move_m=1e-3)
    found = solved(made, first_guess(made)[0])
    (height,) = found.open_directions(over_deg=1.0, over_m=1.0)
    assert not height.turn
    assert abs(height.axis[2]) > 0.99
    assert "along z of the LiDAR" in str(height)
    filled = found.filled(TRUTH, (height,))
    off = p2o.se3.log(filled.camera_from_lidar @ p2o.se3.inverse(TRUTH))
    assert np.degrees(np.linalg.norm(off[:3])) < 0.2
    # Without scales the camera's place to the side hides in how far each step goes.
    assert np.linalg.norm(off[3:]) < (0.05 if metric else 0.5)
    # Of the start it takes nothing but the height.
    lidar_from_camera = p2o.se3.inverse(TRUTH)
    lidar_from_camera[:3, 3] += [0.4, -0.3, 0.2]
    again = found.filled(p2o.se3.inverse(lidar_from_camera), (height,))
    place, before = (-pose[:3, :3].T @ pose[:3, 3] for pose in (again.camera_from_lidar, filled.camera_from_lidar))
    np.testing.assert_allclose(place - before, [0.0, 0.0, 0.2], atol=0.02)


def test_straight_motion_leaves_the_place_and_the_roll_open() -> None:
    tangents = np.zeros((10, 6))
    tangents[:, 3] = 1.0
    made = steps(tangents, turn_rad=1e-4, move_m=1e-3)
    found = solved(made, first_guess(made)[0])
    directions = found.open_directions(over_deg=5.0, over_m=0.5)
    assert [d.turn for d in directions] == [True, False, False, False]
    assert abs(directions[0].axis[0]) > 0.99
    assert "rotation about x of the LiDAR" in str(directions[0])


def test_wrong_steps_do_not_count() -> None:
    made = steps(random_motion(30), turn_rad=1e-4, move_m=1e-3)
    made.camera[:6] = p2o.se3.exp(random_motion(6, seed=9)) @ made.camera[:6]
    found = solved(made, first_guess(made)[0])
    off = p2o.se3.log(found.camera_from_lidar @ p2o.se3.inverse(TRUTH))
    assert found.weight[:6].max() < 0.05 < 0.5 < np.median(found.weight[6:])
    assert np.degrees(np.linalg.norm(off[:3])) < 0.1
    assert np.linalg.norm(off[3:]) < 0.01


@pytest.mark.parametrize("metric", [True, False], ids=["metric", "up to scale"])
def test_the_covariance_covers_the_error(metric: bool) -> None:
    """Squared errors in units of the covariance are 6 on average, whatever deviation the steps were said to have."""
    squares = []
    for seed in range(16):
        made = steps(random_motion(40, seed=seed), metric=metric, turn_rad=2e-3, move_m=0.01, seed=100 + seed)
        made.covariance[:, :3, :3] *= 0.1
        found = solved(made, first_guess(made)[0])
        off = p2o.se3.log(TRUTH @ p2o.se3.inverse(found.camera_from_lidar))
        squares.append(off @ np.linalg.solve(found.covariance, off))
    assert 3.0 < np.mean(squares) < 12.0
