"""Levenberg and Marquardt's method for the least squares of methods with known targets."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

import numpy as np
from p2o import Float

_State = TypeVar("_State")
_MOST_DAMPING = 1e8


def descended(
    state: _State,
    cost: Callable[[_State], float],
    step: Callable[[_State, float], tuple[Float, _State]],
    *,
    iterations: int,
    least_step: float,
    least_gain: float = -1.0,
) -> _State:
    """Return the state of the least cost near a given one.

    `step(state, damping)` returns the update (6,) of the pose and the updated state. The descent ends after an update
    below `least_step` in rad and m, after a gain of at most the share `least_gain` of the cost, or if no damping helps.
    """
    damping, least = 1e-6, cost(state)
    for _ in range(iterations):
        update, trial = step(state, damping)
        total = cost(trial)
        if total <= least * (1 + 1e-12):
            done = np.abs(update).max() < least_step or least - total <= least_gain * least
            state, least, damping = trial, total, max(damping / 10, 1e-12)
            if done:
                break
        else:
            damping *= 10
            if damping > _MOST_DAMPING:
                break
    return state
