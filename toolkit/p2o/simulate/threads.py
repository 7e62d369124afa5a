"""Work cut into fixed slices that run on all cores; results do not depend on how many there are."""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor


def in_slices(work: Callable[[slice], None], count: int, size: int) -> None:
    """Call `work` on slices of `size` rows that cover 0 to `count`, in any order; it writes into its own rows only."""
    slices = [slice(start, min(start + size, count)) for start in range(0, count, size)]
    cores = min(_cores(), len(slices))
    if cores < 2:
        for part in slices:
            work(part)
        return
    with ThreadPoolExecutor(cores) as pool:
        list(pool.map(work, slices))


def _cores() -> int:
    """Return how many cores this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1
