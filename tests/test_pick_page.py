"""`p2o pick` in a real browser, headless: clicks on both pictures make pairs, and their file gives the pose."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from p2o import pose_error, se3
from p2o.cli import main
from p2o.picks.pairs import read_pairs, write_pairs
from p2o.picks.server import PickServer
from p2o.picks.session import Session
from p2o.picks.solve import PickedFrame, solve_picks
from p2o.testing import stage

FRAME = stage.frame()
DATA = "synthetic:?width_px=160&height_px=64&lidar=vlp-16&right=false&place=street"


def started(out: Path, *words: str) -> tuple[subprocess.Popen[str], str]:
    """Return a running `p2o pick` and the address that it printed."""
    argv = [sys.executable, "-m", "p2o", "pick", "--data", DATA, "--out", str(out), "--no-browser", *words]
    running = subprocess.Popen(argv, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env={**os.environ})
    assert running.stdout is not None
    found = re.match(r"pick at (http://127\.0\.0\.1:\d+/\S+/) ", running.stdout.readline())
    assert found is not None, running.communicate()[1]
    return running, found.group(1)


def post(url: str, value: Any) -> Any:
    from urllib.request import Request, urlopen

    body = json.dumps(value).encode()
    with urlopen(Request(url, body, {"Content-Type": "application/json"}), timeout=60) as answer:
        return json.load(answer)


def test_the_command_ends_when_the_page_is_done_and_its_file_stays(tmp_path: Path) -> None:
    running, url = started(tmp_path / "pairs.yaml")
    assert post(f"{url}pairs/0", [{"uv": [5, 6], "xyz": [7, 8, 9]}])["count"] == 1
    assert post(f"{url}done", {})["count"] == 1
    said, complaints = running.communicate(timeout=120)
    assert running.returncode == 0, complaints
    assert f"1 pairs of 1 frames in {tmp_path / 'pairs.yaml'}" in said
    assert "--calibrator picked" in said
    assert len(read_pairs(tmp_path / "pairs.yaml")["scene-0000"]) == 1


def test_ctrl_c_ends_it_too_and_no_pairs_are_status_1(tmp_path: Path) -> None:
    running, _ = started(tmp_path / "pairs.yaml")
    time.sleep(0.5)
    running.send_signal(signal.SIGINT)
    said, complaints = running.communicate(timeout=120)
    assert running.returncode == 1
    assert "0 pairs" in said
    assert complaints == ""


def test_wrong_words_are_told_before_anything_is_served(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    base = ["pick", "--no-browser", "--data", DATA]
    assert main([*base, "--out", str(tmp_path / "none" / "pairs.yaml")]) == 2
    assert "folder of the pairs is missing" in capsys.readouterr().err
    assert main([*base, "--out", str(tmp_path / "pairs.yaml"), "--frames", "7"]) == 2
    assert "out of range" in capsys.readouterr().err
    assert main([*base, "--out", str(tmp_path / "pairs.yaml"), "--port", "70000"]) == 2
    write_pairs(tmp_path / "pairs.yaml", {})
    (tmp_path / "pairs.yaml").write_text("[]")
    assert main([*base, "--out", str(tmp_path / "pairs.yaml")]) == 2
    assert "another form" in capsys.readouterr().err


# ---- in a browser


class Page:
    """The page in a browser, with what a person does on it."""

    def __init__(self, driver: Any, url: str) -> None:
        self.driver, self.url = driver, url
        driver.get_log("browser")
        driver.get_log("performance")
        driver.get(url)
        self.until(lambda: "click a point" in self.text("note"))

    def text(self, name: str) -> str:
        return str(self.driver.execute_script("return document.getElementById(arguments[0]).textContent", name))

    def until(self, true: Any) -> None:
        from selenium.webdriver.support.ui import WebDriverWait

        WebDriverWait(self.driver, 90).until(lambda _: true())

    def click(self, pane: str, x: float, y: float) -> None:
        """Click a place of a picture, in its own units from its left upper corner."""
        from selenium.webdriver import ActionChains

        canvas = self.driver.find_element("id", pane)
        left, top, scale = json.loads(canvas.get_attribute("data-view"))
        size = canvas.size
        at = (left + x * scale - size["width"] / 2, top + y * scale - size["height"] / 2)
        ActionChains(self.driver).move_to_element_with_offset(canvas, round(at[0]), round(at[1])).click().perform()

    def rows(self) -> list[list[str]]:
        script = "return [...document.querySelectorAll('#pairs tr')].map(r => [...r.cells].map(c => c.textContent))"
        return list(self.driver.execute_script(script))

    def off(self) -> list[float]:
        return [float(row[3]) for row in self.rows() if row[3]]

    def press(self, name: str) -> None:
        self.driver.find_element("id", name).click()

    def complaints(self) -> list[str]:
        return [entry["message"] for entry in self.driver.get_log("browser")]

    def elsewhere(self) -> list[str]:
        """Return the addresses outside of the page's own that were asked for."""
        events = [json.loads(entry["message"])["message"] for entry in self.driver.get_log("performance")]
        sent = [e["params"]["request"]["url"] for e in events if e["method"] == "Network.requestWillBeSent"]
        # The browser's own first page (chrome:) may still be loading its parts.
        return [url for url in sent if not url.startswith((self.url, "data:", "blob:", "chrome:"))]


