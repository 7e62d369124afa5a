"""`line-time`: visual odometry, the delay between the sensors, and what is made of it."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import p2o
import pytest
from p2o_baselines.motion import line_time, visual_odometry
from p2o_baselines.motion.sensor_delay import Drive, delay_of
from p2o_testing import stage

CAMERA = p2o.Camera.pinhole(400.0, 400.0, 310.0, 95.0, 620, 190)
ALONG = p2o.se3.make([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]])
"""The camera looks along the x axis of the LiDAR."""


# ---- visual odometry


def points(seed: int = 0, count: int = 300) -> np.ndarray:
    """Things in front of the camera, (N, 3) m."""
    rng = np.random.default_rng(seed)
    uv = rng.uniform((0, 0), (CAMERA.width, CAMERA.height), (count, 2))
    return CAMERA.rays(uv) * rng.uniform(5.0, 40.0, count)[:, None]


@pytest.mark.parametrize(
    "tangent",
    [
        [0.0, 0.02, 0.0, 0.0, 0.0, -0.4],  # ahead, in a bend
        [0.01, -0.03, 0.02, 0.3, 0.05, -0.1],
        [0.0, 0.05, 0.0, 0.0, 0.0, 0.0],  # turns on the spot
        [0.0, 0.0, 0.0, 0.0, 0.0, 0.0],
    ],
)
def test_the_turn_of_a_camera_is_found_among_wrong_corners(tangent: list[float]) -> None:
    truth, xyz, rng = p2o.se3.exp(np.array(tangent)), points(), np.random.default_rng(1)
    here, there = CAMERA.project(xyz), CAMERA.project(p2o.se3.apply(truth, xyz))
    here, there = (uv + rng.normal(0, 0.1, uv.shape) for uv in (here, there))
    there[:60] += rng.uniform(-20, 20, (60, 2))
    step = visual_odometry.camera_step(CAMERA.rays(here), CAMERA.rays(there), CAMERA.focal_px)
    assert step is not None
    assert p2o.se3.angle_deg(p2o.se3.inverse(truth) @ step.second_from_first) < 0.05
    assert 220 <= step.corners <= 270
    assert step.off_px < 0.3


def test_the_camera_moves_the_right_way_and_parallax_is_told() -> None:
    truth, xyz = p2o.se3.exp(np.array([0.0, 0.02, 0.0, 0.1, 0.0, -0.5])), points()
    here, there = CAMERA.rays(CAMERA.project(xyz)), CAMERA.rays(CAMERA.project(p2o.se3.apply(truth, xyz)))
    step = visual_odometry.camera_step(here, there, CAMERA.focal_px)
    way = truth[:3, 3] / np.linalg.norm(truth[:3, 3])
    assert step.second_from_first[:3, 3] @ way > 0.9999
    still = visual_odometry.camera_step(here, here, CAMERA.focal_px)
    assert still.parallax_px < 1e-3 < 0.5 < step.parallax_px


def test_too_few_corners_tell_no_motion() -> None:
    rays = CAMERA.rays(CAMERA.project(points(count=15)))
    assert visual_odometry.camera_step(rays, rays, CAMERA.focal_px) is None
    even = np.full((100, 200), 128, np.uint8)
    assert len(visual_odometry.followed(even, even)[0]) == 0


def test_corners_are_followed_and_none_begins_where_it_is_masked() -> None:
    grey = stage.frame().image.grey
    shifted = np.roll(grey, 7, axis=1)
    masked = np.zeros(grey.shape, bool)
    masked[:, 240:] = True
    here, there = visual_odometry.followed(grey, shifted, masked=masked)
    assert len(here) > 50
    assert here[:, 0].max() < 241
    np.testing.assert_allclose(np.median(there - here, axis=0), [7.0, 0.0], atol=0.05)


# ---- the delay


def yaw_deg(time_s: np.ndarray) -> np.ndarray:
    """A drive with curves to either side, 12 deg/s at most."""
    return 10.0 * np.sin(1.2 * time_s) + 2.0 * np.sin(2.9 * time_s + 0.4)


def drive(delay_s: float, yaw=yaw_deg, *, frames: int = 60, noise_deg: float = 0.0, seed: int = 0) -> Drive:
    """Pictures every 0.1 s, taken `delay_s` after the LiDAR's poses; both odometries have noise in each step."""
    rng, times_s = np.random.default_rng(seed), 0.1 * np.arange(frames)

    def turned(degrees: np.ndarray) -> np.ndarray:
        return np.array([p2o.se3.exp(np.radians([0, 0, each, 0, 0, 0])) for each in degrees])

    def noisy() -> np.ndarray:
        return p2o.se3.exp(np.concatenate([np.radians(noise_deg) * rng.normal(size=3), np.zeros(3)]))

    lidar, there = turned(yaw(times_s)), turned(yaw(times_s + delay_s))
    world = [lidar[0]]
    for before, after in pairwise(lidar):
        world.append(world[-1] @ p2o.se3.inverse(before) @ after @ noisy())
    steps = [
        (ALONG @ noisy() @ p2o.se3.inverse(after) @ before @ p2o.se3.inverse(ALONG))[:3, :3]
        for before, after in pairwise(there)
    ]
    return Drive.of(times_s, steps, np.array(world), span_s=0.5)


