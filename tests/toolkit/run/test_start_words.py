"""A start told in words reaches the calibration by the command line and by Python, and is kept in the recipe."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import p2o
import pytest
from p2o import InputError
from p2o.cli import main
from p2o.geometry.rough_start import rough_start
from p2o.run.recipe import Recipe
from p2o.run.run import run
from p2o.testing import stage

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


def test_python_takes_the_same_words_or_a_pose() -> None:
    registry = p2o.Registry.load(extra_files=[PLUGIN], environ={})
    told = p2o.calibrate(stage.frame(), calibrator="spy", witness="none", start=f"roughly {WORDS}", registry=registry)
    assert np.allclose(told.result.camera_from_lidar, rough_start(f"roughly {WORDS}"))
    plain = p2o.calibrate(stage.frame(), calibrator="spy", witness="none", start=np.eye(4), registry=registry)
    assert np.array_equal(plain.result.camera_from_lidar, np.eye(4))
    assert "start" not in plain.result.recipe


def test_what_contradicts_the_words_is_refused() -> None:
    registry = p2o.Registry.load(extra_files=[PLUGIN], environ={})
    with pytest.raises(InputError, match="both a start and a perturbation"):
        p2o.calibrate("synthetic:", start=f"roughly {WORDS}", perturb="1deg", registry=registry)
    with pytest.raises(InputError, match="a start is of one camera, and a rig has several"):
        p2o.calibrate("synthetic:", start=f"roughly {WORDS}", rig=True, registry=registry)
    with pytest.raises(InputError, match="given twice, as a pose and in words"):
        run(Recipe.of(start=f"roughly {WORDS}").resolve(registry), start=np.eye(4))
    with pytest.raises(InputError, match='expected "roughly x forward, z up; camera looks forward"'):
        p2o.calibrate("synthetic:", start="ahead", registry=registry)
