"""Values that figures and page plot: convergence by round, and which axes are logarithmic."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from p2o.arrays import Float

from p2o_study.row import Row

QUARTILES = (0.25, 0.5, 0.75)
MUCH = 20.0
"""Ratio of medians: on a linear axis of 300 px the smaller box would have 15 px and not be legible."""
RULE = f"An axis is logarithmic where the median size of one row is over {MUCH:g} times that of another."


@dataclass(frozen=True, eq=False)
class Convergence:
    """Lower quartile, median and upper quartile (3, rounds) over `runs` runs of matches and of mean residuals in px."""

    runs: int
    matches: Float
    residual_px: Float


def convergence_of(runs: Iterable[Row]) -> Convergence | None:
    """Return the convergence of runs; None if no run has rounds of matching and solving.

    A run that has ended is continued with the values of its last round; otherwise the last rounds would represent the
    slowest runs only.
    """
    # The round of an initializer has no matches.
    solved = [[r for r in run.rounds if math.isfinite(r.mean_residual) and r.matches] for run in runs]
    values = [np.array([[sum(r.matches.values()), r.mean_residual] for r in rounds]) for rounds in solved if rounds]
    if not values:
        return None
    last = range(max(map(len, values)))
    quartiles = np.array([np.quantile([v[min(i, len(v) - 1)] for v in values], QUARTILES, axis=0) for i in last])
    matches, residual_px = np.moveaxis(quartiles, (2, 1), (0, 1))
    return Convergence(len(values), matches, residual_px)


def rounds_differ_much(histories: Iterable[Convergence | None]) -> tuple[bool, bool]:
    """Return whether the medians of matches and of residuals in the last round `differ_much` between rows."""
    known = [history for history in histories if history is not None]
    return (
        differ_much(history.matches[1, -1:] for history in known),
        differ_much(history.residual_px[1, -1:] for history in known),
    )


def differ_much(rows: Iterable[Float]) -> bool:
    """Return whether the largest median absolute value of a row exceeds `MUCH` times the smallest.

    Rows without finite values and medians of zero are left out.
    """
    medians = [float(np.median(sizes)) for row in rows if len(sizes := _sizes(row))]
    shown = [median for median in medians if median > 0]
    return bool(shown) and max(shown) > MUCH * min(shown)


def lifted(rows: Iterable[Float]) -> list[Float]:
    """Return absolute values for a logarithmic axis: zeros are replaced by the smallest positive value."""
    sizes = [_sizes(row) for row in rows]
    above = [float(size[size > 0].min()) for size in sizes if (size > 0).any()]
    least = min(above, default=1.0)
    return [np.maximum(size, least) for size in sizes]


def _sizes(row: Float) -> Float:
    values = np.abs(np.asarray(row, dtype=np.float64))
    return np.asarray(values[np.isfinite(values)])
