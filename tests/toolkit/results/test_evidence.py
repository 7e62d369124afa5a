"""Predicted errors reach a requirement only if both of them do."""

from __future__ import annotations

import pytest
from p2o.solving import Accuracy


@pytest.mark.parametrize(
    ("rotation_deg", "translation_m", "reaches"),
    [(0.2, 0.05, True), (0.3, 0.1, True), (0.19, 1.0, False), (5.0, 0.04, False), (0.1, 0.01, False)],
)
def test_both_errors_must_be_within_the_limits(rotation_deg: float, translation_m: float, reaches: bool) -> None:
    accuracy = Accuracy(0.2, 0.05, 0.9, 0.25)
    assert accuracy.reaches(rotation_deg, translation_m) is reaches
