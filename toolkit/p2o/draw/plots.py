"""Write figures of results, trainings and shares, without global state of matplotlib."""

from __future__ import annotations

import csv
import io
import math
import warnings
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from p2o.arrays import Float
from p2o.draw.overlay import COLOURS
from p2o.errors import InputError, printable
from p2o.features.side import SIDES
from p2o.files.whole_file import write_whole
from p2o.results.figures import result_name, status_text
from p2o.results.result import DIRECTED, Result, Round

_PIXELS = "pixels"
_SIZE = (7.0, 4.6)
_MAPS_IN_ROW = 4
_LEGEND: dict[str, Any] = {"fontsize": 8, "frameon": False, "ncols": 4, "loc": "upper right"}


def convergence(result: Result, path: Path | str) -> None:
    """Write a PNG of matches, residual and cost by round, as the convergence figure of the paper.

    Matches are stacked by direction; rejected rounds are hollow. A cost in another unit than pixels has a separate
    axis, and residuals are left out if no round has any. Raises InputError if the file cannot be written.
    """
    from matplotlib.ticker import MaxNLocator

    figure, (top, bottom) = _figure(_SIZE, 2, sharex=True, height_ratios=(1, 1.2))
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
    _save(figure, path)


def _figure(size: tuple[float, float], rows: int, columns: int = 1, **layout: Any) -> tuple[Any, Any]:
    """Return a figure of a size in inches and its panels."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=size, layout="constrained")
    FigureCanvasAgg(figure)
    return figure, figure.subplots(rows, columns, **layout)


def _save(figure: Any, path: Path | str) -> None:
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


def learning_curves(log: Path, path: Path | str) -> None:
    """Write a PNG of a training's log: a CSV file with columns step, loss, validation (may be empty), learning_rate.

    Raises InputError if the log is invalid or the figure cannot be written.
    """
    try:
        with log.open(newline="", encoding="utf-8") as file:
            rows = list(csv.DictReader(file))
        columns = {
            name: [(int(row["step"]), float(row[name])) for row in rows if row[name]]
            for name in ("loss", "validation", "learning_rate")
        }
    except (OSError, ValueError, KeyError, TypeError) as problem:
        raise InputError(
            "the log of a training cannot be read",
            where=log,
            expected="columns step, loss, validation, learning_rate",
            got=problem,
        ) from problem
    figure, (top, bottom) = _figure(_SIZE, 2, sharex=True, height_ratios=(2, 1))
    for name, colour, label in (("loss", "tab:blue", "training"), ("validation", "tab:orange", "held out")):
        if columns[name]:
            top.plot(*zip(*columns[name], strict=True), "o-", ms=3, lw=1.3, color=colour, label=label)
    if columns["learning_rate"]:
        bottom.plot(*zip(*columns["learning_rate"], strict=True), lw=1.3, color="0.4")
    top.set_ylabel("loss")
    bottom.set_ylabel("learning rate")
    bottom.set_xlabel("step")
    for axis in (top, bottom):
        axis.grid(axis="y", alpha=0.3)
        axis.spines[["top", "right"]].set_visible(False)
        axis.set_ylim(bottom=0)
    if any(columns[name] for name in ("loss", "validation")):
        top.legend(fontsize=8, frameon=False)
    _save(figure, path)


def heat_maps(
    shares: Mapping[str, Float],
    rows: Sequence[float],
    columns: Sequence[float],
    path: Path | str,
    *,
    row_label: str,
    column_label: str,
    title: str = "",
) -> None:
    """Write a PNG of one heat map for each name: shares (R, C) from 0 to 1 over sizes `rows` (R,) and `columns` (C,).

    Cells without a share (NaN) are empty. Raises InputError if the file cannot be written.
    """
    across = min(_MAPS_IN_ROW, len(shares))
    down = -(-len(shares) // across)
    size = (1.6 + across * (0.9 + 0.55 * len(columns)), 1.2 + down * (0.9 + 0.45 * len(rows)))
    figure, panels = _figure(size, down, across, squeeze=False)
    axes = panels.ravel()
    for axis, (name, values) in zip(axes, shares.items(), strict=False):
        axis.imshow(values, vmin=0, vmax=1, cmap="viridis", origin="lower", aspect="auto")
        for i, j in np.ndindex(values.shape):
            if np.isfinite(values[i, j]):
                dark = values[i, j] < 0.6
                text = f"{100 * values[i, j]:.0f}"
                axis.text(j, i, text, ha="center", va="center", fontsize=8, color="w" if dark else "k")
        axis.set_xticks(range(len(columns)), [f"{x:g}" for x in columns], fontsize=8)
        axis.set_yticks(range(len(rows)), [f"{x:g}" for x in rows], fontsize=8)
        axis.set_title(name.replace("$", r"\$"), fontsize=10)
        axis.set_xlabel(column_label, fontsize=8)
        axis.set_ylabel(row_label, fontsize=8)
    for axis in axes[len(shares) :]:
        axis.set_visible(False)
    if title:
        figure.suptitle(title, fontsize=11)
    _save(figure, path)
