"""Runs over drives: evidence without images, reasons of unreadable logs, and the command."""

from __future__ import annotations

import json
import os
import shutil
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest
from kills import write_drives
from p2o.cli import main
from p2o_fleet.drive import Drive, drives_of
from p2o_fleet.evidence import Evidence, Verdict
from p2o_fleet.store import Store
from p2o_fleet.worker import CheckSettings, DriveJob, check_drive
from p2o_study.worker import Plugins

SETTINGS = CheckSettings(1, 1, "depth/rings")
WORDS = ("--frames", "1", "--candidates", "1", "--extractor", "depth/rings")


@pytest.fixture
def table(tmp_path: Path) -> Path:
    return write_drives(tmp_path / "drives", 5)


def checked(drive: Drive) -> Evidence:
    return check_drive(DriveJob(drive, drive.key(SETTINGS.text), SETTINGS, Plugins()))


def test_evidence_contains_digests_of_the_content_and_no_image(table: Path, tmp_path: Path) -> None:
    drive, second, *_ = drives_of(str(table))
    evidence = checked(drive)
    shutil.copytree(drive.data.removeprefix("folder:"), tmp_path / "copy")
    assert checked(replace(drive, data=f"folder:{tmp_path}/copy", time=5.0)).log == evidence.log
    assert checked(second).log != evidence.log
    assert evidence.verdict is Verdict.CANNOT_TELL
    assert evidence.frames == ("frame",)
    assert len(evidence.log) == len(evidence.extrinsic_digest) == 32
    assert max(len(value) for value in evidence.row().values() if isinstance(value, tuple)) <= 21
    assert len(json.dumps(evidence.row())) < 2000


@pytest.mark.skipif(not Path("/dev/zero").exists(), reason="needs devices")
def test_a_device_or_pipe_as_log_or_extrinsic_is_a_row_with_the_reason(table: Path, tmp_path: Path) -> None:
    good = next(drives_of(str(table)))
    os.mkfifo(tmp_path / "pipe.yaml")
    logs = ("file:///dev/zero", "ros:/dev/zero", "folder:/dev/zero", "https://example.org/a.mcap")
    for bad in (
        *(replace(good, data=data) for data in logs),
        *(replace(good, extrinsic=path) for path in ("/dev/zero", str(tmp_path / "pipe.yaml"))),
    ):
        evidence = checked(bad)
        assert evidence.verdict is Verdict.UNREADABLE, bad
        assert len(evidence.reason.splitlines()) == 1


@pytest.mark.parametrize(
    ("name", "damage", "reason"),
    [("cloud.npy", b"nothing", "cloud"), ("frame.yaml", b"camera: {", "frame"), ("image.png", b"\x89PNG", "image")],
)
def test_a_damaged_log_is_a_row_with_the_reason(table: Path, name: str, damage: bytes, reason: str) -> None:
    drive = next(drives_of(str(table)))
    (Path(drive.data.removeprefix("folder:")) / "frame" / name).write_bytes(damage)
    evidence = checked(drive)
    assert evidence.verdict is Verdict.UNREADABLE
    assert reason in evidence.reason


def test_the_command_checks_each_drive_once_and_goes_on_after_unreadable_ones(
    table: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with table.open("a") as file:
        file.write("van-9,front,top,folder:/does/not/exist,truth,1767225600\n")
    store = str(tmp_path / "store")
    counts = []
    for _ in range(2):
        status = main(["fleet", "run", str(table), "--store", store, "--json", *WORDS])
        counts.append(json.loads(capsys.readouterr().out))
        assert status == 1, "a log was unreadable"
    assert [(one["checked"], one["kept"], one["unreadable"]) for one in counts] == [(6, 0, 1), (1, 5, 1)]
    assert sum(len(checks) for checks in Store(Path(store)).checks()) == 6
    assert main(["fleet", "report", "--store", store, "--out", str(tmp_path / "report")]) == 0
    assert main(["fleet", "report", "--store", store, "--out", str(tmp_path / "report"), "--require"]) == 1
    assert "no estimate in the last 1 checks" in (tmp_path / "report" / "fleet.json").read_text()


def test_without_arrow_the_command_names_the_extra(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    assert main(["fleet", "report"]) == 2
    assert 'pip install "p2o-calib[fleet]"' in capsys.readouterr().err


@pytest.mark.parametrize(
    "words",
    [
        ["run", "nothing.csv"],
        ["run", "drives.txt"],
        ["report", "--store", "nothing"],
        ["report", "--rate", "2"],
        ["simulate", "out", "--seed", "-1"],
        ["simulate", "out", "--vehicles", "0"],
        ["simulate", "out", "--faults", "nan"],
    ],
)
def test_wrong_input_has_exit_status_2(
    words: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, refused: Callable[..., str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert refused(["fleet", *words])
