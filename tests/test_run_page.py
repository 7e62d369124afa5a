"""The page that `p2o run --out` writes, made anew by `p2o report`: what it says, and how it stands in a browser."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import cv2
import numpy as np
import p2o
import pytest
from p2o.cli import main
from p2o.draw.overlay import brightened, display_gamma
from p2o.host.calibration_file import read_initial_guess
from p2o.results.advice import BY_DOUBT, BY_STATUS, next_steps
from p2o.results.result_json import result_from_dict
from p2o.results.verdict import Doubt

from tests.page_description import blocks, column, description, table, texts

STAGE = Path(__file__).with_name("stage_plugin.py")
HOSTILE = '<img src=x onerror="stolen=1">/</script><b>&"\x1b'


def spy(data: str, *words: str) -> list[str]:
    """Return words that run a synthetic method on synthetic frames."""
    return ["run", "--plugin", str(STAGE), "--data", data, "--calibrator", "spy", "--perturb", "2deg 0.1m", *words]


def named(*names: str) -> list[str]:
    return ["--set", f"data.names={json.dumps(names)}"]


@pytest.fixture(scope="module")
def quick(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of one calibration with edges, rounds and a predicted error."""
    out = tmp_path_factory.mktemp("quick") / "out"
    words = ["--plugin", str(STAGE), "--data", "fake:?frames=1", "--extractor", "depth/rings", "--init", "given"]
    assert main(["run", *words, "--perturb", "0.5deg 0.02m", "--out", str(out)]) == 0
    return out


def test_the_page_says_verdict_likely_errors_rounds_and_what_to_do(quick: Path) -> None:
    data = description(quick / "result.html")
    row = json.loads((quick / "run.json").read_text())["results"][0]
    assert blocks(data, "text")[0]["mark"]["text"] == row["verdict"]["trust"]
    said = set(texts(data))
    assert {reason["text"] for reason in row["verdict"]["reasons"]} <= said
    assert {f"{row['accuracy'][name]:.2f}" for name in ("rotation_deg", "pitch_deg")} <= said
    assert set(next_steps(result_from_dict(row))) <= said
    [rounds] = [one for one in blocks(data, "table") if one["columns"][0]["name"] == "stage"]
    assert column(rounds, "kept") == ["yes" if one["accepted"] else "no" for one in row["rounds"]]
    sides = [one[end] for one in blocks(data, "slides") for end in ("left", "right")]
    assert len(sides) == 6, "edges, range, reflectance: twice each"
    assert all(source.startswith("data:image/jpeg") for source in sides)
    times = next(part for part in blocks(data, "part") if part["title"] == "Time")
    assert blocks(times, "facts")[0]["rows"] == [[stage, f"{took:.2f} s"] for stage, took in row["seconds"].items()]


def test_the_poses_of_the_page_are_the_result_whichever_is_pasted(quick: Path, tmp_path: Path) -> None:
    pose = np.array(json.loads((quick / "run.json").read_text())["results"][0]["camera_from_lidar"])
    found = {one["title"]: one["text"] for one in blocks(description(quick / "result.html"), "code") if "title" in one}
    np.testing.assert_allclose(json.loads(found["camera_from_lidar, 4x4"]), pose, atol=1e-9)
    np.testing.assert_allclose(json.loads(found["lidar_from_camera, 4x4"]) @ pose, np.eye(4), atol=1e-8)
    x, y, z, *quaternion = map(float, found["camera_from_lidar, x y z [m], quaternion x y z w"].split())
    own = tmp_path / "pose.yaml"
    own.write_text(f"camera_from_lidar: {{translation_m: {[x, y, z]}, rotation_xyzw: {quaternion}}}\n")
    np.testing.assert_allclose(read_initial_guess(str(own))[0], pose, atol=1e-8)
    ros = tmp_path / "static.txt"
    ros.write_text(found["ROS 2"] + "\n")
    np.testing.assert_allclose(read_initial_guess(str(ros))[0], pose, atol=1e-8)
    rpy = next(text for name, text in found.items() if name.startswith("camera_from_lidar, roll"))
    own.write_text(f"camera_from_lidar: {{translation_m: {[x, y, z]}, rpy_deg: {[*map(float, rpy.split())]}}}\n")
    np.testing.assert_allclose(read_initial_guess(str(own))[0], pose, atol=1e-8)


