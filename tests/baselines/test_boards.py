"""Methods of boards: exact without noise, as good as noise lets them be, and refused in words where they must be."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from p2o import Camera, Checkerboard, Registry, Result, Status, pose_error, se3
from p2o.arrays import Float
from p2o.run.recipe import Recipe
from p2o_baselines.boards.board_in_picture import boards_in_picture
from p2o_baselines.boards.board_in_sweep import boards_in_sweep
from p2o_baselines.boards.pairing import paired, turns
from p2o_baselines.target_method import Sight
from p2o_baselines.targets import geiger, koo, mirzaei, zhou
from scipy.spatial.transform import Rotation

from tests.baselines.board_scene import (
    AWAY,
    BOARD,
    CAMERA,
    FISHEYE,
    TRUTH,
    assert_near,
    frame,
    in_sweep,
    pairs,
    picture,
    poses,
    sights,
    sweep,
)

METHODS = {"zhou": zhou.METHOD, "koo": koo.METHOD, "geiger": geiger.METHOD, "mirzaei": mirzaei.METHOD}
SIZE = (BOARD.width_m, BOARD.height_m)
ACFR = Path(os.environ.get("P2O_DATA", "build/data")) / "rigs/acfr_vlp16"


def solved(method: str, seen: list[Sight], start: Float = AWAY) -> Result:
    offered = METHODS[method]
    result: Result = offered.build(offered.options()).solve(seen, start)
    return result


@pytest.mark.parametrize(("method", "count"), [(zhou, 1), (zhou, 4), (koo, 4), (mirzaei, 4)])
def test_closed_forms_recover_the_pose_of_boards_without_noise(method: object, count: int) -> None:
    found = method.closed(pairs(poses(count)), AWAY)  # type: ignore[attr-defined]
    assert_near(found, 1e-5, 1e-6)


def test_three_boards_and_pieces_give_the_pose_of_their_combination() -> None:
    found = pairs(poses(3))
    assert geiger.posed([pair.board for pair in found], [pair.patch for pair in found]) == pytest.approx(
        TRUTH, abs=1e-6
    )


@pytest.mark.parametrize("seed", range(2))
def test_no_rotation_is_too_far_for_the_minima_of_the_polynomial(seed: int) -> None:
    turn = se3.make(Rotation.random(random_state=seed).as_matrix(), [0.3, -0.2, 0.5])
    found = [
        replace(pair, patch=in_sweep(turn @ se3.inverse(TRUTH) @ pair.board.camera_from_board))
        for pair in pairs(poses(5, seed))
    ]
    assert mirzaei.closed(found, np.eye(4)) == pytest.approx(TRUTH @ se3.inverse(turn), abs=1e-5)


@pytest.mark.parametrize("method", METHODS)
def test_boards_without_noise_are_solved_to_the_truth_from_any_start(method: str) -> None:
    far = se3.exp(np.array([0.5, -0.4, 0.3, 0.5, -0.5, 0.4])) @ TRUTH
    result = solved(method, sights(poses(5)), far)
    assert result.status is Status.CONVERGED, result.reason
    assert_near(result.camera_from_lidar, 1e-4, 1e-5)
    assert result.matches["boards"] == 5
    assert result.accuracy is not None
    assert result.covariance is not None


@pytest.mark.parametrize("method", METHODS)
def test_noise_moves_a_pose_by_no_more_than_its_likely_error_says(method: str) -> None:
    # A plane of 96 points that scatter by 2 cm over 1.0 x 0.8 m tilts by 0.02 / sqrt(96) / 0.25 = 0.5 deg and moves by
    # 2 mm; ten of them, by a third of both. Three deviations of that bound the error.
    result = solved(method, sights(poses(10), noise_px=0.2, noise_m=0.02))
    error = pose_error(result.camera_from_lidar, TRUTH)
    assert error.rotation_deg < 3 * 0.5 / np.sqrt(10) * np.sqrt(3)
    assert error.translation_m < 0.03
    assert result.accuracy is not None
    assert error.rotation_deg < 1.6 * result.accuracy.rotation_deg_95
    assert error.translation_m < 1.6 * result.accuracy.translation_m_95


@pytest.mark.parametrize("method", ["koo", "geiger", "mirzaei"])
def test_fewer_than_three_boards_are_refused_by_methods_of_planes(method: str) -> None:
    result = solved(method, sights(poses(2)))
    assert result.status is Status.TOO_FEW_MATCHES
    assert "of 2 boards" in result.reason
    assert "3 or more with different orientations are needed" in result.reason
    assert np.array_equal(result.camera_from_lidar, AWAY)


def test_boards_that_no_pose_brings_together_are_refused() -> None:
    seen = sights(poses(3))
    # Three pieces whose normals enclose other angles than those of the boards.
    other = [in_sweep(se3.inverse(TRUTH) @ pose) for pose in poses(3, seed=9)]
    result = solved("geiger", [replace(sight, in_sweep=(piece,)) for sight, piece in zip(seen, other, strict=True)])
    assert result.status is Status.TOO_FEW_MATCHES
    assert "0 of 3 boards" in result.reason


@pytest.mark.parametrize(
    ("method", "turn", "reason"), [("koo", 0.0, "parallel"), ("mirzaei", 0.0, "parallel"), ("koo", 0.3, "in one plane")]
)
def test_boards_that_face_one_way_or_turn_about_one_axis_only_are_refused(
    method: str, turn: float, reason: str
) -> None:
    boards = [
        se3.make(None, [0.3 * k, 0.1 * k, 3.0 + 0.3 * k]) @ se3.exp(np.array([0, turn * k, 0, 0, 0, 0]))
        for k in (-2, -1, 1, 2)
    ]
    result = solved(method, sights(boards))
    assert result.status is Status.NOT_OBSERVABLE
    assert reason in result.reason


def test_one_board_whose_upper_and_lower_side_no_ring_crosses_is_refused() -> None:
    seen = sights(poses(1))[0]
    patch = seen.in_sweep[0]
    upright = patch.side % 2 == 1
    patch = replace(patch, ends=patch.ends[upright], side=patch.side[upright], ends_m=patch.ends_m[upright])
    result = solved("zhou", [replace(seen, in_sweep=(patch,))])
    assert result.status is Status.NOT_OBSERVABLE
    assert "a direction of the pose is not observable" in result.reason


def test_pictures_and_sweeps_without_boards_are_told_apart() -> None:
    seen = sights(poses(1))[0]
    for changed, reason in (
        ({"asked": "none", "in_image": ()}, "add it to `targets` of frame.yaml"),
        ({"in_image": ()}, "none of 1 images shows a board"),
        ({"in_sweep": ()}, "no sweep has an isolated plane of 1 x 0.8 m"),
    ):
        result = solved("zhou", [replace(seen, **changed)])  # type: ignore[arg-type]
        assert result.status is Status.NO_FEATURES
        assert reason in result.reason


def test_of_several_pieces_the_one_is_the_board_that_one_pose_explains_in_all_frames() -> None:
    wrong = in_sweep(se3.inverse(TRUTH) @ se3.make(None, [1.5, 0.3, 4.0]))
    seen = [replace(sight, in_sweep=(wrong, *sight.in_sweep)) for sight in sights(poses(4))]
    far = se3.exp(np.array([0.5, -0.4, 0.3, 0.5, -0.5, 0.4])) @ TRUTH
    pairing = paired(seen, far)
    assert pairing is not None
    assert all(pair.patch is sight.in_sweep[1] for pair, sight in zip(pairing.pairs, seen, strict=True))
    assert pose_error(pairing.camera_from_lidar, TRUTH).rotation_deg < 0.01


def test_one_board_may_be_turned_by_half_a_turn_and_the_start_says_which_it_is() -> None:
    seen = sights(poses(1))
    assert [len(turns(size)) for size in (SIZE, (1.0, 1.0))] == [2, 4]
    result = solved("zhou", seen)
    assert pose_error(result.camera_from_lidar, TRUTH).rotation_deg < 1e-4
    assert any("2 poses fit the boards equally well" in line for line in result.warnings)
    around, middle = se3.exp(np.array([0, 0, np.pi, 0, 0, 0])), seen[0].in_image[0].camera_from_board
    other = middle @ around @ se3.inverse(middle) @ TRUTH
    assert pose_error(solved("zhou", seen, other).camera_from_lidar, other).rotation_deg < 1e-4


@pytest.mark.parametrize("camera", [CAMERA, FISHEYE], ids=["pinhole", "fisheye"])
def test_a_board_is_found_in_a_picture_of_any_camera(camera: Camera) -> None:
    truth = poses(1, seed=3)[0]
    found = boards_in_picture(picture(camera, truth), [BOARD])
    assert len(found) == 1
    # Corners to a tenth of a pixel; 35 of them over 150 px or more tell the board to some mm and a fraction of a deg.
    assert found[0].uv == pytest.approx(camera.project(se3.apply(found[0].camera_from_board, BOARD.corners)), abs=0.3)
    assert found[0].rms_px < 0.15
    assert found[0].normal == pytest.approx(-truth[:3, 2], abs=0.02)
    assert found[0].camera_from_board[:3, 3] == pytest.approx(truth[:3, 3], abs=0.02)


def test_no_board_of_another_pattern_is_found() -> None:
    truth = poses(1, seed=3)[0]
    assert boards_in_picture(picture(CAMERA, truth), [Checkerboard(9, 6, 0.1, 1.2, 1.0)]) == ()
    assert boards_in_picture(picture(CAMERA, None), [BOARD]) == ()


@pytest.mark.parametrize("apex_m", [0.0, 0.2])
def test_a_board_is_found_in_a_sweep_by_its_size_alone(apex_m: float) -> None:
    truth = poses(1, seed=2)[0]
    found = boards_in_sweep(sweep(truth, 0.015, apex_m=apex_m), [SIZE], farthest_m=12, sigma_m=0.04)
    there = se3.inverse(TRUTH) @ truth
    best = min(found, key=lambda board: float(np.linalg.norm(board.lidar_from_board[:3, 3] - there[:3, 3])))
    # Rings are 1 deg apart, so 7 cm on the board, and turned sides cross several: a third of that for the middle.
    assert best.lidar_from_board[:3, 3] == pytest.approx(there[:3, 3], abs=0.025)
    assert np.degrees(np.arccos(min(1.0, abs(best.normal @ there[:3, 2])))) < 1.0
    assert best.sigma_m == pytest.approx(0.015, rel=0.3)
    assert len(best.ends) >= 6


def test_a_board_in_a_motion_compensated_sweep_is_where_its_points_are() -> None:
    """All is measured 10 ms after the picture from a car that goes on and turns: the board moves with its points."""
    truth, twist = poses(1, seed=2)[0], np.array([0.0, 0, 0.5, 4.0, 0, 0])
    still = sweep(truth, 0.015, apex_m=0.12)
    raw = replace(still, time_s=np.full(len(still), 0.01))
    before, after = (
        boards_in_sweep(cloud, [SIZE], farthest_m=12, sigma_m=0.04)[0] for cloud in (raw, raw.untwisted(twist))
    )
    on_time = se3.exp(0.01 * twist)
    np.testing.assert_allclose(after.xyz, se3.apply(on_time, before.xyz), atol=1e-9)
    np.testing.assert_allclose(after.lidar_from_board, on_time @ before.lidar_from_board, atol=1e-4)


def test_a_wall_and_a_board_of_another_size_are_none() -> None:
    truth = poses(1, seed=2)[0]
    assert boards_in_sweep(sweep(None, 0.015), [SIZE], farthest_m=12, sigma_m=0.04) == ()
    assert boards_in_sweep(sweep(truth, 0.015), [(1.6, 1.3)], farthest_m=12, sigma_m=0.04) == ()
    assert boards_in_sweep(sweep(truth, 0.015), [(0.5, 0.4)], farthest_m=12, sigma_m=0.04) == ()


def test_drawn_frames_are_calibrated_from_picture_and_sweep() -> None:
    seen = [frame(number, pose) for number, pose in enumerate(poses(5, seed=1))]
    first = zhou.METHOD.build(zhou.METHOD.options())
    prepared = [first.prepare(each) for each in seen]
    for name in METHODS:
        result = solved(name, prepared)
        assert result.status is Status.CONVERGED, f"{name}: {result.reason}"
        # Ranges off by 1.5 cm over some 300 points a board: tilts of 0.2 deg, of which five average to 0.1.
        assert_near(result.camera_from_lidar, 0.4, 0.03)


@pytest.mark.skipif(not ACFR.is_dir(), reason=f"{ACFR} is not there")
def test_boards_of_a_fisheye_and_a_vlp16_are_found_and_calibrated() -> None:
    board = Checkerboard(5, 7, 0.095, 0.61, 0.85)
    dataset = Recipe.of(data=f"folder:{ACFR}").resolve(Registry.load()).dataset()
    stage = zhou.METHOD.build(zhou.METHOD.options())
    frames = [replace(dataset[number], targets=(board,)) for number in (0, 9, 14)]
    prepared = [stage.prepare(each) for each in frames]
    assert all(len(sight.in_image) == 1 and sight.in_sweep for sight in prepared)
    truth = frames[0].camera_from_lidar
    assert truth is not None
    result = stage.solve(prepared, se3.exp(np.array([0.1, -0.1, 0.1, 0.1, 0.1, 0.1])) @ truth)
    assert result.matches["boards"] == 3
    # The reference is good to 0.3 deg and 2 cm, three boards to some 0.5 deg and 2 cm: three of both together.
    assert_near(result.camera_from_lidar, 1.75, 0.085, truth)
