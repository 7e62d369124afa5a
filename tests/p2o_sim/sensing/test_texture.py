"""Texture: centred, without detail that a pixel cannot show, without a period that can be seen."""

from __future__ import annotations

import numpy as np
import pytest
from p2o_sim.sensing.texture import PATTERNS, PERIOD_M, texture


def _places(count: int = 4000) -> np.ndarray:
    return np.random.default_rng(0).uniform(-90, 90, (count, 2)).astype(np.float32)


def _of(name: str, places: np.ndarray, footprint_m: float) -> np.ndarray:
    rows = np.full(len(places), PATTERNS.index(name))
    return texture(rows, places.astype(np.float32), np.full(len(places), footprint_m, np.float32))


@pytest.mark.parametrize("name", PATTERNS)
def test_details_smaller_than_a_pixel_fade_away(name: str) -> None:
    near, far = _of(name, _places(), 0.01), _of(name, _places(), 100.0)
    assert far.std() < 0.25 * near.std()


def test_texture_is_continuous_across_cells() -> None:
    places = _places()
    step = _of("rough", places + np.float32(1e-3), 0.02) - _of("rough", places, 0.02)
    assert np.abs(step).max() < 0.35


def test_the_pattern_alone_repeats_but_the_texture_does_not() -> None:
    places = _places()
    first, second = _of("brick", places, 0.01), _of("brick", places + np.float32(PERIOD_M), 0.01)
    assert np.corrcoef(first, second)[0, 1] < 0.95
    assert np.abs(first - second).max() > 0.05
