"""Ranks of values: what makes any distribution an even one."""

from __future__ import annotations

import numpy as np
from p2o.arrays import Float


def by_rank(values: Float) -> Float:
    """Return values of any shape replaced by their rank, in (0, 1); equal ones share the mean of their ranks."""
    flat = np.sort(values, axis=None)
    below, up_to = (np.searchsorted(flat, values, side) for side in ("left", "right"))
    return np.asarray((below + up_to) / (2.0 * max(flat.size, 1)))
