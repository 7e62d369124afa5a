"""Which of one sensor's measurements is nearest in time to each of another's."""

from __future__ import annotations

import numpy as np
from p2o.arrays import Int


def nearest(sorted_times: Int, wanted: Int) -> Int:
    """Return the index (N,) of the time that is nearest to each wanted one (N,); at equal distance the earlier.

    `sorted_times` (M,) ascend, M at least 1; all are whole numbers of one unit.
    """
    if len(sorted_times) == 1:
        return np.zeros(len(wanted), np.int64)
    after = np.clip(np.searchsorted(sorted_times, wanted), 1, len(sorted_times) - 1)
    before = after - 1
    return np.where(wanted - sorted_times[before] <= sorted_times[after] - wanted, before, after)
