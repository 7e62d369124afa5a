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


def table(points: Peaks) -> np.ndarray:
    """Return all that is known of the points (N, 6), in an order of their own."""
    rows = np.column_stack([points.side, points.uv, points.pixel, points.score])
    return rows[np.lexsort(np.round(rows, 6).T)]


@pytest.mark.parametrize(
    ("side", "uv", "pixel"),
    [
        (Side.LEFT, (5.5, 4), (6, 4)),
        (Side.RIGHT, (5.5, 4), (5, 4)),
        (Side.UPPER, (5, 4.5), (5, 5)),
        (Side.BOTTOM, (5, 4.5), (5, 4)),
    ],
)
def test_a_certain_pair_is_one_edge_between_its_pixels(
    side: Side, uv: tuple[float, ...], pixel: tuple[int, ...]
) -> None:
    edge = found({(side, 4, 5): 1.0})
    assert edge.side.tolist() == [side]
    np.testing.assert_allclose(edge.uv, [uv])
    np.testing.assert_array_equal(edge.pixel, [pixel])
    assert edge.score == pytest.approx([1.0])
    # The background lies from the foreground pixel through the edge.
    np.testing.assert_allclose((edge.uv - edge.pixel)[0], 0.5 * np.array(side.background))


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


def _random_maps(seed: int) -> np.ndarray:
    """Return maps (4, 20, 25) full of sharp and of blurred maxima, in the interior and at the border."""
    maps = np.random.default_rng(seed).random((4, 20, 25)) ** 6
    maps[:2, :, -1] = 0
    maps[2:, -1] = 0
    return maps


@pytest.mark.parametrize("seed", range(3))
def test_the_mirrored_belief_gives_the_mirrored_edges(seed: int) -> None:
    maps = _random_maps(seed)
    flipped = np.zeros_like(maps)
    for side in (Side.LEFT, Side.RIGHT):
        flipped[side.mirrored, :, :-1] = maps[side, :, -2::-1]
    flipped[2:] = maps[2:, :, ::-1]
    direct, mirrored = peaks(maps, 0.3), peaks(flipped, 0.3)
    assert len(direct.uv) > 50
    side = np.array([Side(int(s)).mirrored for s in mirrored.side])
    last = np.array([24, 0])
    sign = np.array([-1, 1])
    back = Peaks(last + sign * mirrored.uv, side, mirrored.score, last + sign * mirrored.pixel)
    np.testing.assert_allclose(table(back), table(direct), atol=1e-9)


def test_the_edge_lies_within_reach_of_its_foreground_pixel() -> None:
    edge = peaks(_random_maps(11), 0.1)
    toward = np.array([Side(int(s)).background for s in edge.side])
    assert (np.abs(((edge.uv - edge.pixel) * toward).sum(axis=1) - 0.5) <= 2).all()
    assert (((edge.uv - edge.pixel) * (1 - np.abs(toward))) == 0).all()


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
