"""`p2o view`: the page in a real headless browser, its sliders, connections, and the command."""

from __future__ import annotations

import json
import os
import re
import signal
import socket
import subprocess
import sys
from collections import deque
from collections.abc import Callable, Iterator
from http.client import HTTPConnection
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from p2o import se3
from p2o.cli import main
from p2o.host.calibration_file import read_initial_guess
from p2o_pages.view.nudge import Nudge
from p2o_pages.view.session import KnownPose, Opened, ViewSession
from p2o_testing import stage

pytest.importorskip("viser", reason="the extra `view` is not installed")

from p2o_pages.view.server import ViewServer

STAGE = str(Path(__file__).with_name("stage_plugin.py"))
FRAME = stage.frame()
START = stage.camera_from_lidar()
RESULT = Nudge("LiDAR", (0.0, 0.0, 1.0)).applied(START)


@pytest.fixture
def server(tmp_path: Path) -> Iterator[ViewServer]:
    """The page of two frames, the first of which has a result, at a free port."""

    def opened(number: int) -> Opened:
        return Opened(FRAME, KnownPose(START, "<b>begin</b>"), KnownPose(RESULT, "trusted") if number == 0 else None)

    session = ViewSession(
        ["one", "two"],
        opened,
        lambda frame, start: KnownPose(START, "all is well"),
        tmp_path / "start.yaml",
        most_points=3000,
    )
    with ViewServer(session) as server:
        yield server


def press(button: Any) -> None:
    """Press a button of the page, from here."""
    button.value = True


# ---- in a browser


def test_the_page_is_up_and_a_slider_changes_the_sweep_on_its_image_at_once(browser: Any, server: ViewServer) -> None:
    from selenium.webdriver.common.keys import Keys

    from tests.in_browser import Page

    def picture() -> str:
        script = "return [...document.images].filter((i) => i.naturalWidth === 480).map((i) => i.src)[0] ?? ''"
        return str(page.run(script))

    def says(text: str) -> None:
        page.until(lambda: text in page.run("return document.body.innerText"), text)

    page = Page(browser, server.url)
    says("begin at the start")
    for text in ("turn x (right) [deg]", "shift z (forward) [m]", "write start.yaml", "(trusted)", "(<b>begin</b>)"):
        says(text)
    before = page.until(picture)
    server.sliders["turn y"].value = 2.0
    page.until(lambda: picture() not in ("", before))
    says("2.00 deg and")
    pose = Nudge("camera", (0.0, 2.0, 0.0)).applied(RESULT)
    assert np.array_equal(server.session.pose, pose)
    assert np.array_equal(server.overlay.image, server.session.shown.overlay(pose))
    # A person writes a number beside a slider.
    fields = "[...document.querySelectorAll('input[type=text]')].filter((i) => i.offsetWidth)"
    # Sliders of turns are the first ones: x, y, z.
    page.until_equal(lambda: page.run(f"return {fields}.slice(0, 3).map((i) => i.value)"), ["0", "2", "0"])
    field = page.run(f"return {fields}[0]")
    before = picture()
    field.click()
    field.send_keys(Keys.END, Keys.BACKSPACE, "1.5", Keys.ENTER)
    page.until_equal(lambda: server.session.nudge, Nudge("camera", (1.5, 2.0, 0.0)))
    page.until(lambda: picture() not in ("", before))
    assert page.complaints("SEVERE") == []
    assert page.elsewhere() == []
    browser.get("about:blank")


# ---- what is pressed


def test_buttons_begin_at_start_or_result_and_put_sliders_to_zero(server: ViewServer) -> None:
    assert server.session.pose is RESULT
    server.sliders["shift x"].value = 0.2
    press(server.begin["start"])
    assert server.session.pose is START
    assert {slider.value for slider in server.sliders.values()} == {0.0}
    server.sliders["turn z"].value = -1.0
    assert np.array_equal(server.session.pose, Nudge("camera", (0.0, 0.0, -1.0)).applied(START))


def test_other_axes_are_named_on_the_sliders_and_keep_the_pose(server: ViewServer) -> None:
    server.sliders["turn z"].value = 1.0
    before = server.session.pose
    server.axes.value = "LiDAR"
    assert server.sliders["turn z"].label == "turn z [deg]"
    assert server.sliders["turn z"].value == 0.0
    assert np.array_equal(server.session.pose, before)
    server.sliders["shift x"].value = 0.5
    assert np.allclose(server.session.pose, before @ se3.make(None, [0.5, 0, 0]))


