"""Methods of boards with holes, and of squares in reflectances: exact without noise, else refused in words."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from p2o import Camera, Checkerboard, Cloud, HoleBoard, Result, Status, pose_error, se3
from p2o.arrays import Float
from p2o_baselines.boards.board_in_sweep import boards_in_sweep
from p2o_baselines.boards.holes_in_picture import circle_poses, ellipses_of, hole_boards_in_picture
from p2o_baselines.boards.holes_in_sweep import hole_boards_in_sweep
from p2o_baselines.boards.pairing import turns_of
from p2o_baselines.target_method import Sight, TargetOptions
from p2o_baselines.targets import acsc, domhof, velas, velo2cam

from tests.baselines import board_scene
from tests.baselines.board_scene import AWAY, CAMERA, FISHEYE, TRUTH, assert_near, poses
from tests.baselines.hole_scene import HOLES, SQUARE, frame, in_sweep, picture, sights, sweep

METHODS = {"velo2cam": velo2cam.METHOD, "domhof": domhof.METHOD}
OBLIQUE = se3.make(None, [0.1, 0.05, 2.6]) @ se3.exp(np.radians([18.0, 32.0, 8.0, 0, 0, 0]))


def solved(method: str, seen: list[Sight], start: Float = AWAY) -> Result:
    offered = METHODS[method]
    result: Result = offered.build(offered.options()).solve(seen, start)
    return result


def turned_away(pose: Float, truth: Float) -> float:
    """Return the angle in deg between poses of a board that looks the same after half a turn."""
    half = se3.exp(np.array([0, 0, np.pi, 0, 0, 0]))
    return min(pose_error(each, truth).rotation_deg for each in (pose, pose @ half))


# ---- the picture


@pytest.mark.parametrize("camera", [CAMERA, FISHEYE], ids=["pinhole", "fisheye"])
def test_a_board_with_holes_is_found_in_a_picture_of_any_camera(camera: Camera) -> None:
    found = hole_boards_in_picture(picture(camera, OBLIQUE), [HOLES])
    assert len(found) == 1
    # Rims of 190 places to some hundredths of a pixel, over 130 px: a few hundredths of a degree and some mm.
    assert turned_away(found[0].camera_from_board, OBLIQUE) < 0.25
    assert found[0].camera_from_board[:3, 3] == pytest.approx(OBLIQUE[:3, 3], abs=0.008)
    assert found[0].rms_px < 0.15


def test_no_board_is_found_where_there_is_none_or_one_of_other_holes() -> None:
    assert hole_boards_in_picture(picture(CAMERA, None), [HOLES]) == ()
    other = HoleBoard(1.2, 0.8, tuple((x, 0.0, 0.12) for x in (-0.4, -0.1, 0.3)))
    assert hole_boards_in_picture(picture(CAMERA, OBLIQUE), [other]) == ()


def test_the_middle_of_an_ellipse_is_not_the_picture_of_the_centre_and_the_circle_behind_it_is_told() -> None:
    near = se3.make(None, [0.2, 0.1, 1.0]) @ se3.exp(np.radians([20.0, 45.0, 0.0, 0, 0, 0]))
    angle = np.linspace(0, 2 * np.pi, 400, endpoint=False)
    rim = se3.apply(near, 0.12 * np.stack([np.cos(angle), np.sin(angle), np.zeros(400)], axis=1))
    plane = rim[:, :2] / rim[:, 2:]
    rows = np.column_stack([plane[:, 0] ** 2, plane[:, 0] * plane[:, 1], plane[:, 1] ** 2, plane])
    a, b, c, d, e = np.linalg.lstsq(rows, np.ones(400), rcond=None)[0]
    shape = np.array([[a, b / 2], [b / 2, c]])
    middle = np.linalg.solve(-2 * shape, [d, e])
    assert np.linalg.norm(middle - near[:2, 3] / near[2, 3]) * 700 > 3  # px at the focal length of the camera
    values, vectors = np.linalg.eigh(shape / (1 + middle @ shape @ middle))
    turn = float(np.arctan2(vectors[1, 0], vectors[0, 0]))
    ellipses = ellipses_of(picture(CAMERA, None))._replace(
        middle=middle[None], axes=1 / np.sqrt(values)[None], turn=np.array([turn])
    )
    middles, normals = circle_poses(ellipses)
    off = np.linalg.norm(0.12 * middles[0] - near[:3, 3], axis=1)
    assert off.min() < 1e-6
    assert normals[0, np.argmin(off)] == pytest.approx(-near[:3, 2], abs=1e-6)


# ---- the sweep


def test_a_board_with_holes_is_found_in_a_sweep() -> None:
    there = se3.inverse(TRUTH) @ OBLIQUE
    found = hole_boards_in_sweep(sweep(there, 0.01), [HOLES], farthest_m=8, sigma_m=0.04)
    assert len(found) == 1
    assert found[0].lidar_from_board[:3, 3] == pytest.approx(there[:3, 3], abs=0.012)
    assert turned_away(found[0].lidar_from_board, there) < 1.0
    solid = HoleBoard(1.2, 0.8, ((0.0, 0.0, 1e-6),))
    assert hole_boards_in_sweep(sweep(there, 0.01, target=solid), [HOLES], farthest_m=8, sigma_m=0.04) == ()


def test_a_board_is_whole_across_the_gap_between_two_blocks_of_lasers() -> None:
    there = se3.inverse(TRUTH) @ poses(1, seed=2)[0]
    cloud = board_scene.sweep(poses(1, seed=2)[0], 0.01)
    assert cloud.ring is not None
    middle = np.abs(
        np.arctan2(cloud.xyz[:, 2], np.hypot(cloud.xyz[:, 0], cloud.xyz[:, 1]))
        - np.arctan2(there[2, 3], np.hypot(there[0, 3], there[1, 3]))
    )
    # No ring within 1.2 deg of the board's middle: 10 cm and more where the others are 5 cm apart.
    kept = middle > np.radians(1.2)
    gapped = Cloud(cloud.xyz[kept], ring=cloud.ring[kept])
    size = (board_scene.BOARD.width_m, board_scene.BOARD.height_m)
    found = boards_in_sweep(gapped, [size], farthest_m=12, sigma_m=0.04)
    assert found
    assert found[0].lidar_from_board[:3, 3] == pytest.approx(there[:3, 3], abs=0.03)


# ---- the methods


@pytest.mark.parametrize(("method", "count"), [("velo2cam", 1), ("velo2cam", 4), ("domhof", 4)])
def test_boards_without_noise_are_solved_to_the_truth(method: str, count: int) -> None:
    result = solved(method, sights(poses(count)))
    assert result.status is Status.CONVERGED, result.reason
    assert_near(result.camera_from_lidar, 1e-4, 1e-5)
    assert result.accuracy is not None
    assert result.matches["boards"] == count


def test_a_board_that_its_own_covariance_calls_poor_pulls_the_joint_pose_less() -> None:
    seen = sights(poses(4))
    wrong = se3.exp(np.array([0.0, 0, 0, 0.0, 0.0, 0.08])) @ seen[0].in_image[0].camera_from_board
    poor = replace(seen[0].in_image[0], camera_from_board=wrong, covariance=np.diag([0.05] * 3 + [0.2] * 3) ** 2)
    seen = [replace(seen[0], in_image=(poor,)), *seen[1:]]
    errors = {name: pose_error(solved(name, seen).camera_from_lidar, TRUTH).translation_m for name in METHODS}
    assert errors["domhof"] < 0.3 * errors["velo2cam"]


def test_a_square_board_fits_four_ways_and_the_start_says_which() -> None:
    seen = sights([OBLIQUE], SQUARE)
    odd = HoleBoard(1.2, 0.8, ((-0.3, -0.2, 0.12), (0.3, -0.2, 0.12), (0.3, 0.2, 0.12)))
    assert [len(turns_of(in_sweep(OBLIQUE, board))) for board in (SQUARE, HOLES, odd)] == [4, 2, 1]
    result = solved("velo2cam", seen)
    assert pose_error(result.camera_from_lidar, TRUTH).rotation_deg < 1e-4
    assert any("4 poses fit the boards equally well" in line for line in result.warnings)
    quarter = OBLIQUE @ se3.exp(np.array([0, 0, np.pi / 2, 0, 0, 0])) @ se3.inverse(OBLIQUE) @ TRUTH
    assert pose_error(solved("velo2cam", seen, quarter).camera_from_lidar, quarter).rotation_deg < 1e-4


@pytest.mark.parametrize("method", METHODS)
def test_what_no_frame_shows_is_said_in_words(method: str) -> None:
    seen = sights(poses(1))[0]
    nobody = solved(method, [replace(seen, asked="none", in_image=())])
    assert "shows a board with holes: add it to `targets`" in nobody.reason
    no_sweep = solved(method, [replace(seen, in_sweep=())])
    assert no_sweep.status is Status.NO_FEATURES
    assert "through whose holes rays go" in no_sweep.reason
    assert np.array_equal(no_sweep.camera_from_lidar, AWAY)


def test_drawn_frames_are_calibrated_from_picture_and_sweep() -> None:
    # Head on, and turned three ways.
    boards = [poses(6, seed=1)[k] for k in (0, 3)]
    stage = velas.METHOD.build(velas.METHOD.options())
    scenes = [stage.prepare(frame(number, pose)) for number, pose in enumerate(boards)]
    for name in METHODS:
        result = solved(name, [scene.sight for scene in scenes])
        assert result.status is Status.CONVERGED, f"{name}: {result.reason}"
        assert_near(result.camera_from_lidar, 0.8, 0.04)
    fine = stage.solve(scenes, AWAY)
    assert fine.status is Status.CONVERGED, fine.reason
    assert pose_error(fine.camera_from_lidar, TRUTH).rotation_deg < 0.8
    assert "edges move the pose of the circles" in fine.reason


# ---- squares in reflectances


SQUARES = Checkerboard(7, 5, 0.1, 1.0, 0.8)


def _squares(xy: Float) -> Float:
    u, v = (xy[:, 0] + 0.4) / 0.1, (xy[:, 1] + 0.3) / 0.1
    inside = (u >= 0) & (u < 8) & (v >= 0) & (v < 6)
    return np.where(inside & ((np.floor(u) + np.floor(v)) % 2 == 0), 0.1, 0.8)


def test_a_sweep_without_intensities_shows_no_squares_and_is_refused_in_a_line() -> None:
    seen = board_scene.frame(0, poses(1, seed=1)[0])
    stage = acsc.METHOD.build(TargetOptions())
    prepared = stage.prepare(seen)
    assert prepared.sight.in_sweep == ()
    result = stage.solve([prepared], AWAY)
    assert result.status is Status.NO_FEATURES
    assert "no sweep has intensities" in result.reason
    assert "intensity" in acsc.METHOD.needs


def test_corners_of_drawn_boards_are_calibrated() -> None:
    stage = acsc.METHOD.build(TargetOptions())
    prepared = []
    for number, pose in enumerate(poses(6, seed=1)[:3]):
        seen = board_scene.frame(number, pose)
        there = se3.inverse(TRUTH) @ pose
        own = se3.apply(se3.inverse(there), seen.cloud.xyz)
        on = np.abs(own[:, 2]) < 0.1
        intensity = np.where(on, _squares(own[:, :2]), 0.3)
        prepared.append(stage.prepare(replace(seen, cloud=replace(seen.cloud, intensity=intensity))))
    assert all(each.sight.in_sweep for each in prepared)
    result = stage.solve(prepared, AWAY)
    assert result.status is Status.CONVERGED, result.reason
    assert_near(result.camera_from_lidar, 0.4, 0.02)
