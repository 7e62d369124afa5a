"""Exporters of other systems' files write what their readers read; refused results are not written."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from p2o import Camera, InputError, Result, Status, se3
from p2o.host.calibration_file import read_calibration_file
from p2o.reading import Calibration, result_to_json
from p2o.results.evidence import Accuracy
from p2o_formats.formats import FORMATS, WRITTEN
from p2o_formats.kitti_calibration import read_calibration
from p2o_formats.result_file import EXPORTER

POSE = se3.exp(np.array([0.1, 0.2, 0.3, 1 / 3, -2 / 7, 1e-9]))
CAMERA = Camera.pinhole(700, 700, 320, 120, 640, 240)
RESULT = Result(("scene-0000",), np.eye(4), POSE, Status.CONVERGED, "done", intrinsics=CAMERA)
BY_NAME = {name: form.exporter() for name, form in WRITTEN.items()}
METHOD = BY_NAME["kitti"]


@pytest.mark.parametrize(
    ("layout", "expected"),
    [
        ("object", {"Tr_velo_to_cam": POSE[:3], "R0_rect": np.eye(3)}),
        ("raw", {"R": POSE[:3, :3], "T": POSE[:3, 3]}),
        ("odometry", {"Tr": POSE[:3]}),
    ],
)
def test_a_layout_of_kitti_has_its_keys(tmp_path: Path, layout: str, expected: dict[str, np.ndarray]) -> None:
    path = tmp_path / "calib.txt"
    METHOD.build(METHOD.options(layout=layout))(RESULT, path)
    calibration = read_calibration(path)
    for key, value in expected.items():
        np.testing.assert_array_equal(calibration.numbers(key, value.shape), value)


COMMENT = "p2o: trusted; predicted error 0.21 deg, 3.4 cm (67 %), 0.50 deg, 8.1 cm (95 %)"
FORMS = [(name, {}) for name in sorted(BY_NAME)] + [("ros2", {"form": form}) for form in ("launch", "urdf")]


@pytest.mark.parametrize(("name", "options"), FORMS, ids=str)
def test_comments_state_verdict_and_predicted_error(tmp_path: Path, name: str, options: dict[str, str]) -> None:
    method, path = BY_NAME[name], tmp_path / "result.out"
    result = replace(RESULT, accuracy=Accuracy(0.21, 0.034, 0.5, 0.081))
    method.build(method.options(**options))(result, path)
    assert path.read_bytes().count(COMMENT.encode()) == (name not in ("kitti", "npy"))
    exact, plain = read_calibration_file(path), tmp_path / "plain.out"
    plain.write_bytes(WRITTEN[name].written(Calibration(CAMERA, POSE), method.options(**options)))
    expected = read_calibration_file(plain)
    assert (exact.camera, exact.parts) == (expected.camera, expected.parts)
    if exact.camera_from_lidar is not None:
        np.testing.assert_array_equal(exact.camera_from_lidar, expected.camera_from_lidar)


@pytest.mark.parametrize(("name", "message"), [("", "name a file, not a folder"), ("file/x", "cannot write the file")])
def test_a_folder_and_a_path_below_a_file_are_refused(tmp_path: Path, name: str, message: str) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(InputError, match=message):
        EXPORTER.build(EXPORTER.options())(RESULT, tmp_path / name)


def test_a_converted_result_keeps_the_comment(tmp_path: Path) -> None:
    path = tmp_path / "result.json"
    path.write_text(result_to_json(replace(RESULT, accuracy=Accuracy(0.21, 0.034, 0.5, 0.081))))
    assert read_calibration_file(path).comment == COMMENT


def test_the_table_lists_every_form_with_what_it_holds() -> None:
    page = (Path(__file__).parents[2] / "docs/how-to/export.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| `([\w-]+)` \| (camera|extrinsic|camera, extrinsic|all of a result) \|", page, re.MULTILINE)
    expected = {name: ", ".join(sorted(form.holds)) for name, form in FORMATS.items()} | {"json": "all of a result"}
    assert dict(rows) == expected
