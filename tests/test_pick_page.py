"""`p2o pick` in a real browser, headless: clicks in both pictures make pairs, and their file yields the pose."""

from __future__ import annotations

import os
import re
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from p2o import InputError, pose_error
from p2o.arrays import Float
from p2o.cli import main
from p2o.problems.picked_pairs import PickedPairs, read_pairs, write_pairs
from p2o.problems.picked_pose import PickedFrame, solve_picks
from p2o_pages.pick.session import PickSession
from p2o_testing import stage

from tests.p2o_pages.pick.rig import places

pytest.importorskip("viser", reason="the extra `view` is not installed")

from p2o_pages.pick.server import Panel, PickServer

FRAME = stage.frame()
POSE = stage.camera_from_lidar()
HIDE = ".mantine-Notifications-root { display: none }"
DATA = "synthetic:?width_px=160&height_px=64&lidar=vlp-16&right=false&place=street"


@pytest.fixture
def server(tmp_path: Path) -> Iterator[PickServer]:
    """The page of two frames, at a free port."""
    session = PickSession([FRAME, FRAME], ["<b>first</b>", "second"], [0, 1], tmp_path / "pairs.yaml")
    with PickServer(session) as server:
        yield server


def press(button: Any) -> None:
    """Press a button of the page, from here."""
    button.value = True


# ---- the pictures in their plane


def test_positions_and_pixels_of_a_picture_are_inverse_and_pictures_do_not_overlap(server: PickServer) -> None:
    assert server.image.bottom < server.sweep.top
    for picture in (server.image, server.sweep, Panel(7, 3, 5.0, 2)):
        pixels = np.array([[-0.5, -0.5], [0, 0], [2.3, 1.6], [picture.columns - 0.501, picture.rows - 0.501]])
        for pixel, position in zip(pixels, picture.position(pixels), strict=True):
            found = picture.pixel(position)
            assert found is not None
            np.testing.assert_allclose(found, pixel, atol=1e-9)
        for outside in ([-0.6, 0], [0, -0.6], [picture.columns - 0.4, 0], [0, picture.rows - 0.4]):
            (position,) = picture.position(np.array([outside]))
            assert picture.pixel(position) is None
    columns, rows = np.diff(Panel(10, 3, 0.0, 4).position(np.array([[0, 0], [1, 1]])), axis=0)[0]
    assert rows == pytest.approx(4 * columns)


# ---- in a browser


def opened(driver: Any, server: PickServer) -> Any:
    """Return the page of a server, ready for clicks."""
    from tests.in_browser import Page

    page = Page(driver, server.url)
    # Without a GPU viser shows a notification, which covers a part of the image.
    page.run("document.head.append(Object.assign(document.createElement('style'), {textContent: arguments[0]}))", HIDE)
    says(page, "Click a point in one view")
    page.until(lambda: server._viser.get_clients())
    wait_for_whole(page, server)
    return page


def wait_for_whole(page: Any, server: PickServer) -> None:
    """Wait until the page shows the whole views."""
    page.until(lambda: View(page).shows(np.zeros(2), np.array([100.0, server.sweep.bottom])), "whole views")


def says(page: Any, text: str) -> None:
    """Wait until the page says this, among other words."""
    page.until(lambda: text in page.run("return document.body.innerText"), text)


class View:
    """The view of the browser: centre (2,) and half the size (2,) in the plane, and the canvas in the window [px]."""

    def __init__(self, page: Any) -> None:
        distance, up, left, fov_deg, aspect, *self.canvas = page.run(VIEW)
        # The axes of the browser's scene are -z, -y and -x of ours.
        self.centre = np.array([-left, -up])
        self.half = np.tan(np.radians(fov_deg) / 2) * distance * np.array([aspect, 1])

    def shows(self, low: Float, high: Float, tolerance: float = 0.2) -> bool:
        """Return whether a rectangle is in the middle, and as large as possible; the width of both views is 100.

        The canvas may grow by a row of pixels (0.1) after the view was fitted to it, which the browser does not report.
        """
        centred = np.abs(self.centre - (low + high) / 2).max() <= tolerance
        return bool(centred and abs((self.half - (high - low) / 2).min()) <= tolerance)

    def screen(self, position: Float) -> tuple[int, int]:
        """Return where a position of the plane is in the window [px]."""
        left, top, *size = self.canvas
        x, y = ((position - self.centre) / self.half + 1) / 2 * size + [left, top]
        return round(x), round(y)


