"""A few kills of a small fleet; the long form is `python benchmarks/kills.py fleet --kills 100`.

Killed studies: tests/p2o_study/test_ablate.py and test_trouble.py.
"""

from __future__ import annotations

import importlib.util
import os
import random
from dataclasses import replace
from pathlib import Path

import pytest
from kills import Fleet, FleetOnCluster, StudyOfStreets, Tally, campaign, disturbed
from p2o_study.rows import Rows

from tests.fake_study import run_of

pytestmark = pytest.mark.skipif(not hasattr(os, "killpg"), reason="needs signals to groups of processes")


def test_a_row_that_differs_in_the_last_digit_is_reported(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Rows of the second study are changed after it has written them."""

    def start(self: StudyOfStreets, folder: Path, number: int) -> list[object]:
        """Write rows as a study would."""
        rows = Rows(folder)
        rows.make_folder()
        known = {row.key for row in rows.each("kills")}
        for number in range(3):
            changed = 1e-5 if folder.name == "run-1" and number == 1 else 0.0
            row = replace(run_of("ours", "f", number, 0.1 + changed, 0.1), key=f"k{number}")
            if row.key not in known:
                rows.put("kills", row)
        return [_Ended()]

    monkeypatch.setattr(StudyOfStreets, "start", start)
    tally, study = Tally(), StudyOfStreets(tmp_path)
    assert not disturbed(study, tmp_path / "run-1", random.Random(0), tally, 1)
    [problem] = tally.broken
    assert problem.endswith("1 rows changed, such as k1")
    assert study.faults(tmp_path / "run-1") == ["1 rows differ in the end, such as k1"]


class _Ended:
    """A process that has ended."""

    pid = 2**22 + 1
    poll = wait = lambda self, timeout=None: 0


def test_a_fleet_that_is_killed_loses_no_finished_check_and_counts_none_twice(tmp_path: Path) -> None:
    tally = campaign(Fleet(tmp_path, 10), 4, 3, tmp_path)
    assert tally.broken == []
    assert tally.kills.total() >= 4


@pytest.mark.skipif(importlib.util.find_spec("distributed") is None, reason='needs pip install ".[dask]"')
def test_a_cluster_whose_scheduler_workers_and_runs_are_killed_loses_no_finished_check(tmp_path: Path) -> None:
    assert campaign(FleetOnCluster(tmp_path, 20), 6, 2, tmp_path).broken == []
