"""Lines about work that takes long, where stderr is no terminal."""

from __future__ import annotations

import threading
import time

import pytest
from p2o.cli import progress
from p2o.cli.progress import long_work
from p2o.runtime.stages import counted, report_stage


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


def test_short_work_is_silent_and_no_thread_remains_also_after_an_error(capsys: pytest.CaptureFixture[str]) -> None:
    monitor = []
    with long_work(monitor.append) as work:
        for number in range(8):
            work(str(number))
            time.sleep(0.05)
    assert capsys.readouterr().err == ""
    assert monitor == [str(number) for number in range(8)]
    with pytest.raises(ValueError, match="no"), long_work(lambda text: None):
        raise ValueError("no")
    assert not [thread for thread in threading.enumerate() if thread.name == "p2o-progress"]


def test_lines_name_the_stage_that_the_work_reports_and_its_progress(capsys: pytest.CaptureFixture[str]) -> None:
    monitor: list[str] = []
    with long_work(monitor.append) as work:
        work("38 frames jointly")
        read = counted("reading frames", lambda item: time.sleep(0.06), 12)
        for item in range(12):
            read(item)
        report_stage("refining poses")
        time.sleep(0.5)
        work("next")
    report_stage("ignored")
    lines = capsys.readouterr().err.splitlines()
    assert all(line.startswith("p2o: 38 frames jointly: ") for line in lines)
    assert any(": reading frames, " in line and " of 12, for 1 s" in line for line in lines)
    assert lines[-1] == "p2o: 38 frames jointly: refining poses, for 1 s"
    assert monitor[1:3] == [f"38 frames jointly: reading frames, {number} of 12" for number in (1, 2)]
    assert monitor[-1] == "next"
