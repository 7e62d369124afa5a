"""Figures of shares over two sizes, one heat map for each name."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from p2o.arrays import Float
from p2o.page.figure import figure_with_panels, save_figure

_MAPS_IN_ROW = 4


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
    figure, panels = figure_with_panels(size, down, across, squeeze=False)
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
    save_figure(figure, path)
