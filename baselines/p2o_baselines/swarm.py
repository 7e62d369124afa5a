"""A particle swarm in a box: many points that are drawn to the best place each has seen, and to the best of all."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from p2o.arrays import Float

# Inertia and pulls of Clerc and Kennedy (2002), with which a swarm comes to rest.
_INERTIA, _PULL = 0.7298, 1.49618


def swarmed(
    cost: Callable[[Float], Float], half: Float, rng: np.random.Generator, *, particles: int, steps: int
) -> tuple[Float, float]:
    """Return the best place (D,) in the box of half widths `half` (D,) around 0, and its cost.

    `cost` takes places (B, D) and returns (B,). The middle of the box is one of the first places, so that nothing worse
    is returned.
    """
    place = rng.uniform(-half, half, (particles, len(half)))
    place[0] = 0.0
    speed = rng.uniform(-half, half, place.shape) * 0.5
    own, own_cost = place.copy(), cost(place)
    for _ in range(steps):
        best = own[np.argmin(own_cost)]
        pulls = rng.uniform(0.0, _PULL, (2, *place.shape))
        speed = _INERTIA * speed + pulls[0] * (own - place) + pulls[1] * (best - place)
        place = np.clip(place + speed, -half, half)
        now = cost(place)
        better = now < own_cost
        own[better], own_cost[better] = place[better], now[better]
    found = int(np.argmin(own_cost))
    return own[found], float(own_cost[found])
