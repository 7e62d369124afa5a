"""Files that a user may name: read whole, or one line that says why not. What is no ordinary file is never opened."""

from __future__ import annotations

import os
import socket
from pathlib import Path

import pytest
from p2o import InputError
from p2o.files.input_file import (
    MAX_BYTES,
    MAX_TEXT_BYTES,
    existing_folder,
    expanded,
    listing,
    naming,
    read_bytes,
    read_start,
    read_text,
)


def test_pipes_sockets_devices_links_to_them_and_huge_sparse_files_are_never_opened(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "zero").symlink_to("/dev/zero")
    (tmp_path / "link").symlink_to(tmp_path / "pipe")
    with socket.socket(socket.AF_UNIX) as listening:
        here = os.getcwd()
        os.chdir(tmp_path)  # names of sockets may not be long
        listening.bind("socket")
        os.chdir(here)
        for name, kind in (("pipe", "named pipe"), ("link", "named pipe"), ("zero", "device"), ("socket", "socket")):
            with pytest.raises(InputError, match=f"the image is a {kind}"):
                read_bytes(tmp_path / name, "image")
    with (tmp_path / "huge").open("wb") as file:
        file.truncate(MAX_TEXT_BYTES + 1)
    with pytest.raises(InputError, match="too large"):
        read_text(tmp_path / "huge", "frame file")


@pytest.mark.parametrize("name", ["a\0b", "x" * 5000, "a/" * 3000])
def test_names_that_no_file_can_have_are_told(tmp_path: Path, name: str) -> None:
    with pytest.raises(InputError, match="the image"):
        read_bytes(tmp_path / name, "image")
    with pytest.raises(InputError, match="the folder of frames"):
        existing_folder(tmp_path / name, "frames")


def test_what_is_no_file_with_content_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "loop").symlink_to(tmp_path / "back")
    (tmp_path / "back").symlink_to(tmp_path / "loop")
    (tmp_path / "folder").mkdir()
    (tmp_path / "empty").touch()
    (tmp_path / "calib.txt").write_bytes(b"\xff\xfe\x00P2")
    for name, message in (
        ("loop", "the image cannot be read"),
        ("nowhere", "nowhere: the image is missing"),
        ("folder", "folder: the image is a folder"),
        ("empty", "empty: the image is empty"),
    ):
        with pytest.raises(InputError, match=message):
            read_bytes(tmp_path / name, "image")
    with pytest.raises(InputError, match=r"calib\.txt: the calibration file is not text"):
        read_text(tmp_path / "calib.txt", "calibration file")

    def refuse(self: Path) -> bytes:
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(Path, "read_bytes", refuse)
    with pytest.raises(InputError, match=r"calib\.txt: the image cannot be read; got Permission denied"):
        read_bytes(tmp_path / "calib.txt", "image")
    with pytest.raises(InputError, match="home folder of an unknown user"):
        expanded("~nosuch-user/data")
    assert expanded("~") == Path.home()


def test_a_folder_is_listed_in_order_what_is_no_folder_is_named_and_naming_adds_a_place_once(tmp_path: Path) -> None:
    for name in "bca":
        (tmp_path / name).touch()
    assert [path.name for path in listing(tmp_path, "frames")] == ["a", "b", "c"]
    with pytest.raises(InputError, match="a: the folder of frames cannot be read; got Not a directory"):
        listing(tmp_path / "a", "frames")
    with pytest.raises(InputError, match="a: the folder of frames is a file"):
        existing_folder(tmp_path / "a", "frames")
    with pytest.raises(InputError, match=r"^a\.txt: wrong; expected 1; got 2; look$"), naming(Path("a.txt")):
        raise InputError("wrong", expected=1, got=2, hint="look")
    with pytest.raises(InputError, match=r"^b\.txt: wrong$"), naming(Path("a.txt")):
        raise InputError("wrong", where="b.txt")


def test_the_start_of_a_file_of_any_size_is_read_and_what_is_no_file_is_refused(tmp_path: Path) -> None:
    long, empty, pipe = tmp_path / "long.bag", tmp_path / "empty.bag", tmp_path / "pipe.bag"
    with long.open("wb") as file:
        file.write(b"#ROSBAG V2.0\n")
        file.truncate(MAX_BYTES + 1)
    empty.touch()
    os.mkfifo(pipe)
    assert read_start(long, "bag", 8) == b"#ROSBAG "
    for path, words in (
        (empty, "the bag is empty"),
        (pipe, "the bag is a named pipe"),
        (tmp_path, "the bag is a folder"),
        (tmp_path / "gone", "the bag is missing"),
        (f"{tmp_path}/\0", "the name of the bag is not valid"),
    ):
        with pytest.raises(InputError, match=words):
            read_start(path, "bag", 8)


@pytest.mark.parametrize("name", ["scnes", "scnes/0001", "Scenes"])
def test_a_mistyped_folder_names_the_nearest(tmp_path: Path, name: str) -> None:
    (tmp_path / "scenes").mkdir()
    (tmp_path / "other").mkdir()
    with pytest.raises(InputError, match=rf"{name}: no such folder; .*; nearest: {tmp_path}/scenes$"):
        existing_folder(tmp_path / name, "frames")
    with pytest.raises(InputError, match=r"no such folder; expected the folder of frames$"):
        existing_folder(tmp_path / "qqqqqq", "frames")
