"""Rig files: what they may say, which frame is of which camera, and each way in which they can be wrong."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from p2o import InputError, UnknownNameError, se3
from p2o.run.rig import Rig, parse_rig

LEFT = se3.exp(np.array([0.3, -2.0, 0.4, -0.6, 0.1, 0.2]))
RIGHT = se3.exp(np.array([0.3, 2.0, 0.4, 0.6, 0.1, 0.2]))
ROWS = {"LEFT": LEFT.tolist(), "RIGHT": RIGHT.tolist()}


def placed(word: str = "camera_from_body", **more: Any) -> dict[str, Any]:
    """Return the content of a rig file of two cameras."""
    return {"cameras": {name: {word: rows} for name, rows in ROWS.items()}, **more}


def groups(rig: Rig | None, names: list[str], said: dict[str, str] | None = None) -> dict[str, list[int]]:
    """Return the frames by camera; `said` are the cameras that frames name."""
    return rig.groups(names, range(len(names)), lambda index: (said or {}).get(names[index], ""))[0]


@pytest.mark.parametrize("suffix", ["yaml", "json"])
def test_a_rig_file_tells_frames_and_places(tmp_path: Path, suffix: str) -> None:
    content = placed(body_from_lidar={"rpy_deg": [0, 0, 90], "translation_m": [1, 0, 2]})
    content["cameras"]["LEFT"]["frames"] = ["*/l?"]
    path = tmp_path / f"rig.{suffix}"
    path.write_text(yaml.safe_dump(content) if suffix == "yaml" else json.dumps(content))
    rig = Rig.of(str(path))
    assert rig.cameras == ("LEFT", "RIGHT")
    np.testing.assert_allclose(rig.camera_from_body["RIGHT"], RIGHT, atol=1e-12)
    body_from_lidar = se3.make([[0, -1, 0], [1, 0, 0], [0, 0, 1]], [1, 0, 2])
    np.testing.assert_allclose(rig.start_of("LEFT"), LEFT @ body_from_lidar, atol=1e-12)
    assert groups(rig, ["a/l0", "a/x", "b/l1"], {"a/x": "RIGHT"}) == {"LEFT": [0, 2], "RIGHT": [1]}


def test_one_place_is_told_in_four_words() -> None:
    there = parse_rig(placed(), "rig").camera_from_body
    inverse = {"cameras": {name: {"body_from_camera": se3.inverse(pose).tolist()} for name, pose in there.items()}}
    counted = {
        "reference": "LEFT",
        "cameras": {"LEFT": {}, "RIGHT": {"camera_from_camera": (RIGHT @ se3.inverse(LEFT)).tolist()}},
    }
    for content in (placed("camera_from_lidar"), inverse, counted):
        places = parse_rig(content, "rig").camera_from_body
        between = places["RIGHT"] @ se3.inverse(places["LEFT"])
        np.testing.assert_allclose(between, RIGHT @ se3.inverse(LEFT), atol=1e-12)
    # Places against the LiDAR are starts, too.
    np.testing.assert_allclose(parse_rig(placed("camera_from_lidar"), "rig").start_of("LEFT"), LEFT, atol=1e-12)
    assert parse_rig(placed(), "rig").start_of("LEFT") is None


def test_a_mapping_of_placed_cameras_alone_is_a_rig_and_without_a_file_frames_say_their_camera() -> None:
    rig = parse_rig({name: {"camera_from_lidar": rows} for name, rows in ROWS.items()}, "rig.json")
    assert rig.cameras == ("LEFT", "RIGHT")
    names = ["scene-0-LEFT", "scene-0-RIGHT", "RIGHT"]
    found, remarks = rig.groups(names, range(3), lambda index: "")
    assert found == {"LEFT": [0], "RIGHT": [1, 2]}
    assert remarks["RIGHT"] == ("rig.json: frames of RIGHT are assigned by the ends of their names",), "never silently"
    # An end is a whole word.
    rig = parse_rig({"cameras": {"LEFT": None, "BACK_LEFT": None}}, "rig")
    assert groups(rig, ["a-BACK_LEFT", "LEFT"]) == {"LEFT": [1], "BACK_LEFT": [0]}
    with pytest.raises(InputError, match="frame XLEFT is of no camera"):
        groups(rig, ["XLEFT"])
    assert groups(Rig.of(True), ["a", "b", "c"], {"a": "R", "b": "L", "c": "R"}) == {"R": [0, 2], "L": [1]}
    assert Rig.of(False) is None
    with pytest.raises(InputError, match="frame b names no camera; expected a camera_name, or a rig file"):
        groups(Rig.of(True), ["a", "b"], {"a": "R"})


def test_a_moving_rig_sees_from_where_it_was_when_each_image_was_taken() -> None:
    """At 10 m/s forward an image 40 ms before the sweep is taken 0.4 m farther back: the LiDAR is 0.4 m ahead of it."""
    content = placed(twist=[0, 0, 0, 10, 0, 0])
    content["cameras"]["LEFT"]["image_before_sweep_s"] = 0.04
    rig = parse_rig(content, "rig")
    np.testing.assert_allclose(rig.camera_from_body["LEFT"], LEFT @ se3.make(translation=[0.4, 0, 0]), atol=1e-12)
    np.testing.assert_allclose(rig.camera_from_body["RIGHT"], RIGHT, atol=1e-12)
    assert rig.warnings == {}
    del content["twist"]
    still = parse_rig(content, "rig")
    np.testing.assert_allclose(still.camera_from_body["LEFT"], LEFT, atol=1e-12)
    assert "the image of LEFT is 40 ms before its sweep; without `twist`" in still.warnings["LEFT"][0]


MIRROR = np.diag([1.0, 1, -1, 1]).tolist()
FLAT = np.diag([0.0, 0, 0, 1]).tolist()


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ([1], "rig: the rig file has no keys; expected cameras: ...; got list"),
        ({}, "rig: cameras is missing"),
        ({"cameras": {}}, "rig: cameras is "),
        ({"cameras": {"LEFT": 3}}, "rig: LEFT is not valid"),
        ({"cameras": {"FRONT LEFT": {}}}, "rig: the name of a camera is not valid"),
        (placed(cameraz={}), "rig: unknown key 'cameraz'; .*did you mean cameras?"),
        ({"cameras": {"LEFT": {"camera_from_bdy": 1}}}, "unknown key of camera LEFT 'camera_from_bdy'.*_from_body"),
        ({"cameras": {"LEFT": {"frames": "*"}}}, "rig: LEFT.frames is not valid"),
        ({"cameras": {**placed()["cameras"], "BACK": {}, "TOP": {}}}, "the place of BACK, TOP is missing"),
        (
            {"cameras": {"LEFT": {"camera_from_body": ROWS["LEFT"], "camera_from_lidar": ROWS["LEFT"]}}},
            "rig, LEFT: a camera has several places",
        ),
        (
            {"cameras": {"LEFT": {"camera_from_body": ROWS["LEFT"]}, "RIGHT": {"camera_from_lidar": ROWS["RIGHT"]}}},
            "the places of the cameras have several forms",
        ),
        ({"cameras": {"LEFT": {"camera_from_body": MIRROR}}}, "the rotation of LEFT.camera_from_body mirrors space"),
        ({"cameras": {"LEFT": {"camera_from_body": FLAT}}}, "LEFT.camera_from_body is not orthonormal"),
        ({"cameras": {"LEFT": {"camera_from_body": [[1, 2], [3, 4]]}}}, "LEFT.camera_from_body is not a pose"),
        (placed(body_from_lidar=[1, 2]), "body_from_lidar is not a pose"),
        ({"cameras": {"LEFT": {}}, "body_from_lidar": np.eye(4).tolist()}, "body_from_lidar is of no use without"),
        ({"cameras": {"LEFT": {}}, "twist": [0, 0, 0, 1, 0, 0]}, "twist is of no use without the places"),
        (placed(twist=[0, 0, 0]), "rig: twist"),
        (placed("camera_from_camera"), "camera_from_camera counts from no camera"),
        (placed("camera_from_camera", reference="LEFT"), "the reference camera LEFT has a place of its own"),
        (placed("camera_from_camera", reference="LEFFT"), "unknown reference camera 'LEFFT'.*did you mean LEFT"),
        (placed(reference="LEFT"), "reference is of no use beside camera_from_body"),
        ({"cameras": {"LEFT": {"image_before_sweep_s": 5}}}, "LEFT.image_before_sweep_s is out of bounds"),
    ],
)
def test_a_wrong_rig_file_is_told_in_one_line(content: Any, message: str) -> None:
    with pytest.raises(InputError, match=message) as caught:
        parse_rig(content, "rig")
    assert "\n" not in str(caught.value)


def test_a_rig_file_that_is_missing_or_no_yaml_is_told(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="rig file"):
        Rig.of(str(tmp_path / "none.yaml"))
    with pytest.raises(InputError, match="the rig file has no name"):
        Rig.of("")
    for name, text, message in (
        ("a.yaml", "cameras: *all", "rig file contains an alias"),
        ("b.json", "{", "the rig file is not JSON"),
        ("c.yaml", "cameras: !!python/object:os.system {}", "contains objects"),
    ):
        (tmp_path / name).write_text(text)
        with pytest.raises(InputError, match=message):
            Rig.of(str(tmp_path / name))


def test_frames_of_unknown_no_or_several_cameras_and_cameras_without_frames_are_told() -> None:
    rig = parse_rig({"cameras": {"LEFT": {"frames": ["a*"]}, "RIGHT": {"frames": ["*1"]}}}, "rig")
    with pytest.raises(UnknownNameError, match=r"rig: unknown camera of frame b 'LEFTT'.*did you mean LEFT"):
        groups(rig, ["b"], {"b": "LEFTT"})
    with pytest.raises(InputError, match=r"frame b is of no camera; expected one of LEFT, RIGHT; give `frames"):
        groups(rig, ["b"])
    with pytest.raises(InputError, match=r"frame a1 matches the patterns of several cameras; .*got LEFT, RIGHT"):
        groups(rig, ["a1"])
    with pytest.raises(InputError, match=r"camera RIGHT has no frames; .*leave the camera out of the rig file"):
        groups(rig, ["a0", "a2"])


def test_a_place_against_the_lidar_may_be_a_calibration_file_beside_the_rig_file(tmp_path: Path) -> None:
    pose = se3.exp(np.array([0.1, 0.2, 0.3, 1, 2, 3]))
    for name in ("front", "left"):
        np.savetxt(tmp_path / f"{name}.txt", pose)
    (tmp_path / "rig.yaml").write_text("front: {camera_from_lidar: front.txt}\nleft: {camera_from_lidar: left.txt}\n")
    rig = Rig.of(str(tmp_path / "rig.yaml"))
    np.testing.assert_allclose(rig.start_of("left"), pose, atol=1e-12)
    assert "does not state a direction" in rig.warnings["left"][0]