def places(session: Session, count: int) -> list[tuple[list[float], tuple[int, int]]]:
    """Return pixels of the image and of the range image that show the same points, at different distances."""
    told = session.described(0)
    found = []
    assert FRAME.camera_from_lidar is not None
    for column in range(2, told["columns"] - 2, 5):
        for row in range(1, told["rows"], 3):
            point = session.point(0, column, row)
            if point is None or (point["column"], point["row"]) != (column, row):
                continue
            uv = FRAME.camera.project(se3.apply(FRAME.camera_from_lidar, np.array([point["xyz"]])))[0]
            if FRAME.camera.in_image(uv, -8):
                found.append(([float(x) for x in uv], (column, row)))
    chosen = np.random.default_rng(2).choice(len(found), count, replace=False)
    return [found[i] for i in chosen]


def test_clicks_make_pairs_that_give_the_pose(browser: Any, tmp_path: Path) -> None:
    """Nine pairs, one wrong: it is marked, and deleted; the file then gives the extrinsic as well as clicks may."""
    path = tmp_path / "pairs.yaml"
    session = Session([FRAME], ["stage"], [0], path)
    told = session.described(0)
    chosen = places(session, 10)
    with PickServer(session) as server:
        page = Page(browser, server.url)
        for i, (uv, (column, row)) in enumerate(chosen):
            wrong = 90 if i == 3 else 0
            wrong = -wrong if uv[0] > FRAME.camera.width / 2 else wrong
            first, then = ("image", "range") if i % 2 else ("range", "image")
            for pane in (first, then):
                if pane == "image":
                    page.click("image", uv[0] + 0.5 + wrong, uv[1] + 0.5)
                else:
                    page.click("range", column + 0.5, (row + 0.5) * told["stretch"])
                if pane == first:
                    page.until(lambda: "now the same point" in page.text("note"))
            page.until(lambda i=i: f"{i + 1} pairs of this frame, saved" in page.text("note"))
            assert len(read_pairs(path)["stage"]) == i + 1, "the file is written after every pair"
        page.until(lambda: "converged: 9 of 10 picks agree" in page.text("result"))
        page.until(lambda: len(page.off()) == 10)
        off = page.off()
        assert off[3] > 40
        assert max(off[:3] + off[4:]) < 6
        bad = browser.execute_script(
            "return [...document.querySelectorAll('#pairs tr.bad td:first-child')].map(c => c.textContent)"
        )
        assert bad == ["4"]
        browser.execute_script("document.querySelectorAll('#pairs button')[3].click()")
        page.until(lambda: "9 of 9 picks agree" in page.text("result"))
        kept = read_pairs(path)["stage"]
        assert len(kept) == 9
        known = {tuple(np.round(xyz, 6)) for xyz in FRAME.cloud.xyz}
        assert all(tuple(np.round(xyz, 6)) in known for xyz in kept.xyz)
        page.press("done")
        page.until(lambda: "done: 9 pairs" in page.text("note"))
        assert server.done.wait(5)
        assert page.complaints() == []
        assert page.elsewhere() == []
    solved = solve_picks([PickedFrame("stage", FRAME.camera, kept)])
    assert solved.camera_from_lidar is not None
    assert FRAME.camera_from_lidar is not None
    assert pose_error(solved.camera_from_lidar, FRAME.camera_from_lidar).rotation_deg < 1.0


def test_zoom_layers_frames_and_a_page_that_is_opened_again(browser: Any, tmp_path: Path) -> None:
    """The second frame is the first with another name; a click while zoomed in is the place that is seen there."""
    from selenium.webdriver import ActionChains
    from selenium.webdriver.common.actions.wheel_input import ScrollOrigin
    from selenium.webdriver.common.keys import Keys
    from selenium.webdriver.support.ui import Select

    session = Session([FRAME, FRAME], ["<b>first</b>", "second"], [0, 1], tmp_path / "pairs.json")
    told = session.described(0)
    (uv, (column, row)), *_ = places(session, 1)
    with PickServer(session) as server:
        page = Page(browser, server.url)
        canvas = browser.find_element("id", "image")
        scale = json.loads(canvas.get_attribute("data-view"))[2]
        for _ in range(3):
            ActionChains(browser).scroll_from_origin(ScrollOrigin.from_element(canvas), 0, -100).perform()
        page.until(lambda: json.loads(canvas.get_attribute("data-view"))[2] > 2 * scale)
        left, top, scale = json.loads(canvas.get_attribute("data-view"))
        middle = [(canvas.size["width"] / 2 - left) / scale, (canvas.size["height"] / 2 - top) / scale]
        page.click("image", *middle)
        page.until(lambda: "now the same point of the sweep" in page.text("note"))
        Select(browser.find_element("id", "layer")).select_by_visible_text("bearing")
        page.click("range", column + 0.5, (row + 0.5) * told["stretch"])
        page.until(lambda: "1 pairs of this frame, saved" in page.text("note"))
        kept = read_pairs(tmp_path / "pairs.json")["<b>first</b>"]
        assert kept.uv[0] == pytest.approx([middle[0] - 0.5, middle[1] - 0.5], abs=1 / scale)
        # A point that waits is forgotten with Esc, and in another frame.
        page.press("fit")
        page.click("image", uv[0] + 0.5, uv[1] + 0.5)
        browser.find_element("tag name", "body").send_keys(Keys.ESCAPE)
        page.click("range", column + 0.5, (row + 0.5) * told["stretch"])
        page.until(lambda: "now the same point of the image" in page.text("note"))
        page.press("next")
        page.until(lambda: "click a point" in page.text("note"))
        assert page.rows() == []
        page = Page(browser, server.url)
        assert Select(browser.find_element("id", "frame")).first_selected_option.text == "<b>first</b> (1)"
        assert len(page.rows()) == 1
        assert page.complaints() == []
        assert page.elsewhere() == []
