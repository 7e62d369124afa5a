"""`p2o convert` goes from any form of calibration file to any other, and says what it wrote."""

from __future__ import annotations

import itertools
import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from p2o import Camera, se3
from p2o.calibration_files.calibration import CAMERA, EXTRINSIC, Calibration
from p2o.cli import main
from p2o.host.calibration_file import read_calibration_file
from p2o_formats.formats import FORMATS, WRITTEN

POSE = se3.make([[0, -1, 0], [0, 0, -1], [1, 0, 0]], [0.06, -0.08, -0.27]) @ se3.exp(
    np.array([0.02, -0.03, 0.01, 0, 0, 0])
)
LENS = Camera("OPENCV", 640, 480, (500.0, 501.0, 320.25, 240.75, -0.1, 0.01, 0.001, 0.002))


def _file(folder: Path, name: str, calibration: Calibration | None = None) -> Path:
    path = folder / f"{name}{FORMATS[name].suffix}"
    path.write_bytes(FORMATS[name].written(calibration or Calibration(LENS, POSE)))
    return path


KINDS = {(form.holds, form.needs): name for name, form in WRITTEN.items()}
"""One form for each combination of what forms have room for and need."""


@pytest.mark.parametrize(
    ("source", "target"), sorted({*itertools.product(WRITTEN, KINDS.values()), *itertools.product(["koide"], WRITTEN)})
)
def test_any_form_becomes_any_other_that_has_room(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], source: str, target: str
) -> None:
    """What both have room for survives; a form that needs more than the source has is refused in one line."""
    path, out = _file(tmp_path, source), tmp_path / "out"
    shared = WRITTEN[source].holds & WRITTEN[target].holds
    possible = shared and WRITTEN[target].needs <= WRITTEN[source].holds
    code = main(["convert", str(path), str(out), "--to", target])
    told = capsys.readouterr()
    assert code == (0 if possible else 2), told.err
    if not possible:
        assert told.err.count("\n") == 1
        assert "there is no" in told.err
        assert not out.exists()
        return
    found = read_calibration_file(out)
    if EXTRINSIC in shared:
        np.testing.assert_allclose(found.extrinsic(), POSE, atol=1e-9)
    if CAMERA in shared:
        assert found.camera == LENS
    assert told.out.startswith(f"{out}: {target}, ")


def test_options_name_frames_form_and_a_camera_of_another_file(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path, out = _file(tmp_path, "koide"), tmp_path / "camera.launch.py"
    to = "ros2?form=launch&lidar_frame=velodyne&camera_frame=front/camera_link"
    assert main(["convert", str(path), str(out), "--to", to]) == 0
    text = out.read_text()
    assert '"--frame-id", "velodyne"' in text
    assert '"--child-frame-id", "front/camera_link"' in text
    said = capsys.readouterr().out
    assert "frames: lidar velodyne, camera front/camera_link" in said
    assert "left out: the camera" in said
    np.testing.assert_allclose(read_calibration_file(out).extrinsic(), POSE, atol=1e-12)
    transform, camera, both = _file(tmp_path, "ros2"), _file(tmp_path, "camera-info"), tmp_path / "calib.json"
    assert main(["convert", str(transform), str(both), "--to", "koide", "--camera", str(camera)]) == 0
    assert read_calibration_file(both).camera == LENS


def test_millimetres_are_noted(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    far = POSE.copy()
    far[:3, 3] *= 1000
    path = _file(tmp_path, "matrix", Calibration(None, far))
    assert main(["convert", str(path), str(tmp_path / "out"), "--to", "text"]) == 0
    assert "is 287.9 m long: if it is in millimetres" in capsys.readouterr().out


def test_what_is_said_is_where_the_camera_stands(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    ahead = se3.make([[0, -1, 0], [0, 0, -1], [1, 0, 0]], [0, 0, -0.3])
    path = _file(tmp_path, "kalibr", Calibration(LENS, ahead))
    assert main(["convert", str(path), str(tmp_path / "pose.npy"), "--to", "npy"]) == 0
    said = capsys.readouterr().out
    assert "camera position in the LiDAR's frame: 0.3000 0.0000 0.0000 m" in said
    assert "camera axes in the LiDAR's frame: optical axis 1.000 0.000 0.000, up 0.000 0.000 1.000" in said
    assert "stored transform: camera_from_lidar\n" in said
    to = "ros2?parent=camera"
    assert main(["convert", str(path), str(tmp_path / "tf.sh"), "--to", to]) == 0
    assert "stored transform: camera_from_lidar, parent from child" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--to", "kalibrr"], "did you mean kalibr"),
        (["--to", "kalibr"], "kalibr has no name for the camera model FULL_OPENCV"),
        (["--to", "json"], "json can only be read"),
        (["--to", "ros2?form=xml"], "form"),
        (["--to", "ros2?camera_frame=a b"], "camera_frame"),
        (["--to", "ros2?nosuch=1"], "nosuch"),
        (["--to", "npy", "--from", "npy"], "not an .npy file"),
        (["--to", "npy", "--from", "autoware"], "frame"),
        (["--to", "npy", "--camera", "missing.yaml"], "missing"),
    ],
)
def test_wrong_words_are_told_in_one_line(
    tmp_path: Path, refused: Callable[..., str], words: list[str], message: str
) -> None:
    rational = Camera("FULL_OPENCV", 640, 480, (500.0, 501.0, 320.0, 240.0, *(0.1,) * 8))
    path = _file(tmp_path, "text", Calibration(rational, POSE))
    assert message in refused(["convert", str(path), str(tmp_path / "out"), *words])
    assert not (tmp_path / "out").exists()


def test_a_result_of_a_run_is_converted(tmp_path: Path) -> None:
    """The run's own folder, and the frame by its name."""
    data = "synthetic:?width_px=160&height_px=64&lidar=vlp-16&right=false&scenes=2"
    plugin = Path(__file__).parent / "stage_plugin.py"
    spy = ["--calibrator", "spy", "--witness", "none", "--plugin", str(plugin), "--perturb", "0deg 0m"]
    assert main(["run", "--data", data, *spy, "--out", str(tmp_path)]) == 0
    run = json.loads((tmp_path / "run.json").read_text())
    name = run["results"][1]["frames"][0]
    assert main(["convert", f"{tmp_path}/run.json#{name}", str(tmp_path / "cam.yaml"), "--to", "kalibr"]) == 0
    found = read_calibration_file(tmp_path / "cam.yaml")
    np.testing.assert_allclose(found.extrinsic(), run["results"][1]["camera_from_lidar"], atol=1e-12)
    assert found.intrinsics().width == 160
