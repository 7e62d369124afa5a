"""A particle swarm in a box: many points that are drawn to the best place each has seen, and to the best of all."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from p2o.arrays import Float


def swarmed(
    cost: Callable[[Float], Float],
    low: Float,
    high: Float,
    rng: np.random.Generator,
    *,
    first: Float,
    particles: int,
    moves: int,
    inertia: float = 0.7298,
    attraction: float = 1.49618,
    narrow: float = 0.0,
) -> tuple[Float, float, int]:
    """Return the best place (D,) found in the box from `low` to `high` (D,), its cost, and the moves that were made.

    `cost` takes places (B, D) and returns (B,), all of a move at once. One particle begins at `first`, so that nothing
    worse is returned; the others all over the box. Each keeps the share `inertia` of its velocity and is drawn by up to
    `attraction` to its own best place and to that of all (Kennedy and Eberhart 1995; the usual figures are those of
    Clerc and Kennedy 2002, with which a swarm comes to rest); it stops at a wall. A swarm whose best places lie within
    `narrow` of one another in every unknown has done its work.
    """
    place = rng.uniform(low, high, (particles, len(low)))
    place[0] = first
    velocity = rng.uniform(-0.5, 0.5, place.shape) * (high - low)
    own, own_cost, moved = place, cost(place), 0
    while moved < moves and not np.ptp(own, axis=0).max() < narrow:
        leader = own[np.argmin(own_cost)]
        to_own, to_leader = rng.uniform(0, attraction, (2, *place.shape))
        velocity = inertia * velocity + to_own * (own - place) + to_leader * (leader - place)
        place = place + velocity
        outside = (place < low) | (place > high)
        velocity = np.where(outside, 0.0, velocity)
        place = np.clip(place, low, high)
        costs = cost(place)
        better = costs < own_cost
        own, own_cost = np.where(better[:, None], place, own), np.where(better, costs, own_cost)
        moved += 1
    best = int(np.argmin(own_cost))
    return own[best], float(own_cost[best]), moved
