"""Sequential tests: closed forms, rates on simulated noise, and what they must be insensitive to."""

from __future__ import annotations

import numpy as np
import pytest
from p2o_fleet.statistics import (
    CLIP,
    SHIFTS,
    beside_previous,
    bets,
    conditional,
    discoveries,
    e_process,
    local_deviations,
    mean_error,
    mixture_over_onsets,
    noise_scale,
    onset,
    onset_prior,
    systematic,
    trend,
)

SIGMA = np.array([0.06, 0.1, 0.06, 0.01, 0.015, 0.01])
COVARIANCE = np.diag(SIGMA**2)
EXACT, USUAL = np.zeros(6), np.repeat([0.2, 0.03], 3)


def noise(rng: np.random.Generator, *shape: int) -> np.ndarray:
    return rng.normal(size=(*shape, 6)) * SIGMA


def test_onset_probabilities_of_any_number_of_checks_sum_to_less_than_one() -> None:
    for count in (1, 2, 100, 10**6):
        assert (onset_prior(count) > 0).all()
        assert onset_prior(count).sum() < 1
    assert onset_prior(10**6).sum() > 0.9, "no probability is wasted"
    assert (onset_prior(50) == onset_prior(100)[:50]).all(), "what is known later does not change earlier statistics"


def test_the_mixture_over_onsets_is_the_sum_over_all_onsets() -> None:
    logs = np.random.default_rng(0).normal(size=(6, 2))
    prior = onset_prior(6)
    for last in range(6):
        terms = [prior[k] * np.exp(logs[k : last + 1].sum(axis=0)) for k in range(last + 1)]
        expected = np.sum(terms, axis=0) + 1 - prior[: last + 1].sum()
        assert np.exp(mixture_over_onsets(logs)[last]) == pytest.approx(expected, rel=1e-9)


def test_a_bet_has_an_expectation_of_at_most_one_within_the_tolerance() -> None:
    # The expectation of exp(k z - k^2 / 2) over a normal z is 1; clipping and a mean below the tolerance lower it.
    nodes, weights = np.polynomial.hermite_e.hermegauss(80)
    weights = weights / weights.sum()
    for mean in (-1.0, 0.0, 0.7, 1.0):
        ratios = np.exp(bets(np.repeat((nodes + mean)[:, None], 6, axis=1), np.ones((80, 6))))
        expectation = (weights[:, None, None, None] * ratios).sum(axis=0)
        assert (expectation <= 1 + 1e-9).all()
    assert np.exp(bets(np.zeros((1, 6)), np.zeros((1, 6)))).max() == pytest.approx(np.exp(-(SHIFTS[0] ** 2) / 2))


def test_a_single_outlier_of_any_size_adds_a_limited_amount_of_evidence() -> None:
    logs = [
        e_process(np.vstack([np.zeros((9, 6)), [[size, 0, 0, 0, 0, 0]]]), np.repeat(COVARIANCE[None], 10, 0), EXACT)
        for size in (1.0, 100.0)
    ]
    assert logs[0][-1, 0] == pytest.approx(logs[1][-1, 0])
    assert logs[1][-1, 0] < max(SHIFTS) * CLIP


def test_differences_from_the_previous_mean_are_standard_normal_about_any_constant() -> None:
    rng = np.random.default_rng(1)
    sigma = rng.uniform(0.5, 2.0, size=(40, 2000))
    values = 7.0 + rng.normal(size=sigma.shape) * sigma
    standard = beside_previous(values, sigma)
    assert (standard[0] == 0).all()
    assert standard[1:].std() == pytest.approx(1, abs=0.01)
    assert np.corrcoef(standard[5], standard[6])[0, 1] == pytest.approx(0, abs=0.07)


def test_correct_extrinsics_reach_a_threshold_no_more_often_than_ville_permits() -> None:
    rng = np.random.default_rng(2)
    covariance = np.repeat(COVARIANCE[None], 40, axis=0)
    highest = []
    for _ in range(200):
        logs = e_process(noise(rng, 40) + rng.uniform(-0.5, 0.5, 6) * SIGMA, covariance, SIGMA / 2)
        highest.append(np.logaddexp.reduce(logs, axis=1).max() - np.log(6))
    # P(sup E >= 10) <= 0.1: more than 34 of 200 have a probability below 0.1 %.
    assert np.sum(np.array(highest) > np.log(10)) <= 34


@pytest.mark.parametrize("axis", [1, 5])
def test_a_slip_is_detected_on_its_axis_although_the_mounting_has_a_constant_error(axis: int) -> None:
    rng = np.random.default_rng(axis)
    error = noise(rng, 60) + SIGMA
    error[30:, axis] += 5 * SIGMA[axis]
    logs = e_process(error, np.repeat(COVARIANCE[None], 60, axis=0), 3 * SIGMA)
    assert (logs[29] < np.log(100)).all()
    assert logs[36].argmax() == axis
    assert logs[36, axis] > np.log(1e5)


