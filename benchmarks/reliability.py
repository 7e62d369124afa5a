"""Does a confidence of 0.8 mean that 8 of 10 are right? Tables and diagrams of how reliable confidences are."""

from __future__ import annotations

import io
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from p2o.arrays import Float, Int, checked
from p2o.errors import InputError
from p2o.files.whole_file import write_whole


@dataclass(frozen=True, eq=False)
class Reliability:
    """Confidences in bins of equal width, each (K,): bounds `low` and `high`, how many, mean confidence, share right.

    Mean and share are NaN in empty bins.
    """

    low: Float
    high: Float
    count: Int
    confidence: Float
    share: Float

    @property
    def expected_error(self) -> float:
        """Expected calibration error: |share - mean confidence|, averaged over all points; NaN without points.

        Naeini, Cooper, Hauskrecht, Obtaining Well Calibrated Probabilities Using Bayesian Binning, AAAI 2015.
        """
        if not self.count.sum():
            return float("nan")
        gap = np.abs(self.share - self.confidence)
        return float(np.nansum(gap * self.count) / self.count.sum())


def reliability(confidence: Float, right: Float, bins: int = 10) -> Reliability:
    """Return the table of confidences (N,) in [0, 1] and of whether each was `right` (N,).

    Raises InputError for confidences outside [0, 1], arrays of different length, or no bins.
    """
    if bins < 1:
        raise InputError("a table needs bins", expected="bins >= 1", got=bins)
    values: Float = checked("confidence", confidence, (None,), np.float64)
    hits: Float = checked("right", right, (len(values),), np.float64)
    if len(values) and not (values.min() >= 0 and values.max() <= 1):
        raise InputError("a confidence is no share", expected="0 to 1", got=f"{values.min():g} to {values.max():g}")
    number = np.minimum((values * bins).astype(np.int64), bins - 1)
    count = np.bincount(number, minlength=bins)
    with np.errstate(invalid="ignore"):
        mean = np.bincount(number, values, minlength=bins) / count
        share = np.bincount(number, hits, minlength=bins) / count
    bounds = np.arange(bins + 1) / bins
    return Reliability(bounds[:-1], bounds[1:], count, mean, share)


def draw_reliability(tables: Mapping[str, Reliability], path: Path | str) -> None:
    """Write a PNG of one or several tables: share right over mean confidence, and below how many there are.

    A reliable confidence lies on the diagonal; above it is too modest, below it too sure. Raises InputError if the
    file cannot be written.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(4.6, 5.6), layout="constrained")
    FigureCanvasAgg(figure)
    top, bottom = figure.subplots(2, 1, sharex=True, height_ratios=(3, 1))
    top.plot([0, 1], [0, 1], color="0.7", lw=1)
    for name, table in tables.items():
        held = table.count > 0
        (line,) = top.plot(
            table.confidence[held], table.share[held], "o-", ms=4, lw=1.3, label=f"{name}, {table.expected_error:.3f}"
        )
        bottom.stairs(table.count, np.append(table.low, table.high[-1:]), color=line.get_color())
    top.set_ylabel("share confirmed")
    bottom.set_ylabel("edge points")
    bottom.set_xlabel("confidence")
    top.set_xlim(0, 1)
    top.set_ylim(0, 1)
    if tables:
        top.legend(fontsize=8, frameon=False, loc="upper left", title="expected calibration error", title_fontsize=8)
    for axis in (top, bottom):
        axis.grid(alpha=0.3)
        axis.spines[["top", "right"]].set_visible(False)
    picture = io.BytesIO()
    figure.savefig(picture, format="png", dpi=130, metadata={"Software": None})
    write_whole(path, picture.getvalue())
