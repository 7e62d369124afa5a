"""The dataset `synthetic`: exact truth that holds between its own image, depth, right image and sweep."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import pytest
from p2o import SIDES, Dataset, Frame, Side, occlusion, se3
from p2o_plugins.data.synthetic import BASELINE_M, METHOD, SyntheticOptions, build, camera_from_lidar
from pydantic import ValidationError
from scipy import ndimage

SIZE: dict[str, Any] = {"width_px": 621, "height_px": 188}


@cache
def _frame(**options: Any) -> Frame:
    """One frame, half as wide as KITTI's; frames cannot be changed, so tests may share them."""
    return build(SyntheticOptions(**{**SIZE, **options}))[0]


def _depth_errors(frame: Frame, camera_from_lidar: np.ndarray) -> np.ndarray:
    """Return |z - depth| of projected points, depth interpolated (1/depth is linear on planes), away from edges."""
    xyz = se3.apply(camera_from_lidar, frame.cloud.xyz)
    uv = frame.camera.project(xyz)
    inner = frame.camera.in_image(uv, margin_px=-3.0)
    uv, z = uv[inner], xyz[inner, 2]
    inverse = 1 / frame.image.depth_m
    most, least = (f(inverse, size=5) for f in (ndimage.maximum_filter, ndimage.minimum_filter))
    smooth = ndimage.map_coordinates((most - least < 0.15 * least).astype(float), uv[:, ::-1].T, order=0) > 0
    assert smooth.sum() > 2000
    return np.abs(z[smooth] - 1 / ndimage.map_coordinates(inverse, uv[smooth, ::-1].T, order=1))


@pytest.mark.parametrize("camera", ["pinhole", "opencv-distorted", "fisheye"])
def test_a_sweep_without_noise_agrees_with_the_depth_map_at_the_true_pose(camera: str) -> None:
    frame = _frame(noise_m=0.0, camera=camera)
    errors = _depth_errors(frame, frame.camera_from_lidar)
    assert np.median(errors) < 1e-3
    assert np.percentile(errors, 90) < 0.02
    wrong = se3.exp(np.radians([1.0, 1.0, 0.0, 0.0, 0.0, 0.0])) @ frame.camera_from_lidar
    assert np.median(_depth_errors(frame, wrong)) > 0.02


def test_the_truth_is_the_documented_rig() -> None:
    truth = camera_from_lidar()
    np.testing.assert_allclose(se3.apply(se3.inverse(truth), np.zeros((1, 3)))[0], [0.27, 0.06, -0.08], atol=1e-12)
    forward = truth[:3, :3] @ [1.0, 0.0, 0.0]
    tilt = se3.make(truth[:3, :3] @ np.array([[0.0, -1, 0], [0, 0, -1], [1, 0, 0]]).T)
    assert se3.angle_deg(tilt) == pytest.approx(0.85, abs=0.01)
    assert forward[2] > 0.99


def test_the_right_picture_shows_the_same_surfaces_at_the_disparity_of_their_depth() -> None:
    frame = _frame(grain=0.0)
    image = frame.image
    focal = frame.camera.params[0]
    v, u = np.mgrid[: frame.camera.height, : frame.camera.width].astype(float)
    disparity = focal * BASELINE_M / image.depth_m
    flat = ndimage.maximum_filter(disparity, 5) - ndimage.minimum_filter(disparity, 5) < 1.0
    inside = flat & np.isfinite(image.depth_m) & (u - disparity > 4) & (disparity > 2)

    def difference(shift: float) -> float:
        grey = image.right.mean(axis=2)
        seen = ndimage.map_coordinates(grey, [v, u - disparity - shift], order=1, mode="nearest")
        return float(np.median(np.abs(seen - image.rgb.mean(axis=2))[inside]))

    assert image.baseline_m == BASELINE_M
    assert difference(0.0) < 2.0
    assert difference(3.0) > 3 * difference(0.0)
    assert difference(-3.0) > 3 * difference(0.0)