def test_a_change_that_only_shows_with_the_other_axes_constant_is_detected() -> None:
    # Pitch and height are correlated: each alone is uncertain, their combination is not.
    covariance = COVARIANCE.copy()
    covariance[1, 4] = covariance[4, 1] = -0.99 * SIGMA[1] * SIGMA[4]
    rng = np.random.default_rng(3)
    error = rng.multivariate_normal(np.zeros(6), covariance, size=60)
    error[20:, 4] += SIGMA[4]
    every = np.repeat(covariance[None], 60, axis=0)
    alone, sigma = conditional(error, every)
    assert sigma[0, 4] == pytest.approx(SIGMA[4] * np.sqrt(1 - 0.99**2))
    assert alone[20:, 4].mean() == pytest.approx(SIGMA[4], abs=5 * sigma[0, 4] / np.sqrt(40))
    assert e_process(error, every, USUAL)[-1, 4] > np.log(1e5)


def test_e_bh_rejects_the_largest_set_whose_values_exceed_their_share() -> None:
    values = np.log([1.0, 450.0, 30.0, 210.0, 1.0])
    # 5 / (0.02 r): 250, 125, 83, ...
    assert discoveries(values, 0.02).tolist() == [False, True, False, True, False]
    assert not discoveries(np.log([1.0, 240.0, 30.0, 1.0, 1.0]), 0.02).any()
    assert not discoveries(np.zeros(0), 0.01).any()


def test_the_onset_is_where_the_mean_changed_and_its_interval_covers_it() -> None:
    rng = np.random.default_rng(4)
    covered = 0
    for _ in range(100):
        values = rng.normal(size=50) + np.where(np.arange(50) >= 20, 3.0, 0.0)
        estimate = onset(values, np.ones(50))
        assert abs(estimate.index - 20) <= 4
        covered += estimate.first <= 20 <= estimate.last
    assert covered >= 88
    assert onset(np.full(50, 3.0), np.ones(50)).index == 0, "an error without a change exists since the first check"


def test_the_mean_ignores_a_wrong_match_and_has_the_covariance_of_the_mean() -> None:
    error = np.zeros((10, 6))
    error[3, 2] = 50.0
    mean = mean_error(error, np.repeat(COVARIANCE[None], 10, axis=0))
    assert abs(mean.error[2]) < 0.02
    assert mean_error(np.zeros((10, 6)), np.repeat(COVARIANCE[None], 10, 0)).sigma == pytest.approx(SIGMA / np.sqrt(10))


def test_the_noise_scale_is_one_for_predicted_noise_and_makes_bets_on_larger_noise_fair() -> None:
    rng = np.random.default_rng(5)
    covariance = np.repeat(COVARIANCE[None], 100, axis=0)
    assert noise_scale([local_deviations(noise(rng, 100), covariance) for _ in range(20)]) == pytest.approx(
        (1.0,) * 6, abs=0.12
    )
    wide = noise_scale([local_deviations(2 * noise(rng, 100), covariance) for _ in range(20)])
    assert wide == pytest.approx((2.0,) * 6, rel=0.2)
    assert noise_scale([local_deviations(noise(rng, 20), covariance[:20])]) == (1.0,) * 6, "few checks are no estimate"
    slipping = [noise(rng, 100) + 10 * SIGMA * (n < 4) * (np.arange(100) >= 10 + 4 * n)[:, None] for n in range(20)]
    assert max(noise_scale([local_deviations(error, covariance) for error in slipping])) < 1.45, "slips are no noise"


def test_a_common_error_of_thirty_vehicles_is_significant_and_their_spread_is_not() -> None:
    rng = np.random.default_rng(7)
    tolerance = np.array([0.03] * 3 + [0.01] * 3)
    sigmas = np.tile(SIGMA / 5, (30, 1))
    means = rng.normal(size=(30, 6)) * np.array([0.05] * 3 + [0.01] * 3)
    means -= means.mean(axis=0)
    assert systematic(means, sigmas, tolerance).log_e.max() < 0
    means[:, 2] += 0.1
    test = systematic(means, sigmas, tolerance)
    assert test.log_e.argmax() == 2
    assert test.log_e[2] > np.log(600)
    assert abs(test.error[2] - 0.1) < 2 * test.sigma[2]
    slipped = np.zeros((30, 6))
    slipped[4, 2] = 50.0
    assert systematic(slipped, sigmas, tolerance).log_e.max() < 0, "one vehicle is no error of its type"


def test_a_trend_with_temperature_is_estimated_although_some_vehicles_slip() -> None:
    rng = np.random.default_rng(8)
    vehicles = []
    for number in range(20):
        temperature = rng.uniform(-10, 30, size=(60, 1))
        error = noise(rng, 60) + rng.normal(size=6) * 3 * SIGMA
        error[:, 1] += 0.006 * temperature[:, 0]
        if number < 3:
            error[30:, 1] += 0.5
        vehicles.append((error, np.tile(SIGMA, (60, 1)), temperature))
    slopes = trend(vehicles)
    assert slopes is not None
    assert slopes.slope[1, 0] == pytest.approx(0.006, abs=0.001)
    assert np.flatnonzero(slopes.significant).tolist() == [1]
    assert trend([(*vehicles[0][:2], np.ones((60, 1)))]) is None, "a constant covariate has no trend"
