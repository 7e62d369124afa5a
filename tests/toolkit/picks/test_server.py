"""The server of `p2o pick`, asked without a browser: what it tells, what it keeps, and whom it refuses."""

from __future__ import annotations

import json
from collections.abc import Iterator
from http.client import HTTPConnection, HTTPResponse
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from p2o import InputError, pose_error, se3
from p2o.picks.pairs import Pairs, read_pairs, write_pairs
from p2o.picks.server import MOST_BYTES, PickServer
from p2o.picks.session import Session
from p2o.testing import stage

FRAME = stage.frame()


class Client:
    """What a browser, or something else, asks of the server."""

    def __init__(self, server: PickServer) -> None:
        self.server = server

    def send(
        self, method: str, path: str, body: bytes | None = None, token: str | None = None, **headers: str
    ) -> tuple[HTTPResponse, bytes]:
        connection = HTTPConnection("127.0.0.1", self.server.port, timeout=20)
        named = {name.replace("_", "-"): value for name, value in headers.items()}
        token = self.server.token if token is None else token
        connection.request(method, f"/{token}/{path}" if token else path, body, named)
        answer = connection.getresponse()
        data = answer.read()
        connection.close()
        return answer, data

    def get(self, path: str) -> Any:
        answer, data = self.send("GET", path)
        assert answer.status == 200, data
        return json.loads(data)

    def post(self, path: str, value: Any, status: int = 200) -> Any:
        answer, data = self.send("POST", path, json.dumps(value).encode(), Content_Type="application/json")
        assert answer.status == status, data
        return json.loads(data)


@pytest.fixture
def session(tmp_path: Path) -> Session:
    return Session([FRAME], ["stage"], [0], tmp_path / "pairs.yaml")


@pytest.fixture
def client(session: Session) -> Iterator[Client]:
    with PickServer(session) as server:
        yield Client(server)


def truthful(count: int = 8) -> list[dict[str, list[float]]]:
    """Return exact pairs of the stage, all over its image."""
    assert FRAME.camera_from_lidar is not None
    uv = FRAME.camera.project(se3.apply(FRAME.camera_from_lidar, FRAME.cloud.xyz))
    rows = np.flatnonzero(FRAME.camera.in_image(uv, -5))
    rows = np.random.default_rng(0).choice(rows, count, replace=False)
    return [{"uv": list(uv[i]), "xyz": list(FRAME.cloud.xyz[i])} for i in rows]


def test_the_overview_names_frames_and_file(client: Client, tmp_path: Path) -> None:
    told = client.get("overview")
    assert told["frames"] == ["stage"]
    assert told["counts"] == [0]
    assert told["path"] == str(tmp_path / "pairs.yaml")


def test_pictures_have_the_sizes_that_are_told(client: Client) -> None:
    import cv2

    told = client.get("frame/0")
    for layer, size in (("image", (told["height"], told["width"])), ("depth", (told["rows"], told["columns"]))):
        answer, data = client.send("GET", f"picture/0/{layer}")
        assert answer.headers["Content-Type"] == "image/png"
        picture = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR)
        assert picture.shape[:2] == size
    np.testing.assert_array_equal(
        cv2.imdecode(np.frombuffer(client.send("GET", "picture/0/image")[1], np.uint8), 1)[..., ::-1], FRAME.image.rgb
    )


