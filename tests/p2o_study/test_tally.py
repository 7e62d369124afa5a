"""Rows of a study's table: counts, and means and medians of absolute errors."""

from __future__ import annotations

from dataclasses import replace
from math import isnan

import numpy as np
import pytest
from p2o import se3
from p2o.geometry.perturb import parse_perturbation
from p2o.solving import Trust
from p2o_study.store import StoredRow
from p2o_study.tally import is_unmoved, is_worse, tallies

ROW = StoredRow("k", "s", "a", frames=("f",), status="converged", trust=Trust.TRUSTED)


def test_errors_of_opposite_signs_do_not_cancel() -> None:
    rows = [replace(ROW, yaw_deg=yaw, rotation_deg=abs(yaw)) for yaw in (-0.4, 0.1, 0.3, -0.2, 1.0)]
    (tally,) = tallies(rows, ["yaw_deg", "rotation_deg"])
    for metric in ("yaw_deg", "rotation_deg"):
        assert tally.mean[metric] == pytest.approx(0.4)
        assert tally.median[metric] == pytest.approx(0.3)


def test_a_calibration_without_a_known_error_is_counted_and_not_averaged() -> None:
    (tally,) = tallies([replace(ROW, yaw_deg=-0.5), ROW], ["yaw_deg", "x_m"])
    assert (tally.count, tally.mean["yaw_deg"], tally.median["yaw_deg"]) == (2, 0.5, 0.5)
    assert isnan(tally.mean["x_m"])
    assert isnan(tally.median["x_m"])


def test_refused_and_crashed_calibrations_are_counted_apart() -> None:
    refused = replace(ROW, status="no-edges", trust=Trust.REFUSED)
    crashed = replace(ROW, status="stage-failed", trust=None)
    (tally,) = tallies([ROW, refused, refused, crashed], [])
    assert (tally.count, tally.solved, tally.refused, tally.crashed) == (4, 1, 2, 1)
    assert tally.trust == {Trust.TRUSTED: 1, Trust.REFUSED: 2}


def test_rows_of_the_table_are_kept_apart_in_their_order() -> None:
    rows = [replace(ROW, row="b"), ROW, replace(ROW, row="b")]
    assert [(tally.row, tally.count) for tally in tallies(rows, [])] == [("b", 2), ("a", 1)]


@pytest.mark.parametrize(
    ("rotation_deg", "translation_m", "within", "worse"),
    [(0.5, 0.1, 1, 0), (0.51, 0.1, 0, 0), (0.5, 0.11, 0, 0), (1.1, 0.0, 0, 1), (0.0, 0.3, 0, 1)],
)
def test_limits_and_the_initial_guess_bound_rotation_and_translation_each(
    rotation_deg: float, translation_m: float, within: int, worse: int
) -> None:
    row = replace(
        ROW,
        rotation_deg=rotation_deg,
        translation_m=translation_m,
        start_rotation_deg=1.0,
        start_translation_m=0.2,
    )
    (tally,) = tallies([row], [], parse_perturbation("0.5deg,0.1m"))
    assert (tally.within, tally.worse) == (within, worse)
    assert is_worse(row) == bool(worse)
    assert not is_worse(replace(row, status="no-edges"))


@pytest.mark.parametrize(
    ("moved_m", "status", "unmoved"),
    [(0.0, "converged", True), (5e-5, "rounds-spent", True)]
    + [(0.01, "converged", False), (0.0, "no-improvement", False)],
)
def test_a_result_that_is_its_initial_guess_is_recognised(moved_m: float, status: str, unmoved: bool) -> None:
    start = np.eye(4)
    estimate = None if status == "no-improvement" else se3.make(translation=[moved_m, 0, 0])
    assert is_unmoved(replace(ROW, status=status, start=start, estimate=estimate)) is unmoved
