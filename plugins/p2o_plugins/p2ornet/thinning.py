"""From probabilities of pairs of pixels to thin, directed, sub-pixel edge points."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from p2o import SIDES, Float, Int8, Side

REACH = 2
"""Pairs on either side of a peak that belong to the same edge."""


@dataclass(frozen=True, eq=False)
class Peaks:
    """Edge points: `uv` (N, 2) px on the outline, `side` (N,), `score` (N,) in 0..1, `pixel` (N, 2) in front."""

    uv: Float
    side: Int8
    score: Float
    pixel: Float

    def select(self, keep: np.ndarray) -> Peaks:
        """Return the points of a mask."""
        at = np.flatnonzero(keep)
        return Peaks(self.uv.take(at, 0), self.side.take(at), self.score.take(at), self.pixel.take(at, 0))


def side_probabilities(probability: Float) -> Float:
    """Return maps (4, H, W) of L, R, U, B from probabilities (inclinations, 2, H, W), east and south pairs first.

    The entry at (v, u) is the probability of an edge of the direction between that pixel and the next one to the right
    (L, R) or below (U, B); pairs that leave the image are 0.
    """
    maps = np.array(probability[:2]).reshape(4, *probability.shape[2:])
    maps[:2, :, -1] = 0
    maps[2:, -1] = 0
    return maps


def peaks(maps: Float, min_score: float) -> Peaks:
    """Return the edge points of maps (4, H, W), one at each maximum across the edge.

    Exactly one pair is the edge, and the network distributes its probability over the candidates. The score is
    therefore the sum over REACH pairs each way, and the position is their mean: the network's own estimate with
    subpixel scatter, since the pairs lie at half-pixels between foreground and background.
    """
    parts = []
    for side in SIDES:
        # The last pair of a line leaves the image.
        p = (maps[side] if side in (Side.LEFT, Side.RIGHT) else maps[side].T)[:, :-1]
        line, place, at, score = _line_peaks(p, min_score)
        ahead = 1 if side in (Side.LEFT, Side.UPPER) else 0  # the foreground is the pair's second pixel
        edge, inner = np.stack([at, line], 1), np.stack([place + ahead, line], 1)
        if side in (Side.UPPER, Side.BOTTOM):
            edge, inner = edge[:, ::-1], inner[:, ::-1]
        parts.append((edge, np.full(len(at), side, np.int8), score, inner))
    return Peaks(*(np.concatenate(column) for column in zip(*parts, strict=True)))


def _line_peaks(p: Float, min_score: float) -> tuple[Float, Float, Float, Float]:
    """Return line, place of the peak, sub-pixel place and score of the maxima along the rows of p (lines, places)."""
    lines, places = p.shape
    inner = (slice(1, -1), slice(REACH + 1, -REACH - 1))
    # Axes stay in the order that they have in memory, here and in what is computed from it.
    order: Literal["C", "F"] = "F" if p.strides[0] < p.strides[1] else "C"
    padded = np.zeros((lines + 2, places + 2 * (REACH + 1)), p.dtype, order)
    padded[inner] = p
    # Neighbouring lines vote on where the peak is, not on how high it is. Sums of 16 in all, and not means: that saves
    # work, and changes no comparison.
    across = padded[1:-1] + padded[1:-1]
    across += padded[:-2]
    across += padded[2:]
    smooth = across[:, 1:-1] + across[:, 1:-1]
    smooth += across[:, :-2]
    smooth += across[:, 2:]

    def beside(k: int) -> Float:
        moved: Float = smooth[:, REACH + k : REACH + k + places]
        return moved

    centre = beside(0)
    highest = centre > 16 * 0.02 * min_score
    highest &= centre > beside(-1)
    highest &= centre >= beside(1)
    line, place = np.divmod(np.flatnonzero(highest), places)
    # It falls to both sides: an even background has no peak, not even at the border of the image.
    flat, (down, along) = smooth.ravel("K"), _steps(smooth)
    at = down * line + along * (place + REACH)
    peak = flat.take(at)
    falls = peak > 1.001 * np.maximum(flat.take(at - REACH * along), flat.take(at + REACH * along))
    line, place = line[falls], place[falls]
    flat, (down, along) = padded.ravel("K"), _steps(padded)
    at = down * (line + 1) + along * (place + 1)
    window = flat.take(at[:, None] + along * np.arange(2 * REACH + 1))
    total = window.sum(axis=1)
    keep = np.flatnonzero(total >= min_score)
    line, place, window, total = line.take(keep), place.take(keep), window.take(keep, 0), total.take(keep)
    shift = window @ np.arange(-REACH, REACH + 1) / np.maximum(total, 1e-9)
    return line, place, place + 0.5 + shift, np.minimum(total, 1.0)


def _steps(array: Float) -> tuple[int, int]:
    """Return the stride in elements between two neighbours along each axis of a contiguous array."""
    rows, columns = array.shape
    return (columns, 1) if array.flags.c_contiguous else (1, rows)