def test_names_of_frames_are_text_on_the_page(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(spy("fake:", *named(HOSTILE, "two"), "--out", str(tmp_path))) == 0
    html = (tmp_path / "result.html").read_text()
    assert "<img src=x" not in html
    assert html.count("</script>") == 2, "description and script of the page itself"
    assert "\x1b" not in html
    assert HOSTILE.replace("\x1b", "\\x1b") in texts(description(html))
    assert f"wrote {tmp_path / 'result.html'}" in capsys.readouterr().out


def test_a_page_of_many_frames_is_of_bounded_size_and_says_where_the_others_are(tmp_path: Path) -> None:
    assert main(spy("fake:?frames=25", "--out", str(tmp_path))) == 0
    data = description(tmp_path / "result.html")
    assert len(blocks(data, "slides")) == 24 * 3
    assert len(table(data, "results")["rows"]) == 25
    assert "Overlays of 1 frames are in the folder of this page: drive_0024" in texts(data)


def test_overlays_beyond_the_limit_are_files_of_full_size_beside_the_page(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out = tmp_path / "a run" / "out"
    assert main(spy("fake:?frames=2", "--joint", "--out", str(out))) == 0
    embedded = (out / "result.html").read_text()
    assert "file:" not in embedded
    monkeypatch.setattr("p2o.page.run_page._MOST_CHARS", len(embedded) // 3)
    for folder in (out, tmp_path / "elsewhere"):
        assert main(["report", str(out), "--out", str(folder)]) == 0
        html = (folder / "result.html").read_text()
        slides = blocks(description(html), "slides")
        sources = [one[end] for one in slides for end in ("left", "right")]
        files = [unquote(text) for text in sources if not text.startswith("data:")]
        assert 0 < len(files) < len(sources) == 12
        assert all((folder / name).is_file() for name in files)
        assert sources[0].startswith("data:image/jpeg"), "edges before sweeps"
        assert [bool(one.get("lazy")) for one in slides] == [not one["left"].startswith("data:") for one in slides]
        assert "img-src data: blob: 'self' file:;" in html


def test_overlays_of_a_large_image_have_its_size_and_the_page_is_small(tmp_path: Path) -> None:
    """Edges of images of long focal lengths are extracted from smaller images."""
    words = ["synthetic:?scenes=1&width_px=2484&height_px=750", "--init", "given", "--extractor", "depth/rings"]
    assert main(["run", *words, "--out", str(tmp_path)]) in (0, 1)
    drawn = cv2.imread(str(tmp_path / "scene-0000" / "after.png"))
    assert drawn.shape == (750, 2484, 3)
    assert (tmp_path / "result.html").stat().st_size < 3_000_000


def test_a_joint_result_shows_its_frames_and_a_failed_frame_its_reason(tmp_path: Path) -> None:
    assert main(spy("fake:?frames=3", "--joint", "--out", str(tmp_path / "joint"))) == 0
    joint = description(tmp_path / "joint" / "result.html")
    assert "3 frames jointly" in joint["title"]
    assert len(blocks(joint, "slides")) == 3 * 3
    assert main(spy("fake:?frames=3&bad=1", "--out", str(tmp_path / "bad"))) == 2
    said = "\n".join(texts(description(tmp_path / "bad" / "result.html")))
    assert "1 could not be calibrated" in said
    assert "the image is cut short" in said


def test_a_rig_has_a_table_of_its_cameras(quick: Path) -> None:
    from p2o.page.run_page import run_page

    run = json.loads((quick / "run.json").read_text())
    cameras = [{"name": f"<{name}>", "rotation_deg": 0.5, "translation_m": 0.02, "left_out": ""} for name in "ab"]
    pose = np.eye(4).tolist()
    rig = {"reason": "two agree", "verdict": {"trust": "trusted"}, "body_from_lidar": pose, "cameras": cameras}
    data = description(run_page(quick, {**run, "rig": rig}))
    assert table(data, "rig")["rows"] == [[f"<{name}>", "0.50", "0.020", "-", ""] for name in "ab"]
    assert {"two agree", "body_from_lidar, 4x4"} <= set(texts(data))


def test_report_makes_the_page_of_a_run_anew(quick: Path, capsys: pytest.CaptureFixture[str]) -> None:
    first = (quick / "result.html").read_bytes()
    assert main(["report", str(quick)]) == 0
    assert capsys.readouterr().out == f"{quick / 'result.html'}\n"
    assert (quick / "result.html").read_bytes() == first
    (quick / "result.html").unlink()
    assert main(["report", str(quick), "--out", str(quick.parent / "elsewhere")]) == 0
    assert (quick.parent / "elsewhere" / "result.html").read_bytes() == first
    (quick / "result.html").write_bytes(first)


@pytest.mark.parametrize(
    ("text", "said"),
    [("[]", "no object of p2o run"), ('{"results": 1}', "no object of p2o run"), ("{", "not JSON")],
)
def test_a_run_json_that_is_none_is_one_clear_line(
    text: str, said: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "run.json").write_text(text)
    assert main(["report", str(tmp_path)]) == 2
    assert said in capsys.readouterr().err


def test_what_belongs_to_studies_is_refused_for_a_run(quick: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["report", str(quick), "--study", "zoo"]) == 2
    assert "a run without studies" in capsys.readouterr().err


def test_every_doubt_and_every_refusal_has_an_advice() -> None:
    assert set(BY_DOUBT) == set(Doubt)
    assert set(BY_STATUS) == {status for status in p2o.Status if not status.solved}


def test_a_dark_picture_is_brightened_by_a_gamma_that_is_told_and_a_bright_one_is_not() -> None:
    dark, bright = (np.full((40, 60, 3), value, np.uint8) for value in (12, 120))
    assert display_gamma(bright) == 1.0
    assert display_gamma(np.zeros((40, 60, 3), np.uint8)) == 1.0
    gamma = display_gamma(dark)
    assert 0.3 < gamma < 0.5
    assert brightened(dark, gamma).mean() > 70
    np.testing.assert_array_equal(brightened(bright, 1.0), bright)


def test_the_brightness_of_all_overlays_can_be_raised_and_images_keep_their_form(quick: Path, browser: Any) -> None:
    from tests.in_browser import Page

    page = Page(browser, quick / "result.html")
    page.until(lambda: page.run("return [...document.images].every((image) => image.naturalWidth > 0)"))
    form = "const i = document.images[0]; return i.clientWidth * i.naturalHeight / (i.clientHeight * i.naturalWidth)"
    page.until_equal(lambda: page.run(form), pytest.approx(1, abs=0.02))
    page.run("const s = document.querySelector('.light input'); s.value = 2; s.dispatchEvent(new Event('input'))")
    page.until_equal(
        lambda: set(page.run("return [...document.images].map((i) => getComputedStyle(i).filter)")), {"brightness(2)"}
    )
