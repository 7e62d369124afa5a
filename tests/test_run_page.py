"""The page that `p2o run --out` writes, made anew by `p2o report`: what it says, and how it stands in a browser."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import cv2
import numpy as np
import p2o
import pytest
from markupsafe import escape
from p2o.cli import main
from p2o.draw.overlay import brightened, display_gamma
from p2o.host.calibration_file import read_initial_guess
from p2o.results.advice import BY_DOUBT, BY_STATUS, next_steps
from p2o.results.result_json import result_from_dict
from p2o.results.verdict import Doubt, Reason, Verdict

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
    html = (quick / "result.html").read_text()
    row = json.loads((quick / "run.json").read_text())["results"][0]
    assert f'<span class="verdict {row["verdict"]["trust"]}">' in html
    for reason in row["verdict"]["reasons"]:
        assert reason["text"] in html
    assert f"<td>{row['accuracy']['rotation_deg']:.2f}</td>" in html
    assert f"<td>{row['accuracy']['pitch_deg']:.2f}</td>" in html
    assert html.count("<td>yes</td>") + html.count("<td>no</td>") == len(row["rounds"])
    for step in next_steps(result_from_dict(row)):
        assert escape(step) in html
    for stage, took in row["seconds"].items():
        assert f">{stage}</td><td>{took:.2f} s</td>" in html


def test_the_poses_of_the_page_are_the_result_whichever_is_pasted(quick: Path, tmp_path: Path) -> None:
    html = (quick / "result.html").read_text()
    pose = np.array(json.loads((quick / "run.json").read_text())["results"][0]["camera_from_lidar"])
    boxes = re.findall(r"<h3>([^<]*)</h3>(?:<p[^>]*>[^<]*</p><div class=\"ros\">)?<pre[^>]*>([^<]*)</pre>", html)
    found = dict(boxes)
    np.testing.assert_allclose(json.loads(found["camera_from_lidar, 4x4"]), pose, atol=1e-9)
    np.testing.assert_allclose(json.loads(found["lidar_from_camera, 4x4"]) @ pose, np.eye(4), atol=1e-8)
    x, y, z, *quaternion = map(float, found["camera_from_lidar, x y z [m], quaternion x y z w"].split())
    own = tmp_path / "pose.yaml"
    own.write_text(f"camera_from_lidar: {{translation_m: {[x, y, z]}, rotation_xyzw: {quaternion}}}\n")
    np.testing.assert_allclose(read_initial_guess(str(own))[0], pose, atol=1e-8)
    ros = tmp_path / "static.txt"
    ros.write_text(found["ROS 2"] + "\n")
    np.testing.assert_allclose(read_initial_guess(str(ros))[0], pose, atol=1e-8)
    rpy = next(text for name, text in boxes if name.startswith("camera_from_lidar, roll"))
    own.write_text(f"camera_from_lidar: {{translation_m: {[x, y, z]}, rpy_deg: {[*map(float, rpy.split())]}}}\n")
    np.testing.assert_allclose(read_initial_guess(str(own))[0], pose, atol=1e-8)


def test_the_page_holds_its_pictures_and_asks_for_nothing(quick: Path) -> None:
    html = (quick / "result.html").read_text()
    sources = re.findall(r'(?:src|href)="([^"]{0,40})', html)
    assert all(text.startswith(("data:", "#")) for text in sources)
    assert sum(text.startswith("data:image/webp") for text in sources) == 6, "edges, range, reflectance: twice each"


def test_names_of_frames_are_text_on_the_page(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(spy("fake:", *named(HOSTILE, "two"), "--out", str(tmp_path))) == 0
    html = (tmp_path / "result.html").read_text()
    assert "<img src=x" not in html
    assert html.count("</script>") == 1, "that of the page itself"
    assert escape('<img src=x onerror="stolen=1">') in html
    assert "\x1b" not in html
    assert f"wrote {tmp_path / 'result.html'}" in capsys.readouterr().out


def test_json_on_stdout_stays_json_beside_a_page(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(spy("fake:", "--json", "--out", str(tmp_path))) == 0
    assert set(json.loads(capsys.readouterr().out)) == {"results", "failed", "summary"}
    assert (tmp_path / "result.html").exists()


def test_a_page_of_many_frames_is_of_bounded_size_and_says_where_the_others_are(tmp_path: Path) -> None:
    assert main(spy("fake:?frames=25", "--out", str(tmp_path))) == 0
    html = (tmp_path / "result.html").read_text()
    assert html.count('<figure class="slides">') == 24 * 3
    assert html.count("<article") == 25
    assert "Overlays of 1 frames are in the folder of this page: drive_0024" in html


def test_overlays_beyond_the_limit_are_files_of_full_size_beside_the_page(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out = tmp_path / "a run" / "out"
    assert main(spy("fake:?frames=2", "--joint", "--out", str(out))) == 0
    embedded = (out / "result.html").read_text()
    monkeypatch.setattr("p2o.draw.run_page._MOST_CHARS", len(embedded) // 3)
    for folder in (out, tmp_path / "elsewhere"):
        assert main(["report", str(out), "--out", str(folder)]) == 0
        html = (folder / "result.html").read_text()
        sources = re.findall(r'<img src="([^"]*)', html)
        files = [unquote(text) for text in sources if not text.startswith("data:")]
        assert 0 < len(files) < len(sources) == 12
        assert all((folder / name).is_file() for name in files)
        assert sources[0].startswith("data:image/webp"), "edges before sweeps"
        assert html.count(' loading="lazy"') == len(files)
        assert "img-src data: blob: 'self' file:;" in html
    assert "file:" not in embedded


def test_overlays_of_a_large_image_have_its_size_and_the_page_is_small(tmp_path: Path) -> None:
    """Edges of images of long focal lengths are extracted from smaller images."""
    words = ["synthetic:?scenes=1&width_px=2484&height_px=750", "--init", "given", "--extractor", "depth/rings"]
    assert main(["run", *words, "--out", str(tmp_path)]) in (0, 1)
    drawn = cv2.imread(str(tmp_path / "scene-0000" / "after.png"))
    assert drawn.shape == (750, 2484, 3)
    assert (tmp_path / "result.html").stat().st_size < 3_000_000


def test_a_joint_result_shows_its_frames_and_a_failed_frame_its_reason(tmp_path: Path) -> None:
    assert main(spy("fake:?frames=3", "--joint", "--out", str(tmp_path / "joint"))) == 0
    html = (tmp_path / "joint" / "result.html").read_text()
    assert "3 frames jointly" in html
    assert html.count('<figure class="slides">') == 3 * 3
    assert main(spy("fake:?frames=3&bad=1", "--out", str(tmp_path / "bad"))) == 2
    html = (tmp_path / "bad" / "result.html").read_text()
    assert "1 could not be calibrated" in html
    assert "the image is cut short" in html


def test_a_rig_has_a_table_of_its_cameras(quick: Path) -> None:
    from p2o.draw.run_page import run_page

    run = json.loads((quick / "run.json").read_text())
    cameras = [{"name": f"<{name}>", "rotation_deg": 0.5, "translation_m": 0.02, "left_out": ""} for name in "ab"]
    pose = np.eye(4).tolist()
    rig = {"reason": "two agree", "verdict": {"trust": "trusted"}, "body_from_lidar": pose, "cameras": cameras}
    html = run_page(quick, {**run, "rig": rig})
    table = html[html.index('<div id="rig">') :].partition("</table>")[0]
    assert table.count("<tr>") == 3
    assert "&lt;a&gt;" in table
    assert "0.50" in table
    assert "two agree" in html


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
    result = p2o.Result(
        ("a",),
        np.eye(4),
        np.eye(4),
        p2o.Status.CONVERGED,
        "",
        verdict=Verdict((Reason(Doubt.RIVAL_POSE, "two"), Reason(Doubt.TOO_UNSURE, "wide"))),
    )
    steps = next_steps(result)
    assert len(steps) == len(set(steps)) >= 3


def test_a_dark_picture_is_brightened_by_a_gamma_that_is_told_and_a_bright_one_is_not() -> None:
    dark, bright = (np.full((40, 60, 3), value, np.uint8) for value in (12, 120))
    assert display_gamma(bright) == 1.0
    assert display_gamma(np.zeros((40, 60, 3), np.uint8)) == 1.0
    gamma = display_gamma(dark)
    assert 0.3 < gamma < 0.5
    assert brightened(dark, gamma).mean() > 70
    np.testing.assert_array_equal(brightened(bright, 1.0), bright)


def test_drawings_of_the_night_are_lighter_than_the_picture_itself() -> None:
    from p2o.draw.overlay import dimmed

    camera = p2o.Camera.pinhole(500, 500, 300, 100, 600, 200)
    night = np.full((200, 600, 3), 10, np.uint8)
    drawn = dimmed(night, camera)
    assert drawn[100:].mean() > night.mean()
    assert cv2.cvtColor(drawn, cv2.COLOR_RGB2GRAY)[4:26, -190:].max() > 150, "the gamma stands in the corner"


# ---- in a browser


@pytest.fixture(scope="module")
def hostile_run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("hostile")
    assert main(spy("fake:", *named(HOSTILE, "a" * 90, "b"), "--out", str(out))) == 0
    return out


@pytest.mark.parametrize(("width", "height"), [(1300, 900), (390, 844)])
@pytest.mark.parametrize("folder", ["quick", "hostile_run"])
def test_the_page_stands_in_a_browser(
    folder: str, width: int, height: int, request: pytest.FixtureRequest, browser: Any
) -> None:
    from tests.in_browser import Page, window

    path = request.getfixturevalue(folder) / "result.html"
    with window(browser, width, height):
        page = Page(browser, path)
        page.until_equal(lambda: page.run("return innerWidth"), width)
        page.until(lambda: page.run("return [...document.images].every((image) => image.naturalWidth > 0)"))
        page.until(lambda: page.run("return document.documentElement.scrollWidth") <= width, "scrolling sideways")
        assert page.run("return typeof stolen") == "undefined"
        # Pictures keep the form of the image.
        form = (
            "const i = document.images[0]; return i.clientWidth * i.naturalHeight / (i.clientHeight * i.naturalWidth)"
        )
        page.until_equal(lambda: page.run(form), pytest.approx(1, abs=0.02))
        shown = "return getComputedStyle(document.querySelectorAll('.compare img')[1]).clipPath"
        middle = page.run(shown)
        moved = "const s = document.querySelector('{}'); s.value = {}; s.dispatchEvent(new Event('input'));"
        page.run(moved.format(".slides .slider", 100))
        page.until(lambda: page.run(shown) != middle)
        light = "return getComputedStyle(document.querySelector('.compare img')).filter"
        assert page.run(light) == "brightness(1)"
        page.run(moved.format(".light input", 2))
        page.until_equal(lambda: page.run(light), "brightness(2)")
        assert page.complaints() == []
        assert page.requests() == []
