"""`p2o view`: a frame in space and on its image, on a page of this machine, and a start found by hand."""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from p2o.cli.pick import open_page
from p2o.cli.plugin_options import load, plugin_options
from p2o.cli.pose_options import pose_options
from p2o.errors import InputError, printable

if TYPE_CHECKING:
    from p2o.arrays import Float
    from p2o.frames.frame import Frame
    from p2o.host.registry import Registry
    from p2o.results.result import Result
    from p2o.viewer.session import KnownPose

_LOOK_S = 0.2
ROUGH = "roughly x forward, z up; camera looks forward"
"""Where to look from when nobody says a start: most LiDARs of cars stand so."""


@click.command("view")
@click.argument("source", metavar="DATASET:PATH|RUN_DIR")
@click.option("--run", "run_dir", metavar="RUN_DIR", help="Show the results in this folder of `p2o run --out`, too.")
@click.option("--frames", default=None, metavar="SPEC", help="Which frames, as in `p2o run` (default: all).")
@pose_options
@click.option("--set", "settings", multiple=True, metavar="data.FIELD=VALUE", help="An option of the dataset.")
@click.option(
    "--out", default="start.yaml", show_default=True, metavar="FILE", help="The button writes the pose here, on demand."
)
@click.option("--host", default="127.0.0.1", show_default=True, metavar="ADDRESS", help="Who is served; see below.")
@click.option("--port", default=0, type=click.IntRange(0, 65535), metavar="N", help="Port (default: any free one).")
@click.option("--no-browser", is_flag=True, help="Do not open a browser; the address is printed either way.")
@plugin_options
def command(
    source: str,
    run_dir: str | None,
    frames: str | None,
    start: str | None,
    pose: str,
    settings: tuple[str, ...],
    out: str,
    host: str,
    port: int,
    no_browser: bool,
    plugin: tuple[str, ...],
    block: tuple[str, ...],
) -> int:
    """Look at a frame in space and on its image, and find a start by hand.

    \b
    p2o view folder:PATH
    p2o view kitti-raw:PATH --frames 0-9 --start roughly "x forward, z up; camera looks forward"
    p2o view out                                       what `p2o run --out out` found
    p2o run --data folder:PATH --start start.yaml      from the pose that was written

    The page shows the cloud, the camera with its image at the start, at the result and at the pose of now, and the
    sweep on the image; sliders turn and shift it. Ctrl-C here ends it. With --host 0.0.0.0 everyone who reaches this
    machine sees your frames: there is no password. Needs viser: pip install "viser>=1.1".
    """  # noqa: D301  (click wants a real backspace: the examples keep their lines)
    from p2o.files.input_file import expanded
    from p2o.frames.selection import select
    from p2o.report.run_page import RUN
    from p2o.run.given_pose import GivenPose
    from p2o.run.recipe import Recipe, open_dataset
    from p2o.run.words import parse_settings
    from p2o.viewer.server import ViewServer, require_viser
    from p2o.viewer.session import ViewSession

    require_viser()
    registry = load(plugin, block)
    options = parse_settings(settings).get("data", {})
    of_run = (expanded(source) / RUN).is_file()
    if of_run and run_dir is not None:
        raise InputError("two runs are named", where="--run", expected="DATASET:PATH before it", got=source)
    results: Mapping[str, Result] = {}
    data = source
    if of_run or run_dir is not None:
        told = ShownRun.of(expanded(source if of_run else str(run_dir)))
        results = told.results
        if of_run and told.data is None:
            raise InputError(
                "the run does not say where its frames are", where=source, hint=f"p2o view DATASET:PATH --run {source}"
            )
        if of_run:
            data, options = str(told.data), {**told.options, **options}
    elif ":" not in source:
        raise InputError(
            "this is no folder of a run, and no dataset is named",
            where=source,
            expected="DATASET:PATH, or a folder that p2o run --out has written",
            hint=f"frames of your own: folder:{source}",
        )
    given = GivenPose.of(Recipe.of(data=data, start=start), "truth" if pose == "truth" else "start")
    dataset = open_dataset(data, registry, options)
    indices = select(dataset.names, frames or "all", where="--frames", skipped=dataset.skipped)
    if of_run and frames is None:
        indices = [index for index in indices if dataset.names[index] in results] or indices
    opener = _Opener(dataset, indices, given, results)
    session = ViewSession(
        [dataset.names[index] for index in indices], opener, out, calibrate=_Calibrator(registry).calibrated
    )
    with ViewServer(session, host, port) as server:
        click.echo(f"view at {server.url} (Ctrl-C here ends it)")
        if not no_browser:
            open_page(server.url)
        with contextlib.suppress(KeyboardInterrupt):
            while True:
                threading.Event().wait(_LOOK_S)
    if session.written is not None:
        path = printable(str(session.written))
        click.echo(f"{path} holds the pose; next: p2o run --data {printable(data)} --start {path}")
    return 0


