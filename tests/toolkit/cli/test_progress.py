"""Lines about work that takes long, where stderr is no terminal."""

from __future__ import annotations

import threading
import time

import pytest
from p2o.cli import progress
from p2o.cli.progress import long_work


@pytest.fixture(autouse=True)
def _soon(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(progress, "LONG_WORK_S", 0.2)


def test_long_work_is_named_with_its_duration_at_growing_intervals(capsys: pytest.CaptureFixture[str]) -> None:
    with long_work(lambda text: None, " (solver cma-es)") as work:
        work("calibration 1 of 2: a")
        time.sleep(1.2)
    lines = capsys.readouterr().err.splitlines()
    assert 2 <= len(lines) <= 4
    assert set(lines) == {"p2o: calibration 1 of 2: a, for 1 s (solver cma-es)"}


def test_short_work_is_silent_and_no_thread_remains(capsys: pytest.CaptureFixture[str]) -> None:
    monitor = []
    with long_work(monitor.append) as work:
        for number in range(8):
            work(str(number))
            time.sleep(0.05)
    assert capsys.readouterr().err == ""
    assert monitor == [str(number) for number in range(8)]
    assert not [thread for thread in threading.enumerate() if thread.name == "p2o-progress"]


def test_an_error_in_the_work_ends_the_lines() -> None:
    with pytest.raises(ValueError, match="no"), long_work(lambda text: None):
        raise ValueError("no")
    assert not [thread for thread in threading.enumerate() if thread.name == "p2o-progress"]
