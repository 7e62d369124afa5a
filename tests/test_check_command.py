"""`p2o check` says whether an extrinsic holds, and in one line what is wrong with what it was given."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import p2o
import pytest
from p2o import se3
from p2o.cli import main
from p2o.cli.check import describe_check, percent
from p2o.frames.direction import Direction, pose_direction
from p2o.results.check import CheckStatus

DATA = "synthetic:?right=false&scenes=1&frames_per_scene=2&period_s=1.5&seed=3&width_px=800&height_px=300"
CHECK = ["check", DATA, "--extractor", "depth/rings"]


@pytest.fixture(scope="module")
def frames() -> list[p2o.Frame]:
    from p2o.run.recipe import open_dataset

    dataset = open_dataset(DATA, p2o.Registry.load())
    return [dataset[0], dataset[1]]


@pytest.mark.parametrize(
    ("probability", "text"), [(1.0, "100"), (0.9961, "100"), (0.123, "12"), (0.0022, "0.22"), (5.5e-16, "5.5e-14")]
)
def test_a_probability_is_a_readable_percentage(probability: float, text: str) -> None:
    assert percent(probability) == text


@pytest.fixture(scope="module")
def truth(frames: list[p2o.Frame]) -> np.ndarray:
    assert frames[0].camera_from_lidar is not None
    return frames[0].camera_from_lidar


def written(folder: Path, content: object) -> str:
    file = folder / "extrinsic.json"
    file.write_text(json.dumps(content))
    return str(file)


def test_the_truth_of_a_simulated_scene_holds(capsys: pytest.CaptureFixture[str]) -> None:
    status = main(["check", DATA, "--extrinsic", "truth", "--json"])
    check = json.loads(capsys.readouterr().out)
    assert check["holding"] != CheckStatus.OFF
    assert status == 0
    assert len(check["frames"]) == 2
    assert check["recipe"]["data"] == DATA


def test_an_extrinsic_in_a_file_that_slipped_is_off(
    truth: np.ndarray, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    wrong = se3.exp(np.array([0.0, np.radians(1.5), 0.0, 0.0, 0.0, 0.0])) @ truth
    for content in (wrong.tolist(), {"lidar_from_camera": se3.inverse(wrong).tolist()}):
        assert main([*CHECK, "--extrinsic", written(tmp_path, content)]) == 1
        said = capsys.readouterr().out
        assert "yaw        off" in said
        assert "yaw +1.5" in said or "yaw +1.4" in said


def test_the_page_shows_the_lines_and_columns_of_the_output(
    truth: np.ndarray, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    page = (Path(__file__).parents[1] / "docs/how-to/check-an-extrinsic.md").read_text(encoding="utf-8")
    sample = page.partition("```text\n")[2].partition("```")[0]
    wrong = se3.exp(np.array([0.0, np.radians(1.0), 0.0, 0.0, 0.0, 0.0])) @ truth
    main([*CHECK, "--extrinsic", written(tmp_path, wrong.tolist())])

    def labels(text: str) -> list[list[str]]:
        """Return the words of each line, without numbers and without which axes are off."""
        lines = (re.sub(r"[-+]?\d\S*|%| (holds|off|cannot tell)\b.*", "", line) for line in text.splitlines())
        return [line.split() for line in lines if not line.startswith("  warning")]

    assert labels(sample) == labels(capsys.readouterr().out)


def test_check_and_watch_take_the_same_words_name_each_frame_and_refuse_unknown_ones(
    frames: list[p2o.Frame], truth: np.ndarray
) -> None:
    told: list[tuple[str, int, int]] = []
    words = {"frames": "1", "extractor": "depth/rings", "seed": 4, "on_frame": lambda *said: told.append(said)}
    found = p2o.check(frames, truth, **words)
    assert told == [(frames[1].name, 0, 1)]
    assert found.holding is not CheckStatus.OFF
    assert [axis.axis for axis in found.axes] == ["roll", "pitch", "yaw", "x", "y", "z"]
    probability = f"deviates this much or more with a probability of {percent(found.p_value)} %;"
    assert probability in describe_check(found)
    seen = p2o.watch(frames, truth, **{**words, "frames": None}, settle=1)
    assert told[1:] == [(frames[0].name, 0, 2), (frames[1].name, 1, 2)]
    for recipe in (found.recipe, seen.recipe):
        assert (recipe["extractor"], recipe["seed"]) == ("depth/rings", 4)
    for look in (p2o.check, p2o.watch):
        with pytest.raises(TypeError, match="unexpected keyword argument 'perturb'"):
            look(frames, truth, perturb="1deg")


def test_an_answer_that_is_asked_for_and_cannot_be_given_is_status_1(capsys: pytest.CaptureFixture[str]) -> None:
    words = [*CHECK, "--extrinsic", "truth", "--frames", "0", "--notice", "0.001deg 0.1mm"]
    assert main(words) == 0
    assert "cannot tell" in capsys.readouterr().out
    assert main([*words, "--require"]) == 1


@pytest.mark.parametrize("look", [p2o.check, lambda *given: p2o.watch(*given, settle=1)], ids=["check", "watch"])
def test_an_inverse_is_refused_however_the_warning_is_worded(
    frames: list[p2o.Frame], truth: np.ndarray, look: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    inverse = se3.inverse(truth)
    assert pose_direction(frames[0].cloud, frames[0].camera, inverse) is Direction.POSSIBLY_INVERSE
    monkeypatch.setattr(Direction, "warnings", lambda *_: ("reworded",))
    with pytest.raises(p2o.InputError, match="the extrinsic looks like lidar_from_camera"):
        look(frames, inverse)


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (["--extrinsic", "no-such.yaml"], "no-such.yaml"),
        (["--extrinsic", "{extrinsic}"], "extrinsic.json"),
        (["--extrinsic", "truth", "--notice", "0.3deg"], "--notice"),
        (["--extrinsic", "truth", "--power", "1.5"], "power"),
        (["--extrinsic", "truth", "--settle", "5"], "--watch"),
        (["--extrinsic", "truth", "--watch", "--notice", "1deg 1m"], "--notice"),
        (["--extrinsic", "truth", "--watch"], "too few frames"),
        (["--extrinsic", "truth", "--watch", "--rate", "nan"], "--rate"),
        (["--extrinsic", "truth", "--matcher", "gmm"], "gives no residuals"),
    ],
)
def test_wrong_words_are_told_in_one_line(
    words: list[str], told: str, refused: Callable[..., str], tmp_path: Path
) -> None:
    no_pose = written(tmp_path, {"camera_from_lidar": [1, 2]})
    assert told in refused([*CHECK, *(word.format(extrinsic=no_pose) for word in words)])


@pytest.mark.system
def test_a_drive_that_does_not_slip_is_watched_frame_after_frame(capsys: pytest.CaptureFixture[str]) -> None:
    drive = DATA.replace("frames_per_scene=2&period_s=1.5", "frames_per_scene=5")
    words = ["check", drive, "--extrinsic", "truth", "--watch", "--settle", "2", "--rate", "20"]
    assert main([*words, "--json"]) == 0
    watch = json.loads(capsys.readouterr().out)
    assert [frame["name"] for frame in watch["frames"]] == [f"scene-0000/{number:04d}" for number in range(5)]
    assert [frame["level"] is None for frame in watch["frames"]] == [True, True, False, False, False]
    assert (watch["rate_hz"], watch["slips"]) == (20.0, [])
