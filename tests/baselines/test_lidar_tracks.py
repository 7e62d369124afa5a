"""The camera's metric motion from LiDAR points that are followed in its pictures."""

from __future__ import annotations

import numpy as np
import p2o
import pytest
from p2o_baselines.motion import lidar_tracks, visual_odometry
from p2o_testing import stage

CAMERA = p2o.Camera.pinhole(400.0, 400.0, 310.0, 95.0, 620, 190)


def points(count: int = 300) -> np.ndarray:
    rng = np.random.default_rng(0)
    return CAMERA.rays(rng.uniform((0, 0), (620, 190), (count, 2))) * rng.uniform(5, 40, count)[:, None]


@pytest.mark.parametrize("tangent", [[0.0, 0.08, 0.0, 0.1, 0.0, -1.5], [0.03, -0.02, 0.05, 0.2, -0.1, 0.6], [0.0] * 6])
def test_the_motion_is_found_in_metres_among_wrong_points(tangent: list[float]) -> None:
    truth, xyz, rng = p2o.se3.exp(np.array(tangent)), points(), np.random.default_rng(1)
    there = CAMERA.project(p2o.se3.apply(truth, xyz)) + rng.normal(0, 0.2, (len(xyz), 2))
    there[:60] += rng.uniform(-30, 30, (60, 2))
    guess = p2o.se3.exp(np.array([0.02, -0.02, 0.01, 0.2, -0.1, 0.3])) @ truth
    step = lidar_tracks.metric_step(xyz, CAMERA.rays(there), CAMERA.focal_px, guess)
    off = p2o.se3.log(step.second_from_first @ p2o.se3.inverse(truth))
    assert np.degrees(np.linalg.norm(off[:3])) < 0.05
    assert np.linalg.norm(off[3:]) < 0.02
    assert off @ np.linalg.solve(step.covariance, off) < 30
    assert 220 <= step.points <= 270


def test_too_few_points_tell_no_motion() -> None:
    xyz = points(15)
    assert lidar_tracks.metric_step(xyz, xyz, 400.0, np.eye(4)) is None
    turned = np.random.default_rng(0).permutation(points())
    assert lidar_tracks.metric_step(points(), turned, 400.0, np.eye(4)) is None


def test_points_to_follow_are_apart_and_lie_on_no_step_in_depth() -> None:
    frame = stage.frame()
    uv, xyz = lidar_tracks.trackable(
        frame.image.grey, frame.camera, None, frame.cloud.xyz, stage.camera_from_lidar(), most=200
    )
    assert 50 < len(uv) <= 200
    np.testing.assert_allclose(frame.camera.project(xyz), uv, atol=1e-6)
    cells = {tuple(cell) for cell in (uv // 10).astype(int).tolist()}
    assert len(cells) == len(uv)


def test_places_are_followed_over_several_pictures() -> None:
    grey = stage.frame().image.grey
    pictures = [np.roll(grey, 4 * number, axis=1) for number in range(4)]
    uv, _ = visual_odometry.followed(pictures[0], pictures[1])
    found = visual_odometry.follow_on(pictures, uv)
    assert found.shape == (3, len(uv), 2)
    for number, there in enumerate(found, 1):
        off = there - uv - [4 * number, 0]
        np.testing.assert_allclose(np.nanmedian(off, axis=0), [0.0, 0.0], atol=0.05)
    assert (np.isnan(found[0]) <= np.isnan(found[2])).all(), "what is lost stays lost"
