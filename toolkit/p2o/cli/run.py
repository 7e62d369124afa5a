"""`p2o run`: calibrate frames and write the results as text, JSON and files."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from p2o.cli.completion import complete_exports, complete_extractors, complete_methods, complete_protocols
from p2o.cli.json_output import json_option, print_json
from p2o.cli.plugin_options import (
    data_argument,
    extractor_option,
    load,
    matcher_option,
    plugin_options,
    seed_option,
    settings_option,
    text_option,
)
from p2o.cli.pose_options import StartCommand
from p2o.cli.progress import long_work, status_line
from p2o.errors import InputError, P2OError, printable

if TYPE_CHECKING:
    from p2o.cli.out_dir import OutDir
    from p2o.cli.recording import Recording
    from p2o.geometry.perturb import Perturbation
    from p2o.host.registry import Registry
    from p2o.host.stages import Exporter
    from p2o.results.result import Result, RigResult
    from p2o.run.isolated import IsolatedCalibration
    from p2o.run.outcome import FailedFrame, Row, Run
    from p2o.run.recipe import Plan
    from p2o.run.run import Progress


@click.command("run", cls=StartCommand)
@data_argument("The data (default: the built-in frame, example:).", default="example:")
@text_option("--frames", "SPEC", "all, indices and ranges (0,4-7), @splits.json#test, or names (default: all).")
@click.option(
    "--method",
    "--recipe",
    "method",
    metavar="NAME",
    shell_complete=complete_methods("calibrator", "matcher", published=True),
    help="A published method, calibrator or matcher with all its parts (`p2o methods`); other options override them.",
)
@extractor_option
@matcher_option
@text_option("--solver", "NAME", "The solver (default: lm).", complete_methods("solver"))
@text_option(
    "--init", "NAME", "The initializer, which proposes poses (default: search).", complete_methods("initializer")
)
@text_option(
    "--calibrator",
    "NAME",
    "A complete method instead of extractor, matcher, solver and init.",
    complete_methods("calibrator"),
)
@settings_option("An option (`p2o methods NAME` lists them).")
@text_option(
    "--accumulate", "NAME", "Accumulate sweeps of a sequence with this method.", complete_methods("accumulator")
)
@text_option(
    "--witness",
    "IMAGE/CLOUD",
    "Extractors for an independent check (default: p2ornet/rings, unless their edges are used already; none).",
    complete_extractors,
)
@text_option(
    "--perturb",
    '"2deg 0.15m"',
    "Error of the initial guess against the ground truth, in a random direction; @FILE reads errors from a list.",
)
@text_option(
    "--start",
    'roughly "x forward, z up; camera looks forward" | FILE',
    "Initial guess in words (two axes of the LiDAR, viewing direction and, if known, position of the camera), or "
    "from a calibration file (formats of `p2o convert`).",
)
@text_option(
    "--start-sigma",
    '"2deg 0.1m"',
    "Standard deviation of the initial guess per axis: then a prior of the result (default: unknown).",
)
@text_option("--protocol", "NAME", "Draw initial guesses and report errors as in a publication.", complete_protocols)
@seed_option
@click.option("--joint", is_flag=True, default=None, help="Calibrate all frames jointly, with one result.")
@text_option(
    "--rig",
    "[FILE]",
    "One joint result per camera; FILE (YAML, JSON) assigns frames to cameras and gives the poses of cameras.",
    is_flag=False,
    flag_value=True,
    type=click.UNPROCESSED,
)
@text_option(
    "--require",
    '"[trusted] [0.3deg 0.1m]"',
    "Exit status 1 unless every result is trusted and, with a size, its predicted error is at most this.",
)
@json_option
@click.option("--verbose", "-v", is_flag=True, help="Print every figure of each result.")
@text_option(
    "--out", "DIR", "Folder of a page (result.html), result JSON, overlays and convergence plots.", type=click.Path()
)
@text_option(
    "--rerun",
    "FILE.rrd",
    "Record sweep, images, edges and poses of each frame for the Rerun viewer (extra rerun).",
)
@click.option(
    "--export",
    "exports",
    multiple=True,
    metavar="NAME:PATH",
    shell_complete=complete_exports,
    help="Write a trusted result to a file.",
)
@click.option("--export-anyway", is_flag=True, help="Export doubtful and ambiguous results, too.")
@click.option(
    "--isolate",
    is_flag=True,
    help="Calibrate in a worker process: a plugin that crashes gives a failed result that names it.",
)
@plugin_options
def command(
    settings: tuple[str, ...],
    require: str | None,
    as_json: bool,
    verbose: bool,
    out: str | None,
    rerun: str | None,
    exports: tuple[str, ...],
    export_anyway: bool,
    isolate: bool,
    plugin: tuple[str, ...],
    block: tuple[str, ...],
    **words: Any,
) -> int:
    """Calibrate frames: estimate the transform from the LiDAR to the camera.

    \b
    p2o run                                            the built-in frame
    p2o run PATH --perturb "2deg 0.15m" --seed 1       the dataset is inferred from the files
    p2o run kitti-raw:PATH --frames @splits.json#test --joint --out out
    p2o run folder:PATH --method nid --joint           a published method
    p2o run folder:PATH --rig rig.yaml
    p2o run folder:PATH --start roughly "x forward, z up; camera looks 45 deg left"

    At most eight lines are printed about a result, with --verbose every figure.

    For several results, PATH of --export contains {frame}, or {camera} with --rig. A result that is not trusted or does
    not meet --require is not exported, except as json, which stores the verdict. Exit status 1 if a result was not
    exported, a calibration was refused (see its status) or does not meet --require: without --require trusted, doubtful
    and ambiguous results count as solved. Exit status 2 if a frame cannot be read; it is listed with the reason.
    """  # noqa: D301  (click wants a real backspace: the examples keep their lines)
    registry, required = load(plugin, block), None if require is None else Required.of(require)
    protocol = words.get("protocol")
    plan = _plan(words, settings, registry)
    folder: OutDir | None = None
    if out is not None:
        # Imported here, because drawing needs packages that are slow to import.
        from p2o.cli.out_dir import OutDir

        folder = OutDir.prepared(out)
    recording: Recording | None = None
    if rerun is not None:
        from p2o.cli.recording import Recording

        recording = Recording.prepared(rerun)
    write = (lambda text: None) if as_json else click.echo
    opened = [Export.of(text, registry) for text in exports]
    output = _Output(write, verbose, plan.recipe.joint, folder, recording, opened, required, export_anyway)
    done, problem = _calibrated(plan, output, protocol, (block, plugin) if isolate else None)
    page: Path | None = None
    try:
        if output.recording is not None:
            output.recording.finish()
        if output.folder is not None:
            if done.rig is not None:
                output.folder.write_common(output.cameras, done.rig)
            page = output.folder.finish(done)
    except P2OError as error:
        problem = problem or error
    if as_json:
        print_json(done.as_dict() | ({"exports": output.exported} if exports else {}))
    else:
        output.summarise(done, page)
    if done.interrupted:
        return 130
    if problem is not None:
        raise problem
    if done.failed:
        count = f"{len(done.failed)} of {len(done.rows) + len(done.failed)} {'cameras' if plan.rig else 'frames'}"
        first = f"{done.failed[0].frame}: {done.failed[0].reason}"
        raise InputError(f"{count} could not be calibrated", got=first)
    judged: list[Result | RigResult] = [row.result for row in done.rows]
    judged += [] if done.rig is None else [done.rig]
    unmet = [] if required is None else required.unmet(judged)
    for line in unmet:
        click.echo(f"p2o: {line}, as --require asks", err=True)
    return 0 if done.solved and not unmet and all(export["written"] for export in output.exported) else 1


def _plan(words: Mapping[str, Any], settings: Sequence[str], registry: Registry) -> Plan:
    """Return the plan of the words that are given on the command line, and of the options in `settings`."""
    from p2o.geometry.perturb import parse_accuracy
    from p2o.run.run import planned
    from p2o.run.words import parse_settings

    given = {name: value for name, value in words.items() if value is not None}
    if (sigma := given.pop("start_sigma", None)) is not None:
        known = parse_accuracy(sigma, "--start-sigma")
        settings = (*settings, f"pipeline.start_sigma=[{known.angle_deg}, {known.distance_m}]")
    if settings:
        given["options"] = parse_settings(settings)
    return planned(given, registry, "--protocol")


@dataclass
class _Output:
    """Prints, draws and exports results as they finish; `write` prints text, `exported` lists the exports.

    `cameras` are the calibrations of the cameras of a rig, whose frames are drawn again at the common result.
    """

    write: Callable[[str], object]
    verbose: bool
    joint: bool
    folder: OutDir | None
    recording: Recording | None
    exports: list[Export]
    required: Required | None
    anyway: bool
    exported: list[dict[str, Any]] = field(default_factory=list)
    rows: list[Row] = field(default_factory=list)
    cameras: list[Progress] = field(default_factory=list)
    failed: list[FailedFrame] = field(default_factory=list)

    def plan_files(self, names: Sequence[str], cameras: Sequence[str]) -> None:
        """Determine and check the files of all frames before any work."""
        from p2o.files.file_names import distinct_names

        # A camera and its only frame may have the same name, and then share a folder.
        if self.folder is not None:
            self.folder = self.folder.for_frames(list(dict.fromkeys([*cameras, *names])))
        named = cameras or (names[:1] if self.joint else names)
        files = distinct_names(cameras or names)
        place = "{camera}" if cameras else "{frame}"
        self.exports = [export.for_frames({name: files[name] for name in named}, place) for export in self.exports]
        outputs = [] if self.folder is None else [("--out", file) for file in self.folder.files]
        outputs += [] if self.recording is None else [("--rerun", self.recording.path)]
        check_apart([*outputs, *((f"--export {e.text}", file) for e in self.exports for file in e.files.values())])

    def add(self, progress: Progress) -> None:
        """Print and write a result or a failed frame."""
        from p2o.cli.summary import MOST_LINES, describe, describe_briefly, describe_failed

        if progress.failed is not None:
            self.failed.append(progress.failed)
            self.write(describe_failed(progress.failed))
        elif progress.row is not None:
            # Printed first, so that a result is not lost if the disk is full.
            self.rows.append(progress.row)
            others = len(self.exports) + (self.folder is not None) + (self.recording is not None)
            row = progress.row
            self.write(describe(row) if self.verbose else describe_briefly(row, MOST_LINES - others))
            if self.folder is not None:
                self.folder.write(progress)
                self.cameras += [progress] if progress.camera else []
            if self.recording is not None:
                self.recording.write(progress)
            for export in self.exports:
                self._export(export, progress.row.result, progress.camera or progress.frames[0].name)

    def _export(self, export: Export, result: Result, name: str) -> None:
        """Write the result of a frame or camera, or print why it is not exported."""
        file, form, trust = str(export.files[name]), export.form, result.verdict.trust.value
        reason = "" if export.stores_verdict else self._refusal(result)
        if reason:
            click.echo(printable(f"p2o: not exported: {file}: {reason}"), err=True)
        else:
            export.write(result, name)
            self.write(printable(f"wrote {file} ({form}, {trust})"))
        written = {"frame": name, "form": form, "path": file, "trust": trust, "written": not reason}
        self.exported.append({**written, "reason": reason})

    def _refusal(self, result: Result) -> str:
        """Return why a result is not exported, empty if it is."""
        if not result.status.solved:
            return f"the result has no estimated pose: {result.status.value} ({result.reason})"
        unmet = [] if self.required is None else self.required.unmet([result])
        if unmet:
            return f"{unmet[0]}, as --require asks"
        if result.verdict.trusted or self.anyway:
            return ""
        return f"the result is {result.verdict.trust.value}; see its reasons, or write it with --export-anyway"

    def summarise(self, run: Run, page: Path | None) -> None:
        """Print the summary of all results and the path of the page."""
        from p2o.cli.summary import describe_rig, describe_run

        if len(run.rows) + len(run.failed) > 1 or run.protocol is not None:
            self.write(describe_run(run))
        if run.rig is not None:
            self.write(describe_rig(run.rig, run.rig_errors))
        if self.folder is not None and page is not None:
            self.write(f"wrote {page} (open it in a browser), {self.folder.content_text()}")
        if self.recording is not None and run.rows:
            self.write(f"wrote {self.recording.path} (open it: rerun {self.recording.path})")


_SLOW = ("matcher", "solver", "calibrator")
"""Stages whose methods a line about a long calibration names."""


def _calibrated(
    plan: Plan, output: _Output, protocol: str | None, isolate: tuple[tuple[str, ...], tuple[str, ...]] | None
) -> tuple[Run, Exception | None]:
    """Run a plan; return the finished results and the exception that ended it after at least one result.

    `isolate` are plugins to leave out and files of plugins for a worker process, None for this process.
    """
    from p2o.run.outcome import Run
    from p2o.run.protocol import protocol_of
    from p2o.run.run import run

    interrupted, common = False, None
    problem: Exception | None = None
    names = (f"{stage} {plan.parts[stage].offer.name}" for stage in _SLOW if stage in plan.parts)
    methods = ", ".join(names)
    by: contextlib.AbstractContextManager[IsolatedCalibration | None] = contextlib.nullcontext()
    if isolate is not None:
        from p2o.run.isolated import isolated

        by = isolated(plan.recipe, *isolate)
    with by as apart, status_line("starting") as show, long_work(show, f" ({methods})") as work:

        def on_progress(progress: Progress) -> None:
            if progress.failed is None and progress.row is None:
                work(f"calibration {progress.done + 1} of {progress.total}: {progress.name}")
            output.add(progress)

        try:
            work("reading the data")
            calls: dict[str, Any] = {} if apart is None else {"calibration": apart, "rig_calibration": apart.rig}
            common = run(plan, on_progress=on_progress, on_names=output.plan_files, **calls).rig
        except KeyboardInterrupt:
            interrupted = True
            click.echo(f"p2o: interrupted; {len(output.rows)} finished calibrations are kept", err=True)
        except BrokenPipeError:
            raise
        except Exception as error:
            # Finished results are printed before the error.
            if not output.rows:
                raise
            problem = error
    named = None if protocol is None else protocol_of(protocol)
    rows, failed = tuple(output.rows), tuple(output.failed)
    done = Run(rows, joint=plan.recipe.joint, interrupted=interrupted, failed=failed, protocol=named, rig=common)
    return done, problem


@dataclass(frozen=True)
class Required:
    """The requirement of --require: trusted results and, with `bound`, a predicted error of at most this."""

    bound: Perturbation | None

    @classmethod
    def of(cls, text: str) -> Required:
        """Parse a requirement; raises InputError unless it has both parts of an accuracy, or none."""
        from p2o.geometry.perturb import parse_accuracy
        from p2o.results.verdict import Trust

        word, _, rest = text.strip().partition(" ")
        size = rest if word == Trust.TRUSTED else text
        if not size.strip() and word == Trust.TRUSTED:
            return cls(None)
        return cls(parse_accuracy(size, "--require", '"trusted", or an angle and a length, "0.3deg 0.1m"'))

    def unmet(self, results: Sequence[Result | RigResult]) -> list[str]:
        """Return a line for each violated requirement."""
        doubted = sum(not result.verdict.trusted for result in results)
        lines = [_count_text(doubted, len(results), "is not trusted", "are not trusted")] if doubted else []
        if self.bound is not None:
            size = self.bound.angle_deg, self.bound.distance_m
            wide = sum(result.verdict.trusted and not result.reaches(*size) for result in results)
            words = (f"{verb} not reach {self.bound}" for verb in ("does", "do"))
            lines += [_count_text(wide, len(results), *words)] if wide else []
        return lines


def _count_text(some: int, many: int, one: str, several: str) -> str:
    """Return a sentence with the number of affected results."""
    return f"{some} of {many} results {several}" if many > 1 else f"the result {one}"


PLACE = "{frame}"
"""Placeholder of the name of the frame in a path; "{camera}" for the camera of a rig."""


@dataclass(frozen=True)
class Export:
    """One text NAME:PATH; `files` are the paths by frame, once the frames are known.

    `form` is the name of the exporter; with `stores_verdict` its files state the verdict, so that it is never refused.
    """

    text: str
    form: str
    stores_verdict: bool
    exporter: Exporter
    path: Path
    files: Mapping[str, Path] = field(default_factory=dict)
    place: str = PLACE

    @classmethod
    def of(cls, text: str, registry: Registry) -> Export:
        """Parse the text; raises as `open_exporter`."""
        from p2o.host.method import Kind
        from p2o.run.recipe import open_exporter

        exporter, path = open_exporter(text, registry)
        form = text.partition(":")[0]
        return cls(text, form, "verdict" in registry.find(Kind.EXPORTER, form).method.gives, exporter, path)

    def for_frames(self, names: Mapping[str, str], place: str = PLACE) -> Export:
        """Return the export with the files of frames; `names` maps frames to the values of `place` in the path.

        Raises InputError if several frames have the same file, or a file cannot be written.
        """
        if len(names) > 1 and place not in str(self.path):
            expected = f"a path that contains {place}" + (", or --joint" if place == PLACE else "")
            raise InputError("several results need several files", where="--export", expected=expected, got=self.text)
        files = {frame: Path(str(self.path).replace(place, name)) for frame, name in names.items()}
        for file in files.values():
            _check_place(file, made=place in str(self.path.parent))
        return replace(self, files=files, place=place)

    def write(self, result: Result, frame: str) -> None:
        """Write the result of a frame, or of a camera of a rig."""
        file = self.files[frame]
        if self.place in str(self.path.parent):
            file.parent.mkdir(parents=True, exist_ok=True)
        self.exporter(result, file)


def check_apart(outputs: Iterable[tuple[str, Path]]) -> None:
    """Raise InputError if two outputs, each an option with a file, have the same file."""
    known: dict[str, str] = {}
    for option, file in outputs:
        other = known.setdefault(_key(file), option)
        if other is not option:
            raise InputError("two outputs have the same file", where=file, got=f"{other} and {option}")


def _key(path: Path) -> str:
    """Return the absolute path in lower case, because some file systems ignore case."""
    return str(path.absolute()).lower()


def _check_place(file: Path, *, made: bool) -> None:
    """Raise InputError if a file cannot be written; with `made` its folder is created later."""
    try:
        if file.is_dir():
            raise InputError("the export is a folder", where=file, expected=f"--export NAME:{file}/{PLACE}.txt")
        if not (made or file.parent.is_dir()):
            hint = f"create it first: mkdir -p {file.parent}"
            raise InputError("the folder of the export is missing", where=file, hint=hint)
    except OSError as problem:
        raise InputError("cannot write the export", where=file, got=problem.strerror or problem) from problem
