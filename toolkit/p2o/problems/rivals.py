"""Poses near a result that cost less than it: evidence that the rounds ended in a local minimum."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from p2o.arrays import Float
from p2o.geometry import se3
from p2o.geometry.pose_error import is_distinct
from p2o.problems.directed_cost import DirectedCost

_SIGMA = np.array([*np.radians([2.2, 2.2, 2.2]), 0.22, 0.22, 0.22])
"""Standard deviations of the drawn poses about and along each axis: 2.2 deg and 22 cm."""
_DRAWS, _KEPT, _NARROWER, _GENERATIONS = 1536, 64, 0.5, 3
_LEAST_DRAWS, _MOST_POINTS, _DRAWN_POINTS = 256, 10_000, 2_000
"""Joint calibrations with more points have fewer draws: their minima are fewer and wider. A subset of points counts."""


def rival_poses(cost: DirectedCost, pose: Float, count: int, seed: int = 0) -> list[Float]:
    """Return up to `count` poses (4, 4) of low cost that are distinct from a pose (4, 4) and from each other.

    Poses of a left update are drawn from a Gaussian, then around the best of them with half the deviation, and again.
    """
    rng = np.random.default_rng(seed)
    drawn_cost = replace(cost.thinned(_DRAWN_POINTS), smooth=False)
    size = max(_LEAST_DRAWS, min(_DRAWS, _DRAWS * _MOST_POINTS // max(cost.points, 1)))
    centres, sigma = np.zeros((1, 6)), _SIGMA
    draws, costs = np.zeros((0, 6)), np.zeros(0)
    for _ in range(_GENERATIONS):
        drawn = centres[rng.integers(len(centres), size=size)] + rng.normal(0.0, sigma, (size, 6))
        draws = np.concatenate([draws, drawn])
        costs = np.concatenate([costs, drawn_cost(se3.exp(drawn) @ pose)])
        centres, sigma = draws[np.argsort(costs, kind="stable")[:_KEPT]], _NARROWER * sigma
    rivals: list[Float] = []
    for draw in draws[np.argsort(costs, kind="stable")[: 4 * _KEPT]]:
        other = se3.exp(draw) @ pose
        if all(is_distinct(se3.inverse(other) @ known) for known in (pose, *rivals)):
            rivals.append(other)
        if len(rivals) == count:
            break
    return rivals
