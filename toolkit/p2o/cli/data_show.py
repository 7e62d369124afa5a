"""`p2o data show`: draw the sweep on the image at a given pose, without calibration."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import click

from p2o.cli.plugin_options import data_argument, load, plugin_options
from p2o.cli.pose_options import StartCommand, most_option, pose_options
from p2o.errors import InputError, P2OError, printable

if TYPE_CHECKING:
    from p2o.arrays import Float, UInt8
    from p2o.frames.frame import Frame

MOST = 8


@click.command("show", cls=StartCommand)
@data_argument("The data.")
@click.option("--frames", default=None, metavar="SPEC", help="Which frames, as in `p2o run` (default: all).")
@most_option(MOST, 200, "Maximum number of frames, evenly spaced.")
@pose_options
@click.option("--set", "settings", multiple=True, metavar="data.FIELD=VALUE", help="An option.")
@click.option("--out", type=click.Path(), required=True, metavar="DIR", help="Folder of the images and index.html.")
@plugin_options
def command(
    data: str,
    frames: str | None,
    most: int,
    start: str | None,
    pose: str,
    settings: tuple[str, ...],
    out: str,
    **plugins: Any,
) -> int:
    """Draw the sweep on the image at the initial guess, by range and by reflectance: one image per frame, and a page.

    Inspect it before a calibration: objects of the sweep and of the image must coincide up to the error of the initial
    guess. Exit status 2 if a frame cannot be shown.
    """
    from p2o.cli.out_dir import OutDir
    from p2o.draw.overlay import write_png
    from p2o.files.file_names import distinct_names
    from p2o.files.whole_file import write_whole
    from p2o.frames.selection import select, spread
    from p2o.page.sweep_page import PAGE, ShownSweep, sweep_page
    from p2o.run.given_pose import GivenPose
    from p2o.run.recipe import Recipe, open_dataset
    from p2o.run.words import parse_settings

    registry = load(**plugins)
    given = GivenPose.of(Recipe.of(data=data, start=start), "truth" if pose == "truth" else "start", registry)
    dataset = open_dataset(data, registry, parse_settings(settings).get("data", {}))
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
            image, seen = drawn(frame, camera_from_lidar)
        except InputError as problem:
            problems.append(problem)
            click.echo(f"{printable(name)}: not shown: {problem}", err=True)
            continue
        path = folder / f"{files[name]}.png"
        write_png(path, image)
        shown.append(ShownSweep(name, path.name, at, seen, len(frame.cloud), image))
        click.echo(f"{printable(name)}: {path}, {seen} of {len(frame.cloud)} points in the image, at {printable(at)}")
    if not shown:
        raise problems[0]
    write_whole(folder / PAGE, sweep_page(data, shown, len(chosen)).encode())
    rest = f" of {len(chosen)}: select others by --frames or --most" if len(chosen) > len(indices) else ""
    click.echo(f"wrote {printable(folder / PAGE)} (open it in a browser): {len(shown)} frames{rest}")
    return P2OError.exit_code if problems else 0


def drawn(frame: Frame, camera_from_lidar: Float) -> tuple[UInt8, int]:
    """Draw the sweep by range and, if it has intensity, by reflectance below; also return the number of visible points.

    Raises InputError if no point is in the image.
    """
    import numpy as np

    from p2o.draw.overlay import before_after
    from p2o.draw.sweep_image import draw_sweep
    from p2o.frames.direction import check_direction
    from p2o.geometry import se3

    # Raises with an explanation if the pose is probably the inverse of camera_from_lidar.
    check_direction(frame.cloud, frame.camera, camera_from_lidar, name="the pose", where=frame.name)
    xyz = se3.apply(camera_from_lidar, frame.cloud.xyz)
    seen = int(frame.camera.in_image(frame.camera.project(xyz)).sum())
    if not seen:
        front = int((xyz[:, 2] > 0).sum())
        got = f"{front} of {len(xyz)} points are in front of the camera" if front else "all points behind the camera"
        hint = "check that it is camera_from_lidar, with camera axes x right, y down, z forward"
        raise InputError("no point of the sweep is in the image at this pose", where=frame.name, got=got, hint=hint)
    sweep = frame.image.rgb, frame.cloud, frame.camera, camera_from_lidar
    by_range = draw_sweep(*sweep)
    if frame.cloud.intensity is None:
        return np.asarray(by_range), seen
    return before_after(by_range, draw_sweep(*sweep, "reflectance"), titles=("by range", "by reflectance")), seen
