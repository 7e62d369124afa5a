"""Errors of the intrinsics are found on the distance maps, although the pose absorbs most of them."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from p2o import se3
from p2o.calibration.intrinsics import IntrinsicsEstimate, estimate_intrinsics
from p2o.features.view import View
from p2o.geometry.motion import EgoMotion, MotionPrior
from p2o.geometry.pose_error import pose_error
from p2o.reading import RadialError

from tests import edge_scene
from tests.edge_scene import PINHOLE, TRUTH
from tests.toolkit.calibration.test_pipeline import as_measured

AWAY = se3.exp(np.array([0.001, -0.001, 0.001, 0.02, -0.01, 0.05])) @ TRUTH


@cache
def views(error: RadialError) -> tuple[View, ...]:
    """Views of a camera whose calibration lacks an error of the intrinsics."""
    true = error.corrected(PINHOLE)
    return tuple(replace(edge_scene.view(true, seed=seed, boxes=60, noise_px=0.5), camera=PINHOLE) for seed in range(3))


@cache
def estimate(error: RadialError) -> IntrinsicsEstimate:
    found = estimate_intrinsics(views(error), AWAY)
    assert found is not None
    return found


@pytest.mark.parametrize(
    ("error", "wrong"),
    [
        (RadialError(focal=0.03), 0),
        (RadialError(focal=-0.05), 0),
        (RadialError(radial=0.06), 1),
        (RadialError(radial=-0.18), 1),
        (RadialError(x_px=30.0), 2),
    ],
    ids=lambda value: str(value),
)
def test_an_error_is_named_and_its_size_is_within_its_interval(error: RadialError, wrong: int) -> None:
    [fit] = estimate(error).fits
    assert [i for i, significant in enumerate(fit.significant) if significant] == [wrong]
    true = np.array([error.focal, error.radial, error.x_px / PINHOLE.focal_px, error.y_px / PINHOLE.focal_px])
    assert np.all(np.abs(fit.values - true) < 2 * np.sqrt(np.diag(fit.covariance)))
    after = pose_error(estimate(error).camera_from_lidar, TRUTH)
    assert after.rotation_deg < 0.2
    assert after.translation_m < 0.03


PRIOR = MotionPrior(EgoMotion(8.0), 8.0, 0.1)


@cache
def drive(error: RadialError, speed_m_s: float, count: int = 4) -> tuple[View, ...]:
    """Raw sweeps of a straight drive, compensated for the expected speed of 8 m/s."""
    measured = (edge_scene.view(error.corrected(PINHOLE), seed=seed, boxes=60, noise_px=0.5) for seed in range(count))
    raw = [replace(as_measured(view, EgoMotion(speed_m_s)), camera=PINHOLE) for view in measured]
    return tuple(view.untwisted(PRIOR.expected.twist) for view in raw)


def doubted(views: tuple[View, ...], prior: MotionPrior | None) -> list[int]:
    """The parameters that are in doubt."""
    motions = [] if prior is None else [prior.expected] * len(views)
    found = estimate_intrinsics(views, AWAY, prior=prior, motions=motions)
    return [number for number, wrong in enumerate(found.fits[0].significant) if wrong]


def test_the_speed_of_a_straight_drive_is_no_error_of_the_principal_point() -> None:
    fast = drive(RadialError(), 25.0)
    assert doubted(fast, None) == [2]  # which is what a wrong speed looks like where motions are taken as known
    assert doubted(fast, PRIOR) == []


@pytest.mark.parametrize(
    ("error", "wrong"), [(RadialError(focal=0.03), 0), (RadialError(radial=0.06), 1), (RadialError(x_px=30.0), 2)]
)
def test_a_wrong_camera_is_named_although_the_motions_are_unknown_too(error: RadialError, wrong: int) -> None:
    assert wrong in doubted(drive(error, 15.0), PRIOR)


def test_the_same_view_again_makes_no_error_of_the_camera_more_certain() -> None:
    error = RadialError(focal=0.01)
    [once], [often] = (estimate_intrinsics(views(error)[:1] * count, AWAY).fits for count in (1, 5))
    assert often.evidence < 1.1 * once.evidence
    assert np.all(np.diag(often.covariance) > 0.9 * np.diag(once.covariance))


def test_a_significant_error_of_the_camera_is_part_of_the_covariance_of_the_pose() -> None:
    """The covariance of the step by which the pose has absorbed it; none without a significant error."""
    wrong, correct = estimate(RadialError(focal=0.03)), estimate(RadialError())
    step = se3.log(wrong.camera_from_lidar @ se3.inverse(AWAY))
    assert np.sqrt(np.diag(wrong.absorbed)) == pytest.approx(np.abs(step))
    assert not correct.absorbed.any()
    assert not any(correct.fits[0].significant)
    assert abs(correct.fits[0].error.focal) < 0.003


@pytest.mark.parametrize("y_px", [-6.5, 6.5])
def test_an_error_too_small_to_be_named_is_part_of_the_predicted_error(y_px: float) -> None:
    """A rotation absorbs a shift of the principal point in y: the image is too low for edges to name a small one."""
    wrong, correct = (estimate(RadialError(y_px=its)) for its in (y_px, 0.0))
    assert not wrong.fits[0].significant[3]
    pitch_deg, usual_deg = (np.degrees(np.sqrt(its.covariance[0, 0])) for its in (wrong, correct))
    absorbed_deg = np.degrees(abs(y_px) / PINHOLE.focal_px)
    assert usual_deg < 0.05 * absorbed_deg
    assert 0.3 * absorbed_deg < pitch_deg < absorbed_deg


def test_parameters_that_are_not_fitted_stay_exactly_zero_and_without_edges_there_is_no_estimate() -> None:
    found = estimate_intrinsics(views(RadialError(focal=0.03)), AWAY, (True, False, False, False))
    error = found.fits[0].error
    assert (error.radial, error.x_px, error.y_px) == (0.0, 0.0, 0.0)
    assert error.focal == pytest.approx(0.03, abs=0.003)
    [view] = views(RadialError())[:1]
    none = replace(view, cloud=type(view.cloud)(view.cloud_edges.select(np.zeros(0, np.int64))))
    assert estimate_intrinsics([none], TRUTH) is None


def test_two_cameras_have_errors_of_their_own() -> None:
    wide = replace(PINHOLE, params=(650.0, 655.0, 610.0, 190.0))
    true = RadialError(focal=0.04).corrected(wide)
    seen = [edge_scene.view(true, seed=seed, boxes=60, noise_px=0.5) for seed in range(3, 6)]
    other = [replace(view, camera=wide) for view in seen]
    found = estimate_intrinsics([*views(RadialError()), *other], AWAY)
    first, second = found.fits
    assert (first.camera, second.camera) == (PINHOLE, wide)
    assert abs(first.error.focal) < 0.005
    assert second.error.focal == pytest.approx(0.04, abs=0.005)
