from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from p2o import Camera, InputError
from p2o.cli import main
from p2o_datasets.bags.bag import Bag
from p2o_datasets.bags.choice import choose, choose_path
from p2o_datasets.bags.overview import overview

from tests.bag_files import FORMS, Said, camera_info, cloud, compressed, image, odometry, tf, transform, write_bag

CAMERA = Camera.pinhole(20, 20, 7, 5, 16, 12)
START_NS = 1_700_000_000_000_000_000
PIXELS = np.zeros((12, 16, 3), np.uint8)
POINTS = {axis: np.ones(5, np.float32) for axis in "xyz"}


def drive(*more: Said) -> list[Said]:
    said = [tf([transform("lidar", "camera", np.eye(4))], START_NS), camera_info("/left/camera_info", START_NS, CAMERA)]
    for number in range(40):
        time_ns = START_NS + number * 50_000_000
        said.append(image("/left/image_raw", time_ns, PIXELS))
        said.append(cloud("/points", time_ns, POINTS))
    return sorted([*said, *more], key=lambda m: m.time_ns)


@pytest.mark.parametrize("form", FORMS)
def test_topics_have_details_of_messages(tmp_path: Path, form: str, capsys: pytest.CaptureFixture[str]) -> None:
    path = write_bag(tmp_path, drive(odometry("/odom", START_NS, (0, 0, 0))), form)
    assert main(["data", "topics", str(path), "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    topics = {topic["name"]: topic for topic in told["topics"]}
    picture = topics["/left/image_raw"]
    assert (picture["type"], picture["count"], picture["frame_id"]) == ("sensor_msgs/Image", 40, "camera")
    assert picture["rate_hz"] == pytest.approx(20)
    assert picture["first_s"] == pytest.approx(1.7e9)
    assert picture["last_s"] - picture["first_s"] == pytest.approx(39 * 0.05, abs=1e-6)
    assert picture["details"] == "16x12 px rgb8"
    assert topics["/points"]["details"] == "5 points (1 rows): x y z"
    assert topics["/left/camera_info"]["details"] == "16x12 px plumb_bob"
    assert topics["/tf_static"]["details"] == "lidar > camera"
    assert told["ros"] == {
        "image": "/left/image_raw",
        "cloud": "/points",
        "camera": "/left/camera_info",
        "start": "TF connects lidar and camera",
    }


def test_the_table_states_why_nothing_is_chosen(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = write_bag(tmp_path, drive(cloud("/other\x1b[31m", START_NS, POINTS)))
    assert main(["data", "topics", f"ros:{path}"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert sum(line.startswith("/") for line in lines) == 5
    assert "\x1b" not in "".join(lines)
    assert "several topics of type cloud" in lines[-1]
    assert "data.cloud_topic=NAME" in lines[-1]


def test_a_topic_that_cannot_be_read_says_so_in_its_line(tmp_path: Path) -> None:
    wrong = cloud("/points", START_NS, POINTS)
    odd = Said("/points", "sensor_msgs/msg/Image", START_NS, image("/points", START_NS, PIXELS).fields | {"height": 0})
    topics = {t.name: t for t in overview(Bag(write_bag(tmp_path, [wrong], "sqlite3")))}
    assert topics["/points"].rate_hz is None
    assert overview(Bag(write_bag(tmp_path / "odd", [odd])))[0].details == "16x0 px rgb8"


def test_the_only_topic_of_a_type_is_taken_and_a_raw_one_before_its_compressed_twin(tmp_path: Path) -> None:
    twin = compressed("/left/image_raw/compressed", START_NS, b"1234")
    depth = compressed("/left/image_raw/compressedDepth", START_NS, b"1234")
    chosen = choose(Bag(write_bag(tmp_path, drive(twin, depth))))
    assert chosen.image.name == "/left/image_raw"
    assert chosen.camera_info.name == "/left/camera_info"


def test_the_camera_info_beside_the_image_is_taken(tmp_path: Path) -> None:
    others = [camera_info("/right/camera_info", START_NS, CAMERA), image("/right/image_raw", START_NS, PIXELS)]
    bag = Bag(write_bag(tmp_path, drive(*others)))
    with pytest.raises(InputError, match=r"several topics of type image.*/left/image_raw, /right/image_raw"):
        choose(bag)
    chosen = choose(bag, image="/right/image_raw")
    assert chosen.camera_info.name == "/right/camera_info"


def test_topics_that_are_wrong_or_missing_are_said(tmp_path: Path) -> None:
    bag = Bag(write_bag(tmp_path, drive()))
    with pytest.raises(InputError, match=r"not a topic of type cloud.*PointCloud2.*got sensor_msgs/Image"):
        choose(bag, cloud="/left/image_raw")
    assert choose_path(bag) is None
    with pytest.raises(InputError, match=r"the bag has no topic of an image.*got /points"):
        choose(Bag(write_bag(tmp_path / "none", [cloud("/points", START_NS, POINTS)])))
    with pytest.raises(InputError, match=r"no topic of an image.*an empty bag"):
        choose(Bag(write_bag(tmp_path / "empty", [], "sqlite3")))


def test_raw_packets_of_a_sensor_have_advice(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    bag = Bag(write_bag(tmp_path, [image("/image", START_NS, PIXELS), odometry("/packets", START_NS, (0, 0, 0))]))
    packets = bag.topics["/packets"]
    scan = type(packets)("/packets", "velodyne_msgs/msg/VelodyneScan", 1)
    monkeypatch.setattr(bag, "topics", {**bag.topics, "/packets": scan})
    with pytest.raises(InputError, match=r"/packets contains raw packets.*record PointCloud2"):
        choose(bag)
