from __future__ import annotations

import builtins
import os
import pickle
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from p2o import Camera, InputError, MethodUnavailable
from p2o_datasets.bags import bag as bags
from p2o_datasets.bags.bag import Bag

from tests.bag_files import FORMS, Said, camera_info, cloud, file_of, image, tf, transform, write_bag
from tests.p2o_datasets.opened import refused

CAMERA = Camera.pinhole(20, 20, 7, 5, 16, 12)
START_NS = 1_700_000_000_000_000_000


def said(count: int = 3) -> list[Said]:
    """Return pictures 0.1 s apart, of which the last two are recorded at once, and a camera."""
    times = [START_NS + min(i, count - 2) * 100_000_000 for i in range(count)]
    pictures = [image("/image", time, np.full((12, 16, 3), i, np.uint8)) for i, time in enumerate(times)]
    return [camera_info("/camera_info", START_NS, CAMERA), *pictures]


@pytest.mark.parametrize("form", FORMS)
def test_topics_and_messages_of_every_container_are_found(tmp_path: Path, form: str) -> None:
    bag = Bag(write_bag(tmp_path, said(), form))
    assert {name: (t.kind, t.count) for name, t in bag.topics.items()} == {
        "/camera_info": ("sensor_msgs/msg/CameraInfo", 1),
        "/image": ("sensor_msgs/msg/Image", 3),
    }
    assert bag.name == "drive"
    assert bag.span_ns == (START_NS, START_NS + 100_000_000)
    found = list(bag.messages(["/image"]))
    assert [message.time_ns - START_NS for message in found] == [0, 100_000_000, 100_000_000]
    assert bag.message("/image", START_NS + 100_000_000, 1).data == found[2].data != found[1].data
    with pytest.raises(InputError, match="no longer exists"):
        bag.message("/image", START_NS + 1)


@pytest.mark.parametrize(
    ("form", "compression"), [("ros1", "BZ2"), ("ros1", "LZ4"), ("sqlite3", "MESSAGE"), ("mcap", "STORAGE")]
)
def test_packed_bags_hold_the_same_messages_and_are_unpacked_up_to_a_bound(
    tmp_path: Path, form: str, compression: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    plain = Bag(write_bag(tmp_path / "plain", said(), form))
    path = write_bag(tmp_path / "packed", said(), form, compression=compression)
    assert [m.data for m in Bag(path).messages(["/image"])] == [m.data for m in plain.messages(["/image"])]
    monkeypatch.setattr(bags, "MAX_UNPACKED_BYTES", 300)
    with pytest.raises(InputError, match=r"a chunk is (too large|truncated or larger than stated)"):
        list(Bag(path).messages(["/image"]))


def test_a_bag_of_several_files_is_read_in_order(tmp_path: Path) -> None:
    folder = write_bag(tmp_path, said(), "sqlite3")
    later = [Said(m.topic, m.kind, m.time_ns + 10**9, m.fields) for m in said()]
    file_of(write_bag(tmp_path / "later", later, "sqlite3")).rename(folder / "drive_1.db3")
    text = (folder / "metadata.yaml").read_text()
    (folder / "metadata.yaml").write_text(text.replace("- drive.db3\n", "- drive_1.db3\n  - folder/drive.db3\n", 1))
    bag = Bag(folder)
    times = [message.time_ns for message in bag.messages(["/image"])]
    assert times == sorted(times)
    assert len(times) == 6 == bag.topics["/image"].count


def test_a_bag_travels_to_other_processes_and_closes_its_files(tmp_path: Path) -> None:
    path = write_bag(tmp_path, said(), "ros1")
    bag = pickle.loads(pickle.dumps(Bag(path)))  # noqa: S301
    assert len(list(bag.messages(["/image"]))) == 3
    before = len(os.listdir("/proc/self/fd")) if Path("/proc/self/fd").is_dir() else 1
    del bag
    after = len(os.listdir("/proc/self/fd")) if Path("/proc/self/fd").is_dir() else 0
    assert after < before


def test_what_is_no_bag_is_said_in_one_line(tmp_path: Path) -> None:
    empty, text, zipped = tmp_path / "empty.bag", tmp_path / "drive.bag", tmp_path / "drive.db3"
    empty.touch()
    text.write_text("not a bag at all")
    zipped.write_bytes(b"\x28\xb5\x2f\xfd1234567")
    (tmp_path / "folder").mkdir()
    (tmp_path / "folder" / "drive.mcap").touch()
    os.mkfifo(tmp_path / "pipe.bag")
    for path, words in (
        (tmp_path / "missing.bag", "the bag is missing"),
        (empty, "the bag is empty"),
        (text, "p2o cannot read this bag.*a file that starts with"),
        (zipped, "a file compressed with zstd"),
        (tmp_path / "folder", "the folder is not a ROS 2 bag.*give one of its files: .*drive.mcap"),
        (tmp_path / "pipe.bag", "the bag is a named pipe"),
    ):
        with refused(words, str(path)):
            Bag(path)


@pytest.mark.parametrize("form", FORMS)
def test_a_bag_that_is_cut_off_is_refused(tmp_path: Path, form: str) -> None:
    path = write_bag(tmp_path, said(), form)
    file = path if form == "ros1" else file_of(path)
    whole = file.read_bytes()
    for share in (0.02, 0.3, 0.6, 0.9):
        file.write_bytes(whole[: max(int(len(whole) * share), 20)])
        with pytest.raises(InputError, match=r"the bag cannot be read.*(reindex|recover)"):
            list(Bag(path).messages(["/image"]))


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("rosbag2_bagfile_information", "something", "metadata does not describe a bag"),
        ("- drive.mcap", "- [1]", "metadata does not describe a bag"),
        ("- drive.mcap", "- ../..", r"leaves the folder of the data set|is a folder"),
        ("- drive.mcap", "- gone.mcap", "the bag is missing"),
        ("version: 9", "version: 99", "unsupported version"),
        ("compression_mode: ''", "compression_mode: FILE", "the files of the bag are compressed.*zstd -d"),
        ("compression_mode: ''", "compression_mode: {", "is not YAML"),
    ],
)
def test_metadata_that_lies_is_refused(tmp_path: Path, old: str, new: str, words: str) -> None:
    folder = write_bag(tmp_path, said())
    text = (folder / "metadata.yaml").read_text()
    assert old in text
    (folder / "metadata.yaml").write_text(text.replace(old, new))
    with pytest.raises(InputError, match=words):
        Bag(folder)


