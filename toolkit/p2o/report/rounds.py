"""How runs come together round by round: matches and mean residual, over all runs of a row."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from p2o.arrays import Float
from p2o.study.store import StoredRow

QUARTILES = (0.25, 0.5, 0.75)


@dataclass(frozen=True, eq=False)
class Convergence:
    """Lower quartile, median and upper quartile (3, rounds) over `runs` runs of matches and of mean residuals in px."""

    runs: int
    matches: Float
    residual_px: Float

    @property
    def ends(self) -> tuple[float, float]:
        """Medians of matches and residual in the last round."""
        return float(self.matches[1, -1]), float(self.residual_px[1, -1])


def convergence(runs: Sequence[StoredRow]) -> Convergence | None:
    """Return how the runs of a row came together; None where none of them has rounds of matching and solving.

    A run that has ended counts with its last round in those that follow: otherwise the last rounds would show the
    slowest runs alone.
    """
    histories = []
    for run in runs:
        # The step of an initializer matches nothing.
        solved = [r for r in run.rounds if isinstance(r.get("mean_residual"), float) and r.get("matches")]
        if solved:
            histories.append([(sum(r["matches"].values()), r["mean_residual"]) for r in solved])
    if not histories:
        return None
    longest = max(map(len, histories))
    values = np.array([history + [history[-1]] * (longest - len(history)) for history in histories], dtype=np.float64)
    matches, residual_px = np.moveaxis(np.quantile(values, QUARTILES, axis=0), -1, 0)
    return Convergence(len(histories), matches, residual_px)
