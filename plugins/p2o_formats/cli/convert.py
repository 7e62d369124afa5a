"""`p2o convert`: read a calibration file, write it in another format, and report what was written."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import click
from p2o import InputError
from p2o.cli.plugin_options import load, plugin_options
from p2o.reading import printable

if TYPE_CHECKING:
    from p2o import Float, Options
    from p2o.reading import Calibration

    from p2o_formats.format import Format


class _Convert(click.Command):
    """The command, whose help lists the formats that are installed."""

    def format_epilog(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """List the readers of the registry and the formats that are written."""
        from p2o import Kind

        from p2o_formats.formats import WRITTEN

        readers = (offer.name for offer in load((), ()).of_kind(Kind.CALIBRATION_READER))
        with formatter.section("Forms"):
            formatter.write_dl([("read", ", ".join(readers)), ("written", ", ".join(sorted(WRITTEN)))])


@click.command("convert", cls=_Convert)
@click.argument("source", metavar="IN")
@click.argument("target", metavar="OUT")
@click.option("--to", "to", required=True, metavar="FORM[?FIELD=VALUE&...]", help="The format of OUT, and its options.")
@click.option("--from", "form", metavar="FORM", help="The format of IN (default: recognised by its content).")
@click.option("--camera", metavar="FILE[#NAME]", help="Take the camera from this file.")
@plugin_options
def command(
    source: str,
    target: str,
    to: str,
    form: str | None,
    camera: str | None,
    plugin: tuple[str, ...],
    block: tuple[str, ...],
) -> int:
    """Convert a calibration file: a camera, its transform to the LiDAR, or both.

    \b
    p2o convert calib.json camera.launch.py --to "ros2?form=launch&lidar_frame=velodyne"
    p2o convert camchain.yaml#cam1 camera.yaml --to camera-info
    p2o convert tf.sh calib.json --to koide --camera camera_info.yaml
    p2o convert "extrinsic.npy?direction=lidar_from_camera" pose.txt --to text

    IN may select one of several cameras (FILE#NAME) and add what the file lacks (FILE?FIELD=VALUE): lidar_frame,
    camera_frame, direction, width, height. `p2o methods FORM` lists the options of a format.
    """  # noqa: D301  (click wants a real backspace: the examples keep their lines)
    from p2o.reading import expanded, read_calibration, validated, write_whole
    from p2o.run.words import split_name

    from p2o_formats.formats import WRITTEN, format_named

    registry = load(plugin, block)
    # Same syntax as --data and --export, but without a path: NAME?FIELD=VALUE.
    name, _, query = to.partition("?")
    chosen = format_named(name, "--to")
    values = split_name(f"{name}:?{query}")[1] if query else {}
    options = validated(chosen.options, values, chosen.name, where="--to", noun=f"option of {chosen.name}")
    if chosen.write is None:
        expected = f"one of {', '.join(WRITTEN)}"
        raise InputError(f"{chosen.name} can only be read", where="--to", expected=expected, got=chosen.name)
    calibration = read_calibration(source, "IN", form=form, registry=registry)
    if camera is not None:
        other = read_calibration(camera, "--camera", registry=registry)
        remarks = (*calibration.remarks, *other.remarks)
        calibration = replace(calibration, camera=other.intrinsics(camera), remarks=remarks)
    write_whole(expanded(target), chosen.written(calibration, options, source))
    click.echo(_described(calibration, chosen, options, source, target))
    return 0


def _described(calibration: Calibration, chosen: Format, options: Options, source: str, target: str) -> str:
    """Return a description of the written file, in lines."""
    from p2o.reading import CAMERA, EXTRINSIC, unit_remark

    lines = [f"{target}: {chosen.name}, {chosen.summary}"]
    stored = chosen.holds & calibration.parts
    if EXTRINSIC in stored and calibration.camera_from_lidar is not None:
        pose = calibration.camera_from_lidar
        forward, up = _spaced(pose[2, :3], 3), _spaced(-pose[1, :3], 3)
        lines.append(f"  camera position in the LiDAR's frame: {_spaced(-pose[:3, :3].T @ pose[:3, 3], 4)} m")
        lines.append(f"  camera axes in the LiDAR's frame: optical axis {forward}, up {up}")
        lines += [f"  note: {text}" for text in unit_remark(pose, source)]
        lines.append(f"  stored transform: {_direction(chosen, options)}")
        if calibration.lidar_frame and calibration.camera_frame:
            lines.append(f"  frames of {source}: lidar {calibration.lidar_frame}, camera {calibration.camera_frame}")
    if CAMERA in stored and calibration.camera is not None:
        camera = calibration.camera
        lines.append(f"  camera: {camera.width}x{camera.height} px {camera.model}")
    names = {key: value for key, value in options.model_dump().items() if key.endswith("_frame")}
    if names:
        lines.append("  frames: " + ", ".join(f"{key.removesuffix('_frame')} {value}" for key, value in names.items()))
    unstored = calibration.parts - stored
    lines += [f"  left out: the {part} of {source}, which {chosen.name} cannot store" for part in unstored]
    lines += [f"  note: {remark}" for remark in calibration.remarks]
    return "\n".join(printable(line) for line in lines)


def _spaced(values: Float, places: int) -> str:
    return " ".join(f"{float(value) + 0.0:.{places}f}" for value in values.round(places))


def _direction(chosen: Format, options: Options) -> str:
    """Return which transform a file stores, given the options of its format."""
    values = options.model_dump()
    if "direction" in values:
        return str(values["direction"])
    if "parent" in values:
        return f"{'lidar_from_camera' if values['parent'] == 'lidar' else 'camera_from_lidar'}, parent from child"
    return chosen.direction
