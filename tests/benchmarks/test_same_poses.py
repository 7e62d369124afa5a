"""Two stores are equal only where every row has the same pose to the last digit."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import p2o
import pytest
from p2o_study.store import Store, StoredRow, StoredStudy

from benchmarks.same_poses import main

ROW = StoredRow("k", "s", "ours", frames=("a",), status="converged", estimate=p2o.se3.exp(np.arange(6) / 10))


def kept(folder: Path, *rows: StoredRow) -> str:
    with Store.open(folder) as store:
        store.begin(StoredStudy("s", "", {}, ()), rows)
        for row in rows:
            store.put(row)
    return str(folder)


def test_a_pose_that_differs_in_the_last_digit_is_reported(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert ROW.estimate is not None
    moved = ROW.estimate.copy()
    moved[0, 3] = np.nextafter(moved[0, 3], 1)
    one = kept(tmp_path / "one", ROW)
    assert main([one, kept(tmp_path / "two", ROW)]) == 0
    assert main([one, kept(tmp_path / "three", replace(ROW, estimate=moved))]) == 1
    assert "ours" in capsys.readouterr().out.splitlines()[-2]


def test_a_row_that_one_store_lacks_and_a_missing_store_are_no_agreement(tmp_path: Path) -> None:
    one = kept(tmp_path / "one", ROW)
    assert main([one, kept(tmp_path / "two", ROW, replace(ROW, key="l", seed=1))]) == 1
    assert main([one, str(tmp_path / "none")]) == 2