def test_the_button_writes_what_start_reads(server: ViewServer) -> None:
    server.sliders["shift y"].value = 0.1
    press(server.write)
    pose, remarks = read_initial_guess(str(server.session.out))
    assert np.allclose(pose, server.session.pose, rtol=0, atol=1e-12)
    assert remarks == ()
    assert "start.yaml: p2o run --start" in server.status.content


def test_the_cloud_has_the_colours_that_are_chosen_and_poses_can_be_hidden(server: ViewServer) -> None:
    for by in ("reflectance", "image", "range"):
        server.by.value = by
        expected = server.session.shown.colours(by, server.session.pose)
        assert np.array_equal(server.cloud.colors, expected)
    server.shows["result"].value = False
    assert (server._frustum["start"].visible, server._frustum["result"].visible) == (True, False)
    server.shows["image"].value = False
    assert (server._frustum["now"].visible, server._frustum["image"].visible) == (True, False)


# ---- who may connect


@pytest.mark.parametrize("origin", ["http://evil.example", "http://127.0.0.1:1", None])
def test_other_pages_get_no_connection_and_nothing_is_handed_on(server: ViewServer, origin: str | None) -> None:
    from websockets.exceptions import InvalidStatus
    from websockets.sync.client import connect

    address = server.url.replace("http", "ws")
    assert address.startswith("ws://127.0.0.1:"), "this machine only"
    with pytest.raises(InvalidStatus, match="403"):
        connect(address, origin=origin, subprotocols=["viser-v1.1.1"])
    connect(address, origin=server.url.rstrip("/"), subprotocols=["viser-v1.1.1"]).close()
    assert server._viser.request_share_url() is None


def test_other_names_of_this_machine_get_no_page(server: ViewServer) -> None:
    """A foreign name may resolve to 127.0.0.1 (DNS rebinding): its pages would have the origin of this page."""
    for host, status in ((None, 200), ("evil.example", 403), (f"evil.example:{server.port}", 403)):
        connection = HTTPConnection(server.host, server.port)
        connection.request("GET", "/", headers={} if host is None else {"Host": host})
        response = connection.getresponse()
        assert response.status == status
        policy = response.getheader("Content-Security-Policy") or ""
        assert ("frame-ancestors 'none'" in policy and "default-src 'self' data: blob:;" in policy) == (status == 200)
        connection.close()


@pytest.mark.parametrize("message", ["text", b"\x81\xa4type\xa1x"])
def test_a_malformed_message_is_one_line(server: ViewServer, message: Any, capsys: pytest.CaptureFixture[str]) -> None:
    from websockets.exceptions import ConnectionClosedError
    from websockets.sync.client import connect

    address, origin = server.url.replace("http", "ws"), server.url.rstrip("/")
    versions = [f"viser-v{version('viser')}"]
    with connect(address, origin=origin, subprotocols=versions, max_size=None) as client:
        client.send(message)
        with pytest.raises(ConnectionClosedError, match="1007"):
            deque(client, maxlen=0)
    said = capsys.readouterr().err.splitlines()
    assert [line[:38] for line in said] == ["p2o: ignored a malformed message of th"]
    connect(address, origin=origin, subprotocols=versions, max_size=None).close()


@pytest.mark.parametrize("value", [np.nan, -1e308])
def test_a_slider_value_that_the_page_does_not_offer_is_set_back_with_one_line(
    server: ViewServer, value: float, capsys: pytest.CaptureFixture[str]
) -> None:
    pose = server.session.pose
    for control, default in (
        (server.sliders["turn x"], 0.0),
        (server.sliders["shift z"], 0.0),
        (server.point_size, 4.0),
    ):
        control.value = value
        assert control.value == default
        assert "invalid value" in server.status.content
    server.axes.value = "nonsense"
    assert server.axes.value == "camera"
    server.frames.value = "nonsense"
    assert np.array_equal(server.session.pose, pose)
    assert server.session.number == 0
    assert capsys.readouterr().err == ""


# ---- the command


def view(out: Path, *words: str) -> list[str]:
    return ["view", *words, "--plugin", STAGE, "--no-browser", "--out", str(out / "start.yaml")]


def test_ctrl_c_ends_it(tmp_path: Path) -> None:
    argv = [sys.executable, "-m", "p2o", *view(tmp_path, "fake:")]
    running = subprocess.Popen(argv, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env={**os.environ})
    assert running.stdout is not None
    line = running.stdout.readline()
    assert re.match(r"view at http://127\.0\.0\.1:\d+/ \(Ctrl-C here ends it\)", line), running.communicate()[1]
    running.send_signal(signal.SIGINT)
    said, complaints = running.communicate(timeout=60)
    assert (running.returncode, said, complaints) == (0, "", "")


