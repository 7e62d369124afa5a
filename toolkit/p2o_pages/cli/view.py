"""`p2o view`: show a frame in 3-D and on its image, and set an initial guess by hand."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
from p2o.cli.plugin_options import load, plugin_options
from p2o.cli.pose_options import StartCommand, pose_options
from p2o.errors import InputError, printable

if TYPE_CHECKING:
    from p2o.arrays import Float
    from p2o.frames.frame import Frame
    from p2o.host.registry import Registry
    from p2o.results.result import Result

    from p2o_pages.view.session import KnownPose

ROUGH = "roughly x forward, z up; camera looks forward"
"""Initial guess for frames without any: the usual mounting on cars."""


@click.command("view", cls=StartCommand)
@click.argument("source", metavar="DATASET:PATH|RUN_DIR")
@click.option("--run", "run_dir", metavar="RUN_DIR", help="Show the results in this folder of `p2o run --out`, too.")
@click.option("--frames", default=None, metavar="SPEC", help="Which frames, as in `p2o run` (default: all).")
@pose_options
@click.option("--set", "settings", multiple=True, metavar="data.FIELD=VALUE", help="An option of the dataset.")
@click.option(
    "--out", default="start.yaml", show_default=True, metavar="FILE", help="File to which the button writes the pose."
)
@click.option(
    "--host", default="127.0.0.1", show_default=True, metavar="ADDRESS", help="Address to listen on; see below."
)
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
    """Show a frame in 3-D and on its image, and set an initial guess by hand.

    \b
    p2o view folder:PATH
    p2o view kitti-raw:PATH --frames 0-9 --start roughly "x forward, z up; camera looks forward"
    p2o view out                                       results of `p2o run --out out`
    p2o run --data folder:PATH --start start.yaml      from the pose that was written

    The page shows the cloud, the camera with its image at the start, at the result and at the current pose, and the
    sweep on the image; sliders turn and shift it. Ctrl-C here ends it. With --host 0.0.0.0 everyone who reaches this
    machine sees your frames: there is no password. Needs viser: pip install "viser>=1.1".
    """  # noqa: D301  (click wants a real backspace: the examples keep their lines)
    from p2o.files.input_file import expanded
    from p2o.frames.selection import select
    from p2o.page.run_page import RUN
    from p2o.run.given_pose import GivenPose
    from p2o.run.recipe import Recipe, open_dataset
    from p2o.run.words import named_data, parse_settings

    from p2o_pages.server import require_viser
    from p2o_pages.view.server import ViewServer
    from p2o_pages.view.session import ViewSession

    require_viser("p2o view")
    registry = load(plugin, block)
    options = parse_settings(settings).get("data", {})
    of_run = (expanded(source) / RUN).is_file()
    if of_run and run_dir is not None:
        raise InputError("two runs are given", where="--run", expected="DATASET:PATH before it", got=source)
    results: Mapping[str, Result] = {}
    data = source
    if of_run or run_dir is not None:
        run = ShownRun.of(expanded(source if of_run else str(run_dir)))
        results = run.results
        if of_run and run.data is None:
            raise InputError(
                "the run does not record its dataset", where=source, hint=f"p2o view DATASET:PATH --run {source}"
            )
        if of_run:
            data, options = str(run.data), {**run.options, **options}
    elif ":" not in (data := named_data(source, registry)):
        raise InputError(
            "the argument is neither the folder of a run nor a dataset",
            where=source,
            expected="DATASET:PATH, or a folder that p2o run --out has written",
            hint=f"frames of your own: folder:{source}",
        )
    given = GivenPose.of(Recipe.of(data=data, start=start), "truth" if pose == "truth" else "start", registry)
    dataset = open_dataset(data, registry, options)
    indices = select(dataset.names, frames or "all", where="--frames", skipped=dataset.skipped)
    if of_run and frames is None:
        indices = [index for index in indices if dataset.names[index] in results] or indices
    opener = _Opener(dataset, indices, given, results)
    names = [dataset.names[index] for index in indices]
    session = ViewSession(names, opener, partial(_calibrated, registry), out, registry=registry)
    with ViewServer(session, host, port) as server:
        server.serve(f"view at {server.url} (Ctrl-C here ends it)", browser=not no_browser)
    if session.written is not None:
        path = printable(str(session.written))
        click.echo(f"{path} holds the pose; next: p2o run --data {printable(data)} --start {path}")
    return 0


@dataclass(frozen=True, eq=False)
class ShownRun:
    """Content of a folder of `p2o run --out`: results by frame, and the dataset (None if frames came from Python)."""

    data: str | None
    options: Mapping[str, Any]
    results: Mapping[str, Result]

    @classmethod
    def of(cls, root: Path) -> ShownRun:
        """Read run.json in a folder; raises InputError for any other folder."""
        from p2o.files.input_file import naming, read_text
        from p2o.files.parsed_text import parse_json
        from p2o.page.run_page import RUN
        from p2o.results.result_json import result_from_dict

        path = root / RUN
        content = parse_json(read_text(path, "run"), "run", path)
        rows = content.get("results") if isinstance(content, Mapping) else None
        if not isinstance(rows, list) or not rows:
            raise InputError("the file contains no results of p2o run", where=path, expected="results")
        with naming(path):
            results = [result_from_dict(row) for row in rows]
        recipe = results[0].recipe
        data, options = recipe.get("data"), recipe.get("options")
        own = options.get("data") if isinstance(options, Mapping) else None
        by_frame = {frame: result for result in results for frame in result.frames}
        return cls(data if isinstance(data, str) else None, dict(own) if isinstance(own, Mapping) else {}, by_frame)


@dataclass(frozen=True, eq=False)
class _Opener:
    """Reads frames by their number among the selected ones, with their initial guess and their result."""

    dataset: Any
    indices: list[int]
    given: Any
    results: Mapping[str, Result]

    def __call__(self, number: int) -> Any:
        from p2o_pages.view.session import KnownPose, Opened

        index = self.indices[number]
        frame = self.dataset[index]
        result = self.results.get(frame.name)
        start = KnownPose(*self._start(frame, index))
        if result is None:
            return Opened(frame, start)
        if self.given.known is None:
            start = KnownPose(result.start, "the initial guess of the run")
        return Opened(frame, start, _known(result) if result.status.solved else None)

    def _start(self, frame: Frame, index: int) -> tuple[Float, str]:
        """Return the initial guess of a frame and its description; ROUGH if there is none."""
        from p2o.geometry.rough_start import rough_start

        given = self.given.known is not None or self.given.which == "truth"
        if not given and frame.start is None and frame.camera_from_lidar is None:
            return rough_start(ROUGH), f"a guess, as none is given: {ROUGH}"
        start: tuple[Float, str] = self.given.of_frame(frame, index)
        return start


def _calibrated(registry: Registry, frame: Frame, start: Float) -> KnownPose:
    """Calibrate one frame by the default methods; raises InputError if that fails."""
    from p2o.run.run import calibrate

    run = calibrate(frame, start=start, registry=registry)
    if run.failed:
        raise InputError(run.failed[0].reason)
    if not run.result.status.solved:
        raise InputError(f"not solved ({run.result.status.value}): {run.result.reason}")
    return _known(run.result)


def _known(result: Result) -> KnownPose:
    """Return the pose of a result, described by its verdict and its predicted error."""
    from p2o_pages.view.session import KnownPose

    description, accuracy = result.verdict.trust.value, result.accuracy
    if accuracy is not None:
        error = f"{accuracy.rotation_deg:.2f} deg and {100 * accuracy.translation_m:.1f} cm"
        description += f", predicted error (67 %): {error}"
    return KnownPose(result.camera_from_lidar, description)
