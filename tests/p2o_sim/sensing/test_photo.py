"""From light to bytes: exposure, noise, lens."""

from __future__ import annotations

import numpy as np
import pytest
from p2o_sim.sensing.photo import Photo, develop, metered_gain

RAMP = np.repeat(np.linspace(0.0, 1.0, 64, dtype=np.float32)[None, :, None], 32, axis=0).repeat(3, axis=2)


def _rng() -> np.random.Generator:
    return np.random.default_rng(0)


def test_a_noiseless_camera_follows_the_srgb_curve() -> None:
    rgb = develop(RAMP, Photo(), _rng())
    # Linear 0.2140 is sRGB 0.5; 0 and 1 are themselves.
    assert (rgb[0, 0], rgb[0, -1]) == (pytest.approx([0, 0, 0]), pytest.approx([255, 255, 255]))
    middle = develop(np.full((4, 4, 3), 0.21404, np.float32), Photo(), _rng())
    assert np.abs(middle.astype(int) - 127.5).max() <= 1


def test_more_exposure_never_darkens_a_pixel_and_ends_white() -> None:
    images = [develop(RAMP, Photo(gain=2.0**ev), _rng()).astype(int) for ev in (-4, -2, 0, 2, 8)]
    assert all((np.diff([p[0, :, 0] for p in images], axis=0) >= 0).ravel())
    assert (images[-1][:, 1:] == 255).all()
    assert images[0].mean() < 0.5 * images[2].mean()


def test_the_meter_brings_any_light_to_the_same_grey_and_a_stop_doubles_it() -> None:
    assert metered_gain(3 * (RAMP + 0.2)) == pytest.approx(metered_gain(RAMP + 0.2) / 3, rel=0.02)
    assert metered_gain(RAMP, 1.0) == pytest.approx(2 * metered_gain(RAMP))


def test_noise_grows_with_the_grain_and_is_centred() -> None:
    flat = np.full((128, 128, 3), 0.2, np.float32)
    deviations = [develop(flat, Photo(grain=g), _rng()).std() for g in (0.0, 1.0, 4.0)]
    assert deviations[0] == 0
    assert deviations[1] < deviations[2]
    assert develop(flat, Photo(grain=2.0), _rng()).mean() == pytest.approx(
        develop(flat, Photo(), _rng()).mean(), abs=0.5
    )


def test_vignetting_darkens_the_corners_and_leaves_the_middle() -> None:
    flat = np.full((101, 201, 3), 0.4, np.float32)
    plain, dark = (develop(flat, Photo(vignetting=v), _rng()).astype(int) for v in (0.0, 0.5))
    assert dark[50, 100, 0] == plain[50, 100, 0]
    assert dark[0, 0, 0] < 0.8 * plain[0, 0, 0]
    np.testing.assert_array_equal(dark, dark[::-1, ::-1])


def test_blur_spreads_a_step_over_its_width_and_compression_stays_close() -> None:
    step = np.zeros((32, 64, 3), np.float32)
    step[:, 32:] = 0.5
    blurred = develop(step, Photo(blur_px=2.0), _rng())[16, :, 0].astype(int)
    assert (np.diff(blurred) >= 0).all()
    assert blurred[30] > 5
    compressed = develop(step, Photo(blur_px=2.0, jpeg_quality=95), _rng())[16, :, 0].astype(int)
    assert 0 < np.abs(compressed - blurred).max() < 12