@dataclass(frozen=True, eq=False)
class ShownRun:
    """What a folder of `p2o run --out` says: results by frame, and where its frames are (None for those of Python)."""

    data: str | None
    options: Mapping[str, Any]
    results: Mapping[str, Result]

    @classmethod
    def of(cls, root: Path) -> ShownRun:
        """Return what run.json in a folder says; raises InputError for any other folder."""
        from p2o.files.input_file import naming, read_text
        from p2o.files.parsed_text import parse_json
        from p2o.report.run_page import RUN
        from p2o.results.result_json import result_from_dict

        path = root / RUN
        told = parse_json(read_text(path, "run"), "run", path)
        rows = told.get("results") if isinstance(told, Mapping) else None
        if not isinstance(rows, list) or not rows:
            raise InputError("there are no results of p2o run in it", where=path, expected="results")
        with naming(path):
            found = [result_from_dict(row) for row in rows]
        recipe = found[0].recipe
        data, options = recipe.get("data"), recipe.get("options")
        own = options.get("data") if isinstance(options, Mapping) else None
        options = dict(own) if isinstance(own, Mapping) else {}
        said = data if isinstance(data, str) else None
        return cls(said, options, {frame: result for result in found for frame in result.frames})


@dataclass(frozen=True, eq=False)
class _Opener:
    """Reads frames by their place among the chosen ones, with where they begin and how they ended."""

    dataset: Any
    indices: list[int]
    given: Any
    results: Mapping[str, Result]

    def __call__(self, number: int) -> Any:
        from p2o.viewer.session import KnownPose, Opened

        index = self.indices[number]
        frame = self.dataset[index]
        result = self.results.get(frame.name)
        start = KnownPose(*self._start(frame, index))
        if result is None:
            return Opened(frame, start)
        if self.given.told is None:
            start = KnownPose(result.start, "where the run began")
        return Opened(frame, start, _known(result) if result.status.solved else None)

    def _start(self, frame: Frame, index: int) -> tuple[Float, str]:
        """Return the start of a frame and what it is; a rough one where nobody says any."""
        from p2o.geometry.rough_start import rough_start

        says = self.given.told is not None or self.given.which == "truth"
        if not says and frame.start is None and frame.camera_from_lidar is None:
            return rough_start(ROUGH), f"a guess, for nobody says any: {ROUGH}"
        found: tuple[Float, str] = self.given.of_frame(frame, index)
        return found


@dataclass(frozen=True, eq=False)
class _Calibrator:
    """The default methods, for "calibrate from here"."""

    registry: Registry

    def calibrated(self, frame: Frame, start: Float) -> KnownPose:
        """Return the result of one frame; raises InputError where it is refused."""
        from p2o.run.run import calibrate

        run = calibrate(frame, start=start, registry=self.registry)
        if run.failed:
            raise InputError(run.failed[0].reason)
        result = run.result
        if not result.status.solved:
            raise InputError(f"not solved ({result.status.value}): {result.reason}")
        return _known(result)


def _known(result: Result) -> KnownPose:
    """Return the pose of a result with its verdict and how wrong it may be."""
    from p2o.viewer.session import KnownPose

    its = result.accuracy
    likely = "" if its is None else f", likely within {its.rotation_deg:.2f} deg and {100 * its.translation_m:.1f} cm"
    return KnownPose(result.camera_from_lidar, f"{result.verdict.trust.value}{likely}")
