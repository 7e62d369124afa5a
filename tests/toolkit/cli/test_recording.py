"""`p2o run --rerun` records frames such that the viewer projects the sweep as p2o does, before and after."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from p2o import Registry
from p2o.cli import main
from p2o.geometry import se3
from p2o.run.recipe import open_dataset

pytestmark = pytest.mark.usefixtures("plain_environment")
SCENE = "synthetic:?scenes=2&width_px=320&height_px=120&right=false"
RUN = ["run", "--data", SCENE, "--extractor", "depth/rings", "--perturb", "2deg 0.15m"]


def needs_rerun() -> None:
    pytest.importorskip("rerun", reason="the extra `rerun` is not installed")


def recorded(path: Path) -> dict[tuple[str, int | None], dict[str, Any]]:
    """Return the components of a recording by entity and frame; None for what holds for all frames."""
    from rerun.chunk import RrdReader

    content: dict[tuple[str, int | None], dict[str, Any]] = {}
    for chunk in RrdReader(path).stream():
        batch = chunk.to_record_batch()
        for row in batch.select([name for name in batch.schema.names if ":" in name or name == "frame"]).to_pylist():
            content.setdefault((chunk.entity_path, row.pop("frame", None)), {}).update(row)
    return content


def projected(content: dict[tuple[str, int | None], dict[str, Any]], camera: str, number: int) -> np.ndarray:
    """Return the pixels, with centres at halves, at which the viewer shows the points of a sweep."""
    transform, image = content[f"/lidar/{camera}", number], content[f"/lidar/{camera}/image", number]
    rotation = np.array(transform["Transform3D:mat3x3"][0]).reshape(3, 3).T
    assert transform["Transform3D:relation"] == [2]  # child from parent: camera_from_lidar
    xyz = np.array(content["/lidar/sweep", number]["Points3D:positions"])
    xyz = xyz @ rotation.T + transform["Transform3D:translation"][0]
    uvw = xyz @ np.array(image["Pinhole:image_from_camera"][0]).reshape(3, 3)
    return np.where(xyz[:, 2:] > 0, uvw[:, :2] / uvw[:, 2:], np.nan)


@pytest.fixture(scope="module")
def joint(tmp_path_factory: pytest.TempPathFactory) -> tuple[dict[tuple[str, int | None], dict[str, Any]], Path]:
    """The recording of a joint calibration of two frames, and its result."""
    needs_rerun()
    folder = tmp_path_factory.mktemp("recording")
    file = folder / "made" / "out.rrd"
    assert main([*RUN, "--joint", "--rerun", str(file), "--export", f"json:{folder / 'result.json'}"]) == 0
    return recorded(file), folder / "result.json"


@pytest.mark.parametrize("camera", ["before", "after", "truth"])
def test_the_viewer_projects_the_sweep_as_p2o_does(camera: str, joint: tuple[Any, Path]) -> None:
    content, file = joint
    result = json.loads(file.read_text())
    for number, frame in enumerate(open_dataset(SCENE, Registry.load())):
        assert frame.camera_from_lidar is not None
        stored = {"before": result["start"], "after": result["camera_from_lidar"], "truth": frame.camera_from_lidar}
        pixels = frame.camera.project(se3.apply(np.array(stored[camera]), frame.cloud.xyz))
        shown, inside = projected(content, camera, number), frame.camera.in_image(pixels)
        assert inside.sum() > 1000
        np.testing.assert_allclose(shown[inside] - 0.5, pixels[inside], atol=0.01)
    assert {frame for _, frame in content} == {None, 0, 1}


def test_every_frame_has_image_edges_by_direction_and_text(joint: tuple[Any, Path]) -> None:
    content, _ = joint
    for number in (0, 1):
        assert content["/lidar/after/image", number]["EncodedImage:media_type"] == ["image/jpeg"]
        [text] = content["/result", number]["TextDocument:text"]
        assert text.startswith(f"scene-000{number}\n")
        assert "trusted" in text
        for entity, points in (("/lidar/edges", "Points3D"), ("/lidar/after/image/edges", "Points2D")):
            edges = content[entity, number]
            assert len(edges[f"{points}:positions"]) == len(edges[f"{points}:class_ids"]) > 100
            assert set(edges[f"{points}:class_ids"]) <= {0, 1, 2, 3}
    labels = [
        entry["class_description"]["info"]["label"] for entry in content["/", None]["AnnotationContext:context"][0]
    ]
    assert labels[:4] == ["left", "right", "upper", "bottom"]


def test_without_the_extra_one_line_states_what_to_install(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(sys.modules, "rerun", None)
    assert main([*RUN, "--rerun", str(tmp_path / "out.rrd")]) == 2
    line = 'p2o run --rerun needs the package rerun, which is not installed; run: pip install "rerun-sdk>=0.41"'
    assert capsys.readouterr().err.splitlines() == [f"p2o: error: {line}"]


def test_a_file_that_cannot_be_written_is_refused_at_once(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    needs_rerun()
    (tmp_path / "file").touch()
    for place, message in ((tmp_path, "the recording is no file"), (tmp_path / "file/x.rrd", "cannot write the")):
        assert main([*RUN, "--rerun", str(place)]) == 2
        captured = capsys.readouterr()
        assert message in captured.err
        assert not captured.out
    same = str(tmp_path / "same")
    assert main([*RUN, "--joint", "--rerun", same, "--export", f"json:{same}"]) == 2
    text = f"p2o: error: {same}: two outputs have the same file; got --rerun and --export json:{same}"
    assert capsys.readouterr().err.splitlines() == [text]
