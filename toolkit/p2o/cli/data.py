"""`p2o data`: list, check, show and select the frames of a dataset."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

import click

from p2o.cli import SubGroup, data_show, data_suggest
from p2o.cli.plugin_options import data_argument, load, plugin_options
from p2o.errors import P2OError, printable

if TYPE_CHECKING:
    from p2o.arrays import Int
    from p2o.frames.cloud import Cloud
    from p2o.frames.frame import Frame
    from p2o.host.guard import GuardedDataset
    from p2o.host.registry import Offer


def _dataset_options(command: Callable[..., Any]) -> Callable[..., Any]:
    command = click.option("--set", "settings", multiple=True, metavar="data.FIELD=VALUE", help="An option.")(command)
    command = click.option("--frames", default=None, metavar="SPEC", help="Which frames, as in `p2o run`.")(command)
    return data_argument("The data.")(plugin_options(command))


@click.group("data", cls=SubGroup)
def command() -> None:
    """List, check, show or select the frames of a dataset, or list the topics of a bag."""


command.add_command(data_show.command)
command.add_command(data_suggest.command)


@command.command("list")
@_dataset_options
def list_frames(data: str, frames: str | None, **words: Any) -> int:
    """Print the names of the frames, one per line, without reading them."""
    dataset, indices = _opened(data, frames, **words)
    for index in indices:
        click.echo(printable(dataset.names[index]))
    return 0


@command.command("check")
@_dataset_options
def check_frames(data: str, frames: str | None, **words: Any) -> int:
    """Read every frame and print its content, or its fault; exit status 2 if any frame is bad.

    Frames that the dataset leaves out are listed with the reason; they are not bad.
    """
    from p2o.host.method import Kind

    dataset, indices = _opened(data, frames, **words)
    extractors = load(words["plugin"], words["block"]).of_kind(Kind.CLOUD_EXTRACTOR)
    bad = 0
    for index in indices:
        try:
            click.echo(described(dataset[index], extractors))
        except P2OError as problem:
            bad += 1
            click.echo(f"{printable(dataset.names[index])}: BAD: {problem}")
    for name, reason in dataset.skipped.items() if frames is None else ():
        click.echo(f"{printable(name)}: left out: {printable(reason)}")
    click.echo(f"{len(indices) - bad} of {len(indices)} frames are good")
    return P2OError.exit_code if bad else 0


def described(frame: Frame, extractors: Sequence[Offer]) -> str:
    """Return the content of a frame in one line, its warnings and advice in further ones; `extractors` are of clouds.

    Raises PluginError if one of them fails to recover rings.
    """
    image, cloud = frame.image, frame.cloud
    label, source = _rings(cloud, extractors)
    parts = [
        *([frame.camera_name] if frame.camera_name else []),
        f"{frame.camera.width}x{frame.camera.height} px {frame.camera.model}",
        f"{len(cloud)} points",
        _counted(label, source),
        *_neighbours(cloud, label),
        *(name for name in ("column", "intensity", "time_s") if getattr(cloud, name) is not None),
        *(name for name in ("right", "depth_m", "masked") if getattr(image, name) is not None),
        "truth" if frame.camera_from_lidar is not None else "no truth",
        *(name for name in ("start", "twist") if getattr(frame, name) is not None),
        *(["no start"] if frame.start is None and frame.camera_from_lidar is None else []),
    ]
    unused = [f"  fields of the points not used: {', '.join(frame.unused_fields)}"] if frame.unused_fields else []
    remarks = [*(f"  warning: {text}" for text in frame.warnings), *(f"  advice: {text}" for text in frame.advice)]
    lines = [f"{frame.name}: {', '.join(parts)}", *unused, *remarks]
    return "\n".join(map(printable, lines))


def ring_count(cloud: Cloud, extractors: Sequence[Offer] = ()) -> str:
    """Return the number of rings of a sweep as text, with the source if they are estimated, or recovered and by whom.

    `extractors` are asked for rings that neither the order nor the elevations of the points show.
    """
    return _counted(*_rings(cloud, extractors))


def _counted(label: Int | None, source: str) -> str:
    return "no rings" if label is None else f"{len(set(label.tolist()))} rings{source}"


def _rings(cloud: Cloud, extractors: Sequence[Offer]) -> tuple[Int | None, str]:
    """Return the ring (N,) of each point, None if unknown, and the source as text."""
    from p2o.frames.rings import RingsUnknownError, rings_of
    from p2o.host.registry import watch

    try:
        label, by = rings_of(cloud)
    except RingsUnknownError:
        for extractor in extractors:
            if extractor.method.rings is not None:
                with watch(extractor, "recovering rings"):
                    rings = extractor.method.rings(cloud)
                if rings is not None:
                    return rings[0], f" recovered by `{extractor.name}` from {rings[1]}"
        return None, ""
    return label, f" from {by}" if by else ""


def _neighbours(cloud: Cloud, label: Int | None) -> list[str]:
    """Return the share of the returns that have a neighbour on their ring (N,) as text, if rings are known."""
    import numpy as np

    from p2o.frames.rings import azimuth_gaps, neighbour_gap

    if label is None:
        return []
    x, y, _ = cloud.as_measured().T
    gap = azimuth_gaps(np.arctan2(y, x), label)
    widest = neighbour_gap(gap)
    return [f"{100 * np.mean(gap <= widest):.0f} % of returns with a neighbour within {np.degrees(widest):.2g} deg"]


def _opened(
    data: str, frames: str | None, settings: tuple[str, ...], plugin: tuple[str, ...], block: tuple[str, ...]
) -> tuple[GuardedDataset, list[int]]:
    from p2o.frames.selection import select
    from p2o.run.recipe import open_dataset
    from p2o.run.words import parse_settings

    dataset = open_dataset(data, load(plugin, block), parse_settings(settings).get("data", {}))
    return dataset, select(dataset.names, frames or "all", where="--frames", skipped=dataset.skipped)
