"""Confidence is how often an edge of that score is there."""

from __future__ import annotations

import numpy as np
import pytest
from p2o import Side
from p2o_plugins.p2ornet.calibration import fit, verdicts
from p2o_plugins.p2ornet.example import UNKNOWN, Example
from p2o_plugins.p2ornet.spans import EAST, SOUTH, Spans
from p2o_plugins.p2ornet.thinning import Peaks


@pytest.mark.parametrize(("slope", "offset"), [(1.0, 0.0), (0.6, -1.0), (1.8, 0.7)])
def test_the_curve_of_a_biased_forecaster_is_found(slope: float, offset: float) -> None:
    rng = np.random.default_rng(0)
    score = rng.uniform(0.02, 0.98, 40_000)
    true = 1 / (1 + np.exp(-(slope * np.log(score / (1 - score)) + offset)))
    found = fit(score, rng.uniform(size=len(score)) < true)
    np.testing.assert_allclose(found, (slope, offset), atol=0.06)


def peak(side: Side, pixel: tuple[int, int]) -> Peaks:
    uv = np.array([pixel], np.float64) + 0.5 * np.array(side.background)
    return Peaks(uv, np.array([side], np.int8), np.array([0.7]), np.array([pixel], np.float64))


def board() -> Example:
    """Return a picture of 12 x 20 px with a board in columns 6 to 12 and rows 3 to 8, every pair known."""
    classes = np.ones((2, 12, 20), np.int8)
    classes[EAST, 3:9, 5], classes[EAST, 3:9, 12] = 0, 2
    classes[SOUTH, 2, 6:13], classes[SOUTH, 8, 6:13] = 0, 2
    return Example("board", np.zeros((12, 20, 3), np.uint8), classes, Spans.joined())


@pytest.mark.parametrize(
    ("side", "on", "off"),
    [
        (Side.LEFT, (6, 5), (10, 5)),
        (Side.RIGHT, (12, 5), (6, 5)),
        (Side.UPPER, (8, 3), (8, 8)),
        (Side.BOTTOM, (8, 8), (8, 3)),
    ],
)
def test_a_peak_on_the_outline_is_right_and_elsewhere_wrong(
    side: Side, on: tuple[int, int], off: tuple[int, int]
) -> None:
    for pixel, expected in ((on, True), (off, False)):
        score, right = verdicts(peak(side, pixel), board())
        assert (list(score), list(right)) == ([0.7], [expected])


def test_a_stretch_confirms_its_own_direction_and_what_is_unknown_says_nothing() -> None:
    stretch = Spans.of(EAST, -1, np.array([5.0]), np.array([4.5]), np.array([7.5]))
    smooth = Spans.of(EAST, 0, np.array([5.0]), np.array([10.0]), np.array([15.0]))
    example = Example("two", np.zeros((12, 20, 3), np.uint8), None, Spans.joined(stretch, smooth))
    assert list(verdicts(peak(Side.LEFT, (6, 5)), example)[1]) == [True]
    assert list(verdicts(peak(Side.LEFT, (13, 5)), example)[1]) == [False]
    assert len(verdicts(peak(Side.LEFT, (6, 9)), example)[1]) == 0
    assert len(verdicts(peak(Side.UPPER, (6, 5)), example)[1]) == 0
    assert UNKNOWN < 0