def test_links_out_of_the_folder_are_refused(tmp_path: Path) -> None:
    folder = write_bag(tmp_path, said())
    file = file_of(folder).rename(tmp_path / "elsewhere.mcap")
    (folder / "drive.mcap").symlink_to(file)
    with pytest.raises(InputError, match="leaves the folder of the data set"):
        Bag(folder)


def test_no_code_is_made_of_definitions_in_a_bag(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = write_bag(tmp_path, said(), "ros1")

    def refuse(*_: Any, **__: Any) -> None:
        raise AssertionError("code was made of data")

    monkeypatch.setattr(builtins, "exec", refuse)
    monkeypatch.setattr("rosbags.typesys.store.Typestore.register", refuse)
    assert len(list(Bag(path).messages(["/image"]))) == 3


def test_the_package_that_is_missing_is_named_with_its_command(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = write_bag(tmp_path, said(), "ros1")
    real = builtins.__import__

    def without(name: str, *rest: Any, **more: Any) -> Any:
        if name.startswith("rosbags"):
            raise ModuleNotFoundError("No module named 'rosbags'", name="rosbags")
        return real(name, *rest, **more)

    monkeypatch.setattr(builtins, "__import__", without)
    with pytest.raises(MethodUnavailable, match=r"rosbags, which is not installed.*pip install \"rosbags"):
        Bag(path)


def long_bag(folder: Path, count: int) -> Path:
    """A bag with images of 1242 x 375 px and sweeps of 120,000 points: 3.5 MB a frame."""
    rng = np.random.default_rng(0)
    camera = Camera.pinhole(720, 720, 621, 187, 1242, 375)
    pixels = rng.integers(0, 256, (375, 1242, 3), dtype=np.uint8)
    columns = {axis: rng.uniform(2, 60, 120_000).astype(np.float32) for axis in "xyz"}
    columns |= {"t": np.linspace(0, 1e8, 120_000).astype(np.uint32)}
    columns |= {"ring": (np.arange(120_000) % 64).astype(np.uint16)}

    def messages() -> Iterator[Said]:
        yield tf([transform("lidar", "camera", np.eye(4))])
        for number in range(count):
            time_ns = 10**18 + number * 100_000_000
            yield camera_info("/camera_info", time_ns, camera)
            yield image("/image", time_ns, pixels)
            yield cloud("/points", time_ns, columns)

    return write_bag(folder, messages(), "mcap")


@pytest.mark.system
def test_reading_a_bag_does_not_keep_its_frames_in_memory(tmp_path: Path) -> None:
    from bench import cost_of

    peaks = [cost_of(["data", "check", f"ros:{long_bag(tmp_path / str(n), n)}"]).peak_mib for n in (10, 60)]
    assert peaks[1] < peaks[0] + 60, "175 MB more of messages"
