"""How points between pixels are counted in the levels of a picture."""

from __future__ import annotations

import numpy as np
import pytest
from p2o_baselines.information.histogram import Hard, Levels, Linear, Spline

RNG = np.random.default_rng(0)
VALUE = RNG.uniform(0, 7, (9, 12))
LEVEL = VALUE.astype(np.int64)
KINDS = {"hard": Hard(LEVEL, 8), "linear": Linear(VALUE, 8), "spline": Spline(LEVEL, 8)}
UV = RNG.uniform([1.0, 1.0], [10.0, 7.0], (40, 2))
kinds = pytest.mark.parametrize("levels", KINDS.values(), ids=KINDS.keys())


def histogram(levels: Levels, uv: np.ndarray) -> np.ndarray:
    """Return the share of each level (N, 8) of each place."""
    out = np.zeros((len(uv), 8))
    for tap in levels.taps(uv):
        out[np.arange(len(uv)), tap.level] += tap.weight
    return out


@pytest.mark.parametrize("name", ["linear", "spline"])
@pytest.mark.parametrize("axis", [0, 1])
def test_derivatives_are_those_of_differences(name: str, axis: int) -> None:
    levels, step = KINDS[name], np.zeros(2)
    step[axis] = 1e-6
    worth = RNG.normal(size=8)
    said = sum(worth[tap.level] * tap.slope[:, axis] for tap in levels.taps(UV, slopes=True))
    seen = (histogram(levels, UV + step) - histogram(levels, UV - step)) @ worth / 2e-6
    assert said == pytest.approx(seen, abs=1e-6)


@kinds
def test_the_corners_of_what_is_shown_can_be_looked_up_and_beyond_is_not_shown(levels: Levels) -> None:
    border = 1.0 if isinstance(levels, Spline) else 0.0
    corners = np.array([[border, border], [11 - border, 8 - border]])
    assert histogram(levels, corners).sum(axis=1) == pytest.approx([1, 1])
    inner = corners + [[0.01, 0.01], [-0.01, -0.01]]
    assert (levels.presence(inner) > 0).all()
    assert not levels.presence(corners + [[-0.6, 0], [0.6, 0]]).any()
    assert not levels.presence(np.full((1, 2), np.nan)).any()


def test_at_a_pixel_hard_and_linear_levels_are_its_own() -> None:
    at = np.array([[4.0, 3.0]])
    assert histogram(KINDS["hard"], at)[0, LEVEL[3, 4]] == 1
    assert histogram(KINDS["linear"], at)[0] @ np.arange(8) == pytest.approx(VALUE[3, 4])


def test_at_a_pixel_a_spline_weighs_it_and_its_neighbours_as_the_uniform_cubic_does() -> None:
    level = np.zeros((5, 5), np.int64)
    level[2, 2] = 1
    assert histogram(Spline(level, 8), np.array([[2.0, 2.0]]))[0, 1] == pytest.approx((4 / 6) ** 2)
    assert histogram(Spline(level, 8), np.array([[1.0, 2.0]]))[0, 1] == pytest.approx(4 / 36)
