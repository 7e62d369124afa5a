"""`p2o run`: words to a recipe, a recipe to a run, a run to text, JSON and files."""

from __future__ import annotations

import contextlib
import json
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import click

from p2o.cli.plugin_options import load, plugin_options
from p2o.errors import InputError, P2OError, printable

if TYPE_CHECKING:
    from p2o.cli.exports import Export
    from p2o.cli.out_dir import OutDir
    from p2o.geometry.perturb import Perturbation
    from p2o.results.result import Result
    from p2o.results.rig import RigResult
    from p2o.run.run import FailedFrame, Progress, Row


class _Run(click.Command):
    """The command, which takes `--start roughly "WORDS"` in two words, and `--start FILE` in one."""

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        joined: list[str] = []
        for word in args:
            if joined[-2:] == ["--start", "roughly"]:
                joined[-1] = f"roughly {word}"
            else:
                joined.append(word)
        return super().parse_args(ctx, joined)


@click.command("run", cls=_Run)
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
@click.option(
    "--perturb",
    metavar='"2deg 0.15m"',
    help="Begin this far from the truth, in a random direction; @FILE takes the errors from a list.",
)
@click.option(
    "--start",
    metavar='roughly "x forward, z up; camera looks forward" | FILE',
    help="Begin at a pose told in words: two axes of the LiDAR, where the camera looks, and where it is if known; "
    "or at that of a calibration file (the forms of `p2o convert`).",
)
@click.option("--protocol", metavar="NAME", help="Draw starts, and report errors, as a publication does.")
@click.option("--seed", type=click.IntRange(min=0), metavar="N", help="Seed of everything random (default: 0).")
@click.option("--joint", is_flag=True, default=None, help="One result for all frames together.")
@click.option(
    "--rig",
    is_flag=False,
    flag_value=True,
    type=click.UNPROCESSED,
    metavar="[FILE]",
    help="One result for each camera, of all its frames; FILE (YAML, JSON) says which are whose, and where it is.",
)
@click.option(
    "--require",
    metavar='"[trusted] [0.3deg 0.1m]"',
    help="Exit status 1 unless every result is trusted and, where a size is said, likely to be this accurate.",
)
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object and nothing else on stdout.")
@click.option(
    "--out",
    type=click.Path(),
    metavar="DIR",
    help="Write a page (result.html), result JSON, overlays and convergence plots here.",
)
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
    p2o run --data folder:PATH --rig rig.yaml
    p2o run --data folder:PATH --start roughly "x forward, z up; camera looks 45 deg left"

    Where there are several results, PATH of --export holds {frame}, or {camera} with --rig. Exit status 1 where any
    calibration was refused (its status says why) or is not as required: a doubtful or ambiguous one counts as solved
    unless --require trusted is said. 2 where a frame cannot be read: it is listed with its reason, after the results of
    the others.
    """  # noqa: D301  (click wants a real backspace: the examples keep their lines)
    with _stdout_kept_for_json(as_json) as stdout:
        from p2o.cli.exports import Export, check_apart
        from p2o.cli.summary import describe, describe_failed, describe_rig, describe_run
        from p2o.files.file_names import distinct_names
        from p2o.run.protocol import protocol_of
        from p2o.run.recipe import Recipe
        from p2o.run.run import Run, run, starts_of
        from p2o.run.words import parse_settings

        registry = load(plugin, block)
        wanted = None if require is None else Required.of(require)
        words = {name: value for name, value in words.items() if value is not None}
        protocol = words.pop("protocol", None)
        if protocol is not None:
            words["perturb"] = starts_of(protocol, words.get("perturb"), "--protocol")
        if settings:
            words["options"] = parse_settings(settings)
        plan = Recipe.of(**words).resolve(registry)
        folder: OutDir | None = None
        if out is not None:
            # Imported here: pictures and pages take longer to load than the rest, and most runs draw none.
            from p2o.cli.out_dir import OutDir

            folder = OutDir.prepared(out)
        writers = [Export.of(text, registry) for text in exports]
        rows: list[Row] = []
        failed: list[FailedFrame] = []

        def planned(names: Sequence[str], cameras: Sequence[str]) -> None:
            """Fix the files of all frames before any work: no two are one, and none is found wrong at the end."""
            nonlocal folder, writers
            # A camera and its only frame may have one name, and then share a folder.
            if folder is not None:
                folder = folder.for_frames(list(dict.fromkeys([*cameras, *names])))
            named = cameras or (names[:1] if plan.recipe.joint else names)
            files = distinct_names(cameras or names)
            place = "{camera}" if cameras else "{frame}"
            writers = [writer.for_frames({name: files[name] for name in named}, place) for writer in writers]
            check_apart(writers, [] if folder is None else folder.files)

        def noted(progress: Progress) -> None:
            if progress.failed is not None:
                failed.append(progress.failed)
                if not as_json:
                    stdout.write(describe_failed(progress.failed) + "\n")
            elif progress.row is None:
                shown(progress)
            else:
                # Said before it is written: a disk that is full takes nothing away.
                rows.append(progress.row)
                if not as_json:
                    stdout.write(describe(progress.row) + "\n")
                if folder is not None:
                    folder.write(progress)
                for writer in writers:
                    _export(writer, progress)

        interrupted, common = False, None
        problem: Exception | None = None
        with _progress() as shown:
            try:
                common = run(plan, on_progress=noted, on_names=planned).rig
            except KeyboardInterrupt:
                interrupted = True
                click.echo(f"p2o: interrupted; {len(rows)} finished calibrations are kept", err=True)
            except BrokenPipeError:
                raise
            except Exception as error:
                # What is finished is told before what went wrong.
                if not rows:
                    raise
                problem = error
        done = Run(
            tuple(rows),
            joint=plan.recipe.joint,
            interrupted=interrupted,
            failed=tuple(failed),
            protocol=None if protocol is None else protocol_of(protocol),
            rig=common,
        )
        page = None
        if folder is not None:
            try:
                page = folder.finish(done)
            except P2OError as error:
                problem = problem or error
    if as_json:
        stdout.write(json.dumps(done.as_dict(), allow_nan=False) + "\n")
    elif len(rows) + len(failed) > 1 or protocol is not None:
        stdout.write(describe_run(done) + "\n")
    if common is not None and not as_json:
        stdout.write(describe_rig(common, done.rig_errors) + "\n")
    if folder is not None and page is not None and not as_json:
        stdout.write(f"wrote {page} (open it in a browser), {folder.told()}\n")
    if interrupted:
        return 130
    if problem is not None:
        raise problem
    if failed:
        raise InputError(
            f"{len(failed)} of {len(rows) + len(failed)} {'cameras' if plan.rig else 'frames'} could not be calibrated",
            got=f"{failed[0].frame}: {failed[0].reason}",
        )
    judged: list[Result | RigResult] = [row.result for row in done.rows]
    judged += [] if common is None else [common]
    short = [] if wanted is None else wanted.unmet(judged)
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

    def unmet(self, results: Sequence[Result | RigResult]) -> list[str]:
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


def _export(export: Export, progress: Progress) -> None:
    """Write a result; one without a pose that the format has no word for is told, and the others go on."""
    assert progress.row is not None
    result = progress.row.result
    try:
        export.write(result, progress.camera or progress.frames[0].name)
    except InputError as problem:
        if result.status.solved:
            raise
        click.echo(f"p2o: not exported: {problem}", err=True)


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
    from rich.markup import escape

    with Console(stderr=True).status("starting") as status:
        yield lambda p: status.update(f"{p.done + 1} of {p.total}: {escape(printable(p.name))}")
