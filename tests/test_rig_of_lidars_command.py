"""`p2o rig`: extrinsics of several LiDARs and cameras from results, sweeps and known transforms."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from p2o import Float, Status, se3
from p2o.cli import main
from p2o.geometry.pose_text import read_pose
from p2o.results.result_json import result_to_dict
from p2o_sim.synthetic import SyntheticOptions, body_from_lidar, truth_at

from tests.p2o_rig.random_rigs import random_rig
from tests.p2o_rig.result_files import COVARIANCE, TOO_UNSURE, exact, result, write_results, write_sensors
from tests.pages import blocks, shell_blocks

PAGE = "docs/how-to/several-lidars.md"
CAMERAS = ("front", "left")
AT = "-0.8,0.6,-0.3,10,0,60"


@pytest.fixture
def truth() -> dict[str, Float]:
    """True poses of two LiDARs and two cameras in the frame of the first LiDAR."""
    rig = random_rig(np.random.default_rng(1), 2, 2, noise=0.0).truth
    return dict(zip(("top", "side", *CAMERAS), rig.values(), strict=True))


@pytest.fixture
def sensors(tmp_path: Path, truth: dict[str, Float]) -> dict[str, Any]:
    """The content of a file of sensors, whose files of results are in the temporary folder."""
    for lidar in ("top", "side"):
        write_results(tmp_path / f"{lidar}.json", [(camera, exact(truth, camera, lidar)) for camera in CAMERAS])
    return {"lidars": {"top": {"results": ["top.json"]}, "side": {"results": ["side.json"]}}}


def combined(content: dict[str, Any], folder: Path, capsys: pytest.CaptureFixture[str]) -> tuple[int, dict[str, Any]]:
    status = main(["rig", str(write_sensors(folder / "sensors.yaml", content)), "--json"])
    return status, json.loads(capsys.readouterr().out)


def test_exact_results_give_the_true_poses_as_text_json_and_yaml(
    sensors: dict[str, Any], truth: dict[str, Float], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = write_sensors(tmp_path / "sensors.yaml", sensors)
    assert main(["rig", str(file), "--out", str(tmp_path / "out"), "--json"]) == 0
    rig = json.loads(capsys.readouterr().out)
    assert json.loads((tmp_path / "out/rig.json").read_text()) == rig
    assert not (tmp_path / "out/sweeps.png").exists()
    assert (rig["reference"], rig["verdict"]["trust"], rig["degrees"]) == ("top", "trusted", 6)
    assert [(sensor["name"], sensor["kind"]) for sensor in rig["sensors"]] == [
        ("top", "lidar"), ("side", "lidar"), ("front", "camera"), ("left", "camera")
    ]  # fmt: skip
    written = yaml.safe_load((tmp_path / "out/extrinsics.yaml").read_text())["reference_from_sensor"]
    for sensor in rig["sensors"]:
        name = sensor["name"]
        np.testing.assert_allclose(sensor["reference_from_sensor"], truth[name], atol=1e-9)
        np.testing.assert_allclose(read_pose(name, written[name], tmp_path)[0], truth[name], atol=1e-9)
    assert all(edge["used"] and edge["check"]["chi_square"] < 1e-9 for edge in rig["edges"])
    assert main(["rig", str(file)]) == 0
    text = capsys.readouterr().out
    assert "4 of 4 sensors, 4 edges, in the frame of top" in text
    assert "front-side (result): side.json; 0.000 deg and 0.0000 m from all others" in text


def test_a_wrong_result_among_known_transforms_is_named(
    sensors: dict[str, Any], truth: dict[str, Float], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    wrong = se3.exp(np.radians([0, 3.0, 0, 0, 0, 0])) @ se3.inverse(truth["left"]) @ truth["side"]
    rows = [("front", exact(truth, "front", "side")), ("left", result(wrong, COVARIANCE))]
    write_results(tmp_path / "side.json", rows)
    known = [
        {"parent": parent, "child": child, "pose": (se3.inverse(truth[parent]) @ truth[child]).tolist(), "sigma": sigma}
        for parent, child, sigma in (("front", "left", "0.05deg 2mm"), ("top", "side", "0.3deg 0.1m"))
    ]
    status, rig = combined({**sensors, "known": known}, tmp_path, capsys)
    assert status == 1
    [one] = rig["contradictions"]
    assert one["edges"] == ["left-side (result)"]
    assert "about y" in one["text"]
    assert rig["verdict"]["trust"] == "trusted", "the rest is a loop that agrees"
    for sensor in rig["sensors"]:
        np.testing.assert_allclose(sensor["reference_from_sensor"], truth[sensor["name"]], atol=1e-9)


def test_sensors_without_an_edge_are_named_with_the_cause(
    sensors: dict[str, Any], truth: dict[str, Float], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    refused = result(np.eye(4), None, status=Status.TOO_FEW_MATCHES, reason="3 pairs")
    unusable = result(np.eye(4), np.full((6, 6), np.nan))
    write_results(tmp_path / "side.json", [("front", refused), ("left", unusable)])
    status, rig = combined({**sensors, "cameras": ["front", "left", "rear"]}, tmp_path, capsys)
    assert status == 1
    assert rig["verdict"]["trust"] == "doubtful"
    assert "there is no pose of side, rear" in rig["verdict"]["reasons"]
    by_name = {sensor["name"]: sensor for sensor in rig["sensors"]}
    assert by_name["rear"]["verdict"] == {"trust": "refused", "reasons": "no edge connects rear with top"}
    assert "front-side (result) is left out" in by_name["side"]["verdict"]["reasons"]
    assert [one["name"] for one in rig["left_out"]] == ["front-side (result)", "left-side (result)"]
    assert rig["left_out"][0]["reason"] == "too-few-matches: 3 pairs"
    np.testing.assert_allclose(by_name["left"]["reference_from_sensor"], truth["left"], atol=1e-9)


def test_a_result_that_is_not_trusted_is_confirmed_by_a_loop_only(
    sensors: dict[str, Any], truth: dict[str, Float], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rows = [(camera, exact(truth, camera, "side", verdict=TOO_UNSURE)) for camera in CAMERAS]
    write_results(tmp_path / "side.json", rows)
    assert combined(sensors, tmp_path, capsys)[0] == 0
    write_results(tmp_path / "side.json", rows[:1])
    status, rig = combined(sensors, tmp_path, capsys)
    assert status == 1
    assert rig["verdict"]["reasons"] == "the poses of side are not confirmed"
    side = next(sensor for sensor in rig["sensors"] if sensor["name"] == "side")
    assert side["verdict"]["trust"] == "doubtful"
    np.testing.assert_allclose(side["reference_from_sensor"], truth["side"], atol=1e-9)


def test_one_result_of_any_run_is_assigned_to_a_camera_which_may_be_the_reference(
    sensors: dict[str, Any], truth: dict[str, Float], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "one.json").write_text(json.dumps(result_to_dict(exact(truth, "left", "side"))))
    write_results(tmp_path / "side.json", [("front", exact(truth, "front", "side"))])
    sensors["lidars"]["side"]["results"] = ["side.json", "one.json#left"]
    status, rig = combined({**sensors, "reference": "left"}, tmp_path, capsys)
    assert status == 0
    for sensor in rig["sensors"]:
        expected = se3.inverse(truth["left"]) @ truth[sensor["name"]]
        np.testing.assert_allclose(sensor["reference_from_sensor"], expected, atol=1e-9)
    assert rig["edges"][-1]["name"] == "left-side (result)"
    assert rig["edges"][-1]["source"] == "one.json#left"


KNOWN = {"parent": "front", "child": "left", "pose": np.eye(4).tolist(), "sigma": "1deg 1m"}


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"lidars": {}}, "lidars"),
        ({"lidar": {}}, "unknown key 'lidar'"),
        ({"lidars": {"top": {"result": ["top.json"]}}}, "unknown key of LiDAR top 'result'"),
        ({"lidars": {"top": {"results": ["../../nowhere/top.json"]}}}, "the file of results is missing"),
        ({"lidars": {"top": {"results": ["text.json"]}}}, "the file of results is not JSON"),
        ({"lidars": {"top": {"results": ["top.json", "top.json"]}}}, "camera front and LiDAR top have two results"),
        ({"lidars": {"top": {"results": ["top.json#front"]}}}, "#front names the camera of one result"),
        ({"lidars": {"top": {"results": ["no-camera.json"]}}}, "a result names no camera"),
        ({"lidars": {"top": {"results": ["broken.json"]}}}, "broken.json: .*camera_from_lidar"),
        ({"lidars": {"a b": {}}}, "name of a camera"),
        ({"cameras": ["front"]}, "unknown camera in top.json 'left'"),
        ({"cameras": ["front", "left", "top"]}, "top is both a camera and a LiDAR"),
        ({"reference": "frnt"}, "unknown reference 'frnt'; .* did you mean front"),
        ({"known": [{**KNOWN, "child": "lft"}]}, "unknown sensor in known.0 'lft'; .* did you mean left"),
        ({"known": [{**KNOWN, "child": "front"}]}, "an edge connects front with itself"),
        ({"known": [{**KNOWN, "pose": np.diag([1, 1, 2, 1]).tolist()}]}, "the rotation of known.0.pose is not ortho"),
        ({"known": [{**KNOWN, "pose": "front.json"}]}, "known.0.pose is not a pose"),
        ({"known": [{**KNOWN, "sigma": "0.1deg"}]}, "known.0.sigma: the accuracy needs two parts"),
        ({"known": [{**KNOWN, "sigma": "nandeg 1m"}]}, "known.0.sigma: cannot read the size"),
        ({"known": [KNOWN, {**KNOWN, "parent": "left", "child": "front"}]}, "left and front is given twice"),
        ({"known": [{"parent": "front"}]}, "known.0.child is missing"),
        ({"moments": 2}, "moments is out of bounds"),
        ({"lidars": {"top": {"sweeps": "synthetik:"}, "side": {"sweeps": "synthetic:"}}}, "unknown dataset"),
    ],
)  # fmt: skip
def test_wrong_files_end_with_one_line(
    change: dict[str, Any],
    message: str,
    sensors: dict[str, Any],
    truth: dict[str, Float],
    tmp_path: Path,
    refused: Callable[..., str],
) -> None:
    write_results(tmp_path / "no-camera.json", [("", exact(truth, "front", "top"))])
    broken = {**result_to_dict(exact(truth, "front", "top")), "camera": "front"}
    broken["camera_from_lidar"] = np.diag([1.0, 1.0, -1.0, 1.0]).tolist()
    (tmp_path / "broken.json").write_text(json.dumps(broken))
    (tmp_path / "text.json").write_text("no JSON")
    error = refused(["rig", str(write_sensors(tmp_path / "sensors.yaml", {**sensors, **change}))])
    assert re.search(message, error), error


def test_lidars_alone_are_aligned_from_approximate_poses_and_drawn(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("small_gicp", reason='needs pip install ".[gicp]"')
    data = "synthetic:?place=street&scenes=3&right=false&speed_m_s=0&seed=3&width_px=64&height_px=64&lidar=vlp-16"
    lidars: dict[str, Any] = {
        "top": {"sweeps": data, "body_from_lidar": np.eye(4).tolist()},
        "side": {"sweeps": f"{data}&lidar_at={AT}"},
    }
    status, rig = combined({"lidars": lidars}, tmp_path, capsys)
    assert status == 1
    assert rig["left_out"][0]["name"] == "top-side (sweeps)"
    assert rig["left_out"][0]["reason"].startswith("there is no initial guess")
    lidars["side"]["body_from_lidar"] = {"rpy_deg": [11, 1, 59], "translation_m": [-0.7, 0.6, -0.3]}
    file = write_sensors(tmp_path / "sensors.yaml", {"lidars": lidars})
    assert main(["rig", str(file), "--json", "--out", str(tmp_path / "out")]) == 0
    rig = json.loads(capsys.readouterr().out)
    true = body_from_lidar(SyntheticOptions(lidar_at=AT))
    error = se3.inverse(true) @ np.array(rig["sensors"][1]["reference_from_sensor"])
    assert se3.angle_deg(error) < 0.3
    assert se3.distance_m(error) < 0.04
    assert (tmp_path / "out/sweeps.png").read_bytes().startswith(b"\x89PNG")


@pytest.mark.system
def test_the_lines_of_the_page_lead_from_frames_to_the_extrinsics_of_all_sensors(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """The lines of docs/how-to/several-lidars.md, on smaller images and with exact depth instead of the network."""
    pytest.importorskip("small_gicp", reason='needs pip install ".[gicp]"')
    monkeypatch.chdir(tmp_path)
    [content] = [yaml.safe_load(block.text) for block in blocks(PAGE) if block.language == "yaml"]
    write_sensors(tmp_path / "sensors.yaml", content)
    commands = [command for block in shell_blocks(PAGE) for command in block.commands()]
    programs = [" ".join(command.words[:2]) for command in commands]
    assert programs == ["p2o rig", "pip install", *["p2o simulate"] * 2, *["p2o run"] * 2, "p2o rig"]
    for command in commands[2:6]:
        words = command.words[1:]
        words += ["--extractor", "depth/rings"] if words[0] == "run" else ["--set", "width_px=621"]
        capsys.readouterr()
        assert main(words) == 0
        if command.target is not None:
            Path(command.target).write_text(capsys.readouterr().out)
    capsys.readouterr()
    assert main([*commands[6].words[1:], "--json"]) == 0
    rig = json.loads(capsys.readouterr().out)
    assert {edge["kind"] for edge in rig["edges"]} == {"result", "sweeps", "known"}
    assert all(edge["check"] is not None for edge in rig["edges"])
    place = next(word for word in commands[3].words if word.startswith("lidar_at="))
    true = {"top": np.eye(4), "side": body_from_lidar(SyntheticOptions(lidar_at=place.partition("=")[2]))}
    true |= {camera: se3.inverse(truth_at(SyntheticOptions(), 0, 0, camera)) for camera in CAMERAS}
    for sensor in rig["sensors"]:
        error = se3.inverse(true[sensor["name"]]) @ np.array(sensor["reference_from_sensor"])
        assert se3.angle_deg(error) < 0.2
        assert se3.distance_m(error) < 0.05
        assert sensor["verdict"]["trust"] == "trusted"
    # The known transform between the cameras and the aligned sweeps identify a result with an error of 2 deg.
    wrong = json.loads(Path("side.json").read_text())
    pose = np.array(wrong["results"][1]["camera_from_lidar"])
    wrong["results"][1]["camera_from_lidar"] = (se3.exp(np.radians([0, 2.0, 0, 0, 0, 0])) @ pose).tolist()
    Path("side.json").write_text(json.dumps(wrong))
    assert main(["rig", "sensors.yaml", "--json"]) == 1
    rig = json.loads(capsys.readouterr().out)
    assert [one["edges"] for one in rig["contradictions"]] == [["left-side (result)"]]
