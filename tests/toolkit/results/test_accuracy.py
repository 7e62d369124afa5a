"""How wrong a calibration is likely to be: what follows from a covariance, and what makes it more or less."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from p2o import se3
from p2o.confidence.accuracy import (
    DEFAULT_ERROR_MODEL,
    INTERVAL_ERROR_MODEL,
    ErrorBudget,
    ErrorModel,
    likely_accuracy,
    likely_covariance,
    or_rival,
    predicted_covariance,
)
from p2o.geometry.pose_error import deviations, pose_error
from p2o.solving import Accuracy, Agreement, Rival

from tests.edge_scene import TRUTH


def covariance(scale: float = 1.0) -> np.ndarray:
    root = np.random.default_rng(0).normal(size=(6, 6)) * np.array([0.002] * 3 + [0.02] * 3)[:, None]
    return scale * root @ root.T


def test_deviations_are_the_root_mean_square_errors_of_poses_that_scatter_so() -> None:
    # The LiDAR a metre from the camera: turns about the camera move it.
    pose = np.array(TRUTH)
    pose[:3, 3] = 0.3, -0.8, 0.5
    draws = np.random.default_rng(1).multivariate_normal(np.zeros(6), covariance(), 1500)
    errors = [pose_error(se3.exp(draw) @ pose, pose) for draw in draws]
    rotation, translation = (
        np.sqrt(np.mean(np.square(values)))
        for values in ([e.rotation_deg for e in errors], [e.translation_m for e in errors])
    )
    assert deviations(covariance(), pose) == pytest.approx((rotation, translation), rel=0.05)


def met(near: float, places: int = 80) -> Agreement:
    """How edges meet; one in thirty would by chance."""
    return Agreement(near, 0.03, 500, places)


NOTHING = np.zeros((6, 6))


def spread(pairs: np.ndarray, beams: np.ndarray = NOTHING, rings: float = 0.0) -> ErrorBudget:
    return ErrorBudget(pairs, beams, NOTHING, np.full(6, rings))


def test_better_pairs_better_beams_and_better_agreement_promise_smaller_errors() -> None:
    def likely(pairs: float = 1.0, beams: float = 1.0, rings: float = 0.01, near: float = 0.25) -> Accuracy:
        return likely_accuracy(spread(covariance(pairs), covariance(beams), rings), TRUTH, met(near))

    usual = likely()
    for better in (likely(pairs=0.25), likely(beams=0.25), likely(rings=0.005), likely(near=0.4)):
        for name in ("rotation_deg", "translation_m", "rotation_deg_95", "translation_m_95", "yaw_deg", "z_m"):
            assert getattr(better, name) < getattr(usual, name)


def test_errors_fall_with_the_odds_without_a_step_back_and_none_count_as_the_worst() -> None:
    bounds = [
        likely_accuracy(spread(covariance()), TRUTH, met(near)).rotation_deg_95 for near in np.linspace(0.01, 0.9, 50)
    ]
    assert (np.diff(bounds) <= 0).all()
    nothing = likely_accuracy(spread(covariance()), TRUTH, Agreement(0.0, 0.0, 0))
    worst = likely_accuracy(spread(covariance()), TRUTH, met(0.001, 1))
    assert nothing == worst
    assert np.isfinite(nothing.rotation_deg_95)


def test_agreement_in_few_places_widens_all_errors_alike_but_those_of_intervals() -> None:
    many, few = (likely_accuracy(spread(covariance()), TRUTH, met(0.25, places)) for places in (400, 5))
    ratio = few.rotation_deg / many.rotation_deg
    assert ratio > 1.5
    for name in ("translation_m", "rotation_deg_95", "translation_m_95", "yaw_deg", "z_m"):
        assert getattr(few, name) / getattr(many, name) == pytest.approx(ratio)
    budget = replace(spread(covariance()), intervals=True)
    weak, strong = (likely_accuracy(budget, TRUTH, met(near, 400)) for near in (0.1, 0.5))
    assert weak == strong
    more = likely_accuracy(replace(spread(covariance() / 4), views=4.0, intervals=True), TRUTH, met(0.1, 400))
    assert 0.45 < more.rotation_deg / weak.rotation_deg < 0.65
    assert 0.45 < more.translation_m / weak.translation_m < 0.65


def test_a_direction_that_nothing_determines_widens_its_own_axis_only() -> None:
    pose = np.array(TRUTH)
    pose[:3, 3] = 0.0  # so that turns do not move the LiDAR
    names = ("pitch_deg", "yaw_deg", "roll_deg", "x_m", "y_m", "z_m")
    usual = likely_accuracy(spread(covariance(), covariance()), pose, met(0.25))
    for place, name in enumerate(names):
        open_there = np.zeros((6, 6))
        open_there[place, place] = 0.3**2
        for pairs, beams in ((covariance() + open_there, covariance()), (covariance(), covariance() + open_there)):
            found = likely_accuracy(spread(pairs, beams), pose, met(0.25))
            for other in names:
                if other == name:
                    assert getattr(found, other) > 3 * getattr(usual, other)
                else:
                    assert getattr(found, other) == pytest.approx(getattr(usual, other))


@pytest.mark.parametrize("model", [DEFAULT_ERROR_MODEL, INTERVAL_ERROR_MODEL])
@pytest.mark.parametrize("part", ["pairs", "cameras", "absorbed"])
def test_total_axes_and_covariance_state_one_predicted_error(model: ErrorModel, part: str) -> None:
    budget = replace(spread(covariance(), covariance(0.1), 0.01), **{part: covariance(4.0)})
    found = likely_accuracy(budget, TRUTH, met(0.25), model)
    rotation, translation = [found.roll_deg, found.pitch_deg, found.yaw_deg], [found.x_m, found.y_m, found.z_m]
    assert found.rotation_deg == pytest.approx(np.linalg.norm(rotation))
    assert found.translation_m == pytest.approx(np.linalg.norm(translation))
    assert 0 < found.rotation_deg <= found.rotation_deg_95
    assert 0 < found.translation_m <= found.translation_m_95
    whole = predicted_covariance(likely_covariance(budget, TRUTH, met(0.25), model), TRUTH, model)
    assert deviations(whole, TRUTH) == pytest.approx((found.rotation_deg, found.translation_m))


def test_what_the_pose_absorbed_of_a_wrong_camera_is_on_its_axis_and_in_the_total() -> None:
    """A focal length that is 3 % wrong puts the pose 0.3 m along the optical axis."""
    pose = np.array(TRUTH)
    pose[:3, 3] = 0.0  # so that turns do not move the LiDAR
    step = np.array([0.0, 0.005, 0.0, 0.0, 0.0, 0.3])
    usual = spread(covariance(0.01))
    before, after = (
        likely_accuracy(its, pose, met(0.25)) for its in (usual, replace(usual, absorbed=np.outer(step, step)))
    )
    assert after.z_m == pytest.approx(np.hypot(before.z_m, 0.3))
    assert after.yaw_deg == pytest.approx(np.hypot(before.yaw_deg, np.degrees(0.005)))
    assert (after.x_m, after.y_m, after.roll_deg) == pytest.approx((before.x_m, before.y_m, before.roll_deg))
    assert after.translation_m == pytest.approx(np.hypot(before.translation_m, 0.3))


def test_no_number_of_frames_promises_what_the_sensors_calibrations_do_not_give() -> None:
    model = DEFAULT_ERROR_MODEL
    for views in (1.0, 4.0, 1e9):
        found = likely_accuracy(replace(spread(covariance(1e-12)), views=views), TRUTH, met(0.5))
        turn, shift = np.hypot(
            [model.floor_deg, model.floor_m], np.array([model.view_deg, model.view_m]) / np.sqrt(views)
        )
        assert found.rotation_deg == pytest.approx(np.sqrt(3) * turn * model.rotation[0], rel=1e-3)
        assert found.translation_m == pytest.approx(np.sqrt(3) * shift * model.translation[0], rel=1e-3)


def test_a_rival_that_fits_as_well_is_how_far_off_the_worst_may_be() -> None:
    told = likely_accuracy(spread(covariance()), TRUTH, met(0.25))
    near, far = Rival(0.2, "edges", 0.6, 0.01), Rival(0.2, "edges", 9.0, 3.0)
    assert or_rival(told, None) == told
    assert or_rival(told, replace(far, lead=2.0)) == told
    assert or_rival(told, replace(far, unit="cost")) == told
    worst = or_rival(told, far)
    assert (worst.rotation_deg_95, worst.translation_m_95) == (9.0, 3.0)
    assert (worst.rotation_deg, worst.translation_m) == (told.rotation_deg, told.translation_m)
    assert or_rival(told, near).translation_m_95 == told.translation_m_95