@pytest.mark.parametrize("delay_s", [-0.13, 0.0, 0.02])
def test_a_known_delay_is_found_from_a_start_that_is_somewhat_wrong(delay_s: float) -> None:
    wrong = p2o.se3.exp(np.radians([2.0, -1.0, 1.5, 0, 0, 0])) @ ALONG
    found = delay_of([drive(delay_s)], wrong)
    assert found.inside
    assert found.delay_s == pytest.approx(delay_s, abs=0.002)
    assert found.explained > 0.99


def test_the_deviation_is_that_of_many_drives() -> None:
    off = []
    for seed in range(6):
        found = delay_of([drive(0.05, noise_deg=0.05, seed=seed)], ALONG)
        off.append((found.delay_s - 0.05) / found.sigma_s)
    assert 0.4 < np.sqrt(np.mean(np.square(off))) < 2.0


# ---- the whole method


def method(**options: object) -> line_time.LineTime:
    return line_time.METHOD.build(line_time.LineTimeOptions(**options))


@pytest.mark.parametrize(
    ("delay_s", "turning", "reason"),
    [
        (0.0, lambda time_s: 0.0 * time_s, "drive so that it turns"),
        (0.0, lambda time_s: 15.0 * time_s, "too evenly"),
        (0.35, yaw_deg, "the longest that is tried"),
    ],
    ids=["straight", "one even bend", "beyond what is tried"],
)
def test_a_drive_that_does_not_tell_is_refused(delay_s: float, turning, reason: str) -> None:
    found = delay_of([drive(delay_s, turning, noise_deg=0.02)], ALONG)
    status, text = method()._trouble(found, 60)
    assert status is p2o.Status.NOT_OBSERVABLE
    assert reason in text


def test_frames_that_stand_alone_are_too_few() -> None:
    stands = [replace(frame, sequence=frame.name) for frame in stage.drive()]
    calibrator = method()
    result = calibrator.solve([calibrator.prepare(frame) for frame in stands], stage.camera_from_lidar())
    assert result.status is p2o.Status.TOO_FEW_MATCHES
    assert "jointly" in result.reason
    with pytest.raises(p2o.InputError, match="no drive"):
        calibrator.prepare(stage.frame())


def test_sweeps_are_moved_to_the_moments_of_their_pictures() -> None:
    """What a LiDAR that moves sees at one moment, moved by the delay, is what it sees later."""
    rate, delay_s = np.array([0.0, 0.0, 0.3, 6.0, 0.0, 0.0]), 0.08
    xyz = np.array([[10.0, 1.0, 0.0], [20.0, -3.0, 1.0]])

    def moment(time_s: float) -> line_time.Moment:
        pose = p2o.se3.exp(rate * time_s)
        seen = p2o.CloudEdges(p2o.se3.apply(p2o.se3.inverse(pose), xyz), np.full(2, p2o.Side.NONE, np.int8))
        view = p2o.View(str(time_s), CAMERA, p2o.ImageFeatures(), p2o.CloudFeatures(seen))
        return line_time.Moment("drive", time_s, pose, np.zeros((2, 2), np.uint8), None, view)

    moments = [moment(time_s) for time_s in (0.0, 0.1, 0.2)]
    for sign in (1, -1):
        for view, at in zip(line_time.synchronised(moments, sign * delay_s), moments, strict=True):
            later = moment(at.time_s + sign * delay_s).view
            np.testing.assert_allclose(view.cloud_edges.xyz, later.cloud_edges.xyz, atol=1e-9)


@pytest.fixture(scope="module")
def simulated() -> list[p2o.Frame]:
    """A drive with curves, 18 frames 0.05 s apart, whose LiDAR has some noise in its odometry."""
    text = (
        "synthetic:?place=street&frames_per_scene=18&period_s=0.05&speed_m_s=4&swing_deg=20&sway=0&right=false"
        "&odometry_noise_deg=0.01&odometry_noise_m=0.01&width_px=414&height_px=125&lidar=vlp-16"
    )
    return list(p2o.Recipe.of(data=text).resolve(p2o.Registry.load()).dataset())


def test_pictures_and_sweeps_of_different_moments_are_told_apart(simulated: list[p2o.Frame]) -> None:
    """Pictures of even frames with sweeps and poses of odd ones: each was taken 50 ms before its sweep."""
    start = simulated[0].camera_from_lidar
    frames = [
        replace(picture, cloud=swept.cloud, lidar_world_from_lidar=swept.lidar_world_from_lidar)
        for picture, swept in zip(simulated[::2], simulated[1::2], strict=True)
    ]
    calibrator = method()
    moments = [calibrator.prepare(frame.without_truth()) for frame in frames]
    result = calibrator.solve(moments, start)
    found = delay_of([line_time.turns_of(line_time.drives_of(moments)[0], calibrator.options)], start)
    assert found.delay_s == pytest.approx(-0.05, abs=0.015)
    assert found.sigma_s < 0.015
    assert f"{1e3 * abs(found.delay_s):.1f} +-" in result.reason
    assert any("their sweeps" in text for text in result.warnings)
