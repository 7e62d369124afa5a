"""`p2o run`: words to a recipe, a recipe to a run, a run to text, JSON and files."""

from __future__ import annotations

import contextlib
import json
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from p2o.cli.plugin_options import load, plugin_options
from p2o.errors import InputError

if TYPE_CHECKING:
    from p2o.geometry.perturb import Perturbation
    from p2o.results.result import Result
    from p2o.run.run import Progress, Row

_PLACE = "{frame}"


@click.command("run")
@click.option("--data", metavar="DATASET:PATH", help="What to calibrate (default: a synthetic scene, synthetic:).")
@click.option(
    "--frames", metavar="SPEC", help="all, indices and ranges (0,4-7), @splits.json#test, or names (default: all)."
)
@click.option("--extractor", metavar="IMAGE/CLOUD", help="The two extractors (default: p2ornet/rings).")
@click.option("--matcher", metavar="NAME", help="How points and lines are paired (default: ogm).")
@click.option("--solver", metavar="NAME", help="How the pose is improved (default: lm).")
@click.option("--init", metavar="NAME", help="How starting poses are found (default: search).")
@click.option("--calibrator", metavar="NAME", help="A whole method instead of extractor, matcher, solver and init.")
@click.option(
    "--set", "settings", multiple=True, metavar="STAGE.FIELD=VALUE", help="An option (`p2o methods NAME` lists them)."
)
@click.option("--accumulate", metavar="NAME", help="Join sweeps of a sequence with this method.")
@click.option(
    "--witness",
    metavar="IMAGE/CLOUD",
    help="Extractors whose edges check a result that has none of its own (default: p2ornet/rings; none: unchecked).",
)
@click.option("--perturb", metavar='"2deg 0.15m"', help="Begin this far from the truth, in a random direction.")
@click.option("--seed", type=click.IntRange(min=0), metavar="N", help="Seed of everything random (default: 0).")
@click.option("--joint", is_flag=True, default=None, help="One result for all frames together.")
@click.option(
    "--require",
    metavar='"[trusted] [0.3deg 0.1m]"',
    help="Exit status 1 unless every result is trusted and, where a size is said, likely to be this accurate.",
)
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object and nothing else on stdout.")
@click.option("--out", type=click.Path(), metavar="DIR", help="Write result JSON, overlays and convergence plots here.")
@click.option("--export", "exports", multiple=True, metavar="NAME:PATH", help="Write the result in another format.")
@plugin_options
def command(
    settings: tuple[str, ...],
    require: str | None,
    as_json: bool,
    out: str | None,
    exports: tuple[str, ...],
    plugin: tuple[str, ...],
    block: tuple[str, ...],
    **words: Any,
) -> int:
    """Calibrate frames: find the transform from the LiDAR to the camera.

    \b
    p2o run                                            a synthetic scene
    p2o run --data kitti-raw:PATH --perturb "2deg 0.15m" --seed 1
    p2o run --data kitti-raw:PATH --frames @splits.json#test --joint --out out

    Where there are several results, PATH of --export holds {frame}. Exit status 1 where any calibration was refused
    (its status says why) or is not as required.
    """  # noqa: D301  (click wants a real backspace: the examples keep their lines)
    with _stdout_kept_for_json(as_json) as stdout:
        from p2o.cli.out_dir import OutDir
        from p2o.cli.summary import describe, describe_run
        from p2o.files.file_names import folder_name
        from p2o.run.recipe import Recipe, open_exporter
        from p2o.run.run import Run, run
        from p2o.run.words import parse_settings

        registry = load(plugin, block)
        wanted = None if require is None else Required.of(require)
        words = {name: value for name, value in words.items() if value is not None}
        if settings:
            words["options"] = parse_settings(settings)
        plan = Recipe.of(**words).resolve(registry)
        folder = None if out is None else OutDir.prepared(out)
        writers = [open_exporter(text, registry) for text in exports]
        rows: list[Row] = []

        def noted(progress: Progress) -> None:
            if progress.row is None:
                shown(progress)
                if progress.total > 1:
                    _require_places(exports)
                return
            rows.append(progress.row)
            if folder is not None:
                folder.write(progress)
            for writer, path in writers:
                writer(progress.row.result, Path(str(path).replace(_PLACE, folder_name(progress.frames[0].name))))
            if not as_json:
                stdout.write(describe(progress.row) + "\n")

        interrupted = False
        with _progress() as shown:
            try:
                run(plan, on_progress=noted)
            except KeyboardInterrupt:
                interrupted = True
                click.echo(f"p2o: interrupted; {len(rows)} finished calibrations are kept", err=True)
        done = Run(tuple(rows), joint=plan.recipe.joint, interrupted=interrupted)
        if folder is not None:
            folder.finish(done)
    if as_json:
        stdout.write(json.dumps(done.as_dict(), allow_nan=False) + "\n")
    elif len(rows) > 1:
        stdout.write(describe_run(done) + "\n")
    if interrupted:
        return 130
    short = [] if wanted is None else wanted.unmet([row.result for row in done.rows])
    for line in short:
        click.echo(f"p2o: {line}, as --require asks", err=True)
    return 0 if done.solved and not short else 1