def test_the_same_options_give_the_same_bytes_and_another_seed_or_scene_others() -> None:
    options = SyntheticOptions(width_px=160, height_px=64, scenes=2)
    first, again = (build(options)[0] for _ in range(2))
    other_scene = build(options)[1]
    other_seed = build(SyntheticOptions(width_px=160, height_px=64, seed=1))[0]
    for pick in (lambda f: f.image.rgb, lambda f: f.image.right, lambda f: f.image.depth_m, lambda f: f.cloud.xyz):
        assert pick(first).tobytes() == pick(again).tobytes()
        assert pick(first).tobytes() != pick(other_scene).tobytes()
        assert pick(first).tobytes() != pick(other_seed).tobytes()


def test_noise_and_camera_leave_the_street_as_it_is() -> None:
    quiet, noisy = (_frame(noise_m=noise, grain=0.0) for noise in (0.0, 0.05))
    assert quiet.image.rgb.tobytes() == noisy.image.rgb.tobytes()
    assert np.linalg.norm(quiet.cloud.xyz - noisy.cloud.xyz, axis=1).std() > 0.01
    assert _frame(noise_m=0.0, camera="fisheye").cloud.xyz.tobytes() == quiet.cloud.xyz.tobytes()


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_both_sensors_see_occlusion_edges_in_all_four_directions(seed: int) -> None:
    frame = _frame(seed=seed)
    _, side = occlusion.edges_from_orders(occlusion.occlusion_orders(frame.image.depth_m, frame.camera))
    for direction in SIDES:
        assert (side == direction).sum() >= 200, direction
    seen = _range_jumps(frame)
    for direction in SIDES:
        assert seen[direction] >= 30, direction


def _range_jumps(frame: Frame) -> dict[Side, int]:
    """Return how many returns ahead are nearer by 0.4 m and a fifth than the next beam on that side."""
    cloud = frame.cloud
    near = np.full((64, 2000), np.nan)
    near[cloud.ring, cloud.column] = np.linalg.norm(cloud.xyz, axis=1)
    near = np.roll(near, 1000, axis=1)[:, 800:1200]

    def jumps(step: int, axis: int) -> int:
        behind = np.roll(near, -step, axis)
        inner = np.s_[1:-1, 1:-1]
        return int((behind - near > 0.4 + 0.2 * near)[inner].sum())

    # Columns turn counter-clockwise: the next one lies to the left. Rings go downwards.
    return {Side.LEFT: jumps(1, 1), Side.RIGHT: jumps(-1, 1), Side.UPPER: jumps(-1, 0), Side.BOTTOM: jumps(1, 0)}


def test_frames_carry_what_the_method_says_it_gives() -> None:
    frame = _frame()
    assert METHOD.gives == {"right", "depth", "truth", "rings", "intensity"}
    assert frame.image.right is not None
    assert frame.image.depth_m is not None
    assert frame.image.masked is None
    assert frame.camera_from_lidar is not None
    assert set(np.unique(frame.cloud.ring)) == set(range(64))
    assert 0 <= frame.cloud.intensity.min() < frame.cloud.intensity.max() <= 1
    assert frame.cloud.time_s.min() >= -0.05
    assert frame.cloud.time_s.max() < 0.05


@pytest.mark.parametrize("camera", ["opencv-distorted", "fisheye"])
def test_distorted_cameras_fill_the_whole_image_and_have_no_right_picture(camera: str) -> None:
    frame = _frame(noise_m=0.0, camera=camera)
    assert frame.image.right is None
    assert frame.image.masked is None
    assert not np.isnan(frame.image.depth_m).any()


def test_it_is_a_lazy_dataset_with_names() -> None:
    dataset = build(SyntheticOptions(scenes=1000, width_px=64, height_px=64))
    assert isinstance(dataset, Dataset)
    assert (len(dataset), dataset.names[0], dataset.names[-1]) == (1000, "scene-0000", "scene-0999")
    assert dataset[-1].name == "scene-0999"
    assert len(dataset[2:5]) == 3
    with pytest.raises(IndexError):
        dataset[1000]


@pytest.mark.parametrize(
    "wrong", [{"scenes": 0}, {"noise_m": -0.1}, {"camera": "pinhole2"}, {"width_px": 1}, {"colour": "red"}]
)
def test_options_out_of_bounds_are_refused(wrong: dict[str, Any]) -> None:
    with pytest.raises(ValidationError):
        SyntheticOptions(**wrong)
