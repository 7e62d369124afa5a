"""`p2o basin`: from how far away methods still find their way, as heat maps."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import click

from p2o.cli.plugin_options import plugin_options
from p2o.errors import InputError

_ROTATIONS = "0.5,1,2,4,8"
_TRANSLATIONS = "0.05,0.15,0.3,0.6"


@click.command("basin")
@click.argument("methods", nargs=-1, required=True, metavar="METHOD...")
@click.option("--data", default="synthetic:", show_default=True, metavar="DATASET:PATH", help="Frames to try them on.")
@click.option("--frames", default="all", show_default=True, metavar="SPEC", help="Which frames, as in `p2o run`.")
@click.option("--rotations", default=_ROTATIONS, show_default=True, metavar="DEG,...", help="Sizes of wrong starts.")
@click.option("--translations", default=_TRANSLATIONS, show_default=True, metavar="M,...", help="The same in metres.")
@click.option(
    "--seeds", default=1, show_default=True, type=click.IntRange(1, 1000), help="Starts of each size a frame."
)
@click.option("--within", default="0.5deg 0.2m", show_default=True, metavar="SIZE", help="What counts as arrived.")
@click.option(
    "--at-most",
    type=click.IntRange(min=1),
    metavar="N",
    help="So many calibrations are meant, where they are over 100,000.",
)
@click.option("--joint", is_flag=True, help="All frames together.")
@click.option("--study", metavar="STUDY", help="METHODs may be labels of this study's rows, with their options.")
@click.option("--out", default="p2o-out/basin", show_default=True, metavar="DIR", help="Keep rows and write here.")
@click.option("--jobs", type=click.IntRange(min=1), default=1, show_default=True, metavar="N", help="Processes to use.")
@click.option("--quiet", is_flag=True, help="No progress.")
@plugin_options
def command(
    methods: tuple[str, ...],
    data: str,
    frames: str,
    rotations: str,
    translations: str,
    seeds: int,
    within: str,
    at_most: int | None,
    joint: bool,
    study: str | None,
    out: str,
    jobs: int,
    quiet: bool,
    plugin: tuple[str, ...],
    block: tuple[str, ...],
) -> int:
    """Show which wrong starts methods still correct: shares of successes over rotation and translation of the start.

    METHOD is a matcher (with the extractors and the solver that its example names), a calibrator, or the label of a row
    of --study. Started again, it goes on where it was. DIR gets basin.png, basin.json and the rows (study.sqlite).
    """
    from p2o.cli.ablate import progress_shown
    from p2o.draw.heat_maps import heat_maps
    from p2o.files.whole_file import write_whole
    from p2o.geometry.perturb import parse_perturbation
    from p2o.study.ablate import MOST_CALIBRATIONS, ablate
    from p2o.study.basin import Contender, Grid, basin_of, basin_study
    from p2o.study.study import find_study
    from p2o.study.worker import Plugins
    from p2o.work.parallel import Workers

    plugins = Plugins.of(block, plugin)
    registry = plugins.registry()
    grid = Grid(
        _sizes("--rotations", rotations),
        _sizes("--translations", translations),
        parse_perturbation(within, "--within"),
    )
    found = None if study is None else find_study(study, registry).study
    contenders = [Contender.of(name, found, registry) for name in dict.fromkeys(methods)]
    most, count = MOST_CALIBRATIONS if at_most is None else at_most, len(contenders) * len(grid.cells) * seeds
    if count > most:
        raise InputError(
            "too many calibrations",
            where="p2o basin",
            expected=f"at most {most}",
            got=f"{count} for each frame",
            hint="ask for fewer sizes, methods or seeds, or say that so many are meant: --at-most N",
        )
    file = basin_study(contenders, grid, data, frames, seeds, joint)
    with progress_shown(quiet) as (say, warn):
        done = ablate(
            file, out, plugins=plugins, workers=Workers(jobs), at_most=at_most, on_progress=say, on_warning=warn
        )
    basins = [basin_of(contender, grid, done.rows) for contender in contenders]
    for basin in basins:
        click.echo(_table(basin, grid))
    told: dict[str, Any] = {
        "rotations_deg": grid.rotations_deg,
        "translations_m": grid.translations_m,
        "within": str(grid.within),
        "data": data,
        "frames": frames,
        "seeds": seeds,
        "joint": joint,
        "methods": [basin.as_dict() for basin in basins],
    }
    write_whole(Path(out) / "basin.json", (json.dumps(told, indent=1, allow_nan=False) + "\n").encode())
    heat_maps(
        {basin.name: basin.success for basin in basins},
        grid.rotations_deg,
        grid.translations_m,
        Path(out) / "basin.png",
        row_label="rotation of the start, deg",
        column_label="translation, m",
        title=f"% of starts that end within {grid.within}",
    )
    return 130 if done.interrupted else 0


def _sizes(where: str, text: str) -> tuple[float, ...]:
    try:
        return tuple(float(part) for part in text.split(","))
    except ValueError as problem:
        raise InputError("cannot read the sizes", where=where, expected="numbers such as 1,2,5", got=text) from problem


def _table(basin: Any, grid: Any) -> str:
    """Return the shares of successes in percent: a line for each rotation, a column for each translation."""
    head = f"{basin.name}: % within {grid.within} of {int(basin.count.max())} starts each"
    lines = [head, "  deg \\ m" + "".join(f"{size:>7g}" for size in grid.translations_m)]
    for angle, row in zip(grid.rotations_deg, basin.success, strict=True):
        lines.append(
            f"  {angle:>7g}" + "".join("      -" if share != share else f"{100 * share:>7.0f}" for share in row)
        )
    return "\n".join(lines)