@dataclass(frozen=True)
class Required:
    """What results have to be: trusted, and where `bound` says so likely to have no larger error."""

    bound: Perturbation | None

    @classmethod
    def of(cls, text: str) -> Required:
        """Return what a text asks for; raises InputError unless it states both parts of an accuracy, or none."""
        from p2o.geometry.perturb import parse_perturbation
        from p2o.results.verdict import Trust

        word, _, rest = text.strip().partition(" ")
        size = rest if word == Trust.TRUSTED else text
        if not size.strip() and word == Trust.TRUSTED:
            return cls(None)
        bound = parse_perturbation(size, "--require")
        if not bound.exact or not (bound.angle_deg > 0 and bound.distance_m > 0):
            raise InputError(
                "an accuracy has two parts",
                where="--require",
                expected='"trusted", or an angle and a length, "0.3deg 0.1m"',
                got=repr(text),
            )
        return cls(bound)

    def unmet(self, results: Sequence[Result]) -> list[str]:
        """Return a line for each way in which results fall short."""
        doubted = sum(not result.verdict.trusted for result in results)
        lines = [_of(doubted, len(results), "is not trusted", "are not trusted")] if doubted else []
        if self.bound is not None:
            size = self.bound.angle_deg, self.bound.distance_m
            wide = sum(result.verdict.trusted and not result.reaches(*size) for result in results)
            words = (f"{verb} not reach {self.bound}" for verb in ("does", "do"))
            lines += [_of(wide, len(results), *words)] if wide else []
        return lines


def _of(some: int, many: int, one: str, several: str) -> str:
    """Return how many results this is said of."""
    return f"{some} of {many} results {several}" if many > 1 else f"the result {one}"


def _require_places(exports: Sequence[str]) -> None:
    """Raise InputError where several results would be written to one file."""
    for text in exports:
        if _PLACE not in text:
            raise InputError(
                "several results do not fit in one file",
                where="--export",
                expected=f"a path with {_PLACE} in it, or --joint",
                got=text,
            )


@contextlib.contextmanager
def _stdout_kept_for_json(wanted: bool) -> Iterator[Any]:
    """Yield stdout; while it is kept for JSON, whatever a plugin prints goes to stderr."""
    stdout = sys.stdout
    with contextlib.redirect_stdout(sys.stderr) if wanted else contextlib.nullcontext():
        yield stdout


@contextlib.contextmanager
def _progress() -> Iterator[Any]:
    """Yield what shows progress: a line on stderr when it is a terminal, nothing otherwise."""
    if not sys.stderr.isatty():
        yield lambda progress: None
        return
    from rich.console import Console

    with Console(stderr=True).status("starting") as status:
        yield lambda p: status.update(f"{p.done + 1} of {p.total}: {p.name}")
