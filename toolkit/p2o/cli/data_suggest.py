"""`p2o data suggest`: which frames to calibrate together, and whether they are enough."""

from __future__ import annotations

import json
from shlex import quote
from typing import TYPE_CHECKING, Any

import click

from p2o.cli.plugin_options import load, plugin_options
from p2o.cli.pose_options import pose_options
from p2o.errors import InputError, printable

if TYPE_CHECKING:
    from p2o.calibration.frame_choice import SeenEdges, Step, Wanted
    from p2o.frames.frame import Frame
    from p2o.host.registry import Registry
    from p2o.run.given_pose import Which

MOST = 40
_REACH_PX = 12.0
"""How far apart edges of both sensors may be to count as seen by both; what follows hardly depends on it."""


@click.command("suggest")
@click.argument("data", metavar="DATASET:PATH")
@click.option("--frames", default="all", metavar="SPEC", help="Among which frames, as in `p2o run` (default: all).")
@click.option(
    "--most",
    type=click.IntRange(min=1, max=2000),
    default=MOST,
    show_default=True,
    metavar="N",
    help="Look at so many of them at most, spread evenly.",
)
@click.option("--count", type=click.IntRange(min=1), metavar="N", help="Choose so many (default: until they suffice).")
@click.option("--require", metavar='"0.2deg 0.05m"', help="How accurate the result is to be; exit status 1 if not.")
@click.option("--extractor", metavar="IMAGE/CLOUD", help="The two extractors (default: p2ornet/rings).")
@click.option("--perturb", metavar='"2deg 0.15m"', help="Look from so far off the truth.")
@pose_options
@click.option("--set", "settings", multiple=True, metavar="STAGE.FIELD=VALUE", help="An option.")
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object.")
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
    plugin: tuple[str, ...],
    block: tuple[str, ...],
) -> int:
    """Choose frames to calibrate together (--joint), each the one that tells most beside those before it.

    Edges of all directions, near and far, spread over the image determine a pose; the same place seen again tells
    little. Likely errors are those that `p2o run` would state, of the edges alone, and no promise: nothing is
    calibrated here.
    """
    from p2o.calibration.frame_choice import Wanted, choose, open_axes, shortage
    from p2o.cli.run import Required

    bound = None if require is None else Required.of(require).bound
    if require is not None and bound is None:
        raise InputError("an accuracy is asked for", where="--require", expected='"0.2deg 0.05m"', got=repr(require))
    wanted = None if bound is None else Wanted(bound.angle_deg, bound.distance_m)
    words = {"extractor": extractor, "start": start, "perturb": perturb}
    said = {name: value for name, value in words.items() if value is not None}
    found, total = _looked_at(data, frames, most, pose, settings, said, load(plugin, block))
    by_name = {edges.name: (index, edges) for index, edges in found}
    steps = choose([edges for _, edges in found], count=count, wanted=wanted)
    if not steps or steps[-1].accuracy is None:
        raise InputError(
            "no edge of the sweep has one of the image near it",
            where=data,
            hint="look at the pose (p2o data show), or give a nearer start",
        )
    spec = ",".join(str(index) for index in sorted(by_name[step.name][0] for step in steps))
    enough = None if wanted is None else wanted.met(steps[-1].accuracy)
    still = [] if wanted is None or enough else open_axes(steps[-1].accuracy, wanted)
    why = shortage([by_name[step.name][1] for step in steps], still) if still else ""
    if as_json:
        told = {
            "frames": spec,
            "steps": [_plain(step, by_name[step.name][0]) for step in steps],
            "enough": enough,
            "open": still,
            "why": why,
            "looked_at": len(found),
            "of": total,
        }
        click.echo(json.dumps(told, allow_nan=False))
        return 0 if enough is not False else 1
    click.echo(f"{len(found)} of {total} frames looked at; likely errors (two of three) after each:")
    for step in steps:
        its = step.accuracy
        size = "cannot be told" if its is None else f"{its.rotation_deg:.2f} deg {its.translation_m:.3f} m"
        click.echo(f"  {size}  {printable(step.name)}: {step.places} new places with edges")
    click.echo(_conclusion(wanted, enough, still, why, all_taken=len(steps) == len(found)))
    click.echo(f"p2o run --data {quote(printable(data, 500))} --frames {spec} --joint")
    return 0 if enough is not False else 1


def _conclusion(wanted: Wanted | None, enough: bool | None, still: list[str], why: str, *, all_taken: bool) -> str:
    if wanted is None:
        return "all of them tell something" if all_taken else "further frames tell little more"
    size = f"{wanted.rotation_deg:g} deg and {wanted.translation_m:g} m"
    if enough:
        return f"enough for {size}"
    verb = "stays" if len(still) == 1 else "stay"
    return f"not enough for {size}: {' and '.join(still)} {verb} open because {why}"


def _plain(step: Step, index: int) -> dict[str, Any]:
    from dataclasses import asdict

    accuracy = None if step.accuracy is None else asdict(step.accuracy)
    return {"frame": step.name, "index": index, "gain": step.gain, "places": step.places, "accuracy": accuracy}


def _looked_at(
    data: str,
    frames: str,
    most: int,
    pose: Which,
    settings: tuple[str, ...],
    words: dict[str, str],
    registry: Registry,
) -> tuple[list[tuple[int, SeenEdges]], int]:
    """Return the edges of the frames that are looked at, with their indices, and how many frames were asked for."""
    from p2o.calibration.frame_choice import SeenEdges
    from p2o.calibration.pipeline import Pipeline
    from p2o.frames.selection import select, spread
    from p2o.problems.point_to_line import PointToLine
    from p2o.run.given_pose import GivenPose
    from p2o.run.recipe import Recipe
    from p2o.run.run import listed_errors, one_camera
    from p2o.run.words import parse_settings

    recipe = Recipe.of(data=data, frames=frames, options=parse_settings(settings), witness="none", **words)
    plan = recipe.resolve(registry)
    dataset, pipeline = plan.dataset(), plan.assembly().calibrator
    assert isinstance(pipeline, Pipeline)
    chosen = select(dataset.names, frames, where="--frames", skipped=getattr(dataset, "skipped", {}))
    indices = spread(chosen, most)
    given, listed = GivenPose.of(recipe, pose), listed_errors(recipe, dataset.names, indices)
    first: Frame | None = None
    found, problems = [], []
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
            raise InputError("a matcher that pairs points with lines is needed", where=recipe.matcher, expected="ogm")
        place = frame.lidar_world_from_lidar
        found.append((index, SeenEdges(frame.name, pairs, camera_from_lidar, frame.sequence, place)))
    if not found:
        raise problems[0]
    return found, len(chosen)
