"""Picks give a pose: exactly where they are exact, without the wrong ones, and with how sure it is."""

from __future__ import annotations

import numpy as np
import pytest
from p2o import Camera, InputError, Status, pose_error, se3
from p2o.problems.picked_pairs import PickedPairs
from p2o.problems.picked_pose import PickedFrame, PickedPose, picks_off_px, solve_picks

from tests.p2o_pages.pick.rig import CAMERAS, TRUTH, moved, picks

PINHOLE = CAMERAS["pinhole"]


def solved(pairs: PickedPairs, camera: str = "pinhole", trials: int = 500) -> PickedPose:
    return solve_picks([PickedFrame("frame", CAMERAS[camera], pairs)], trials=trials)


@pytest.mark.parametrize("camera", CAMERAS)
@pytest.mark.parametrize("count", [4, 15, 30])
def test_exact_pairs_give_the_truth(camera: str, count: int) -> None:
    """To 1e-6 rad and m; with 30 picks triples are drawn at random, below that all are tried."""
    found = solved(picks(CAMERAS[camera], count, seed=count), camera)
    assert found.status is Status.CONVERGED, found.reason
    assert found.camera_from_lidar is not None
    assert np.abs(se3.log(found.camera_from_lidar @ se3.inverse(TRUTH))).max() < 1e-6
    assert found.agrees.all()
    assert found.off_px.max() < 1e-4


@pytest.mark.parametrize("camera", CAMERAS)
@pytest.mark.parametrize("seed", range(2))
def test_of_twenty_percent_wrong_picks_none_has_a_say(camera: str, seed: int) -> None:
    pairs = picks(CAMERAS[camera], 15, seed=seed, noise_px=1.0)
    wrong = [2, 7, 11]
    bad = moved(pairs, wrong, np.array([[55.0, 0], [-40, 30], [0, -58]]))
    found = solved(bad, camera)
    assert np.flatnonzero(~found.agrees).tolist() == wrong
    assert (found.off_px[wrong] > 20).all()
    keep = np.setdiff1d(np.arange(15), wrong)
    clean = solved(PickedPairs(pairs.uv[keep], pairs.xyz[keep]), camera)
    assert found.camera_from_lidar is not None
    np.testing.assert_allclose(found.camera_from_lidar, clean.camera_from_lidar, atol=1e-7)


def test_how_wrong_a_pose_is_said_to_be_is_how_wrong_poses_are() -> None:
    """Of 30 draws of the noise half to nine tenths are within what two of three should be, nearly all within 95 %."""
    inside, widely, ratio = [], [], []
    for seed in range(30):
        found = solved(picks(PINHOLE, 8, seed=seed, noise_px=1.5), trials=60)
        assert found.camera_from_lidar is not None
        error = pose_error(found.camera_from_lidar, TRUTH)
        inside += [error.rotation_deg < found.accuracy.rotation_deg, error.translation_m < found.accuracy.translation_m]
        widely += [error.rotation_deg < found.accuracy.rotation_deg_95]
        ratio += [error.rotation_deg / found.accuracy.rotation_deg]
    assert 0.5 < np.mean(inside) < 0.95
    assert np.mean(widely) > 0.85
    assert 1 / 3 < np.median(ratio) < 1.5


def test_frames_of_one_rig_are_solved_together() -> None:
    """Three picks in each of two cameras: neither frame alone has enough."""
    parts = [PickedFrame(name, CAMERAS[name], picks(CAMERAS[name], 3, seed=5)) for name in ("pinhole", "fisheye")]
    assert solve_picks(parts[:1]).status is Status.TOO_FEW_MATCHES
    both = solve_picks(parts)
    assert both.status is Status.CONVERGED
    assert both.frame_of.tolist() == [0, 0, 0, 1, 1, 1]
    np.testing.assert_allclose(both.camera_from_lidar, TRUTH, atol=1e-6)


@pytest.mark.parametrize("count", [0, 1, 3])
def test_fewer_than_four_picks_are_too_few(count: int) -> None:
    found = solved(picks(PINHOLE, count))
    assert found.status is Status.TOO_FEW_MATCHES
    assert "at least 4 are needed" in found.reason
    assert found.camera_from_lidar is None


@pytest.mark.parametrize(
    ("size", "word"), [([4.0, 0, 0], "on a line"), ([4.0, 2, 0], "in a plane"), ([0, 0, 0], "place")]
)
def test_points_on_a_line_in_a_plane_or_in_one_place_are_refused(size: list[float], word: str) -> None:
    """Four poses may hold the corners of a board alike; around a line every pose does."""
    rng = np.random.default_rng(0)
    turn = se3.exp(np.array([0.3, -0.2, 0.4, 0, 0, 12.0]))
    seen = se3.apply(turn, rng.uniform(-0.5, 0.5, (9, 3)) * size)
    pairs = PickedPairs(PINHOLE.project(seen), se3.apply(se3.inverse(TRUTH), seen))
    found = solved(pairs)
    assert found.status is Status.NOT_OBSERVABLE
    assert word in found.reason
    assert found.camera_from_lidar is None


def test_picks_that_contradict_one_another_or_of_which_only_a_line_agrees_are_refused() -> None:
    rng = np.random.default_rng(3)
    pairs = picks(PINHOLE, 12)
    found = solved(PickedPairs(rng.permutation(pairs.uv), pairs.xyz))
    assert found.status is Status.TOO_FEW_MATCHES
    assert "of 12 picks agree" in found.reason
    assert "7 are needed" in found.reason
    seen = np.array([[-3.0, 0.1, 10], [-2, 0.1, 10], [0, 0.1, 10], [1, 0.1, 10], [2.5, 0.1, 10], [0, -1, 14]])
    pairs = PickedPairs(PINHOLE.project(seen), se3.apply(se3.inverse(TRUTH), seen))
    found = solved(moved(pairs, [5], np.array([[0.0, 90.0]])))
    assert found.status is Status.NOT_OBSERVABLE
    assert "on a line" in found.reason or "determine" in found.reason or "in a plane" in found.reason


def test_a_pick_outside_of_the_image_or_where_the_fisheye_sees_nothing_names_its_frame() -> None:
    with pytest.raises(InputError, match=r"frame.*pick 2 lies outside of the image"):
        solved(moved(picks(PINHOLE, 5), [1], np.array([[5000.0, 0]])))
    wide = Camera("OPENCV_FISHEYE", 1000, 800, (300, 300, 500, 400, 0, 0, 0, 0))  # a quarter turn is 471 px
    pairs = PickedPairs(np.array([[500.0, 400], [0, 0]]), np.ones((2, 3)))
    with pytest.raises(InputError, match="sees nothing at pick 2"):
        solve_picks([PickedFrame("frame", wide, pairs)])


def test_what_picks_are_off_at_a_pose_is_told_and_the_same_picks_give_the_same_bits() -> None:
    frame = PickedFrame("frame", PINHOLE, moved(picks(PINHOLE, 5), [3], np.array([[0.0, 4.0]])))
    off = picks_off_px([frame], TRUTH)
    assert off[[0, 1, 2, 4]].max() < 1e-6
    assert off[3] == pytest.approx(4, rel=0.3)
    pairs = picks(PINHOLE, 30, noise_px=1.0)
    np.testing.assert_array_equal(solved(pairs).camera_from_lidar, solved(pairs).camera_from_lidar)
