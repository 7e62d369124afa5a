from __future__ import annotations

from pathlib import Path

import pytest
from p2o import InputError
from p2o_plugins.data.input_file import existing_folder, naming, read_bytes, read_text


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"nowhere\.bin: the sweep is missing"):
        read_bytes(tmp_path / "nowhere.bin", "sweep")


def test_a_folder_in_place_of_a_file_is_named(tmp_path: Path) -> None:
    (tmp_path / "a.png").mkdir()
    with pytest.raises(InputError, match=r"a\.png: the image is a folder"):
        read_bytes(tmp_path / "a.png", "image")


def test_an_empty_file_is_named(tmp_path: Path) -> None:
    (tmp_path / "a.png").touch()
    with pytest.raises(InputError, match=r"a\.png: the image is empty"):
        read_bytes(tmp_path / "a.png", "image")


def test_a_file_without_permission_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(self: Path) -> bytes:
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(Path, "read_bytes", refuse)
    with pytest.raises(InputError, match=r"a\.png: the image cannot be read; got Permission denied"):
        read_bytes(tmp_path / "a.png", "image")


def test_bytes_that_are_no_text_are_named(tmp_path: Path) -> None:
    (tmp_path / "calib.txt").write_bytes(b"\xff\xfe\x00P2")
    with pytest.raises(InputError, match=r"calib\.txt: the calibration file is not text"):
        read_text(tmp_path / "calib.txt", "calibration file")


def test_naming_adds_a_place_only_where_none_is_given() -> None:
    with pytest.raises(InputError, match=r"^a\.txt: wrong; expected 1; got 2; look$"), naming(Path("a.txt")):
        raise InputError("wrong", expected=1, got=2, hint="look")
    with pytest.raises(InputError, match=r"^b\.txt: wrong$"), naming(Path("a.txt")):
        raise InputError("wrong", where="b.txt")


def test_the_folder_of_a_dataset_must_exist_and_be_a_folder(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(InputError, match="nowhere: the folder of frames is missing"):
        existing_folder(tmp_path / "nowhere", "frames")
    with pytest.raises(InputError, match="file: the folder of frames is a file"):
        existing_folder(tmp_path / "file", "frames")