VIEW = """
const { camera, canvas } = window.__viserMutable, box = canvas.getBoundingClientRect();
return [...camera.position, camera.fov, camera.aspect, box.left, box.top, box.width, box.height];
"""


def click(page: Any, server: PickServer, picture: Panel, pixel: Any) -> None:
    """Click a pixel of a picture."""
    from selenium.webdriver.common.actions.action_builder import ActionBuilder

    (position,) = picture.position(np.array([pixel], np.float64))
    actions = ActionBuilder(page.driver)
    actions.pointer_action.move_to_location(*View(page).screen(position)).click()
    actions.perform()


def drag(page: Any, low: Float, high: Float) -> None:
    """Draw a rectangle of the plane, again if the page did not receive it, and wait until the page shows it."""
    from selenium.webdriver.common.actions.action_builder import ActionBuilder

    from tests.in_browser import WAIT_S

    drawn, tolerance = -np.inf, 0.0

    def zoomed() -> bool:
        nonlocal drawn, tolerance
        view = View(page)
        if view.shows(low, high, tolerance):
            return True
        if time.monotonic() > drawn + WAIT_S / 4:
            actions, drawn, tolerance = ActionBuilder(page.driver), time.monotonic(), 6 * view.half[0] / view.canvas[2]
            actions.pointer_action.move_to_location(*view.screen(low)).pointer_down()
            actions.pointer_action.move_to_location(*view.screen((low + high) / 2))
            actions.pointer_action.move_to_location(*view.screen(high)).pointer_up()
            actions.perform()
        return False

    page.until(zoomed, "zoomed")


def test_clicks_make_pairs_that_yield_the_pose(browser: Any, server: PickServer) -> None:
    """Nine pairs, one wrong: it is marked, then deleted; the file then yields the extrinsic."""
    session = server.session
    page = opened(browser, server)
    for i, (uv, place) in enumerate(places(session, 10)):
        wrong = 0 if i != 3 else -90 if uv[0] > FRAME.camera.width / 2 else 90
        both = [(server.image, uv + [wrong, 0]), (server.sweep, place)]
        for picture, pixel in both if i % 2 else both[::-1]:
            click(page, server, picture, pixel)
            if picture is (both if i % 2 else both[::-1])[0][0]:
                says(page, "now the same point of the " + ("sweep" if i % 2 else "image"))
        says(page, f"{i + 1} pairs of this frame, saved")
        assert len(read_pairs(session.path)["<b>first</b>"]) == i + 1, "the file is written after every pair"
    says(page, "solved: 9 of 10 picks agree")
    says(page, "predicted error (67 %)")
    page.until_equal(lambda: page.texts("table.pairs tr.outlier td:first-child"), ["4"])
    errors = [float(text) for text in page.texts("table.pairs td:last-child")]
    assert errors[3] > 40
    assert max(errors[:3] + errors[4:]) < 6
    server.pair.value = "4"
    press_text(page, "delete this pair")
    says(page, "9 of 9 picks agree")
    wait_for_whole(page, server)
    kept = read_pairs(session.path)["<b>first</b>"]
    assert len(kept) == 9
    known = {tuple(np.round(xyz, 6)) for xyz in FRAME.cloud.xyz}
    assert all(tuple(np.round(xyz, 6)) in known for xyz in kept.xyz)
    press_text(page, "done")
    says(page, "done: 9 pairs")
    assert server.done.wait(60)
    assert page.complaints("SEVERE") == []
    assert page.elsewhere() == []
    browser.get("about:blank")
    solved = solve_picks([PickedFrame("stage", FRAME.camera, kept)])
    assert solved.camera_from_lidar is not None
    assert pose_error(solved.camera_from_lidar, POSE).rotation_deg < 1.0


