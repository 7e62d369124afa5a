"""Work cut into fixed slices that run on all cores; results do not depend on how many there are."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

from p2o.native import cores


def in_slices(work: Callable[[slice], None], count: int, size: int) -> None:
    """Call `work` on slices of `size` rows that cover 0 to `count`, in any order; it writes into its own rows only."""
    slices = [slice(start, min(start + size, count)) for start in range(0, count, size)]
    threads = min(cores(), len(slices))
    if threads < 2:
        for part in slices:
            work(part)
        return
    with ThreadPoolExecutor(threads) as pool:
        list(pool.map(work, slices))
