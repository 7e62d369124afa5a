"""Errors of a camera's calibration: what they do to pixels, and that the pairs of both sensors tell them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from p2o import Camera, InputError, Side, se3
from p2o.calibration.adjustment import Nuisance, fit_with_nuisances
from p2o.geometry.pose_error import pose_error
from p2o.geometry.radial_error import slopes
from p2o.reading import RadialError
from p2o.solving import PointToLine

from tests.edge_scene import DISTORTED, FISHEYE, PINHOLE, TRUTH
from tests.plugins.solve.exact_pairs import NEAR, pairs

ERROR = RadialError(-0.004, 0.012)
cameras = pytest.mark.parametrize("camera", [PINHOLE, DISTORTED, FISHEYE], ids=lambda c: c.model)


def test_a_pinhole_is_seen_larger_by_the_polynomial_and_the_shift_is_that_of_the_farthest_corner() -> None:
    fx, _, cx, cy = PINHOLE.params
    for rho in (0.1, 0.5, 0.8):
        u = cx + fx * rho * (1 - 0.004) * (1 + 0.012 * rho**2)
        assert ERROR.seen(PINHOLE, np.array([cx + fx * rho, cy])) == pytest.approx([u, cy], abs=1e-9)
    corners = np.array([(u, v) for u in (-0.5, PINHOLE.width - 0.5) for v in (-0.5, PINHOLE.height - 0.5)])
    rho = np.linalg.norm(corners - [cx, cy], axis=1).max() / fx
    assert RadialError(radial=0.01).shift_px(PINHOLE) == pytest.approx(fx * 0.01 * rho**3, rel=1e-9)


@cameras
def test_calibrated_takes_back_what_seen_does(camera: Camera) -> None:
    uv = np.random.default_rng(0).uniform([200, 100], [800, 300], size=(50, 2))
    there = ERROR.seen(camera, uv)
    assert np.abs(there - uv).max() > 0.3
    assert ERROR.calibrated(camera, there) == pytest.approx(uv, abs=1e-6)
    assert RadialError().corrected(camera) is camera
    assert RadialError().shift_px(camera) == pytest.approx(0, abs=0.01)


THIN_PRISM = Camera(
    "THIN_PRISM_FISHEYE", 1242, 375, (480, 480, 620, 187, 0.02, -0.006, 5e-4, -3e-4, 1e-3, -2e-4, 4e-4, 0)
)
RATIONAL = Camera("FULL_OPENCV", 1242, 375, (700, 705, 620, 187, 0.1, -0.02, 1e-3, -1e-3, 0.01, 0.05, 0.01, 0.002))


@pytest.mark.parametrize("camera", [PINHOLE, DISTORTED, FISHEYE, THIN_PRISM, RATIONAL], ids=lambda c: c.model)
def test_the_slopes_are_those_of_the_pixels(camera: Camera) -> None:
    xyz = np.vstack([np.random.default_rng(0).uniform([-4, -2, 6], [4, 2, 20], size=(50, 3)), [0, 0, 5], [1, 1, -5]])
    for error in (RadialError(), replace(ERROR, x_px=3.0)):
        for parameter, name in enumerate(("focal", "radial")):
            ahead, behind = (
                replace(error, **{name: getattr(error, name) + step}).corrected(camera).project(xyz)
                for step in (1e-4, -1e-4)
            )
            by_error = slopes(camera, error, xyz)[..., parameter]
            np.testing.assert_allclose(by_error, (ahead - behind) / 2e-4, rtol=1e-6, atol=1e-6)


FOV = Camera("FOV", 1242, 375, (700.0, 700.0, 600.0, 180.0, 0.9))


def test_errors_out_of_bounds_and_cameras_without_a_radial_coefficient_are_refused() -> None:
    for values in ((0.3, 0.0), (0.0, -0.21), (np.nan, 0.0), (0.0, np.inf)):
        with pytest.raises(InputError, match=r"at most 0\.2"):
            RadialError(*values)
    with pytest.raises(InputError, match="no radial coefficient"):
        ERROR.corrected(FOV)


def miscalibrated(camera: Camera, **options: object) -> PointToLine:
    """Return pairs that are exact for `camera` corrected, with the camera as its calibration has it."""
    exact = pairs(cameras=(ERROR.corrected(camera),), **options)
    return replace(exact, cameras=(camera,))


@cameras
def test_exact_pairs_tell_error_and_pose(camera: Camera) -> None:
    problem = miscalibrated(camera, count=2000)
    found = fit_with_nuisances(problem, NEAR, Nuisance())
    pose, (fit,) = found.camera_from_lidar, found.cameras
    assert fit.camera == camera
    # Errors are drawn to zero a little.
    assert fit.error.focal == pytest.approx(ERROR.focal, abs=1e-4)
    assert fit.error.radial == pytest.approx(ERROR.radial, abs=2e-4)
    error = pose_error(pose, TRUTH)
    assert error.rotation_deg < 0.002
    assert error.translation_m < 0.002


def test_every_camera_has_its_own_error_and_unknown_models_stay() -> None:
    wide = Camera.pinhole(650.0, 655.0, 610.0, 190.0, 1242, 375)
    other = RadialError(0.003, -0.008)
    exact = pairs(cameras=(ERROR.corrected(PINHOLE), other.corrected(wide), FOV), count=3000)
    fits = fit_with_nuisances(replace(exact, cameras=(PINHOLE, wide, FOV)), NEAR, Nuisance()).cameras
    assert [fit.camera for fit in fits] == [PINHOLE, wide]
    assert fits[0].error.radial == pytest.approx(ERROR.radial, abs=1e-4)
    assert fits[1].error.radial == pytest.approx(other.radial, abs=1e-4)


def test_outlines_that_one_sensor_sees_wider_do_not_look_like_a_focal_length() -> None:
    # Left outlines on the right of the picture and right ones on its left: wider by 1 px is as if all shrank inwards.
    rng = np.random.default_rng(0)
    uv = rng.uniform([0, 0], [1242, 375], size=(3000, 2))
    rays = PINHOLE.rays(uv)
    xyz = se3.apply(se3.inverse(TRUTH), rays / rays[:, 2:] * rng.uniform(5, 40, (3000, 1)))
    side = np.where(uv[:, 0] > 600, Side.LEFT, Side.RIGHT).astype(np.int8)
    upright = rng.random(3000) < 0.7
    side = np.where(upright, side, rng.choice([Side.UPPER, Side.BOTTOM], 3000)).astype(np.int8)
    normal = np.where(upright[:, None], [1.0, 0.0], [0.0, 1.0])
    out = np.select([side == Side.LEFT, side == Side.RIGHT], [-1.0, 1.0], 0.0)
    centre = uv - out[:, None] * normal
    problem = PointToLine(xyz, centre, normal, np.ones(3000), side, np.zeros(3000, np.int64), (PINHOLE,), 2.0)
    (fit,) = fit_with_nuisances(problem, TRUTH, Nuisance()).cameras
    assert abs(fit.error.focal) < 1e-5
    (blind,) = fit_with_nuisances(replace(problem, side=np.full(3000, -1, np.int8)), TRUTH, Nuisance()).cameras
    assert blind.error.focal > 1e-3


def test_the_stated_deviation_is_the_one_that_noise_causes() -> None:
    found, stated = [], []
    for seed in range(24):
        problem = pairs(cameras=(PINHOLE,), count=300, noise_px=0.7, seed=seed)
        (fit,) = fit_with_nuisances(problem, TRUTH, Nuisance()).cameras
        found.append([fit.error.focal, fit.error.radial])
        stated.append(np.sqrt(np.diag(fit.covariance)))
        assert fit.sigma_px > 0
    ratio = np.std(found, axis=0) / np.mean(stated, axis=0)
    assert ((ratio > 0.6) & (ratio < 1.7)).all()
