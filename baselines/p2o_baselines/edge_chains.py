"""Edge pixels as chains, one pixel after the other, and the straight pieces and arcs that chains are made of.

Chains are linked as Kovesi's edge linking does: from pixels with one neighbour on, straight through junctions, so that
a line that another one crosses stays one chain. They are cut where they bend, by Douglas and Peucker's method; lines
are fitted by least squares of distances, circles by Kasa's algebraic fit.
"""

from __future__ import annotations

from math import hypot
from typing import NamedTuple

import numpy as np
from p2o.arrays import Bool, Float, Int

_AROUND = ((0, 1), (1, 0), (0, -1), (-1, 0), (1, 1), (1, -1), (-1, -1), (-1, 1))
"""The eight neighbours of a pixel, those that share a side first."""
_BEYOND = tuple((dv, du) for dv in range(-2, 3) for du in range(-2, 3) if max(abs(dv), abs(du)) == 2)
"""The sixteen pixels around those."""
_STRAIGHT = 0.9
"""Cosine of the angle that a chain may turn by where it goes on beyond another one."""
_LOOK_BACK = 5
"""The direction of a chain is that of its last pixels, so many of them."""


def chains(pixels: Bool) -> list[Int]:
    """Return the chains of edge pixels (H, W), each (M, 2) with u and v of its pixels in order; every pixel is in one.

    Neighbours in a chain touch by a side or a corner, but where it crosses another one. A closed
    chain ends next to its first pixel.
    """
    # A border of nothing spares the walk a look at the bounds.
    free = np.pad(np.asarray(pixels, np.bool_), 1)
    around = sum(np.roll(free, step, axis=(0, 1)).astype(np.int8) for step in _AROUND)
    v, u = np.nonzero(free)
    ends_first = np.argsort(around[v, u] > 1, kind="stable")
    left = set(zip(v.tolist(), u.tolist(), strict=True))
    found = []
    for row, column in zip(v[ends_first].tolist(), u[ends_first].tolist(), strict=True):
        if (row, column) not in left:
            continue
        left.discard((row, column))
        chain = _walk([(row, column)], left)
        chain.reverse()
        found.append(np.array(_walk(chain, left), np.int64)[:, ::-1] - 1)
    return found


def _walk(chain: list[tuple[int, int]], left: set[tuple[int, int]]) -> list[tuple[int, int]]:
    """Return the chain with what is left of its way from its last pixel on, which is taken out of `left`."""
    while True:
        (row, column), back = chain[-1], chain[max(len(chain) - _LOOK_BACK, 0)]
        way = (row - back[0], column - back[1])
        near = [step for step in _AROUND if (row + step[0], column + step[1]) in left]
        if not near and len(chain) >= _LOOK_BACK:
            # A chain that crosses has taken the pixel between.
            near = [
                step for step in _BEYOND if (row + step[0], column + step[1]) in left and _along(way, step) > _STRAIGHT
            ]
        if not near:
            return chain
        # Straight on; of equals the one that shares a side, so that no corner of a staircase is left behind.
        step = max(near, key=lambda step: _along(way, step)) if len(near) > 1 else near[0]
        chain.append((row + step[0], column + step[1]))
        left.discard(chain[-1])


def _along(way: tuple[int, int], step: tuple[int, int]) -> float:
    """Return the cosine of the angle between a step and a way, 0 where there is no way yet."""
    return (way[0] * step[0] + way[1] * step[1]) / (hypot(*way) * hypot(*step) or 1.0)


def cut(chain: Int, off_px: float) -> tuple[Int, Int]:
    """Return a chain (M, 2) and where in it (K,) its pieces begin and end: no pixel is `off_px` from its piece's chord.

    A closed chain is turned so that it begins where it bends.
    """
    corners = _bends(chain, off_px)
    closed = len(chain) > 8 and np.abs(chain[0] - chain[-1]).max() <= 2
    if closed and len(corners) > 2:
        chain = np.roll(chain, -int(corners[1]), axis=0)
        corners = _bends(chain, off_px)
    return chain, corners


def _bends(chain: Int, off_px: float) -> Int:
    """Return the indices (K,) of Douglas and Peucker's corners of a chain (M, 2), its first and last among them."""
    keep, open_yet = {0, len(chain) - 1}, [(0, len(chain) - 1)]
    while open_yet:
        first, last = open_yet.pop()
        if last - first < 2:
            continue
        way, between = chain[last] - chain[first], chain[first + 1 : last] - chain[first]
        length = float(np.hypot(*way))
        # From the point itself where both ends are one.
        off = np.abs(way[0] * between[:, 1] - way[1] * between[:, 0]) / length if length > 2 else np.hypot(*between.T)
        far = int(np.argmax(off))
        if off[far] >= off_px:
            keep.add(first + 1 + far)
            open_yet += [(first, first + 1 + far), (first + 1 + far, last)]
    return np.array(sorted(keep), np.int64)


def line_rms_px(uv: Float) -> float:
    """Return the root mean square distance of pixels (M, 2) from the line that fits them best."""
    offset = uv - uv.mean(axis=0)
    return float(np.sqrt(max(np.linalg.eigvalsh(offset.T @ offset)[0], 0.0) / len(uv)))


class Arc(NamedTuple):
    """A circle fitted to pixels: its radius, how far pixels are off, and the angle that they go along it."""

    radius_px: float
    rms_px: float
    angle_deg: float


def arc_of(uv: Float) -> Arc:
    """Return the circle that fits pixels (M, 2) of a chain best, by Kasa's fit; of infinite radius for a line."""
    middle = uv.mean(axis=0)
    offset = uv - middle
    rows = np.column_stack([2 * offset, np.ones(len(offset))])
    found, _, rank, _ = np.linalg.lstsq(rows, (offset**2).sum(axis=1), rcond=1e-9)
    if rank < 3:
        return Arc(np.inf, 0.0, 0.0)
    radius = float(np.sqrt(max(found[2] + found[:2] @ found[:2], 0.0)))
    spoke = offset - found[:2]
    off = np.hypot(*spoke.T) - radius
    turn = np.diff(np.unwrap(np.arctan2(spoke[:, 1], spoke[:, 0])))
    return Arc(radius, float(np.sqrt((off**2).mean())), float(np.degrees(abs(turn.sum()))))
