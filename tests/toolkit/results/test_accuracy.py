"""How wrong a calibration is likely to be: what follows from a covariance, and what makes it more or less."""

from __future__ import annotations

import numpy as np
import pytest
from p2o import Accuracy, se3
from p2o.calibration.accuracy import deviations, likely_accuracy
from p2o.geometry.pose_error import pose_error

from tests.edge_scene import TRUTH


def covariance(scale: float = 1.0) -> np.ndarray:
    root = np.random.default_rng(0).normal(size=(6, 6)) * np.array([0.002] * 3 + [0.02] * 3)[:, None]
    return scale * root @ root.T


def test_deviations_are_the_root_mean_square_errors_of_poses_that_scatter_so() -> None:
    # The LiDAR a metre from the camera: turns about the camera move it.
    pose = np.array(TRUTH)
    pose[:3, 3] = 0.3, -0.8, 0.5
    draws = np.random.default_rng(1).multivariate_normal(np.zeros(6), covariance(), 4000)
    errors = [pose_error(se3.exp(draw) @ pose, pose) for draw in draws]
    rotation, translation = (
        np.sqrt(np.mean(np.square(values)))
        for values in ([e.rotation_deg for e in errors], [e.translation_m for e in errors])
    )
    assert deviations(covariance(), pose) == pytest.approx((rotation, translation), rel=0.03)


def test_better_pairs_and_better_agreement_promise_smaller_errors() -> None:
    usual = likely_accuracy(covariance(), TRUTH, 10.0)
    surer = likely_accuracy(covariance(0.25), TRUTH, 10.0)
    agreed = likely_accuracy(covariance(), TRUTH, 20.0)
    for better in (surer, agreed):
        assert better.rotation_deg < usual.rotation_deg
        assert better.translation_m < usual.translation_m
        assert better.rotation_deg_95 < usual.rotation_deg_95
        assert better.translation_m_95 < usual.translation_m_95
    # A quarter of the covariance halves the deviation; what is left of any is the floor.
    assert surer.rotation_deg == pytest.approx(0.5 * usual.rotation_deg, rel=0.05)


def test_nineteen_of_twenty_lie_within_more_than_two_of_three() -> None:
    for scale in (1e-6, 1.0, 100.0):
        found = likely_accuracy(covariance(scale), TRUTH, 7.0)
        assert 0 < found.rotation_deg <= found.rotation_deg_95
        assert 0 < found.translation_m <= found.translation_m_95


def test_no_number_of_frames_promises_what_the_sensors_calibrations_do_not_give() -> None:
    found = likely_accuracy(covariance(1e-9), TRUTH, 30.0)
    assert found.rotation_deg == pytest.approx(0.02, abs=1e-3)
    assert found.translation_m == pytest.approx(0.025, abs=1e-3)


def test_an_odds_ratio_that_is_none_counts_as_the_worst() -> None:
    assert likely_accuracy(covariance(), TRUTH, float("nan")) == likely_accuracy(covariance(), TRUTH, 0.0)
    assert likely_accuracy(covariance(), TRUTH, float("inf")) == likely_accuracy(covariance(), TRUTH, 1e6)


def test_both_parts_have_to_be_reached() -> None:
    found = Accuracy(0.2, 0.08, 0.6, 0.2)
    assert found.reaches(0.2, 0.08)
    assert not found.reaches(0.19, 1.0)
    assert not found.reaches(1.0, 0.07)
