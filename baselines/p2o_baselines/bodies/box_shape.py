"""A box as geometry: its turns that leave it alike, its edges, and which of them one sees of a corner."""

from __future__ import annotations

from itertools import permutations, product

import numpy as np
from p2o.arrays import Bool, Float, Int

_EQUAL = 0.03  # sides that differ by less of the larger one are taken for equal


def symmetries(size_m: Float) -> list[Float]:
    """Return the rotations (4, 4) that leave a box of `size_m` (3,) as it is: four, eight, or 24 of a cube."""
    out = []
    for order in permutations(range(3)):
        if any(abs(size_m[a] - size_m[b]) > _EQUAL * max(size_m[a], size_m[b]) for a, b in enumerate(order)):
            continue
        for signs in product((1.0, -1.0), repeat=3):
            turn = np.eye(4)
            turn[:3, :3] = np.diag(signs) @ np.eye(3)[list(order)]
            if np.linalg.det(turn[:3, :3]) > 0:
                out.append(turn)
    return out


def near_corner(eye: Float, size_m: Float) -> int | None:
    """Return the corner of a box whose three faces are seen from `eye` (3,) in its frame; None where fewer are."""
    out = np.abs(eye) > size_m / 2
    return int(np.sum((eye > 0) * np.array([1, 2, 4]))) if out.all() else None


def around(corner: int) -> tuple[list[int], list[tuple[int, int]]]:
    """Return the six corners of the outline that one sees of a corner, in turn, and the three edges that meet there.

    Corners are numbered by bits as in `p2o.Box.outline`. The first, third and fifth of the outline are the ends of the
    edges: along x, y and z.
    """
    x, y, z = corner ^ 1, corner ^ 2, corner ^ 4
    return [x, corner ^ 3, y, corner ^ 6, z, corner ^ 5], [(corner, x), (corner, y), (corner, z)]


def enters(start: Float, way: Float, half: Float) -> tuple[Float, Int, Bool]:
    """Return how far along rays (N, 3) in its frame a box of half sizes (3,) is met, across which axis, and whether."""
    with np.errstate(divide="ignore", invalid="ignore"):
        one, two = ((sign * half - start) / way for sign in (-1.0, 1.0))
    low, high = np.fmin(one, two), np.fmax(one, two)
    enter, leave = low.max(axis=1), high.min(axis=1)
    return enter, low.argmax(axis=1), (enter < leave) & (leave > 0)
