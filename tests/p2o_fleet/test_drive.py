"""Tables of drives: what they mean, and which row is wrong."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
from p2o.errors import InputError
from p2o_fleet.drive import Drive, drives_of, parse_time

HEAD = "vehicle,camera,lidar,data,extrinsic,time,temperature_c,service\n"
ROW = 'van-1,front,top,"ros:a.bag?every_m=5",calib.yaml,2026-01-01T10:00:00+01:00,-3.5,\n'
EXPECTED = Drive("van-1", "front", "top", "ros:a.bag?every_m=5", "calib.yaml", 1767258000.0, temperature_c=-3.5)


def test_a_row_of_a_table_is_a_drive(tmp_path: Path) -> None:
    (tmp_path / "drives.csv").write_text(HEAD + ROW)
    assert list(drives_of(str(tmp_path / "drives.csv"))) == [EXPECTED]


@pytest.mark.parametrize(
    ("text", "named"),
    [
        ("vehicle,camera\na,b\n", "no column lidar"),
        (HEAD + ROW.replace("van-1", ""), "line 2.*vehicle"),
        (HEAD + ROW + ROW.replace("2026-01-01", "yesterday"), "line 3.*time"),
        (HEAD + ROW.replace("-3.5", "cold"), "line 2.*temperature_c"),
        (HEAD + 'van-1,"front\n', "cannot be read"),
        (HEAD + ROW.replace("-3.5,", "-3.5,wind\u202escreen"), "line 2.*service"),
        (HEAD + ROW.replace("van-1", "v" * 300), "line 2.*vehicle"),
        (HEAD + ROW.replace("-3.5", "1e300"), "line 2.*temperature_c"),
        (HEAD + ROW.replace("2026-01-01T10", "1960-01-01T10"), "line 2.*time"),
    ],
)
def test_an_invalid_table_names_row_and_column(tmp_path: Path, text: str, named: str) -> None:
    (tmp_path / "drives.csv").write_text(text)
    with pytest.raises(InputError, match=named):
        list(drives_of(str(tmp_path / "drives.csv")))


@pytest.mark.parametrize("text", ["1767258000", "1767258000.0", "2026-01-01T09:00:00Z", "2026-01-01 09:00:00"])
def test_times_are_seconds_or_iso_8601_in_utc(text: str) -> None:
    assert parse_time(text, "row") == 1767258000.0


def test_the_key_changes_with_the_content_of_the_extrinsic_and_with_the_settings(tmp_path: Path) -> None:
    file = tmp_path / "calib.yaml"
    file.write_text("first")
    one = Drive("a", "front", "top", "folder:x", str(file), 0.0)
    before = one.key("8")
    assert one.key("8") == before
    assert one.key("9") != before
    file.write_text("second")
    assert one.key("8") != before


@pytest.mark.skipif(os.name == "nt", reason="needs pipes and devices")
@pytest.mark.parametrize("kind", ["pipe", "device"])
def test_tables_and_extrinsics_that_are_no_files_are_never_opened(tmp_path: Path, kind: str) -> None:
    path = tmp_path / "drives.csv"
    if kind == "pipe":
        os.mkfifo(path)
    else:
        path.symlink_to("/dev/zero")
    with pytest.raises(InputError, match="the table of drives is a"):
        list(drives_of(str(path)))
    assert Drive("a", "front", "top", "folder:x", str(path), 0.0).key(), "an extrinsic is identified by its name"
