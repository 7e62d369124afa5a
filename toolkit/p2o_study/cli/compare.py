"""`p2o compare`: rank methods on frames without ground truth."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Any

import click
from p2o.cli import INTERRUPTED
from p2o.cli.completion import complete_methods
from p2o.cli.json_output import json_option, print_json
from p2o.cli.plugin_options import data_argument, plugin_options
from p2o.cli.pose_options import StartCommand

from p2o_study.cli.ablate import at_most_option, jobs_option, session_words

_option = partial(click.option, show_default=True)


@click.command("compare", cls=StartCommand)
@data_argument("The data.")
@click.option(
    "--methods",
    required=True,
    metavar="NAME,...",
    shell_complete=complete_methods("calibrator", "matcher", published=True, many=True),
    help="The methods: ours,ours-without-prior,nid,gmm,...",
)
@_option("--frames", default="all", metavar="SPEC", help="Which frames, as in `p2o run`.")
@_option("--groups", default=6, metavar="N", help="Number of disjoint groups of frames.")
@_option("--seeds", default="3", metavar="N|LIST", help="Initial guesses for each group.")
@click.option("--start", metavar='FILE | roughly "WORDS"', help="The initial guess, if the data have none.")
@_option(
    "--perturb", default="1deg 0.1m", metavar="SIZE", help="Distance of the initial guesses from it, random directions."
)
@at_most_option
@_option("--out", default="p2o-out/compare", metavar="DIR", help="Folder of rows and page.")
@jobs_option
@json_option
@click.option("--quiet", is_flag=True, help="No progress.")
@plugin_options
def command(
    data: str,
    methods: str,
    seeds: str,
    out: str,
    jobs: int,
    as_json: bool,
    quiet: bool,
    plugin: tuple[str, ...],
    block: tuple[str, ...],
    **words: Any,
) -> int:
    """Compare methods on your frames without ground truth.

    Each method calibrates disjoint groups of frames from several initial guesses. It is ranked by the spread of its
    poses, by their cost on the other groups, and by their distance from methods of other families. Methods that cannot
    be distinguished from the best at 95 % form the top group. Interrupted, it ranks what is finished; started again, it
    continues with the missing rows. Writes compare.html, compare.json and the rows (JSON lines) to DIR.

    \b
    p2o compare kitti-raw:PATH --frames 0-23 --methods ours,nid,gmm
    p2o compare folder:PATH --start extrinsic.yaml --methods ours,hand-eye --groups 5

    Exit status 1 if a calibration crashed or a method gives no estimate, 2 for wrong input, 130 if interrupted.
    """  # noqa: D301  (click wants a real backspace: the examples keep their lines)
    from p2o.files.whole_file import write_json, write_whole

    from p2o_study.ablate import parse_seeds
    from p2o_study.compare import compare, contenders_of
    from p2o_study.parallel import Workers
    from p2o_study.report.comparison_page import comparison_page, comparison_text
    from p2o_study.worker import Plugins

    plugins = Plugins.of(block, plugin)
    contenders = contenders_of([name.strip() for name in methods.split(",")], plugins.registry())
    with session_words(plugins, Workers(jobs, isolate=None), quiet or as_json) as session:
        done, comparison = compare(contenders, data, out, seeds=parse_seeds(seeds), **words, **session)
    if done.interrupted or done.missing:
        click.echo(f"p2o: interrupted; {len(done.rows)} rows are kept in {out}; the same command continues", err=True)
    if comparison is None:
        return INTERRUPTED
    plain = comparison.as_dict()
    write_json(Path(out) / "compare.json", plain)
    write_whole(Path(out) / "compare.html", comparison_page(comparison).encode())
    if as_json:
        print_json(plain)
    else:
        click.echo(comparison_text(comparison), nl=False)
        click.echo(f"wrote {Path(out) / 'compare.html'}; single calibrations: p2o report {out}")
    if comparison.interrupted:
        return INTERRUPTED
    crashed = any(outcome.crashed for outcome in comparison.outcomes.values())
    return 1 if crashed or comparison.unranked else 0
