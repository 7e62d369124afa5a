"""Boxes: corners and cuboids as geometry says, the exact pose without noise, and refusals in words."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from p2o import Box, Camera, Result, Status, pose_error, se3
from p2o.arrays import Float
from p2o_baselines.boards import adjustment
from p2o_baselines.bodies.box_in_picture import BoxInPicture, boxes_in_picture, fitted_box, flat_at
from p2o_baselines.bodies.box_in_sweep import (
    BoxInSweep,
    Face,
    around,
    boxes_in_sweep,
    near_corner,
    symmetries,
)
from p2o_baselines.target_method import Sight
from p2o_baselines.targets import pusztai

from tests.baselines.board_scene import AWAY, CAMERA, FISHEYE, TRUTH, assert_near
from tests.baselines.body_scene import CUBOID, corner_on, picture, sweep

SIZE = CUBOID.size_m


def seen(camera_from_box: Float, noise_px: float = 0.0, seed: int = 0) -> BoxInPicture:
    """Return a box as a picture shows it, its seven corners off by noise."""
    corner = near_corner(se3.inverse(camera_from_box)[:3, 3], SIZE)
    assert corner is not None
    vertex = np.array([*around(corner)[0], corner])
    flat = flat_at(CAMERA, CAMERA.project(camera_from_box[None, :3, 3])[0])
    assert flat is not None
    uv = flat.seen(se3.apply(camera_from_box, CUBOID.outline[vertex]))
    uv = uv + np.random.default_rng(seed).normal(0, 1, uv.shape) * noise_px
    covariance = np.tile(np.eye(2) * max(noise_px, 0.05) ** 2, (7, 1, 1))
    box = fitted_box(BoxInPicture(CUBOID, flat, uv, covariance, vertex, camera_from_box, 0.0, None))
    assert box is not None
    return box


def scanned(camera_from_box: Float, noise: float = 0.0, seed: int = 0) -> BoxInSweep:
    """Return the same box as a sweep shows it, its pose off by noise (rad, m) about its middle."""
    pose = se3.inverse(TRUTH) @ camera_from_box
    about = se3.make(translation=pose[:3, 3])
    sigma = np.repeat([1.0, 0.3], 3) * max(noise, 1e-3)
    step = np.random.default_rng(seed).normal(0, 1, 6) * np.repeat([1.0, 0.3], 3) * noise
    moved = np.eye(6)
    moved[3:, :3] = se3.skew(pose[:3, 3])
    face = Face(np.zeros((30, 3)), np.eye(3)[0], 0.0, 0.01)
    found = about @ se3.exp(step) @ se3.inverse(about) @ pose
    return BoxInSweep(tuple(SIZE), found, moved @ np.diag(sigma**2) @ moved.T, 0.01, (face, face, face))


def sights(boxes: list[Float], noise_px: float = 0.0, noise: float = 0.0) -> list[Sight]:
    return [
        Sight(f"pose{k}", "a box", (seen(pose, noise_px, k),), (scanned(pose, noise, k),))
        for k, pose in enumerate(boxes)
    ]


def solved(found: list[Sight], start: Float = AWAY, **options: float) -> Result:
    result: Result = pusztai.METHOD.build(pusztai.METHOD.options(**options)).solve(found, start)
    return result


@pytest.mark.parametrize(("size", "count"), [((0.9, 0.7, 0.5), 4), ((0.9, 0.7, 0.7), 8), ((0.7, 0.7, 0.7), 24)])
def test_turns_that_leave_a_box_alike_leave_its_corners_in_place(size: tuple[float, ...], count: int) -> None:
    turns = symmetries(np.array(size))
    corners = {tuple(c) for c in Box(*size).outline.round(6)}
    assert len(turns) == count
    assert all({tuple(c) for c in se3.apply(turn, Box(*size).outline).round(6)} == corners for turn in turns)
    assert len({tuple(turn.ravel().round(6)) for turn in turns}) == count


@pytest.mark.parametrize("count", [1, 4])
def test_boxes_without_noise_give_the_pose_exactly(count: int) -> None:
    result = solved(sights(corner_on(count)))
    assert result.status is Status.CONVERGED, result.reason
    assert_near(result.camera_from_lidar, np.degrees(1e-6), 1e-6)
    assert result.matches["corners"] == 7 * count


def test_a_box_that_is_turned_to_itself_in_the_sweep_gives_the_same_pose() -> None:
    plain = sights(corner_on(3))
    for turn in symmetries(SIZE):
        found = [
            replace(s, in_sweep=(replace(s.in_sweep[0], lidar_from_box=s.in_sweep[0].lidar_from_box @ turn),))
            for s in plain
        ]
        assert solved(found).camera_from_lidar == pytest.approx(TRUTH, abs=1e-6)


def test_boxes_that_are_turned_differently_leave_one_pose_from_the_start_of_another_turn() -> None:
    (box,) = corner_on(1)
    far = box @ symmetries(SIZE)[1] @ se3.inverse(box) @ TRUTH
    assert pose_error(solved(sights(corner_on(3)), far).camera_from_lidar, TRUTH).rotation_deg < 1e-3


def test_noise_moves_a_pose_by_what_its_covariance_says(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(adjustment, "RANGE_BIAS_M", 0.0)
    monkeypatch.setattr(adjustment, "CAMERA_PX", 0.0)
    size = []
    for seed in range(10):
        result = solved(sights(corner_on(5, seed), 0.3, 0.004))
        step = se3.log(result.camera_from_lidar @ se3.inverse(TRUTH))
        size.append(step @ np.linalg.solve(result.covariance, step))
    # A sum of six squares: 6 on average, to 1.1 over ten draws; a scatter that widens makes it smaller.
    assert 2.0 < np.mean(size) < 9.5


def test_a_box_elsewhere_in_a_sweep_is_left_out() -> None:
    found = sights(corner_on(3))
    other = scanned(se3.make(translation=[1.2, 0.3, 0.5]) @ corner_on(1, 9)[0])
    found[1] = replace(found[1], in_sweep=(other, *found[1].in_sweep))
    assert solved(found).camera_from_lidar == pytest.approx(TRUTH, abs=1e-6)


def test_frames_without_boxes_are_told_apart() -> None:
    found = sights(corner_on(2))
    assert "add it to `targets`" in solved([replace(s, asked="none", in_image=()) for s in found]).reason
    assert "none of 2 images shows" in solved([replace(s, in_image=()) for s in found]).reason
    nothing = solved([replace(s, in_sweep=()) for s in found])
    assert nothing.status is Status.NO_FEATURES
    assert "no sweep has" in nothing.reason
    assert np.array_equal(nothing.camera_from_lidar, AWAY)


def test_sweeps_and_pictures_of_other_places_are_refused() -> None:
    found = sights(corner_on(2))
    far = [replace(s, in_sweep=(scanned(se3.make(translation=[0, 0, 5]) @ corner_on(1, 5)[0]),)) for s in found]
    result = solved(far)
    assert result.status is Status.TOO_FEW_MATCHES
    assert "less than 3 m between the sensors" in result.reason


def test_boxes_of_another_size_than_targets_say_are_told() -> None:
    # A box said to be a quarter larger: pictures have it a quarter farther off, sweeps have its near corner in place.
    large, near = Box(*(1.25 * SIZE)), []
    for sight, truth in zip(sights(corner_on(4)), corner_on(4), strict=True):
        (box,), (scan,) = sight.in_image, sight.in_sweep
        farther, anchored = truth.copy(), scan.lidar_from_box.copy()
        farther[:3, 3] *= 1.25
        corner = CUBOID.outline[_nearest(scan.lidar_from_box)]
        anchored[:3, 3] -= 0.25 * anchored[:3, :3] @ corner
        near.append(
            replace(
                sight,
                in_image=(replace(box, target=large, camera_from_box=farther),),
                in_sweep=(replace(scan, size_m=tuple(large.size_m), lidar_from_box=anchored),),
            )
        )
    result = solved(near)
    assert result.status is Status.TOO_FEW_MATCHES
    assert "size in `targets`" in result.reason


@pytest.mark.parametrize("camera", [CAMERA, FISHEYE], ids=["pinhole", "fisheye"])
def test_a_box_is_found_in_a_picture_of_any_camera(camera: Camera) -> None:
    (truth,) = corner_on(1, 3)
    (box,) = boxes_in_picture(picture(camera, [truth], CUBOID, noise=2.0), [CUBOID])
    off = [truth @ turn @ se3.inverse(box.camera_from_box) for turn in symmetries(SIZE)]
    assert min(se3.angle_deg(step) for step in off) < 0.3
    assert box.camera_from_box[:3, 3] == pytest.approx(truth[:3, 3], abs=0.01)
    corners = box.flat.seen(se3.apply(truth, CUBOID.outline))
    assert max(np.linalg.norm(corners - uv, axis=1).min() for uv in box.uv) < 0.5
    assert len(box.uv) == 7
    assert boxes_in_picture(picture(camera, [truth], CUBOID), [Box(0.9, 0.4, 0.4)]) == ()


def test_a_box_is_found_in_a_sweep_and_one_of_another_size_is_not() -> None:
    (truth,) = corner_on(1, 3)
    there = sweep([truth], CUBOID, 0.015)
    (box,) = boxes_in_sweep(there, [tuple(SIZE)], farthest_m=12, sigma_m=0.04)
    pose = se3.inverse(TRUTH) @ truth
    assert box.lidar_from_box[:3, 3] == pytest.approx(pose[:3, 3], abs=0.01)
    off = [pose @ turn @ se3.inverse(box.lidar_from_box) for turn in symmetries(SIZE)]
    assert min(se3.angle_deg(step) for step in off) < 1.0
    corner = np.linalg.solve([face.normal for face in box.faces], [face.offset_m for face in box.faces])
    assert corner == pytest.approx(se3.apply(pose, CUBOID.outline)[_nearest(pose)], abs=0.02)
    for size in ((0.9, 0.7, 0.9), (0.6, 0.5, 0.4)):
        assert boxes_in_sweep(there, [size], farthest_m=12, sigma_m=0.04) == ()
    assert boxes_in_sweep(sweep([], CUBOID, 0.015), [tuple(SIZE)], farthest_m=12, sigma_m=0.04) == ()


def _nearest(pose: Float) -> int:
    return int(np.linalg.norm(se3.apply(pose, CUBOID.outline), axis=1).argmin())
