"""Write figures without global state of matplotlib; the figure of a result by round."""

from __future__ import annotations

import io
import math
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from p2o.draw.overlay import COLOURS
from p2o.errors import printable
from p2o.features.side import SIDES
from p2o.files.whole_file import write_whole
from p2o.results.figures import result_name, status_text
from p2o.results.result import DIRECTED, Result, Round

_PIXELS = "pixels"
_SIZE = (7.0, 4.6)
_LEGEND: dict[str, Any] = {"fontsize": 8, "frameon": False, "ncols": 4, "loc": "upper right"}


def convergence(result: Result, path: Path | str) -> None:
    """Write a PNG of matches, residual and cost by round, as the convergence figure of the paper.

    Matches are stacked by direction; rejected rounds are hollow. A cost in another unit than pixels has a separate
    axis, and residuals are left out if no round has any. Raises InputError if the file cannot be written.
    """
    from matplotlib.ticker import MaxNLocator

    figure, (top, bottom) = figure_with_panels(_SIZE, 2, sharex=True, height_ratios=(1, 1.2))
    rounds = result.rounds
    numbers = list(range(1, len(rounds) + 1))
    # Dollar signs in names are no formulas.
    top.set_title(f"{printable(result_name(result), 80)}: {status_text(result.status)}", fontsize=10, parse_math=False)

    floor = [0] * len(rounds)
    for side in SIDES:
        counts = [r.matches.get(side.letter, 0) for r in rounds]
        if any(counts):
            top.bar(numbers, counts, 0.7, floor, color=_face(side.letter), label=side.letter)
            floor = [a + b for a, b in zip(floor, counts, strict=True)]
    rest = [sum(r.matches.values()) - below for r, below in zip(rounds, floor, strict=True)]
    if any(rest):
        top.bar(numbers, rest, 0.7, floor, color="0.75", label="no direction")
    top.set_ylabel("matches")

    name, unit = _cost(result)
    residuals = [r.mean_residual for r in rounds]
    has_residuals = not rounds or any(map(math.isfinite, residuals))
    # Costs in another unit have a separate axis.
    side = bottom.twinx() if has_residuals and unit != _PIXELS else bottom
    if has_residuals:
        _curve(bottom, rounds, residuals, "black", "mean residual")
        bottom.set_ylabel(_PIXELS)
    _curve(side, rounds, [r.cost for r in rounds], "tab:purple", name)
    side.set_ylabel(unit)
    bottom.set_xlabel("round" if all(r.accepted for r in rounds) else "round (hollow: rejected)")
    bottom.xaxis.set_major_locator(MaxNLocator(integer=True))
    for axis in (top, bottom):
        axis.grid(axis="y", alpha=0.3)
        axis.spines[["top", "right"]].set_visible(False)
        if not rounds:
            axis.text(0.5, 0.5, "no rounds", ha="center", va="center", transform=axis.transAxes, color="0.5")
    if rounds:
        for axis in dict.fromkeys((top, bottom, side)):
            low, high = min(0.0, axis.get_ylim()[0]), axis.get_ylim()[1]
            axis.set_ylim(low, high + 0.25 * (high - low))  # room for the legend
        if top.get_legend_handles_labels()[0]:  # a method without matches has no curve there
            top.legend(**_LEGEND)
        lines = [line for axis in dict.fromkeys((bottom, side)) for line in axis.get_legend_handles_labels()[0]]
        bottom.legend(handles=lines, **_LEGEND)
    save_figure(figure, path)


def figure_with_panels(size: tuple[float, float], rows: int, columns: int = 1, **layout: Any) -> tuple[Any, Any]:
    """Return a figure of a size in inches and its panels."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=size, layout="constrained")
    FigureCanvasAgg(figure)
    return figure, figure.subplots(rows, columns, **layout)


def save_figure(figure: Any, path: Path | str) -> None:
    """Write a figure as PNG; raises InputError if the file cannot be written."""
    buffer = io.BytesIO()
    with warnings.catch_warnings():
        # Characters that the font lacks are drawn as boxes.
        warnings.filterwarnings("ignore", "Glyph", UserWarning)
        figure.savefig(buffer, format="png", dpi=130, metadata={"Software": None})
    write_whole(path, buffer.getvalue())


def _curve(axis: Any, rounds: Sequence[Round], values: Sequence[float], colour: str, label: str) -> None:
    """Draw one value per round, hollow for rejected rounds."""
    axis.plot(range(1, len(rounds) + 1), values, color=colour, lw=1.3, label=label)
    for kept in (True, False):
        at = [(n, v) for n, (v, r) in enumerate(zip(values, rounds, strict=True), 1) if r.accepted is kept]
        axis.plot(*zip(*at, strict=True) if at else ([], []), "o", ms=5, color=colour, mfc=colour if kept else "w")


def _cost(result: Result) -> tuple[str, str]:
    """Return the name of the cost of a round and its unit."""
    judged = result.judged
    if judged is None or judged.judge == DIRECTED:
        return "directed cost", _PIXELS
    return judged.judge, _PIXELS if judged.unit == "px" else judged.unit


def _face(letter: str) -> tuple[float, ...]:
    return tuple(c / 255 for c in COLOURS[letter])
