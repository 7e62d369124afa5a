"""Joint histograms and what is told from them, against closed forms."""

from __future__ import annotations

import numpy as np
import pytest
from p2o_baselines.information.histogram import (
    MI,
    NID,
    NMI,
    Measure,
    Plain,
    Shrunk,
    Smoothed,
    by_rank,
    entropy,
    joint_counts,
    kernel,
)

RNG = np.random.default_rng(0)
COUNTS = RNG.integers(0, 9, (5, 6, 8)).astype(float)
MEASURES = pytest.mark.parametrize("measure", [MI, NMI, NID], ids=["mi", "nmi", "nid"])
ESTIMATORS = pytest.mark.parametrize(
    "estimator", [Plain(), Shrunk(), Smoothed.by_silverman(COUNTS[0])], ids=["plain", "shrunk", "smoothed"]
)


def test_points_are_counted_where_they_belong() -> None:
    row, column = np.array([0, 1, 1]), np.array([[2, 0, 0], [1, 1, 2]])
    counts = joint_counts(row, column, np.array([[1.0, 2.0, 0.5], [1.0, 1.0, 0.0]]), 2, 3)
    assert counts.tolist() == [[[0, 0, 1], [2.5, 0, 0]], [[0, 1, 0], [0, 1, 0]]]


def test_independent_values_tell_nothing_of_one_another() -> None:
    shares = np.outer([0.2, 0.3, 0.5], [0.1, 0.9])[None]
    assert MI.of(shares) == pytest.approx([0.0], abs=1e-12)
    assert NMI.of(shares) == pytest.approx([-1.0])
    assert NID.of(shares) == pytest.approx([1.0])


def test_values_that_determine_one_another_tell_their_entropy() -> None:
    share = np.array([0.2, 0.3, 0.5])
    shares = np.diag(share)[None, [2, 0, 1]]
    assert MI.of(shares) == pytest.approx(-entropy(share[None]))
    assert NMI.of(shares) == pytest.approx([-2.0])
    assert NID.of(shares) == pytest.approx([0.0], abs=1e-12)


@MEASURES
def test_one_grey_or_no_points_cost_the_most(measure: Measure) -> None:
    one = np.zeros((2, 4, 4))
    one[1, 2, 3] = 7
    assert measure.of(Plain().shares(one)).tolist() == [measure.worst] * 2


@MEASURES
@ESTIMATORS
def test_derivatives_by_counts_are_those_of_differences(measure: Measure, estimator: Plain) -> None:
    counts = COUNTS[1] + 0.5
    change = RNG.normal(size=counts.shape)
    slope = estimator.slope(counts, measure.slope(estimator.shares(counts[None])[0]))
    ahead, behind = measure.of(estimator.shares(np.stack([counts + 1e-5 * change, counts - 1e-5 * change])))
    assert float((slope * change).sum()) == pytest.approx((ahead - behind) / 2e-5, rel=1e-5)


def test_many_counts_are_hardly_shrunk_and_a_pair_of_them_wholly() -> None:
    pair = np.zeros((1, 6, 8))
    pair[0, [1, 4], [2, 5]] = 1
    assert Shrunk().shares(pair) == pytest.approx(np.full((1, 6, 8), 1 / 48))
    assert Shrunk().share_of_target(1e6 * COUNTS).max() < 1e-3
    assert (Shrunk().share_of_target(COUNTS) > Shrunk().share_of_target(10 * COUNTS)).all()


def test_kernels_keep_all_counts_and_their_width() -> None:
    spread = kernel(101, 4.0)[:, 50]
    assert kernel(16, 5.0).sum(axis=0) == pytest.approx(np.ones(16))
    assert np.sqrt(spread @ (np.arange(101) - 50) ** 2) == pytest.approx(4.0, rel=1e-3)
    assert kernel(16, 0.0) == pytest.approx(np.eye(16))


def test_the_width_of_kernels_is_that_of_silverman() -> None:
    counts = np.zeros((1001, 2))
    counts[[400, 600], 0] = 512.0  # sigma 100, n 1024
    smoothed = Smoothed.by_silverman(counts).over_rows[:, 500]
    assert np.sqrt(smoothed @ (np.arange(1001) - 500) ** 2) == pytest.approx(1.06 * 100 * 1024**-0.2, rel=1e-3)


def test_ranks_are_even_and_equal_values_share_theirs() -> None:
    assert by_rank(np.array([5.0, -1.0, 100.0, 7.0])) == pytest.approx([0.375, 0.125, 0.875, 0.625])
    assert by_rank(np.array([[3.0, 3.0], [3.0, 9.0]])) == pytest.approx(np.array([[0.375, 0.375], [0.375, 0.875]]))
    values = RNG.normal(size=50)
    assert by_rank(np.exp(values)) == pytest.approx(by_rank(values))
