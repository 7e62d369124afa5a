"""When an axis of a figure is logarithmic: where rows differ so much that a linear one would show the worst alone."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from p2o.arrays import Float

MUCH = 20.0
"""On a linear axis of some 300 px the smaller of two such rows is 15 px: its box could not be read."""
RULE = f"An axis is logarithmic where the median size of one row is over {MUCH:g} times that of another."


def differ_much(rows: Iterable[Float]) -> bool:
    """Return whether the largest median of the sizes of rows of values is over `MUCH` times the smallest.

    Rows without a finite value, and medians of zero, which no logarithm shows, are left out.
    """
    medians = [float(np.median(sizes)) for row in rows if len(sizes := _sizes(row))]
    shown = [median for median in medians if median > 0]
    return bool(shown) and max(shown) > MUCH * min(shown)


def lifted(rows: Iterable[Float]) -> list[Float]:
    """Return the sizes of rows of values as a logarithmic axis takes them: a zero is as large as the smallest other."""
    sizes = [_sizes(row) for row in rows]
    above = [float(size[size > 0].min()) for size in sizes if (size > 0).any()]
    least = min(above, default=1.0)
    return [np.maximum(size, least) for size in sizes]


def _sizes(row: Float) -> Float:
    values = np.abs(np.asarray(row, dtype=np.float64))
    return np.asarray(values[np.isfinite(values)])
