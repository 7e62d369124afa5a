"""`p2o run --rig`: a result for each camera, and a common one where the cameras are fixed to each other."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import p2o
import pytest
import yaml
from p2o import se3
from p2o.cli import main
from p2o.errors import PluginError
from p2o.results.result import RigResult
from p2o.results.result_json import result_from_dict
from p2o.run.run import run
from p2o_sim.synthetic import SyntheticOptions, truth_at

from tests.page_description import blocks, description

PLUGIN = Path(__file__).with_name("stage_plugin.py")
SPY = ["--plugin", str(PLUGIN), "--calibrator", "spy", "--witness", "none"]
SEEN = "synthetic:?cameras=front,left&scenes=2&width_px=160&height_px=64&lidar=vlp-16&right=false"
STREET = "synthetic:?cameras=front,left&width_px=621&height_px=240&place=street&right=false"


@pytest.fixture
def rig_file(tmp_path: Path) -> Path:
    """A rig file of the synthetic cameras; the body is the LiDAR as it stands."""
    places = {name: truth_at(SyntheticOptions(), 0, 0, name) for name in ("front", "left")}
    return written(tmp_path / "rig.yaml", {name: {"camera_from_body": p.tolist()} for name, p in places.items()})


def written(path: Path, cameras: dict[str, Any], **more: Any) -> Path:
    path.write_text(yaml.safe_dump({"cameras": cameras, **more}))
    return path


def test_two_cameras_of_a_rig_are_calibrated_each_and_in_common(
    rig_file: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["run", "--data", STREET, "--extractor", "depth/rings", "--rig", str(rig_file), "--json"]
    out, export = tmp_path / "out", tmp_path / "{camera}.json"
    exports = ["--export", f"json:{export}", "--export", f"kitti:{tmp_path}/{{camera}}.txt"]
    assert main([*words, "--out", str(out), *exports, "--require", "trusted"]) == 0
    run = json.loads(capsys.readouterr().out)
    stated = [(entry["frame"], entry["form"], entry["trust"], entry["written"]) for entry in run.pop("exports")]
    assert stated == [(name, form, "trusted", True) for name in ("front", "left") for form in ("json", "kitti")]
    assert set(run) == {"results", "failed", "rig", "summary"}
    assert [row["camera"] for row in run["results"]] == ["front", "left"]
    assert [row["frames"] for row in run["results"]] == [["scene-0000/front"], ["scene-0000/left"]]
    for row in run["results"]:
        assert row["verdict"]["trust"] == "trusted"
        assert row["error"]["rotation_deg"] < row["start_error"]["rotation_deg"] / 4
        again = result_from_dict(row)
        assert again.camera_from_lidar.tolist() == row["camera_from_lidar"]
        assert json.loads((out / row["camera"] / "result.json").read_text()) == row
        assert (tmp_path / f"{row['camera']}.json").exists()
    common = run["rig"]
    # The body of the file is the LiDAR itself, so the truth is the identity.
    off = np.array(common["body_from_lidar"])
    assert se3.angle_deg(off) < 0.3
    assert se3.distance_m(off) < 0.1
    assert common["verdict"]["trust"] == "trusted"
    assert common["reason"] == "one calibration of the edges of 2 cameras"
    assert common["degrees"] == 12, "both cameras are trusted alone, and differ from the common pose in six ways"
    assert common["p_value"] > 0.01
    for camera in common["cameras"]:
        place = truth_at(SyntheticOptions(), 0, 0, camera["name"])
        np.testing.assert_allclose(camera["camera_from_lidar"], place @ off, atol=1e-9)
        assert camera["error"]["rotation_deg"] == pytest.approx(se3.angle_deg(off), abs=1e-6)
    assert common["error"]["count"] == 2
    assert json.loads((out / "run.json").read_text()) == run
    drawn = [sorted(path.name for path in folder.glob("*.png")) for folder in out.glob("scene*")]
    poses = [{name.split(".")[0].split("-")[-1] for name in names} for names in drawn]
    assert poses == [{"before", "after", "common"}] * 2, "each overlay is there for all three poses"
    assert len(drawn[0]) == 9
    assert [one["ends"][1] for one in blocks(description(out / "result.html"), "slides")].count("common result") == 2
    # Python goes the same way.
    same = p2o.calibrate(STREET, extractor="depth/rings", rig=rig_file)
    assert same.rig is not None
    np.testing.assert_allclose(same.rig.body_from_lidar, off, atol=1e-9)


def test_a_plugin_that_fails_in_the_common_calibration_leaves_the_mean_and_the_reason(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    places = {
        name: {"camera_from_body": truth_at(SyntheticOptions(), 0, 0, name).tolist()} for name in ("front", "left")
    }
    plan = p2o.Recipe.of(data=STREET, extractor="depth/rings", rig={"cameras": places}).resolve(p2o.Registry.load())

    def failing(*given: object) -> RigResult:
        raise PluginError("matcher ogm raised", got="ValueError")

    monkeypatch.setenv("P2O_STRICT", "0")
    monkeypatch.setenv("P2O_DEBUG", "0")
    common = run(plan, rig_calibration=failing).rig
    assert common is not None
    assert common.body_from_lidar is not None
    assert common.reason.startswith("the mean of 2 cameras")
    assert "the calibration of all edges failed: matcher ogm raised" in common.reason
    monkeypatch.setenv("P2O_STRICT", "1")
    with pytest.raises(PluginError):
        run(plan, rig_calibration=failing)


def test_without_a_covariance_the_summary_says_why_there_is_no_common_result(
    rig_file: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["run", "--data", SEEN, *SPY, "--rig", str(rig_file)]) == 1
    assert capsys.readouterr().out.endswith(
        "rig\n"
        "  result    0 of 2 cameras have a pose with a covariance, and it takes two\n"
        "  verdict   refused\n"
        "  camera    front: left out: its result has no covariance\n"
        "  camera    left: left out: its result has no covariance\n"
    )


def test_without_a_file_frames_are_grouped_by_the_camera_that_they_name(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["run", "--data", SEEN, *SPY, "--perturb", "1deg 0.1m", "--rig", "--json"]) == 0
    run = json.loads(capsys.readouterr().out)
    assert set(run) == {"results", "failed", "summary"}, "nothing tells where the cameras are"
    assert [(row["camera"], row["frames"]) for row in run["results"]] == [
        ("front", ["scene-0000/front", "scene-0001/front"]),
        ("left", ["scene-0000/left", "scene-0001/left"]),
    ]
    assert run["results"][0]["recipe"]["rig"] is True
    assert not np.allclose(run["results"][0]["start"], run["results"][1]["start"])


def test_the_start_of_a_rig_is_one_place_of_the_lidar(tmp_path: Path) -> None:
    places = {name: truth_at(SyntheticOptions(), 0, 0, name) for name in ("front", "left")}
    guess = se3.exp(np.array([0.01, 0, 0.02, 0.1, 0, 0]))
    cameras = {name: {"camera_from_body": place.tolist()} for name, place in places.items()}
    rig, registry = {"cameras": cameras, "body_from_lidar": guess.tolist()}, p2o.Registry.load(extra_files=[PLUGIN])
    run = p2o.calibrate(SEEN, calibrator="spy", witness="none", rig=rig, registry=registry)
    for row in run.rows:
        np.testing.assert_allclose(row.result.start, places[row.camera] @ guess, atol=1e-9)
    assert run.rig is not None
    assert run.rig.body_from_lidar is None
    assert not run.solved
    assert p2o.Recipe.of(**dict(run.rows[0].result.recipe)).rig == rig


def test_a_camera_with_a_bad_frame_fails_and_the_others_are_calibrated(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = written(tmp_path / "rig.yaml", {"A": {"frames": ["*/0000", "*/0001"]}, "B": {"frames": ["*/0002"]}})
    words = ["run", "--data", "fake:?frames=3&bad=1", *SPY, "--rig", str(path), "--perturb", "1deg", "--json"]
    assert main(words) == 2
    captured = capsys.readouterr()
    run = json.loads(captured.out)
    assert [row["camera"] for row in run["results"]] == ["B"]
    assert run["failed"][0]["frame"] == "A"
    assert "leave drive/0001 out of --frames, or repair it" in run["failed"][0]["reason"]
    assert "1 of 2 cameras could not be calibrated" in captured.err


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--rig", "--joint"], "--rig: a rig has one result for each camera; expected no --joint beside it"),
        (["--rig", ""], "--rig: the rig file has no name"),
        (["--rig", "nowhere.yaml"], "nowhere.yaml"),
        (["--rig", "--export", "json:one.json"], "expected a path that contains {camera}; got json:one.json"),
        (["--joint"], "--joint: frames of 2 cameras have no pose in common; expected frames of one camera; got front,"),
    ],
)
def test_wrong_words_are_told_in_one_line(words: list[str], message: str, refused: Callable[..., str]) -> None:
    assert message in refused(["run", "--data", SEEN, *SPY, *words])
