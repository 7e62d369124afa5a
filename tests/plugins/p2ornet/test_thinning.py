"""Probabilities of pairs of pixels become thin edge points of the right side, at the right place."""

from __future__ import annotations

import numpy as np
import pytest
from p2o import SIDES, Side
from p2o_plugins.image.p2ornet import long_enough
from p2o_plugins.p2ornet.thinning import Peaks, peaks, side_probabilities

PAIR = {Side.LEFT: (0, 0), Side.RIGHT: (0, 1), Side.UPPER: (1, 0), Side.BOTTOM: (1, 1)}
"""The plane (0 east, 1 south) and the order (0 occluded, 1 occluding) of a pair that says an edge of each side."""


def belief(height: int, width: int, pairs: dict[tuple[Side, int, int], float]) -> np.ndarray:
    """Return probabilities (2, 2, H, W) of occlusions that are zero but for these pairs (side, v, u)."""
    p = np.zeros((2, 2, height, width))
    for (side, v, u), value in pairs.items():
        p[(*PAIR[side], v, u)] = value
    return p


def found(pairs: dict[tuple[Side, int, int], float], size: tuple[int, int] = (9, 14), low: float = 0.02) -> Peaks:
    return peaks(side_probabilities(belief(*size, pairs)), low)


@pytest.mark.parametrize("side", SIDES)
def test_belief_spread_over_two_pairs_is_one_edge_at_their_mean_with_their_sum(side: Side) -> None:
    along = side in (Side.LEFT, Side.RIGHT)
    edge = found({(side, 4, 5): 0.4, (side, *((4, 6) if along else (5, 5))): 0.3})
    assert edge.score == pytest.approx([0.7])
    place = (5.5 if along else 4.5) + 3 / 7
    assert edge.uv[0, 0 if along else 1] == pytest.approx(place)


def test_a_pole_one_pixel_wide_has_both_its_sides_on_the_same_pixel() -> None:
    edge = found({(Side.LEFT, 4, 5): 1.0, (Side.RIGHT, 4, 6): 1.0})
    assert dict(zip(edge.side.tolist(), edge.pixel.tolist(), strict=True)) == {0: [6, 4], 1: [6, 4]}
    assert dict(zip(edge.side.tolist(), edge.uv[:, 0].tolist(), strict=True)) == {0: 5.5, 1: 6.5}


def test_nothing_is_found_where_there_is_nothing_or_too_little() -> None:
    assert len(found({}).uv) == 0
    assert len(found({(Side.LEFT, 4, 5): 0.2}, low=0.21).uv) == 0
    assert len(found({(Side.LEFT, 4, 5): 0.22}, low=0.21).uv) == 1
    for size in ((1, 1), (1, 9), (9, 1), (2, 2)):
        assert found({}, size=size).uv.shape == (0, 2)


def test_pairs_at_the_border_are_edges_and_pairs_that_leave_the_image_are_not() -> None:
    height, width = 7, 8
    for side, inner, outer in (
        (Side.LEFT, (3, width - 2), (3, width - 1)),
        (Side.RIGHT, (3, width - 2), (3, width - 1)),
        (Side.UPPER, (height - 2, 3), (height - 1, 3)),
        (Side.BOTTOM, (height - 2, 3), (height - 1, 3)),
    ):
        assert len(found({(side, *outer): 1.0}, size=(height, width)).uv) == 0
        edge = found({(side, *inner): 0.5, (side, *outer): 0.5}, size=(height, width))
        assert edge.score == pytest.approx([0.5])
        assert edge.uv.max() == max(inner) + 0.5
        first = found({(side, *((3, 0) if side in (Side.LEFT, Side.RIGHT) else (0, 3))): 1.0}, size=(height, width))
        assert first.uv.min() == 0.5


# ---- what is kept of them


def test_lines_shorter_than_asked_for_are_dropped_side_by_side() -> None:
    straight = np.array([[3, v] for v in range(5)])
    slanted = np.array([[8 + v, v] for v in range(5)])
    short = np.array([[16, v] for v in range(4)])
    pixel = np.concatenate([straight, slanted, short]).astype(float)
    side = np.zeros(len(pixel), np.int8)
    assert long_enough(pixel, side, (10, 20), 5).tolist() == [True] * 10 + [False] * 4
    assert long_enough(pixel, side, (10, 20), 4).all()
    # A line is of one side: alternating ones are pieces of one pixel.
    assert not long_enough(straight.astype(float), np.arange(5, dtype=np.int8) % 2, (10, 20), 2).any()
    assert long_enough(np.zeros((0, 2)), np.zeros(0, np.int8), (10, 20), 5).shape == (0,)


def test_an_even_background_has_no_edges_not_even_at_the_border() -> None:
    assert len(peaks(np.full((4, 20, 30), 0.1), 0.05).uv) == 0
