"""Five kills at random moments of a small study; `python benchmarks/kills.py --kills 100` is the long form."""

from __future__ import annotations

import os
import random
import sqlite3
from pathlib import Path

import kills
import pytest
from kills import Tally, campaign


@pytest.mark.skipif(not hasattr(os, "killpg"), reason="needs signals to groups of processes")
def test_a_study_that_is_killed_loses_no_finished_row_and_changes_no_bit(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("P2O_PLUGINS", raising=False)
    tally = campaign(5, 4, tmp_path, scenes=1, seeds=3)
    assert tally.broken == []
    assert tally.kills.total() == 5
    assert tally.rows == 9


def test_a_row_that_differs_in_one_bit_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The judge is judged: rows of the second study are changed behind its back."""

    def start(file: Path, folder: Path, jobs: int) -> object:
        """Write a store as a study would."""
        folder.mkdir(exist_ok=True)
        with sqlite3.connect(folder / "study.sqlite") as connection:
            connection.execute("create table if not exists runs (key primary key, status, rotation_deg, seconds)")
            for number in range(3):
                changed = 1e-16 if folder.name == "study-1" and number == 1 else 0.0
                connection.execute("insert into runs values (?, 'converged', ?, 1)", (f"k{number}", 0.1 + changed))
        connection.close()
        return _Ended()

    monkeypatch.setattr(kills, "_start", start)
    tally = Tally()
    pace, expected = kills._undisturbed(tmp_path / "x.toml", tmp_path / "undisturbed")
    assert not kills._disturbed(tmp_path, tmp_path / "study-1", 1, random.Random(0), pace, tally, expected, 1)
    [told] = tally.broken
    assert told.endswith("1 rows changed, such as k1")


class _Ended:
    """A process that has done its work."""

    pid = 2**22 + 1
    poll = wait = lambda self, timeout=None: 0
