"""The table of `benchmarks/bench.py`, made from given numbers: nothing is timed here."""

from __future__ import annotations

import numpy as np
from bench import Cost, compared, differences, middle


def test_rows_of_median_costs_stand_beside_their_reference_with_ratios() -> None:
    ours = {"rings": middle([Cost(0.02, 0.03, 150.4), Cost(0.01, 0.9, 90.0), Cost(0.05, 0.02, 500.0)])}
    lines = compared({**ours, "new": Cost(1.5, 2.0)}, {"rings": Cost(0.04, 0.03)}, "before").splitlines()
    assert lines[0] == "|  | processor s | wall s | peak MiB | processor s, before | ratio | wall s, before | ratio |"
    assert lines[2] == "| rings | 0.020 | 0.030 | 150 | 0.040 | 0.50 | 0.030 | 1.00 |"
    assert lines[3] == "| new | 1.50 | 2.00 |  |  |  |  |  |"


def test_poses_of_commits_are_counted_that_are_equal_to_the_last_digit() -> None:
    moved, nearly = np.eye(4), np.eye(4)
    moved[0, 3], nearly[0, 3] = 0.0015, 1e-16
    ours = {name: {"pose": pose.tolist(), "verdict": "trusted"} for name, pose in (("a", moved), ("b", nearly))}
    theirs = {name: {"pose": np.eye(4).tolist(), "verdict": "doubtful"} for name in ("a", "b")}
    line = "0 of 2 poses are equal, apart at most 0.00000 deg and 1.500 mm; 2 with another status or verdict"
    assert differences(ours, theirs) == line
    assert differences(ours, ours).startswith("2 of 2 poses are equal")
