"""Figures of basins of attraction, one heat map for each method."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from p2o.page.figure import figure_with_panels, save_figure

from p2o_study.basin import Basin, Grid

_MAPS_IN_ROW = 4


def heat_maps(basins: Sequence[Basin], grid: Grid, path: Path) -> None:
    """Write a PNG of the shares of successes (R, T) of basins; cells without a share (NaN) are empty.

    Raises InputError if the file cannot be written.
    """
    rows, columns = grid.rotations_deg, grid.translations_m
    across = min(_MAPS_IN_ROW, len(basins))
    down = -(-len(basins) // across)
    size = (1.6 + across * (0.9 + 0.55 * len(columns)), 1.2 + down * (0.9 + 0.45 * len(rows)))
    figure, panels = figure_with_panels(size, down, across, squeeze=False)
    axes = panels.ravel()
    for axis, basin in zip(axes, basins, strict=False):
        axis.imshow(basin.success, vmin=0, vmax=1, cmap="viridis", origin="lower", aspect="auto")
        for (i, j), share in np.ndenumerate(basin.success):
            if np.isfinite(share):
                colour = "w" if share < 0.6 else "k"
                axis.text(j, i, f"{100 * share:.0f}", ha="center", va="center", fontsize=8, color=colour)
        axis.set_xticks(range(len(columns)), [f"{x:g}" for x in columns], fontsize=8)
        axis.set_yticks(range(len(rows)), [f"{x:g}" for x in rows], fontsize=8)
        axis.set_title(basin.name.replace("$", r"\$"), fontsize=10)
        axis.set_xlabel("translation, m", fontsize=8)
        axis.set_ylabel("rotation error of the initial guess, deg", fontsize=8)
    for axis in axes[len(basins) :]:
        axis.set_visible(False)
    figure.suptitle(f"% of calibrations that end within {grid.within}", fontsize=11)
    save_figure(figure, path)
