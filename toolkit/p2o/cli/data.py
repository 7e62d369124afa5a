"""`p2o data`: what a dataset holds, whether every frame can be used, which ones to use, and what is in a bag."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import click

from p2o.cli import data_show, data_suggest
from p2o.cli.plugin_options import load, plugin_options
from p2o.errors import P2OError, printable

if TYPE_CHECKING:
    from p2o.frames.cloud import Cloud
    from p2o.frames.frame import Frame
    from p2o.host.guard import GuardedDataset


def _dataset_options(command: Callable[..., Any]) -> Callable[..., Any]:
    command = click.option("--set", "settings", multiple=True, metavar="data.FIELD=VALUE", help="An option.")(command)
    command = click.option("--frames", default=None, metavar="SPEC", help="Which frames, as in `p2o run`.")(command)
    return click.argument("data", metavar="DATASET:PATH")(plugin_options(command))


@click.group("data")
def command() -> None:
    """List, check, show or choose the frames of a dataset, or list the topics of a bag."""


command.add_command(data_show.command)
command.add_command(data_suggest.command)


@command.command("list")
@_dataset_options
def list_frames(
    data: str, frames: str | None, settings: tuple[str, ...], plugin: tuple[str, ...], block: tuple[str, ...]
) -> int:
    """Print the names of the frames, one a line; no frame is read."""
    dataset, indices = _opened(data, frames, settings, plugin, block)
    for index in indices:
        click.echo(printable(dataset.names[index]))
    return 0


@command.command("check")
@_dataset_options
def check_frames(
    data: str, frames: str | None, settings: tuple[str, ...], plugin: tuple[str, ...], block: tuple[str, ...]
) -> int:
    """Read every frame and say what it holds, or what is wrong with it; exit status 2 where any is bad.

    Frames that the dataset leaves out are named with the reason; they are not bad.
    """
    dataset, indices = _opened(data, frames, settings, plugin, block)
    bad = 0
    for index in indices:
        try:
            click.echo(described(dataset[index]))
        except P2OError as problem:
            bad += 1
            click.echo(f"{printable(dataset.names[index])}: BAD: {problem}")
    for name, reason in dataset.skipped.items() if frames is None else ():
        click.echo(f"{printable(name)}: left out: {printable(reason)}")
    click.echo(f"{len(indices) - bad} of {len(indices)} frames are good")
    return P2OError.exit_code if bad else 0


@command.command("topics")
@click.argument("path", metavar="BAG")
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object.")
def list_topics(path: str, as_json: bool) -> int:
    """Print the topics of a ROS bag, and which ones the dataset `ros` takes by itself."""
    import json
    from dataclasses import asdict

    from p2o.bags.bag import Bag
    from p2o.bags.overview import chosen_words, overview

    bag = Bag(path.removeprefix("ros:"))
    topics, chosen = overview(bag), chosen_words(bag)
    if as_json:
        click.echo(json.dumps({"topics": [asdict(topic) for topic in topics], "ros": chosen}))
        return 0
    rows: list[tuple[str, ...]] = [("topic", "type", "count", "Hz", "frame", "first s", "last s", "")]
    for topic in topics:
        times = ("" if value is None else f"{value:.3f}" for value in (topic.first_s, topic.last_s))
        rate = "" if topic.rate_hz is None else f"{topic.rate_hz:g}"
        rows.append((topic.name, topic.type, str(topic.count), rate, topic.frame_id or "", *times, topic.details))
    rows = [tuple(printable(cell, 200) for cell in row) for row in rows]
    widths = [max(len(row[column]) for row in rows) for column in range(len(rows[0]) - 1)]
    for row in rows:
        cells = (cell.ljust(width) for cell, width in zip(row, (*widths, 0), strict=True))
        click.echo("  ".join(cells).rstrip())
    click.echo()
    for what, said in chosen.items():
        click.echo(f"{what}: {printable(said)}")
    return 0


def described(frame: Frame) -> str:
    """Return in one line what a frame holds, and its warnings in further ones."""
    image, cloud = frame.image, frame.cloud
    parts = [
        *([frame.camera_name] if frame.camera_name else []),
        f"{frame.camera.width}x{frame.camera.height} px {frame.camera.model}",
        f"{len(cloud)} points",
        rings_of(cloud),
        *(name for name in ("column", "intensity", "time_s") if getattr(cloud, name) is not None),
        *(name for name in ("right", "depth_m", "masked") if getattr(image, name) is not None),
        "truth" if frame.camera_from_lidar is not None else "no truth",
        *(name for name in ("start", "twist") if getattr(frame, name) is not None),
    ]
    lines = [f"{frame.name}: {', '.join(parts)}", *(f"  warning: {text}" for text in frame.warnings)]
    return "\n".join(map(printable, lines))


def rings_of(cloud: Cloud) -> str:
    """Return in a few words how many rings a sweep has, and what tells them where its file does not."""
    import numpy as np

    from p2o.frames.rings import RingsUnknownError, told_rings

    if cloud.ring is not None:
        return f"{len(np.unique(cloud.ring))} rings"
    x, y, z = cloud.as_measured().T.astype(np.float32)
    azimuth = np.mod(np.arctan2(y, x), np.float32(2 * np.pi))
    try:
        label, by = told_rings(azimuth, z / np.maximum(np.hypot(x, y), np.float32(1e-6)))
    except RingsUnknownError:
        return "no rings"
    return f"{len(np.unique(label))} rings told by {by}"


def _opened(
    data: str, frames: str | None, settings: tuple[str, ...], plugin: tuple[str, ...], block: tuple[str, ...]
) -> tuple[GuardedDataset, list[int]]:
    from p2o.frames.selection import select
    from p2o.run.recipe import open_dataset
    from p2o.run.words import parse_settings

    dataset = open_dataset(data, load(plugin, block), parse_settings(settings).get("data", {}))
    return dataset, select(dataset.names, frames or "all", where="--frames", skipped=dataset.skipped)
