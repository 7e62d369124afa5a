"""The fuzzer sees what it is there to see: each promise broken on purpose."""

from __future__ import annotations

import json
import os
import resource
import signal
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from tests.fuzz import contract, sandbox
from tests.fuzz.contract import broken
from tests.fuzz.surfaces import Case


def _status_70() -> int:
    print("p2o: error: unexpected ValueError: x", file=sys.stderr)
    return 70


def _traceback() -> int:
    raise ValueError("x")


def _killed() -> int:
    os.kill(os.getpid(), signal.SIGSEGV)
    return 0


def _busy() -> int:
    while True:
        pass


def _asleep() -> int:
    time.sleep(60)
    return 0


def _large() -> int:
    return int(np.ones(1_700_000_000 // 8).sum()) * 0


def _silent() -> int:
    return 2


def _noisy() -> int:
    os.write(2, b"libpng warning: x\n")
    return 0


def _coloured() -> int:
    print("\x1b[31mred")
    return 0


def _outside() -> int:
    Path("../escaped").write_text("x")
    return 0


def _moved() -> int:
    os.rename("in/file", "in/other")
    return 0


def _program() -> int:
    return os.system("true")


def _not_rigid() -> int:
    Path("out/result.json").write_text(json.dumps({"camera_from_lidar": (2 * np.eye(4)).tolist()}))
    return 0


def _nan() -> int:
    Path("out/result.json").write_text('{"camera_from_lidar": NaN}')
    return 0


@pytest.fixture(autouse=True)
def _room(monkeypatch: pytest.MonkeyPatch) -> None:
    """Leave out of account what other tests made this process hold, which its forks begin with."""
    with open("/proc/self/statm", encoding="ascii") as file:
        held = int(file.read().split()[1]) * resource.getpagesize()
    monkeypatch.setattr(contract, "PEAK_BYTES", held + 1_000_000_000)


@pytest.mark.parametrize(
    ("command", "fault"),
    [
        (_status_70, "status 70"),
        (_traceback, "status 255"),
        (_killed, "ended by signal 11"),
        (_busy, "hung"),
        (_asleep, "hung"),
        (_large, "took "),
        (_silent, "without a word"),
        (_noisy, "not of p2o: libpng"),
        (_coloured, "control character on stdout"),
        (_outside, "must not: open '../escaped'"),
        (_moved, "must not: os.rename"),
        (_program, "must not: os.system"),
        (_not_rigid, "not rigid"),
        (_nan, "holds NaN"),
    ],
)
def test_a_broken_promise_is_seen(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, command: Callable[[], int], fault: str
) -> None:
    if fault == "hung":
        monkeypatch.setattr(sandbox, "CPU_S", 1)
        monkeypatch.setattr(sandbox, "WALL_S", 20 if command is _busy else 3)
    (tmp_path / "in").mkdir()
    (tmp_path / "in/file").touch()
    case = Case(call=command)
    found = broken(case, sandbox.run(case, tmp_path, case.hangs), tmp_path)
    assert any(fault in line for line in found), found


def _waits() -> int:
    Path("out/hangs").touch()
    time.sleep(60)
    return 0


def test_a_command_that_announces_to_hang_is_interrupted(tmp_path: Path) -> None:
    def right() -> int:
        try:
            return _waits()
        except KeyboardInterrupt:
            return 130

    def wrong() -> int:
        try:
            return _waits()
        except KeyboardInterrupt:
            return 0

    case = Case(call=right, hangs="out/hangs")
    assert broken(case, sandbox.run(case, tmp_path, case.hangs), tmp_path) == []
    case = Case(call=wrong, hangs="out/hangs")
    assert broken(case, sandbox.run(case, tmp_path, case.hangs), tmp_path) == ["interrupted, and status 0"]


def test_a_command_that_keeps_its_promises_is_left_alone(tmp_path: Path) -> None:
    def fine() -> int:
        Path("out/result.json").write_text(json.dumps({"camera_from_lidar": np.eye(4).tolist()}))
        print("p2o: a word", file=sys.stderr)
        return 0

    case = Case(call=fine)
    assert broken(case, sandbox.run(case, tmp_path, case.hangs), tmp_path) == []
