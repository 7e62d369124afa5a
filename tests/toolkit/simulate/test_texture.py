"""Texture: bounded, smooth, without a visible period, and without detail that a pixel cannot show."""

from __future__ import annotations

import numpy as np
import pytest
from p2o.simulate.texture import OCTAVES, texture, value_noise


def _points(count: int = 4000, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).uniform(-90, 90, (count, 3))


def test_noise_stays_within_its_bounds_and_around_zero() -> None:
    noise = value_noise(_points(), 0.7)
    assert np.abs(noise).max() <= 1.0
    assert abs(noise.mean()) < 0.05
    assert noise.std() > 0.2


def test_noise_is_continuous_across_cells_on_both_sides_of_zero() -> None:
    points = _points()
    # The steepest slope of a smooth step is 1.5 a cell, over a difference of at most 2.
    assert np.abs(value_noise(points + np.array([1e-3, 0, 0]), 1.0) - value_noise(points, 1.0)).max() <= 3e-3 + 1e-6


def test_noise_takes_the_random_value_of_the_lattice_at_its_corners() -> None:
    corners = np.array([[3.0, 4.0, 5.0], [3.0 + 64.0, 4.0, 5.0 - 64.0]])
    assert value_noise(corners, 1.0)[0] == value_noise(corners, 1.0)[1]
    assert value_noise(2.5 * corners, 2.5)[0] == pytest.approx(value_noise(corners, 1.0)[0])


def test_details_smaller_than_a_pixel_fade_away() -> None:
    points = _points()
    coarse = texture(points, np.full(len(points), 50.0))
    np.testing.assert_array_equal(coarse, 0.0)
    # A pixel as large as the second octave's cell leaves the first alone, at the share that its ramp gives.
    (largest, weight), (second, _) = OCTAVES[:2]
    share = largest / (2 * second) - 0.5
    alone = texture(points, np.full(len(points), second))
    np.testing.assert_allclose(alone, share * weight * value_noise(points, largest), atol=1e-6)


def test_texture_does_not_repeat_along_a_street() -> None:
    line = np.column_stack([np.arange(0, 40, 0.05), np.full(800, 1.3), np.full(800, 0.2)])
    signal = texture(line, np.full(800, 0.02))
    signal -= signal.mean()
    spectrum = np.fft.rfft(signal, 1600)
    similarity = np.fft.irfft(np.abs(spectrum) ** 2)[:400]
    similarity /= similarity[0] * (1 - np.arange(400) / 800)
    assert similarity[60:].max() < 0.5