def test_a_place_of_the_range_image_is_one_point_of_the_sweep(client: Client) -> None:
    told = client.get("frame/0")
    found = [client.get(f"point/0/{c}/{told['rows'] // 2}") for c in range(0, told["columns"], told["columns"] // 7)]
    known = {tuple(np.round(xyz, 6)) for xyz in FRAME.cloud.xyz}
    some = [each for each in found if each is not None]
    assert len(some) >= 3
    for each in some:
        assert tuple(each["xyz"]) in known
        again = client.get(f"point/0/{each['column']}/{each['row']}")
        assert again == each


def test_pairs_are_in_the_file_after_every_change(client: Client, tmp_path: Path) -> None:
    pairs = truthful(3)
    for count in (1, 3, 2, 0):
        told = client.post("pairs/0", pairs[:count])
        assert told["count"] == count
        kept = read_pairs(tmp_path / "pairs.yaml")
        assert len(kept.get("stage", Pairs.none())) == count
    assert [path.name for path in tmp_path.iterdir()] == ["pairs.yaml"]


def test_a_file_is_gone_on_with_and_other_frames_stay_in_it(tmp_path: Path) -> None:
    path = tmp_path / "pairs.json"
    old = Pairs(np.array([[5.0, 6]]), FRAME.cloud.xyz[[50]])
    write_pairs(path, {"stage": old, "elsewhere": old})
    session = Session([FRAME], ["stage"], [0], path)
    with PickServer(session) as server:
        client = Client(server)
        told = client.get("frame/0")
        assert told["pairs"][0]["uv"] == [5, 6]
        client.post("pairs/0", truthful(2))
    kept = read_pairs(path)
    assert {name: len(pairs) for name, pairs in kept.items()} == {"stage": 2, "elsewhere": 1}


def test_the_pixel_of_a_pair_is_that_of_its_point(client: Client) -> None:
    told = client.get("frame/0")
    found = client.get(f"point/0/{told['columns'] // 2}/{told['rows'] // 2}")
    client.post("pairs/0", [{"uv": [5, 6], "xyz": found["xyz"]}])
    assert client.get("frame/0")["pairs"][0]["pixel"] == [found["column"], found["row"]]


def test_exact_pairs_are_solved_and_each_is_told(client: Client) -> None:
    pairs = truthful(9)
    pairs[4]["uv"][0] += 60 if pairs[4]["uv"][0] < FRAME.camera.width / 2 else -60
    client.post("pairs/0", pairs)
    told = client.post("solve", {})
    assert told["solved"]
    assert told["status"] == "converged"
    assert FRAME.camera_from_lidar is not None
    assert pose_error(np.array(told["pose"]), FRAME.camera_from_lidar).rotation_deg < 0.02
    mine = told["frames"]["stage"]
    assert mine["agrees"] == [i != 4 for i in range(9)]
    assert mine["off_px"][4] > 20
    assert max(off for i, off in enumerate(mine["off_px"]) if i != 4) < 0.1
    assert abs(mine["seen"][4][0] - pairs[4]["uv"][0]) == pytest.approx(60, abs=0.2)


def test_too_few_pairs_are_a_status(client: Client) -> None:
    client.post("pairs/0", truthful(2))
    told = client.post("solve", {})
    assert not told["solved"]
    assert told["status"] == "too-few-matches"
    assert told["frames"]["stage"]["off_px"] == [None, None]


def test_done_is_answered_before_it_ends(client: Client) -> None:
    assert not client.server.done.is_set()
    assert client.post("done", {})["count"] == 0
    assert client.server.done.wait(5)


@pytest.mark.parametrize(
    "value",
    [
        {},
        [1],
        [{"uv": [1, 2]}],
        [{"uv": [1, "2"], "xyz": [1, 2, 3]}],
        [{"uv": [1, 1e300], "xyz": [1, 2, 3]}],
        [{"uv": [-50, 2], "xyz": [1, 2, 3]}],
        [{"uv": [1, 2], "xyz": [1, 2, 3], "more": 1}],
        [{"uv": [1, 2], "xyz": [1, 2, 3]}] * 10_001,
    ],
)
def test_what_is_no_pairs_is_refused_and_the_file_stays(client: Client, tmp_path: Path, value: Any) -> None:
    client.post("pairs/0", truthful(2))
    before = (tmp_path / "pairs.yaml").read_bytes()
    assert client.post("pairs/0", value, status=400)["error"]
    assert (tmp_path / "pairs.yaml").read_bytes() == before
    assert client.get("overview")["counts"] == [2]


def test_a_file_that_cannot_be_written_is_told_and_nothing_is_taken(client: Client, tmp_path: Path) -> None:
    (tmp_path / "pairs.yaml").mkdir()
    assert "cannot write" in client.post("pairs/0", truthful(2), status=400)["error"]
    assert client.get("overview")["counts"] == [0]


@pytest.mark.parametrize(
    "path",
    [
        "frame/1",
        "frame/-1",
        "frame/x",
        "frame/٣",
        "frame/99999999999",
        "frame/0/",
        "picture/0/nothing",
        "picture/0/../../overview",
        "point/0/nan/1",
        "point/0/1e9/1",
        "point/0/-1/1",
        "point/0//1",
        "point/0/1",
        "pairs/0",
        "done",
        "index.html",
    ],
)
def test_what_is_not_there_is_not_found(client: Client, path: str) -> None:
    from urllib.parse import quote

    answer, data = client.send("GET", quote(path))
    assert answer.status == 404
    assert json.loads(data) == {"error": "Not Found"}
    assert not client.server.done.is_set()


def test_a_place_far_outside_of_the_range_image_has_no_point(client: Client) -> None:
    assert client.get("point/0/99999999/99999999") is None


def test_who_does_not_know_the_token_sees_nothing(client: Client) -> None:
    wrong = "x" + client.server.token[1:] if client.server.token[0] != "x" else "y" + client.server.token[1:]
    for token, path in ((wrong, "overview"), (wrong, ""), ("", "/"), ("", "/overview"), ("", "/favicon.ico")):
        answer, data = client.send("GET", path, token=token)
        assert answer.status == 404
        assert b"stage" not in data
    assert len(client.server.token) >= 22
    with PickServer(client.server.session) as other:
        assert other.token != client.server.token


def test_requests_for_another_host_or_from_another_origin_are_refused(client: Client) -> None:
    assert client.send("GET", "overview", Host="evil.example")[0].status == 403
    assert client.send("GET", "overview", Host=f"evil.example:{client.server.port}")[0].status == 403
    kind = {"Content_Type": "application/json"}
    assert client.send("POST", "done", b"{}", Origin="http://evil.example", **kind)[0].status == 403
    assert client.send("POST", "done", b"{}", Origin="null", **kind)[0].status == 403
    assert client.send("POST", "done", b"{}", Content_Type="text/plain")[0].status == 415
    assert not client.server.done.is_set()
    assert client.send("POST", "done", b"{}", Origin=client.server.origin, **kind)[0].status == 200


def test_bodies_that_are_too_large_or_of_no_length_are_refused(client: Client) -> None:
    kind = {"Content_Type": "application/json"}
    assert client.send("POST", "pairs/0", Content_Length=str(MOST_BYTES + 1), **kind)[0].status == 413
    assert client.send("POST", "pairs/0", Content_Length="-5", **kind)[0].status == 411
    assert client.send("POST", "pairs/0", Content_Length="9" * 30, **kind)[0].status == 411
    assert client.send("POST", "pairs/0", b"[" * 5000, **kind)[0].status == 400
    assert client.send("POST", "pairs/0", b"\xff", **kind)[0].status == 400


def test_every_answer_forbids_what_the_page_does_not_need(client: Client) -> None:
    for path in ("", "overview", "nothing"):
        answer, _ = client.send("GET", path)
        policy = answer.headers["Content-Security-Policy"]
        assert "default-src 'none'" in policy
        assert "unsafe" not in policy
        assert "frame-ancestors 'none'" in policy
        assert answer.headers["X-Content-Type-Options"] == "nosniff"
        assert answer.headers["Cache-Control"] == "no-store"
        assert answer.headers["Referrer-Policy"] == "no-referrer"


def test_the_page_names_no_address_of_elsewhere(client: Client) -> None:
    _, page = client.send("GET", "")
    assert page.startswith(b"<!doctype html>")
    assert b"http://" not in page
    assert b"https://" not in page
    assert b"{{" not in page


def test_only_this_machine_is_listened_to(client: Client) -> None:
    assert client.server.url.startswith("http://127.0.0.1:")
    assert client.server._http.server_address[0] == "127.0.0.1"


def test_a_port_that_is_taken_is_told(client: Client, session: Session) -> None:
    with pytest.raises(InputError, match="port cannot be used"):
        PickServer(session, client.server.port)


def test_a_frame_that_cannot_be_read_is_told(tmp_path: Path) -> None:
    class Broken(list[Any]):
        def __getitem__(self, index: Any) -> Any:
            raise InputError("the image is missing", where="a.png") if index == 0 else ValueError("odd")

    with PickServer(Session(Broken(), ["a", "b"], [0, 1], tmp_path / "pairs.yaml")) as server:
        client = Client(server)
        answer, data = client.send("GET", "frame/0")
        assert answer.status == 400
        assert "image is missing" in json.loads(data)["error"]
        assert client.send("GET", "frame/1")[0].status == 500
        assert client.get("overview")["frames"] == ["a", "b"]


def test_a_missing_folder_and_a_strange_file_are_told_at_once(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="folder of the pairs is missing"):
        Session([FRAME], ["stage"], [0], tmp_path / "none" / "pairs.yaml")
    (tmp_path / "pairs.yaml").write_text("name: something else\n")
    with pytest.raises(InputError, match="another form"):
        Session([FRAME], ["stage"], [0], tmp_path / "pairs.yaml")


def test_no_truth_is_told(client: Client) -> None:
    """Neither the extrinsic nor anything that follows from it is in what the page is given before pairs are picked."""
    told = json.dumps([client.get("overview"), client.get("frame/0"), client.post("solve", {})])
    assert FRAME.camera_from_lidar is not None
    assert f"{FRAME.camera_from_lidar[0, 3]:.6f}"[:8] not in told
    assert json.loads(told)[2]["pose"] is None
