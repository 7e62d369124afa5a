"""`picked` makes a result of a file of pairs: pose, residual of each pick, the wrong ones named, how sure it is."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from p2o import Cloud, Frame, Image, InputError, Result, Status, pose_error, se3
from p2o.cli import main
from p2o.problems.picked_pairs import PickedPairs, write_pairs
from p2o.solving import Doubt, Trust
from p2o_baselines.picked import EXAMPLE, METHOD, PickedOptions

from tests.p2o_pages.pick.rig import CAMERAS, TRUTH, moved, picks

PINHOLE = CAMERAS["pinhole"]
START = se3.exp(np.array([0.05, -0.08, 0.02, 0.3, -0.2, 0.4])) @ TRUTH


def frame(name: str = "street") -> Frame:
    image = Image(np.zeros((PINHOLE.height, PINHOLE.width, 3), np.uint8), PINHOLE)
    return Frame(name, image, Cloud(np.array([[5.0, 0, 0]])))


def result(tmp_path: Path, *names: str, **frames: PickedPairs) -> Result:
    """Return what the method makes of frames (all of them unless named) with these pairs."""
    write_pairs(tmp_path / "pairs.yaml", frames)
    stage = METHOD.build(PickedOptions(pairs=str(tmp_path / "pairs.yaml")))
    return stage.solve([stage.prepare(frame(name)) for name in names or frames], START)


def test_exact_pairs_give_the_truth_and_what_each_is_off(tmp_path: Path) -> None:
    found = result(tmp_path, street=picks(PINHOLE, 8))
    assert found.status is Status.CONVERGED
    error = pose_error(found.camera_from_lidar, TRUTH)
    assert error.rotation_deg < 0.01  # the file rounds to a thousandth of a pixel
    assert error.translation_m < 0.001
    assert list(found.residual_px) == [f"pick {i}" for i in range(1, 9)]
    assert max(found.residual_px.values()) < 0.01
    assert found.matches == {"picks": 8}
    assert found.warnings == ()
    assert found.judged is not None
    assert found.judged.start > 20 * found.judged.estimate


def test_wrong_picks_are_left_out_and_named(tmp_path: Path) -> None:
    found = result(tmp_path, street=moved(picks(PINHOLE, 10), [3, 6], np.array([[60.0, 0], [0, -40]])))
    assert found.matches == {"picks": 8}
    assert "8 of 10 picks agree" in found.reason
    assert len(found.warnings) == 2
    assert found.warnings[0].startswith("pick 4 at (")
    assert found.warnings[1].startswith("pick 7 at (")
    assert all("px off, an outlier" in text for text in found.warnings)
    assert found.residual_px["pick 4"] == pytest.approx(60, rel=0.3)


def test_a_pick_within_reach_that_the_others_contradict_is_named(tmp_path: Path) -> None:
    found = result(tmp_path, street=moved(picks(PINHOLE, 14, noise_px=0.3), [5], np.array([[0.0, 8.0]])))
    assert found.matches == {"picks": 14}
    (text,) = found.warnings
    assert text.startswith("pick 6 at (")
    assert "in the pose of the other picks" in text


def test_frames_together_give_one_pose_and_picks_are_told_apart(tmp_path: Path) -> None:
    found = result(tmp_path, a=picks(PINHOLE, 3, seed=1), b=picks(PINHOLE, 4, seed=2))
    assert found.status is Status.CONVERGED
    assert list(found.residual_px) == [*(f"a pick {i}" for i in (1, 2, 3)), *(f"b pick {i}" for i in (1, 2, 3, 4))]


def test_the_spread_of_the_picks_is_the_covariance(tmp_path: Path) -> None:
    rough, fine = (result(tmp_path, street=picks(PINHOLE, 12, noise_px=noise)) for noise in (2.0, 0.2))
    assert rough.covariance is not None
    assert fine.covariance is not None
    ratio = np.sqrt(np.diag(rough.covariance) / np.diag(fine.covariance))
    np.testing.assert_allclose(ratio, 10, rtol=0.3)
    assert rough.accuracy is not None
    assert fine.accuracy is not None
    assert not rough.accuracy.reaches(fine.accuracy.rotation_deg, fine.accuracy.translation_m)


def test_a_frame_without_picks_says_which_frames_have_some(tmp_path: Path) -> None:
    found = result(tmp_path, "other", street=picks(PINHOLE, 8))
    assert found.status is Status.TOO_FEW_MATCHES
    assert "has no picks of other; it has of: street" in found.reason
    np.testing.assert_array_equal(found.camera_from_lidar, START)


def test_too_few_picks_and_a_line_of_them_return_the_start(tmp_path: Path) -> None:
    few = result(tmp_path, street=picks(PINHOLE, 3))
    assert few.status is Status.TOO_FEW_MATCHES
    seen = np.linspace(-2, 2, 7)[:, None] * [1.0, 0.2, 0] + [0, 0, 9.0]
    line = result(tmp_path, street=PickedPairs(PINHOLE.project(seen), se3.apply(se3.inverse(TRUTH), seen)))
    assert line.status is Status.NOT_OBSERVABLE
    for found in (few, line):
        np.testing.assert_array_equal(found.camera_from_lidar, START)
        assert found.verdict.trust is Trust.REFUSED


def test_a_second_pose_that_fits_as_well_makes_the_result_ambiguous(tmp_path: Path) -> None:
    """Four corners of a small board, one of them a little before it: with noise two tilts show the same."""
    board = np.array([[-0.5, -0.5, 0], [0.5, -0.5, 0], [0.5, 0.5, 0], [-0.5, 0.5, 0.04]])
    seen = se3.apply(se3.exp(np.array([0.05, 0.1, 0, 0, 0, 10.0])), board)
    noise = np.random.default_rng(0).normal(0, 1.0, (4, 2))
    found = result(tmp_path, street=PickedPairs(PINHOLE.project(seen) + noise, se3.apply(se3.inverse(TRUTH), seen)))
    assert found.rival is not None
    assert found.rival.rotation_deg > 0.5
    assert [reason.doubt for reason in found.verdict.reasons] == [Doubt.RIVAL_POSE]


def test_a_missing_file_is_told_before_any_frame_is_read(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="file of pairs is missing"):
        METHOD.build(PickedOptions(pairs=str(tmp_path / "none.yaml")))


def test_the_example_runs_from_the_command_line(capsys: pytest.CaptureFixture[str]) -> None:
    assert EXAMPLE.is_file()
    assert main(["run", "--calibrator", "picked", "--perturb", "20deg 1m", "--witness", "none", "-v"]) == 0
    said = capsys.readouterr().out
    assert "10 of 12 picks agree" in said
    assert "pick 4 at (253.8, 257.3)" in said
    assert "an outlier" in said