def press_text(page: Any, text: str) -> None:
    """Press the button that says this."""
    script = "[...document.querySelectorAll('button')].find((b) => b.textContent === arguments[0]).click()"
    page.run(script, text)


def test_a_click_in_a_zoomed_picture_is_exact_and_keys_change_view_and_frame(browser: Any, server: PickServer) -> None:
    """One pixel of the image is many of the screen: the click is within a tenth of a pixel of where it was meant."""
    from selenium.webdriver.common.keys import Keys

    session = server.session
    page = opened(browser, server)
    wanted = np.array([117.3, 84.6])
    (position,) = server.image.position(wanted[None])
    drag(page, position - 1.5, position + [3.0, 1.5])
    click(page, server, server.image, wanted)
    says(page, "now the same point of the sweep")
    assert session.picked_uv is not None
    np.testing.assert_allclose(session.picked_uv, wanted, atol=0.1)
    wait_for_whole(page, server)
    # Esc discards it; F shows the whole views.
    page.find("body").send_keys(Keys.ESCAPE)
    page.until(lambda: session.picked_uv is None)
    (place,) = server.sweep.position(np.array([(uv := places(session, 1)[0])[1]]))
    drag(page, place - 2, place + 2)
    page.find("body").send_keys("f")
    wait_for_whole(page, server)
    click(page, server, server.sweep, uv[1])
    says(page, "now the same point of the image")
    # Another frame discards it, too.
    page.find("body").send_keys("n")
    page.until_equal(lambda: (session.number, server.frames.value), (1, "1: second"))
    assert session.picked_xyz is None
    page.find("body").send_keys("n")
    page.find("body").send_keys("p")
    page.until_equal(lambda: (session.number, server.frames.value), (0, "0: <b>first</b>"))
    assert page.complaints("SEVERE") == []
    assert page.elsewhere() == []
    browser.get("about:blank")


def test_on_a_phone_both_pictures_are_above_the_controls(browser: Any, server: PickServer) -> None:
    from tests.in_browser import Page, window

    with window(browser, 390, 844):
        page = Page(browser, server.url)
        says(page, "Click a point in one view")
        page.until(lambda: server._viser.get_clients())
        low, high = np.zeros(2), np.array([100.0, server.sweep.bottom])

        def visible() -> bool:
            (left, top), (right, bottom) = (View(page).screen(corner) for corner in (low, high))
            return left >= -1 and top >= -1 and right <= 391 and bottom <= 0.4 * 844 + 1

        page.until(visible)
    browser.get("about:blank")


# ---- what is pressed


def test_layers_are_shown_and_pairs_are_selected_and_deleted(server: PickServer) -> None:
    session = server.session
    for each in places(session, 3):
        session.pick_pixel(each[0])
        session.pick_point(*each[1])
    server.show()
    assert server.frames.value == "0: <b>first</b> (3)"
    assert server.pair.options == ("none", "1", "2", "3")
    press(server.delete)
    assert len(session.pairs) == 3, "none is selected"
    expected = np.delete(session.pairs.uv, 1, axis=0)
    server.pair.value = "2"
    press(server.delete)
    np.testing.assert_array_equal(session.pairs.uv, expected)
    assert (server.pair.value, server.pair.options) == ("none", ("none", "1", "2"))
    drawn = server._viser.scene.get_handle_by_name("/sweep").image
    server.layer.value = "bearing"
    after = server._viser.scene.get_handle_by_name("/sweep").image
    assert after.shape == drawn.shape
    assert not np.array_equal(after, drawn)
    rows, columns = session.ranges.index.shape
    times = after.shape[1] // columns
    assert after.shape[0] == rows * session.ranges.stretch * times
    np.testing.assert_array_equal(after[:: session.ranges.stretch * times, ::times], session.ranges.drawn("bearing"))


