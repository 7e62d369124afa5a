"""Charts that add up small lasting changes, held against closed forms and against noise."""

from __future__ import annotations

import numpy as np
import pytest
from p2o.confidence.watch import autocorrelation, beside_mean, charts, innovations, limit_for, mean_run


def test_a_chart_adds_what_is_above_its_slack_never_falls_below_zero_and_leaves_out_what_is_missing() -> None:
    (up, down), (up_since, down_since) = charts(np.array([[1.0], [1.0], [-3.0], [2.0]]), slack=0.25)
    np.testing.assert_allclose(up[:, 0], [0.75, 1.5, 0.0, 1.75])
    np.testing.assert_allclose(down[:, 0], [0.0, 0.0, 2.75, 0.5])
    np.testing.assert_array_equal(up_since[:, 0], [0, 0, 3, 3])
    np.testing.assert_array_equal(down_since[:, 0], [1, 2, 2, 2])
    (up, _), (up_since, _) = charts(np.array([[1.0], [np.nan], [1.0]]), slack=0.0)
    np.testing.assert_allclose(up[:, 0], [1.0, 1.0, 2.0])
    assert up_since[2, 0] == 0


@pytest.mark.parametrize("slack", [0.25, 0.5])
def test_false_alarms_come_as_often_as_the_limit_was_chosen_for(slack: float) -> None:
    limit = limit_for(slack, 200.0)
    assert mean_run(slack, limit) == pytest.approx(200.0)
    rng = np.random.default_rng(1)
    sums, runs, length = np.zeros(4000), np.full(4000, np.nan), 3000
    for step in range(length):
        sums = np.maximum(0.0, sums + rng.standard_normal(4000) - slack)
        runs = np.where(np.isnan(runs) & (sums > limit), step + 1, runs)
    assert not np.isnan(runs).any()
    assert runs.mean() == pytest.approx(200.0, rel=0.1)
    assert mean_run(slack, limit_for(slack, 1000.0, charts=12)) == pytest.approx(12_000.0)


def test_what_a_value_says_of_the_next_is_taken_out() -> None:
    rng = np.random.default_rng(0)
    noise, values = rng.standard_normal((20_000, 2)), np.zeros((20_000, 2))
    for at in range(1, len(values)):
        values[at] = 0.6 * values[at - 1] + 0.8 * noise[at]
    assert autocorrelation(values) == pytest.approx(0.6, abs=0.02)
    new = innovations(values, 0.6)
    assert autocorrelation(new) == pytest.approx(0.0, abs=0.02)
    assert new.std() == pytest.approx(1.0, abs=0.02)


def test_beside_the_mean_of_those_before_values_are_independent_whatever_their_mean() -> None:
    rng = np.random.default_rng(0)
    rows = beside_mean(5.0 + rng.standard_normal((4, 50_000)))
    assert np.isnan(rows[0]).all()
    np.testing.assert_allclose(np.cov(rows[1:]), np.eye(3), atol=0.03)
    np.testing.assert_allclose(rows[1:].mean(axis=1), 0.0, atol=0.02)
    # A missing value counts for nothing.
    with_gap, without = np.array([[1.0], [np.nan], [2.0]]), np.array([[1.0], [2.0]])
    np.testing.assert_allclose(beside_mean(with_gap)[2], beside_mean(without)[1])
    np.testing.assert_allclose(beside_mean(without)[1], np.sqrt(0.5))
