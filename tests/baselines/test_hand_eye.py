"""`hand-eye`: what is consecutive, what is refused, and an extrinsic from motion alone."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import p2o
import pytest
from p2o.solving import Doubt
from p2o_baselines.motion import corner_depths, hand_eye
from p2o_baselines.motion import moments as drives
from p2o_baselines.motion.corner_depths import Followed
from p2o_baselines.motion.moments import Moment, consecutive
from p2o_testing import stage

CAMERA = p2o.Camera.pinhole(700.0, 700.0, 620.0, 180.0, 1242, 375)
TRUTH = p2o.se3.exp(np.array([0.05, -0.08, 0.06, 0.0, 0.0, 0.0])) @ p2o.se3.make(
    [[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]], [0.06, -0.35, -0.27]
)
DRIVE = (
    "synthetic:?place=street&frames_per_scene=5&period_s=0.2&speed_m_s=4&swing_deg=25&tilt_deg=3&sway=0&right=false"
    "&seed=1&width_px=828&height_px=250"
)


def method(**options: object) -> hand_eye.HandEyeCalibration:
    return hand_eye.HandEyeCalibration(hand_eye.HandEyeOptions(**options))


def moment(number: int, sequence: str = "drive", time_s: float | None = None) -> Moment:
    time_s, grey = 0.1 * number if time_s is None else time_s, np.zeros((8, 8), np.uint8)
    return Moment(f"{sequence}/{number}", sequence, time_s, CAMERA, grey, None, np.ones((5, 3)), np.eye(4))


# ---- which frames


def test_stretches_end_where_time_is_missing_and_where_a_drive_ends() -> None:
    times = (0.0, 0.1, 0.2, 5.0, 5.1, 9.0)
    moments = [moment(number, time_s=time_s) for number, time_s in enumerate(times)]
    found = consecutive([*reversed(moments), moment(0, "other"), moment(1, "other")], 0.5)
    assert [[each.name for each in group] for group in found] == [
        ["drive/0", "drive/1", "drive/2"],
        ["drive/3", "drive/4"],
        ["other/0", "other/1"],
    ]


def lost(*_: object) -> None:
    """Stand in for an odometry that fails."""
    raise p2o.InputError("sweeps 3 and 4 of the sequence do not fit together")


@pytest.mark.parametrize(
    ("period_s", "status", "reason"),
    [
        (3.0, p2o.Status.TOO_FEW_MATCHES, "0 steps between consecutive frames, of 8 frames.*calibrated jointly"),
        (0.1, p2o.Status.NOT_OBSERVABLE, "is static"),
    ],
)
def test_frames_far_apart_a_rig_that_stands_still_and_sweeps_that_do_not_fit_are_refused(
    period_s: float, status: p2o.Status, reason: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    frames = [moment(number, time_s=period_s * number) for number in range(8)]
    result = method(lidar="given").solve(frames, TRUTH)
    assert result.status is status
    assert re.search(reason, result.reason)
    monkeypatch.setattr(drives, "lidar_poses", lost)
    result = method().solve([moment(number) for number in range(8)], TRUTH)
    assert result.status is p2o.Status.TOO_FEW_MATCHES
    assert "do not fit together" in result.reason


def test_a_frame_of_no_drive_is_refused() -> None:
    with pytest.raises(p2o.InputError, match="no drive"):
        method().prepare(stage.frame())
    with pytest.raises(p2o.InputError, match="no pose of the LiDAR"):
        method(lidar="given").prepare(replace(stage.drive()[0], lidar_world_from_lidar=None))


def test_the_initializer_says_why_there_is_no_start() -> None:
    views = [replace(stage.view(), prepared=moment(0)), stage.view()]
    with pytest.raises(p2o.InputError, match="no start from motion: 0 steps"):
        hand_eye.build_start(hand_eye.HandEyeOptions())(views, TRUTH)


# ---- corners with the sweeps' depth


def room(rng: np.random.Generator, count: int) -> np.ndarray:
    """Points on the walls and the floor of a corridor, in the world, (N, 3) m."""
    along = rng.uniform(4, 40, count)
    across, up = rng.uniform(-5, 5, count), rng.uniform(-1.7, 4, count)
    wall = rng.integers(0, 3, count)
    y = np.where(wall == 0, 5.0, np.where(wall == 1, -5.0, across))
    return np.stack([along, y, np.where(wall == 2, -1.7, up)], axis=1)


def groups(tangents: np.ndarray, noise_px: float = 0.0) -> list[Followed]:
    """Exact tracks of things in a corridor while the LiDAR goes by tangents (N, 6) from its first place."""
    rng, found = np.random.default_rng(0), []
    for tangent in tangents:
        lidar = p2o.se3.exp(tangent)
        sweep, things = room(rng, 12000), room(rng, 250)
        here, there = p2o.se3.apply(TRUTH, things), p2o.se3.apply(TRUTH @ lidar, things)
        uv = CAMERA.project(here)
        seen = CAMERA.in_image(uv) & CAMERA.in_image(CAMERA.project(there)) & (here[:, 2] > 0.1)
        later = CAMERA.project(there[seen]) + noise_px * rng.normal(size=(int(seen.sum()), 2))
        found.append(Followed(CAMERA, sweep, uv[seen], CAMERA.rays(uv[seen]), CAMERA.rays(later)[None], lidar[None]))
    return found


def tangents(turn: float = 0.12, tilt: float = 0.05) -> np.ndarray:
    rng = np.random.default_rng(1)
    out = np.zeros((8, 6))
    out[:, :2], out[:, 2] = rng.uniform(-tilt, tilt, (8, 2)), rng.uniform(-turn, turn, 8)
    out[:, 3] = -rng.uniform(0.5, 1.0, 8)
    return out


@pytest.mark.parametrize("off", [[0.03, -0.03, 0.03, 0.3, -0.2, 0.3], [0, 0, 0, -0.6, 0, 0]])
def test_corners_tell_the_extrinsic_from_half_a_metre_away(off: list[float]) -> None:
    found = corner_depths.refined(groups(tangents(), 0.1), p2o.se3.exp(np.array(off)) @ TRUTH)
    left = p2o.se3.log(found.camera_from_lidar @ p2o.se3.inverse(TRUTH))
    assert found.settled
    assert np.degrees(np.linalg.norm(left[:3])) < 0.1
    assert np.linalg.norm(left[3:]) < 0.03
    assert np.abs(left / np.sqrt(np.diag(found.covariance))).max() < 5


def test_where_the_ground_is_flat_the_sweeps_depth_tells_the_height() -> None:
    """Motion alone leaves it open (`test_hand_eye_equations`); things at the wrong height get a wrong distance."""
    lower = p2o.se3.make(translation=(0.0, 0.3, 0.0)) @ TRUTH
    found = corner_depths.refined(groups(tangents(tilt=0.0), 0.1), lower)
    assert abs(p2o.se3.log(found.camera_from_lidar @ p2o.se3.inverse(TRUTH))[4]) < 0.02


# ---- the whole method


@pytest.fixture(scope="module")
def drive() -> list[p2o.Frame]:
    return list(p2o.Recipe.of(data=DRIVE).resolve(p2o.Registry.load()).dataset())


def test_no_start_is_needed(drive: list[p2o.Frame], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(drives, "OPEN_M", 10.0)
    monkeypatch.setattr(drives, "OPEN_DEG", 90.0)
    calibrator, truth = method(lidar="given"), drive[0].camera_from_lidar
    moments = [calibrator.prepare(frame.without_truth()) for frame in drive]
    one, other = (calibrator.solve(moments, start) for start in (np.eye(4), truth))
    np.testing.assert_array_equal(one.camera_from_lidar, other.camera_from_lidar)
    error = p2o.pose_error(one.camera_from_lidar, truth)
    assert error.rotation_deg < 0.3
    assert error.translation_m < 0.1
    assert one.covariance.shape == (6, 6)
    assert one.matches["steps"] == 4
    assert abs(one.time.offset_s) < 0.02


def test_a_motion_that_contradicts_the_pictures_is_said(drive: list[p2o.Frame]) -> None:
    """The LiDAR is said to go a fifth farther than it does."""
    calibrator, truth = method(lidar="given"), drive[0].camera_from_lidar
    moments = []
    for frame in drive:
        pose = np.array(frame.lidar_world_from_lidar)
        pose[:3, 3] *= 1.2
        moments.append(calibrator.prepare(replace(frame, lidar_world_from_lidar=pose)))
    result = calibrator.solve(moments, truth)
    assert any("the LiDAR's motion seems wrong by" in text for text in result.warnings)
    # How wrong it is likely to be is told, or what is open is.
    error = p2o.pose_error(result.camera_from_lidar, truth)
    assert result.accuracy is None or error.translation_m < 1.5 * result.accuracy.translation_m_95


def test_an_open_direction_is_said_and_taken_from_the_start_or_refused(
    drive: list[p2o.Frame], monkeypatch: pytest.MonkeyPatch
) -> None:
    """With a bound so low that everything is open, the result is the start."""
    truth = drive[0].camera_from_lidar
    start = p2o.se3.exp(np.array([0.01, 0.02, -0.01, 0.1, 0.05, -0.1])) @ truth
    options = {"lidar": "given", "rounds": 0, "joint": False}
    monkeypatch.setattr(drives, "OPEN_M", 1e-6)
    monkeypatch.setattr(drives, "OPEN_DEG", 1e-6)
    moments = [method(**options).prepare(frame) for frame in drive]
    filled = method(**options).solve(moments, start)
    assert filled.status.solved
    assert p2o.se3.angle_deg(filled.camera_from_lidar @ p2o.se3.inverse(start)) < 0.05
    assert "kept from the initial guess" in filled.verdict.why
    assert not set(filled.warnings) - {filled.verdict.why}, "the line of the verdict is not repeated"
    assert filled.accuracy is None
    # A witness adds its agreement to this reason, and does not take it away.
    assert [reason.doubt for reason in filled.verdict.reasons] == [Doubt.TOO_UNSURE]
    refused = method(**options, fill=False).solve(moments, start)
    assert refused.status is p2o.Status.NOT_OBSERVABLE
    assert "not observable from motion: the rotation about" in refused.reason
    np.testing.assert_array_equal(refused.camera_from_lidar, start)


def test_it_hands_its_result_to_the_matcher(drive: list[p2o.Frame]) -> None:
    words = {"extractor": "canny/rings", "matcher": "nearest", "init": "hand-eye"}
    recipe = p2o.Recipe.of(data=None, **words, options={"init": {"lidar": "given"}, "pipeline": {"rounds": 1}})
    pipeline = recipe.resolve(p2o.Registry.load()).calibrator()
    truth = drive[0].camera_from_lidar
    far = p2o.se3.exp(np.array([0.2, -0.2, 0.2, 0.5, -0.5, 0.5])) @ truth
    result = pipeline(drive, far)
    assert result.status.solved
    error = p2o.pose_error(result.camera_from_lidar, truth)
    assert error.rotation_deg < 1.5
    assert error.translation_m < 0.4