def test_errors_are_shown_and_the_frame_stays(tmp_path: Path) -> None:
    class Broken(list[Any]):
        def __getitem__(self, index: Any) -> Any:
            if index:
                raise InputError("<the image> is missing") if index == 1 else ValueError("odd")
            return FRAME

    path = tmp_path / "pairs.yaml"
    write_pairs(path, {"a": PickedPairs(np.full((4, 2), 5000.0), FRAME.cloud.xyz[:4])})
    with PickServer(PickSession(Broken(), ["a", "b", "c"], [0, 1, 2], path)) as server:
        assert "outside of the image" in server.status.content
        server.session.pick_pixel(np.array([1.0, 2.0]))
        for frame, text in (("1: b", "&lt;the image&gt; is missing"), ("2: c", "unexpected ValueError: odd")):
            server.frames.value = frame
            assert text in server.status.content
            assert server.session.number == 0
            assert server.session.picked_uv is not None
            assert server.frames.value == "0: a (4)"


# ---- the command


def started(out: Path) -> tuple[subprocess.Popen[str], str]:
    """Return a running `p2o pick` and the address that it printed."""
    argv = [sys.executable, "-m", "p2o", "pick", "--data", DATA, "--out", str(out), "--no-browser"]
    running = subprocess.Popen(argv, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env={**os.environ})
    assert running.stdout is not None
    printed = re.match(r"pick at (http://127\.0\.0\.1:\d+/) ", running.stdout.readline())
    assert printed is not None, running.communicate()[1]
    return running, printed.group(1)


def test_the_command_ends_when_the_page_is_done_and_its_file_stays(browser: Any, tmp_path: Path) -> None:
    from tests.in_browser import Page

    write_pairs(tmp_path / "pairs.yaml", {"scene-0000": PickedPairs(np.array([[5.0, 6]]), np.array([[7.0, 8, 9]]))})
    running, url = started(tmp_path / "pairs.yaml")
    page = Page(browser, url)
    says(page, "Click a point in one view")
    press_text(page, "done")
    printed, complaints = running.communicate(timeout=120)
    browser.get("about:blank")
    assert running.returncode == 0, complaints
    assert f"1 pairs of 1 frames in {tmp_path / 'pairs.yaml'}" in printed
    assert "--calibrator picked" in printed
    assert len(read_pairs(tmp_path / "pairs.yaml")["scene-0000"]) == 1


def test_ctrl_c_ends_it_too_and_no_pairs_are_status_1(tmp_path: Path) -> None:
    running, _ = started(tmp_path / "pairs.yaml")
    running.send_signal(signal.SIGINT)
    printed, complaints = running.communicate(timeout=120)
    assert running.returncode == 1
    assert "0 pairs" in printed
    assert complaints == ""


@pytest.mark.parametrize(
    ("out", "words", "message"),
    [
        ("none/pairs.yaml", [], "folder of the pairs is missing"),
        ("pairs.yaml", ["--frames", "7"], "out of range"),
        ("pairs.yaml", ["--port", "70000"], "70000"),
        ("other.yaml", [], "another form"),
        ("pairs.yaml", ["--port", "{taken}"], "127.0.0.1:{taken}: the port cannot be used"),
    ],
)
def test_wrong_input_is_an_error_before_anything_is_served(
    out: str, words: list[str], message: str, tmp_path: Path, refused: Callable[..., str]
) -> None:
    (tmp_path / "other.yaml").write_text("[]")
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = str(taken.getsockname()[1])
        said = [word.format(taken=port) for word in words]
        line = refused(["pick", "--no-browser", "--data", DATA, "--out", str(tmp_path / out), *said])
    assert message.format(taken=port) in line


def test_without_viser_one_line_names_the_package(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(sys.modules, "viser", None)
    assert main(["pick", "--no-browser", "--data", DATA, "--out", str(tmp_path / "pairs.yaml")]) != 0
    [line] = capsys.readouterr().err.splitlines()
    assert "p2o pick needs the package viser" in line
    assert line.endswith('run: pip install "viser>=1.1"')
