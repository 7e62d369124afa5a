"""`p2o basin`: the basin of attraction of methods, as heat maps."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Any

import click
from p2o.cli import INTERRUPTED
from p2o.cli.plugin_options import plugin_options
from p2o.errors import InputError

from p2o_study.cli.ablate import at_most_option, jobs_option, session_words

_option = partial(click.option, show_default=True)


@click.command("basin")
@click.argument("methods", nargs=-1, required=True, metavar="METHOD...")
@_option("--data", default="synthetic:", metavar="DATASET:PATH", help="The data.")
@_option("--frames", default="all", metavar="SPEC", help="Which frames, as in `p2o run`.")
@_option("--rotations", default="0.5,1,2,4,8", metavar="DEG,...", help="Rotation errors of the initial guess.")
@_option("--translations", default="0.05,0.15,0.3,0.6", metavar="M,...", help="Translation errors of initial guesses.")
@_option("--seeds", default=1, type=click.IntRange(1, 1000), help="Initial guesses per size and frame.")
@_option("--within", default="0.5deg 0.2m", metavar="SIZE", help="Maximum error of a success.")
@at_most_option
@click.option("--joint", is_flag=True, help="Calibrate all frames jointly.")
@click.option("--study", metavar="STUDY", help="METHOD may be a label of a row of this study, with its options.")
@_option("--out", default="p2o-out/basin", metavar="DIR", help="Folder of rows and results.")
@jobs_option
@click.option("--quiet", is_flag=True, help="No progress.")
@plugin_options
def command(
    methods: tuple[str, ...],
    rotations: str,
    translations: str,
    within: str,
    at_most: int | None,
    study: str | None,
    out: str,
    jobs: int,
    quiet: bool,
    plugin: tuple[str, ...],
    block: tuple[str, ...],
    **words: Any,
) -> int:
    """Measure the share of successes over rotation and translation errors of the initial guess.

    METHOD is a published method (`p2o methods`), a calibrator, a matcher, or the label of a row of --study.
    Started again, it continues with the missing rows. Writes basin.png, basin.json and the rows (JSON lines) to DIR.
    """
    from p2o.files.whole_file import write_json
    from p2o.geometry.perturb import parse_perturbation

    from p2o_study.ablate import ablate
    from p2o_study.basin import Grid, basin_of, basin_study, contender_of, heat_maps
    from p2o_study.parallel import Workers
    from p2o_study.study import find_study
    from p2o_study.worker import Plugins

    plugins = Plugins.of(block, plugin)
    registry = plugins.registry()
    limits = parse_perturbation(within, "--within")
    grid = Grid(_sizes("--rotations", rotations), _sizes("--translations", translations), limits)
    known_study = None if study is None else find_study(study, registry)
    contenders = [contender_of(name, known_study, registry) for name in dict.fromkeys(methods)]
    file = basin_study(contenders, grid, **words)
    with session_words(plugins, Workers(jobs, isolate=None), quiet) as session:
        done = ablate(file, out, at_most=at_most, **session)
    basins = [basin_of(contender, grid, done.rows) for contender in contenders]
    for basin in basins:
        click.echo(_table(basin, grid))
    sizes = {"rotations_deg": grid.rotations_deg, "translations_m": grid.translations_m, "within": str(grid.within)}
    report = {**sizes, **words, "methods": [basin.as_dict() for basin in basins]}
    write_json(Path(out) / "basin.json", report)
    heat_maps(basins, grid, Path(out) / "basin.png")
    return INTERRUPTED if done.interrupted else 0


def _sizes(where: str, text: str) -> tuple[float, ...]:
    try:
        return tuple(float(part) for part in text.split(","))
    except ValueError as problem:
        raise InputError("cannot read the sizes", where=where, expected="numbers such as 1,2,5", got=text) from problem


def _table(basin: Any, grid: Any) -> str:
    """Return the shares of successes in percent: a line per rotation, a column per translation."""
    head = f"{basin.name}: % within {grid.within} of {int(basin.count.max())} calibrations each"
    lines = [head, "  deg \\ m" + "".join(f"{size:>7g}" for size in grid.translations_m)]
    for angle, row in zip(grid.rotations_deg, basin.success, strict=True):
        shares = ("-" if share != share else f"{100 * share:.0f}" for share in row)
        lines.append(f"  {angle:>7g}" + "".join(f"{share:>7}" for share in shares))
    return "\n".join(lines)
