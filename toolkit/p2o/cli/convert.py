"""`p2o convert`: one calibration file to another, and what was read and written in words."""

from __future__ import annotations

from typing import TYPE_CHECKING

import click

from p2o.errors import InputError, printable

if TYPE_CHECKING:
    from p2o.arrays import Float
    from p2o.formats.calibration import Calibration
    from p2o.formats.format import Format
    from p2o.options import Options


@click.command("convert")
@click.argument("source", metavar="IN")
@click.argument("target", metavar="OUT")
@click.option("--to", "to", required=True, metavar="FORM[?FIELD=VALUE&...]", help="The form of OUT, and its options.")
@click.option("--from", "form", metavar="FORM", help="The form of IN (default: told by its content).")
@click.option("--camera", metavar="FILE[#NAME]", help="Take the camera from this file.")
def command(source: str, target: str, to: str, form: str | None, camera: str | None) -> int:
    """Convert a calibration file: a camera, its transform to the LiDAR, or both.

    \b
    p2o convert calib.json camera.launch.py --to "ros2?form=launch&lidar_frame=velodyne"
    p2o convert camchain.yaml#cam1 camera.yaml --to camera-info
    p2o convert tf.sh calib.json --to koide --camera camera_info.yaml
    p2o convert "extrinsic.npy?direction=lidar_from_camera" pose.txt --to text

    Forms: ros2, autoware, koide, opencalib, opencalib-camera, kalibr, colmap, colmap-cameras, opencv, camera-info,
    kitti, npy, matrix, text; json (results of p2o) is read only. `p2o methods NAME` lists the options of a form.
    IN may name one of several cameras (FILE#NAME), and say what the file does not (FILE?FIELD=VALUE): lidar_frame,
    camera_frame, direction, width, height.
    """  # noqa: D301  (click wants a real backspace: the examples keep their lines)
    from p2o.files.input_file import expanded
    from p2o.files.whole_file import write_whole
    from p2o.formats.files import format_named, joined, read_words
    from p2o.host.validation import validated
    from p2o.run.words import split_data

    # As in --data and --export, but without a path: NAME?FIELD=VALUE.
    name, _, query = to.partition("?")
    chosen = format_named(name, "--to")
    values = split_data(f"{name}:?{query}")[1] if query else {}
    options = validated(chosen.options, values, chosen.name, where="--to", noun=f"option of {chosen.name}")
    if chosen.write is None:
        raise InputError(f"{chosen.name} is read, not written", where="--to", expected="another form", got=chosen.name)
    found = read_words(source, "IN", form=form)
    if camera is not None:
        found = joined(found, read_words(camera, "--camera"), camera)
    path = expanded(target)
    write_whole(path, chosen.written(found, options, source))
    click.echo(_said(found, chosen, options, source, target))
    return 0


def _said(found: Calibration, chosen: Format, options: Options, source: str, target: str) -> str:
    """Return what was written, in lines."""
    from p2o.formats.calibration import CAMERA, EXTRINSIC

    lines = [f"{target}: {chosen.name}, {chosen.summary}"]
    held = chosen.holds & found.held
    if EXTRINSIC in held and found.camera_from_lidar is not None:
        pose = found.camera_from_lidar
        looks, up = _spaced(pose[2, :3], 3), _spaced(-pose[1, :3], 3)
        lines.append(f"  the camera stands at {_spaced(-pose[:3, :3].T @ pose[:3, 3], 4)} m in the LiDAR's frame")
        lines.append(f"  it looks along {looks} of the LiDAR's axes, and its up is {up}")
        lines.append(f"  the file's numbers are {_direction(chosen, options)}")
    if CAMERA in held and found.camera is not None:
        camera = found.camera
        lines.append(f"  camera: {camera.width}x{camera.height} px {camera.model}")
    names = {key: value for key, value in options.model_dump().items() if key.endswith("_frame")}
    if names:
        lines.append("  frames: " + ", ".join(f"{key.removesuffix('_frame')} {value}" for key, value in names.items()))
    lines += [f"  left out: the {part} of {source}, which {chosen.name} has no room for" for part in found.held - held]
    lines += [f"  note: {remark}" for remark in found.remarks]
    return "\n".join(printable(line) for line in lines)


def _spaced(values: Float, places: int) -> str:
    return " ".join(f"{float(value) + 0.0:.{places}f}" for value in values.round(places))


def _direction(chosen: Format, options: Options) -> str:
    """Return which transform the numbers of a file are, as its options have it."""
    said = options.model_dump()
    if "direction" in said:
        return str(said["direction"])
    if "parent" in said:
        return f"{'lidar_from_camera' if said['parent'] == 'lidar' else 'camera_from_lidar'}, parent from child"
    return chosen.direction
