"""A start told in words reaches the calibration by the command line and by Python, and is kept in the recipe."""

from __future__ import annotations

import importlib
import json
from pathlib import Path

import numpy as np
import p2o
import pytest
from p2o import Camera, InputError, se3
from p2o.calibration_files.calibration import Calibration
from p2o.cli import main
from p2o.cli.run import command
from p2o.geometry.rough_start import rough_start
from p2o.run.recipe import Recipe
from p2o.run.run import run
from p2o_formats.formats import FORMATS
from p2o_testing import stage

PLUGIN = str(Path(__file__).parents[2] / "stage_plugin.py")
WORDS = "x forward, z up; camera looks 10 deg left; camera 0.27 m forward of lidar"
SPY = ["--calibrator", "spy", "--witness", "none", "--plugin", PLUGIN]


def test_the_command_line_begins_at_the_pose_that_the_words_mean(capsys: pytest.CaptureFixture[str]) -> None:
    """The method of the test answers with its start."""
    data = "synthetic:?width_px=160&height_px=64&lidar=vlp-16&right=false"
    code = main(["run", "--data", data, *SPY, "--json", "--start", "roughly", WORDS])
    told = capsys.readouterr()
    assert code == 0, told.err
    [row] = json.loads(told.out)["results"]
    expected = rough_start(f"roughly {WORDS}")
    assert np.allclose(row["camera_from_lidar"], expected)
    assert row["recipe"]["start"] == f"roughly {WORDS}"
    assert row["start_error"]["rotation_deg"] > 5
    again = Recipe.of(**row["recipe"])
    assert again.start == f"roughly {WORDS}"


@pytest.mark.parametrize("words", [["--start", "roughly"], ["--start", "roughly", "--joint"]])
def test_an_option_after_roughly_is_no_part_of_it(words: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["run", "--data", "synthetic:", *words]) == 2
    told = capsys.readouterr().err
    assert "roughly x forward, z up" in told or "x forward, z up" in told
    assert "--joint" not in told
    assert told.count("\n") == 1


@pytest.mark.parametrize(
    ("words", "start", "joint"),
    [
        (["--start", "roughly", WORDS, "--joint"], f"roughly {WORDS}", True),
        (["--start", f"roughly {WORDS}", "--joint"], f"roughly {WORDS}", True),
        (["--joint", "--start", "roughly", WORDS], f"roughly {WORDS}", True),
        (["--start", "roughly", "--joint"], "roughly", True),
        (["--start", "a.json", "--joint"], "a.json", True),
    ],
)
def test_a_start_in_two_words_is_one_value(words: list[str], start: str, joint: bool | None) -> None:
    parameters = command.make_context("run", list(words)).params
    assert (parameters["start"], parameters["joint"]) == (start, joint)


@pytest.mark.parametrize("name", ["p2o.cli.data_show", "p2o.cli.data_suggest", "p2o_pages.cli.view"])
def test_commands_that_project_from_a_pose_take_the_two_words_too(name: str) -> None:
    other = importlib.import_module(name).command
    rest = ["--pose", "truth", *(["--out", "a"] if name.endswith("show") else [])]
    for option in ("--start", "--extrinsic"):
        parameters = other.make_context("x", ["folder:a", option, "roughly", WORDS, *rest]).params
        assert (parameters["start"], parameters["pose"]) == (f"roughly {WORDS}", "truth")


def test_python_takes_the_same_words_or_a_pose_and_refuses_what_contradicts_them() -> None:
    registry = p2o.Registry.load(extra_files=[PLUGIN], environ={})
    told = p2o.calibrate(stage.frame(), calibrator="spy", witness="none", start=f"roughly {WORDS}", registry=registry)
    assert np.allclose(told.result.camera_from_lidar, rough_start(f"roughly {WORDS}"))
    plain = p2o.calibrate(stage.frame(), calibrator="spy", witness="none", start=np.eye(4), registry=registry)
    assert np.array_equal(plain.result.camera_from_lidar, np.eye(4))
    assert "start" not in plain.result.recipe
    with pytest.raises(InputError, match="both a start and a perturbation"):
        p2o.calibrate("synthetic:", start=f"roughly {WORDS}", perturb="1deg", registry=registry)
    with pytest.raises(InputError, match="a start is of one camera, and a rig has several"):
        p2o.calibrate("synthetic:", start=f"roughly {WORDS}", rig=True, registry=registry)
    with pytest.raises(InputError, match="given twice, as a pose and in words"):
        run(Recipe.of(start=f"roughly {WORDS}").resolve(registry), start=np.eye(4))
    with pytest.raises(InputError, match='expected "roughly x forward, z up; camera looks forward"'):
        p2o.calibrate("synthetic:", start="ahead", registry=registry)


def test_a_file_without_a_direction_is_checked_by_the_sweep(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The inverse of a pose with x forward lies on its side; and that the file says no direction is told."""
    path, pose = tmp_path / "pose.npy", rough_start(f"roughly {WORDS}")
    data = "synthetic:?width_px=160&height_px=64&lidar=vlp-16&right=false"
    np.save(path, pose)
    assert main(["run", "--data", data, *SPY, "--json", "--start", str(path)]) == 0
    [row] = json.loads(capsys.readouterr().out)["results"]
    assert any("does not state a direction" in warning for warning in row["warnings"])
    assert not any("may be lidar_from_camera" in warning for warning in row["warnings"])
    np.save(path, se3.inverse(pose))
    code = main(["run", "--data", data, *SPY, "--json", "--start", str(path)])
    told = capsys.readouterr()
    warnings = [] if code == 2 else json.loads(told.out)["results"][0]["warnings"]
    assert "looks like lidar_from_camera" in told.err or any("may be lidar_from_camera" in text for text in warnings)


def test_a_start_file_that_holds_a_camera_alone_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "camera.yaml"
    path.write_bytes(FORMATS["camera-info"].written(Calibration(Camera.pinhole(10, 10, 5, 5, 10, 10))))
    with pytest.raises(InputError, match="the file has no extrinsic"):
        Recipe.of(start=str(path)).resolve(p2o.Registry.load(environ={}))
