"""`p2o data show` and `p2o data suggest`: what is written and said before anything is calibrated."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
from p2o.cli import main
from p2o.frames.selection import spread
from p2o_testing import stage

from tests.page_description import blocks, description

STAGE = ["--plugin", str(Path(__file__).with_name("stage_plugin.py"))]


def saved(path: Path, text: str) -> str:
    path.write_text(text)
    return str(path)


# ---- show


def test_show_writes_a_picture_a_frame_and_a_page_and_says_so(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["data", "show", "fake:", *STAGE, "--out", str(tmp_path / "new")]) == 0
    out = capsys.readouterr().out
    for name in ("drive_0000.png", "drive_0001.png", "index.html"):
        assert (tmp_path / "new" / name).is_file()
        assert str(tmp_path / "new" / name) in out
    assert "points in the image, at the calibration that the data give" in out
    html = (tmp_path / "new" / "index.html").read_text()
    assert [one["source"][:23] for one in blocks(description(html), "image")] == ["data:image/jpeg;base64,"] * 2


def test_the_picture_shows_the_sweep_at_a_start_of_a_file_or_in_words_by_range_above_reflectance(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    pose = np.array(stage.frame().camera_from_lidar)
    pose[:3, 3] += [0.3, 0.1, 0.0]
    file = saved(tmp_path / "start.txt", "\n".join(" ".join(map(str, row)) for row in pose.tolist()))
    guess = "x forward, z up; camera looks forward"
    words, pictures = ["data", "show", "fake:?frames=1", *STAGE, "--out", str(tmp_path)], []
    starts = [[], ["--start", file], ["--start", "roughly", guess], ["--start", f"roughly {guess}"]]
    for start, said in zip(starts, ("the calibration that", file, f"roughly {guess}", f"roughly {guess}"), strict=True):
        assert main([*words, *start]) == 0
        assert re.search(f"at (the pose of )?{re.escape(said)}", capsys.readouterr().out)
        pictures.append(cv2.imread(str(tmp_path / "drive_0000.png")))
    camera = stage.frame().camera
    half = camera.height + 22
    assert pictures[0].shape == (2 * half, camera.width, 3)
    assert np.abs(pictures[0][22:half].astype(int) - pictures[0][half + 22 :]).mean() > 5
    assert [np.array_equal(pictures[0], other) for other in pictures[1:]] == [False] * 3
    assert main([*words, "--start", file, "--pose", "truth"]) == 2
    assert "the pose is said twice" in capsys.readouterr().err


def test_at_most_eight_frames_are_shown_spread_evenly(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["data", "show", "fake:?frames=15", *STAGE, "--out", str(tmp_path)]) == 0
    assert "8 frames of 15" in capsys.readouterr().out
    assert sorted(p.name for p in tmp_path.glob("*.png"))[::7] == ["drive_0000.png", "drive_0014.png"]
    assert spread(range(15), 8) == list(range(0, 15, 2))
    assert spread([3, 1], 8) == [3, 1]
    assert spread(range(9), 1) == [0]


def test_a_pose_that_shows_nothing_is_one_clear_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    turned = saved(tmp_path / "behind.txt", "0 -1 0 0\n0 0 -1 500\n1 0 0 -5000\n0 0 0 1\n")
    words = ["data", "show", "fake:?frames=1", *STAGE, "--out", str(tmp_path / "out")]
    assert main([*words, "--start", turned]) == 2
    error = capsys.readouterr().err.splitlines()[-1]
    assert "no point of the sweep is in the image" in error
    assert "all points behind the camera" in error


def test_a_frame_without_any_pose_says_what_to_give() -> None:
    from p2o import InputError
    from p2o.run.given_pose import GivenPose
    from p2o.run.recipe import Recipe

    bare = stage.frame().without_truth()
    given = GivenPose.of(Recipe.of(data="fake:"))
    with pytest.raises(InputError, match="there is no pose to look from"):
        given.of_frame(bare, 0)
    with pytest.raises(InputError, match="the truth is not known"):
        GivenPose.of(Recipe.of(data="fake:"), "truth").of_frame(bare, 0)


def test_a_bad_frame_does_not_keep_the_others_from_being_shown(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["data", "show", "fake:?frames=3&bad=1", *STAGE, "--out", str(tmp_path)]) == 2
    captured = capsys.readouterr()
    assert "drive/0001: not shown" in captured.err
    assert "2 frames" in captured.out
    assert len(list(tmp_path.glob("*.png"))) == 2


# ---- suggest


SUGGEST = ["data", "suggest", "synthetic:?scenes=3&seed=4", "--extractor", "depth/rings"]


def test_suggest_prints_frames_to_paste_and_what_each_adds(capsys: pytest.CaptureFixture[str]) -> None:
    assert main([*SUGGEST, "--count", "2", "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert len(told["steps"]) == 2
    assert told["frames"] == ",".join(str(i) for i in sorted(step["index"] for step in told["steps"]))
    assert told["steps"][0]["gain"] > told["steps"][1]["gain"] > 0
    assert told["steps"][1]["accuracy"]["rotation_deg"] < told["steps"][0]["accuracy"]["rotation_deg"]
    assert told["enough"] is None
    assert main([*SUGGEST, "--count", "2"]) == 0
    assert f"--frames {told['frames']} --joint" in capsys.readouterr().out.splitlines()[-1]


def test_suggest_says_whether_frames_are_enough_and_what_stays_open(capsys: pytest.CaptureFixture[str]) -> None:
    assert main([*SUGGEST, "--require", "5deg 1m"]) == 0
    out = capsys.readouterr().out
    assert "enough for 5 deg and 1 m" in out
    assert "not enough" not in out
    assert main([*SUGGEST, "--require", "0.001deg 0.0001m"]) == 1
    assert "not enough for 0.001 deg and 0.0001 m: " in capsys.readouterr().out
    same = ["data", "suggest", "fake:?frames=3", *STAGE, "--extractor", "depth/rings", "--count", "2", "--json"]
    assert main(same) == 0
    first, second = json.loads(capsys.readouterr().out)["steps"]
    assert first["places"] > 10
    assert second["places"] == 0, "the same frame under another name adds nothing"


def test_suggested_likely_errors_are_near_those_that_a_run_states(capsys: pytest.CaptureFixture[str]) -> None:
    data = ["synthetic:?scenes=2&seed=4", "--extractor", "depth/rings"]
    assert main(["data", "suggest", *data, "--pose", "truth", "--count", "2", "--json"]) == 0
    told = json.loads(capsys.readouterr().out)["steps"][-1]["accuracy"]
    words = ["--joint", "--perturb", "1deg 0.1m", "--json"]
    assert main(["run", "--data", *data, *words]) == 0
    stated = json.loads(capsys.readouterr().out)["results"][0]["accuracy"]
    assert told["rotation_deg"] == pytest.approx(stated["rotation_deg"], rel=0.6)
    assert told["translation_m"] == pytest.approx(stated["translation_m"], rel=0.6)


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--require", "trusted"], "the accuracy is missing"),
        (["--require", "0.1deg"], "the accuracy needs two parts"),
        (["--pose", "truth", "--perturb", "1deg 0.1m"], "the pose is said twice"),
        (["--frames", "99"], "--frames"),
    ],
)
def test_wrong_words_are_one_clear_line(words: list[str], said: str, refused: Callable[..., str]) -> None:
    assert said in refused(["data", "suggest", "fake:", *STAGE, "--extractor", "depth/rings", *words])
