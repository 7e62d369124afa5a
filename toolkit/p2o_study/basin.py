"""Measure the basin of attraction of methods: the share of successes over rotation and translation of the start error.

A basin is a study whose rows are methods x sizes of the start error; it is stored and resumed as a study.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np
from p2o.arrays import Float
from p2o.errors import InputError
from p2o.geometry.perturb import Perturbation
from p2o.host.registry import Registry
from p2o.host.slots import METHOD_WORDS
from p2o.results.verdict import Trust
from p2o.run.presets import Preset, preset_of

from p2o_study.row import Row
from p2o_study.statistics import by_label, is_within
from p2o_study.study import Study, study_of

_MAPS_IN_ROW = 4


def contender_of(text: str, study: Study | None, registry: Registry) -> Preset:
    """Return the method named `text`: a row of the study, else as `preset_of`. Raises UnknownNameError."""
    rows = {} if study is None else {row.label: row for row in study.rows()}
    if text not in rows:
        hint = "name a published method, a calibrator, a matcher or a row of --study"
        return preset_of(text, registry, None, rows, hint)
    words = {word: value for word, value in rows[text].words.items() if word in (*METHOD_WORDS, "accumulate")}
    return Preset(text, words, rows[text].words.get("options", {}))


@dataclass(frozen=True)
class Grid:
    """The sizes of start errors, and the maximum final error of a success.

    Raises InputError for no sizes, equal sizes and sizes outside 0 to 180.
    """

    rotations_deg: tuple[float, ...]
    translations_m: tuple[float, ...]
    within: Perturbation

    def __post_init__(self) -> None:
        for field in fields(self)[:2]:
            sizes = getattr(self, field.name)
            if not sizes or len(set(sizes)) < len(sizes) or not all(0 <= size <= 180 for size in sizes):
                raise InputError(
                    "the sizes of start errors form no grid",
                    where=field.name,
                    expected="different numbers from 0 to 180",
                    got=" ".join(f"{size:g}" for size in sizes) or "none",
                )

    @property
    def cells(self) -> list[Perturbation]:
        """The start errors, ordered by rotation, then by translation."""
        return [Perturbation(a, d) for a, d in itertools.product(self.rotations_deg, self.translations_m)]


def basin_study(
    contenders: Sequence[Preset], grid: Grid, data: str, frames: str, seeds: int, joint: int | bool
) -> Study:
    """Return the study of a basin: one row for each method and size of the start error, named by `label`."""
    rows = [
        {"label": label(contender, cell), "section": contender.name, **contender.words, "perturb": str(cell)}
        | ({"options": contender.options} if contender.options else {})
        for contender, cell in itertools.product(contenders, grid.cells)
    ]
    content = {"name": "basin", "title": "Basins of attraction", "seeds": seeds, "joint": joint, "row": rows}
    return study_of({**content, "dataset": [{"name": "data", "data": data, "frames": frames}]}, "basin")


def label(contender: Preset, cell: Perturbation) -> str:
    """Return the label of the row of a method and a size of the start error."""
    return f"{contender.name} from {cell}"


@dataclass(frozen=True, eq=False)
class Basin:
    """The basin of one method: shares of calibrations (R, T) over rotation and translation of the start error.

    `success` is the share that ended within the limits of the grid, `refused` the share without an estimate,
    `deceived` the share of false accepts (trusted, but outside the limits). `count` is the number of calibrations;
    shares are NaN where it is 0.
    """

    name: str
    success: Float
    refused: Float
    deceived: Float
    count: Float

    def as_dict(self) -> dict[str, Any]:
        """Return the shares as lists, for JSON; NaN becomes null."""
        shares = {name: value for name, value in vars(self).items() if name != "name"}
        plain = {k: [[None if np.isnan(x) else float(x) for x in row] for row in v] for k, v in shares.items()}
        return {"name": self.name, **plain}


def basin_of(contender: Preset, grid: Grid, rows: Sequence[Row]) -> Basin:
    """Return the basin of one method from the finished rows of the study."""
    known = by_label(rows)
    shape = (len(grid.rotations_deg), len(grid.translations_m))
    shares_of_cells = []
    for cell in grid.cells:
        runs = known.get(label(contender, cell), [])
        arrived = [is_within(row, grid.within) for row in runs]
        wrong = [row.trust is Trust.TRUSTED and not good for row, good in zip(runs, arrived, strict=True)]
        count = len(runs)
        shares = (sum(arrived), sum(not row.solved for row in runs), sum(wrong))
        shares_of_cells.append([*(x / count if count else np.nan for x in shares), count])
    table = np.array(shares_of_cells, dtype=np.float64).T.reshape(4, *shape)
    return Basin(contender.name, *table)


def heat_maps(basins: Sequence[Basin], grid: Grid, path: Path) -> None:
    """Write a PNG of the shares of successes (R, T) of basins; cells without a share (NaN) are empty.

    Raises InputError if the file cannot be written.
    """
    from p2o.page.figure import figure_with_panels, save_figure

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
