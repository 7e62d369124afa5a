"""The figure of a training: loss and learning rate by step."""

from __future__ import annotations

import csv
from pathlib import Path

from p2o.errors import InputError
from p2o.page.figure import figure_with_panels, save_figure

_SIZE = (7.0, 4.6)


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
    figure, (top, bottom) = figure_with_panels(_SIZE, 2, sharex=True, height_ratios=(2, 1))
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
    save_figure(figure, path)
