"""`p2o data show`: the sweep on the image at the given pose, before anything is calibrated."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from p2o.cli.plugin_options import load, plugin_options
from p2o.cli.pose_options import pose_options
from p2o.errors import InputError, P2OError, printable

if TYPE_CHECKING:
    from p2o.arrays import Float, UInt8
    from p2o.frames.frame import Frame

MOST = 8


@click.command("show")
@click.argument("data", metavar="DATASET:PATH")
@click.option("--frames", default=None, metavar="SPEC", help="Which frames, as in `p2o run` (default: all).")
@click.option(
    "--most",
    type=click.IntRange(min=1, max=200),
    default=MOST,
    show_default=True,
    metavar="N",
    help="At most so many of them, spread evenly.",
)
@pose_options
@click.option("--set", "settings", multiple=True, metavar="data.FIELD=VALUE", help="An option.")
@click.option("--out", type=click.Path(), required=True, metavar="DIR", help="Write pictures and index.html here.")
@plugin_options
def command(
    data: str,
    frames: str | None,
    most: int,
    start: str | None,
    pose: str,
    settings: tuple[str, ...],
    out: str,
    plugin: tuple[str, ...],
    block: tuple[str, ...],
) -> int:
    """Draw the sweep on the image at the start, by range and by reflectance: one picture a frame, and a page.

    Look at it before you calibrate: things must lie on themselves, give or take the error of the start. Exit status 2
    where a frame cannot be shown.
    """
    from p2o.cli.out_dir import OutDir
    from p2o.draw.overlay import write_png
    from p2o.files.file_names import distinct_names
    from p2o.files.whole_file import write_whole
    from p2o.frames.selection import select, spread
    from p2o.report.sweep_page import PAGE, ShownSweep, sweep_page
    from p2o.run.given_pose import GivenPose
    from p2o.run.recipe import Recipe, open_dataset
    from p2o.run.words import parse_settings

    given = GivenPose.of(Recipe.of(data=data, start=start), "truth" if pose == "truth" else "start")
    dataset = open_dataset(data, load(plugin, block), parse_settings(settings).get("data", {}))
    chosen = select(dataset.names, frames or "all", where="--frames", skipped=dataset.skipped)
    indices = spread(chosen, most)
    folder = OutDir.prepared(out).root
    files = distinct_names([dataset.names[index] for index in indices], taken=[PAGE.partition(".")[0]])
    shown, problems = [], []
    for index in indices:
        name = dataset.names[index]
        try:
            frame = dataset[index]
            camera_from_lidar, at = given.of_frame(frame, index)
            picture, seen = drawn(frame, camera_from_lidar)
        except InputError as problem:
            problems.append(problem)
            click.echo(f"{printable(name)}: not shown: {problem}", err=True)
            continue
        path = folder / f"{files[name]}.png"
        write_png(path, picture)
        shown.append(ShownSweep(name, path.name, at, seen, len(frame.cloud), picture))
        click.echo(f"{printable(name)}: {path}, {seen} of {len(frame.cloud)} points in the image, at {printable(at)}")
    if not shown:
        raise problems[0]
    write_whole(folder / PAGE, sweep_page(data, shown, len(chosen)).encode())
    rest = f" of {len(chosen)}: --frames or --most says others" if len(chosen) > len(indices) else ""
    click.echo(f"wrote {printable(str(Path(folder / PAGE)))} (open it in a browser): {len(shown)} frames{rest}")
    return P2OError.exit_code if problems else 0


def drawn(frame: Frame, camera_from_lidar: Float) -> tuple[UInt8, int]:
    """Return the sweep by range and, where it tells reflectance, by that below, and how many points are in the image.

    Raises InputError where no point is.
    """
    import numpy as np

    from p2o.draw.overlay import before_after
    from p2o.draw.sweep_picture import draw_sweep
    from p2o.frames.direction import check_direction
    from p2o.geometry import se3

    # Says what is wrong with a pose that shows nothing while its inverse shows the sweep.
    check_direction(frame.cloud, frame.camera, camera_from_lidar, name="the pose", where=frame.name)
    xyz = se3.apply(camera_from_lidar, frame.cloud.xyz)
    seen = int(frame.camera.in_image(frame.camera.project(xyz)).sum())
    if not seen:
        front = int((xyz[:, 2] > 0).sum())
        raise InputError(
            "no point of the sweep is in the image at this pose",
            where=frame.name,
            got=f"{front} of {len(xyz)} points lie before the camera" if front else "all points lie behind the camera",
            hint="is it camera_from_lidar, with the camera's x right, y down, z forward?",
        )
    pictures = [draw_sweep(frame.image.rgb, frame.cloud, frame.camera, camera_from_lidar)]
    if frame.cloud.intensity is not None:
        pictures.append(draw_sweep(frame.image.rgb, frame.cloud, frame.camera, camera_from_lidar, "reflectance"))
    titles = ("by range", "by reflectance")
    return (before_after(*pictures, titles=titles) if len(pictures) == 2 else np.asarray(pictures[0])), seen
