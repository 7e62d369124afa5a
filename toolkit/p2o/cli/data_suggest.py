"""`p2o data suggest`: select frames for a joint calibration, and predict its accuracy."""

from __future__ import annotations

from dataclasses import asdict
from shlex import quote
from typing import TYPE_CHECKING, Any

import click

from p2o.cli.json_output import json_option, print_json
from p2o.cli.plugin_options import data_argument, extractor_option, load, plugin_options, settings_option
from p2o.cli.pose_options import StartCommand, most_option, pose_options
from p2o.errors import InputError, printable

if TYPE_CHECKING:
    from p2o.confidence.frame_choice import SeenEdges, Step, Wanted
    from p2o.frames.frame import Frame
    from p2o.host.registry import Registry
    from p2o.run.given_pose import Which
    from p2o.run.recipe import Recipe

MOST = 40
_REACH_PX = 12.0
"""Maximum distance of matched edges of both sensors; the selection hardly depends on it."""


@click.command("suggest", cls=StartCommand)
@data_argument("The data.")
@click.option("--frames", default="all", metavar="SPEC", help="Candidate frames, as in `p2o run` (default: all).")
@most_option(MOST, 2000, "Maximum number of evaluated frames, evenly spaced.")
@click.option(
    "--count", type=click.IntRange(min=1), metavar="N", help="Number of frames to select (default: until sufficient)."
)
@click.option(
    "--require", metavar='"0.2deg 0.05m"', help="Required accuracy of the result; exit status 1 if it is not reached."
)
@extractor_option
@click.option("--perturb", metavar='"2deg 0.15m"', help="Error of the initial guess against the ground truth.")
@pose_options
@settings_option()
@json_option
@plugin_options
def command(
    data: str,
    frames: str,
    most: int,
    count: int | None,
    require: str | None,
    extractor: str | None,
    start: str | None,
    perturb: str | None,
    pose: Which,
    settings: tuple[str, ...],
    as_json: bool,
    **plugins: Any,
) -> int:
    """Select frames for a joint calibration (--joint) greedily by their information.

    Edges of all directions, near and far, distributed over the image, determine a pose; the same place observed again
    adds little information. Predicted errors are those that `p2o run` would state from the edges alone; no calibration
    is performed.
    """
    from p2o.cli.run import Required
    from p2o.confidence.frame_choice import choose, open_axes, shortage
    from p2o.run.recipe import Recipe
    from p2o.run.words import parse_settings

    bound = None if require is None else Required.of(require).bound
    if require is not None and bound is None:
        raise InputError("the accuracy is missing", where="--require", expected='"0.2deg 0.05m"', got=repr(require))
    wanted = None if bound is None else (bound.angle_deg, bound.distance_m)
    words = {"extractor": extractor, "start": start, "perturb": perturb}
    words = {name: value for name, value in words.items() if value is not None}
    recipe = Recipe.of(data=data, frames=frames, options=parse_settings(settings), witness="none", **words)
    evaluated, total = _evaluated(recipe, most, pose, load(**plugins))
    by_name = {edges.name: (index, edges) for index, edges in evaluated}
    steps = choose([edges for _, edges in evaluated], count=count, wanted=wanted)
    if not steps or steps[-1].accuracy is None:
        hint = "inspect the pose (p2o data show), or use a better initial guess"
        raise InputError("no edge of the sweep is near an image edge", where=data, hint=hint)
    spec = ",".join(str(index) for index in sorted(by_name[step.name][0] for step in steps))
    enough = None if wanted is None else steps[-1].accuracy.reaches(*wanted)
    still = [] if wanted is None or enough else open_axes(steps[-1].accuracy, wanted)
    why = shortage([by_name[step.name][1] for step in steps], still) if still else ""
    if as_json:
        plain = [_plain(step, by_name[step.name][0]) for step in steps]
        report = {"frames": spec, "steps": plain, "enough": enough, "open": still, "why": why}
        print_json({**report, "looked_at": len(evaluated), "of": total})
        return 0 if enough is not False else 1
    click.echo(f"{len(evaluated)} of {total} frames evaluated; predicted errors (67 %) after each:")
    for step in steps:
        accuracy = step.accuracy
        size = (
            "not observable" if accuracy is None else f"{accuracy.rotation_deg:.2f} deg {accuracy.translation_m:.3f} m"
        )
        click.echo(f"  {size}  {printable(step.name)}: {step.places} new places with edges")
    click.echo(_conclusion(wanted, enough, still, why, all_taken=len(steps) == len(evaluated)))
    click.echo(f"p2o run --data {quote(printable(data, 500))} --frames {spec} --joint")
    return 0 if enough is not False else 1


def _conclusion(wanted: Wanted | None, enough: bool | None, still: list[str], why: str, *, all_taken: bool) -> str:
    if wanted is None:
        return "every frame adds information" if all_taken else "further frames add little information"
    size = f"{wanted[0]:g} deg and {wanted[1]:g} m"
    if enough:
        return f"enough for {size}"
    return f"not enough for {size}: {' and '.join(still)} not accurate enough, because {why}"


def _plain(step: Step, index: int) -> dict[str, Any]:
    accuracy = None if step.accuracy is None else asdict(step.accuracy)
    return {"frame": step.name, "index": index, "gain": step.gain, "places": step.places, "accuracy": accuracy}


def _evaluated(recipe: Recipe, most: int, pose: Which, registry: Registry) -> tuple[list[tuple[int, SeenEdges]], int]:
    """Return the matched edges of the evaluated frames with their indices, and the number of selected frames."""
    from p2o.confidence.frame_choice import SeenEdges
    from p2o.frames.selection import select, spread
    from p2o.problems.point_to_line import PointToLine
    from p2o.run.given_pose import GivenPose
    from p2o.run.initial_guess import listed_errors, one_camera
    from p2o.run.pipeline import Pipeline

    plan = recipe.resolve(registry)
    dataset, pipeline = plan.dataset(), plan.assembly().calibrator
    assert isinstance(pipeline, Pipeline)
    chosen = select(dataset.names, recipe.frames, where="--frames", skipped=getattr(dataset, "skipped", {}))
    indices = spread(chosen, most)
    given, listed = GivenPose.of(recipe, pose, registry), listed_errors(recipe, dataset.names, indices)
    first: Frame | None = None
    evaluated, problems = [], []
    for index in indices:
        try:
            frame = dataset[index]
            plan.check_frame(frame)
            camera_from_lidar, _ = given.of_frame(frame, index, listed)
        except InputError as problem:
            problems.append(problem)
            click.echo(f"{printable(dataset.names[index])}: left out: {problem}", err=True)
            continue
        first = first or frame
        one_camera([first, frame])
        view = pipeline.prepare(frame).as_seen_from(camera_from_lidar).without_hidden(camera_from_lidar)
        pairs = pipeline.matcher([view], camera_from_lidar, _REACH_PX)
        if not isinstance(pairs, PointToLine):
            raise InputError("the matcher does not pair points with lines", where=recipe.matcher, expected="ogm")
        place = frame.lidar_world_from_lidar
        evaluated.append((index, SeenEdges(frame.name, pairs, camera_from_lidar, frame.sequence, place)))
    if not evaluated:
        raise problems[0]
    return evaluated, len(chosen)
