"""Process fixed slices of rows on all cores; results do not depend on the number of cores."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

from p2o.solving import cores


def in_slices(work: Callable[[slice], None], count: int, size: int) -> None:
    """Call `work` on slices of `size` rows that cover 0 to `count`, in any order; it may only write to these rows."""
    slices = [slice(start, min(start + size, count)) for start in range(0, count, size)]
    with ThreadPoolExecutor(max(1, min(cores(), len(slices)))) as pool:
        list(pool.map(work, slices))