def opened_session(monkeypatch: pytest.MonkeyPatch, words: list[str]) -> ViewSession:
    """Return the session that a command would serve."""
    seen: list[ViewSession] = []

    class Seen(ViewServer):
        def __init__(self, session: ViewSession, host: str, port: int) -> None:
            seen.append(session)
            raise KeyboardInterrupt

    monkeypatch.setattr("p2o_pages.view.server.ViewServer", Seen)
    assert main(words) == 130
    [session] = seen
    return session


def test_a_folder_of_a_run_shows_where_it_began_and_ended(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    run = ["run", "--plugin", STAGE, "--data", "fake:?frames=3", "--frames", "1", "--calibrator", "spy"]
    run += ["--witness", "none"]
    assert main([*run, "--perturb", "2deg 0.1m", "--out", str(tmp_path / "out")]) == 0
    row = json.loads((tmp_path / "out" / "run.json").read_text())["results"][0]
    for words in ([str(tmp_path / "out")], ["fake:?frames=3", "--frames", "1", "--run", str(tmp_path / "out")]):
        session = opened_session(monkeypatch, view(tmp_path, *words))
        assert session.names == ("drive/0001",)
        assert session.start.description == "the initial guess of the run"
        assert np.allclose(session.start.camera_from_lidar, row["start"])
        assert session.result is not None
        assert session.result.description.startswith(row["verdict"]["trust"])
        assert np.allclose(session.pose, row["camera_from_lidar"])


@pytest.mark.parametrize(
    ("content", "said"),
    [
        ("[]", "no results of p2o run"),
        ('{"results": []}', "no results of p2o run"),
        ('{"results": [{"frames": 3}]}', "run.json"),
        ("{", "run.json"),
    ],
)
def test_a_folder_whose_run_cannot_be_read_is_told(
    content: str, said: str, tmp_path: Path, refused: Callable[..., str]
) -> None:
    (tmp_path / "run.json").write_text(content)
    assert said in refused(view(tmp_path, str(tmp_path)))


def test_a_run_of_frames_of_python_asks_where_they_are(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, refused: Callable[..., str]
) -> None:
    import p2o

    run = p2o.calibrate(FRAME, calibrator="spy", witness="none", registry=p2o.Registry.load(extra_files=[STAGE]))
    (tmp_path / "run.json").write_text(json.dumps(run.as_dict()))
    assert f"p2o view DATASET:PATH --run {tmp_path}" in refused(view(tmp_path, str(tmp_path)))
    session = opened_session(monkeypatch, view(tmp_path, "fake:", "--run", str(tmp_path)))
    assert session.result is None, "no frame of these data is called as the one of the run"


def test_frames_without_any_start_are_looked_at_from_a_guess(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    bare = stage.frame().without_truth()
    monkeypatch.setattr(stage, "frame", lambda: bare)
    session = opened_session(monkeypatch, view(tmp_path, "fake:"))
    assert session.start.description.startswith("a guess, as none is given: roughly x forward")
    given = opened_session(
        monkeypatch, view(tmp_path, "fake:", "--start", "roughly x forward, z up; camera looks left")
    )
    assert given.start.description == "the pose of roughly x forward, z up; camera looks left"


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["nowhere"], "expected DATASET:PATH, or a folder that p2o run --out has written"),
        (["fake:", "--frames", "9"], "--frames"),
        (["fake:", "--run", "nowhere"], "run.json"),
        (["fake:", "--start", "none.yaml"], "none.yaml"),
        (["fake:", "--host", "no.such.host.example"], "the port cannot be used"),
        (["fake:", "--port", "{taken}"], "127.0.0.1:{taken}: the port cannot be used"),
    ],
)
def test_wrong_words_are_one_clear_line(
    words: list[str], said: str, tmp_path: Path, refused: Callable[..., str]
) -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = str(taken.getsockname()[1])
        line = refused(view(tmp_path, *(word.format(taken=port) for word in words)))
    assert said.format(taken=port) in line


def test_without_viser_one_line_says_how_to_get_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(sys.modules, "viser", None)
    assert main(view(tmp_path, "fake:")) != 0
    [line] = capsys.readouterr().err.splitlines()
    assert line.endswith('run: pip install "viser>=1.1"')
