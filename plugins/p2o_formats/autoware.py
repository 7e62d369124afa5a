"""Read and write Autoware's sensor_kit_calibration.yaml: poses of sensors as x y z (m) and roll pitch yaw (rad).

Source: the files of Autoware's *_sensor_kit_description packages. The key of the base frame contains one entry per
child frame with base_from_child, R = Rz(yaw) Ry(pitch) Rx(roll). Cameras are given by their body frame
`camera0/camera_link` (x forward, y left, z up); the URDF of the camera defines its optical frame relative to it.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from typing import Any

from p2o import Options, field, se3
from p2o.reading import Calibration, FrameName, Reading, Source, digits, plain, read_pose, rotation_of, rpy_of

from p2o_formats.format import FRAMES, ONLY_EXTRINSIC, Format, comment_lines
from p2o_formats.frame_names import optical_from
from p2o_formats.frame_tree import Edge, calibration_of

_KEYS = ("x", "y", "z", "roll", "pitch", "yaw")


class AutowareOptions(Options):
    """Names of the frames, and the pose of the LiDAR in the base frame."""

    base_frame: FrameName = field("sensor_kit_base_link", help="Name of the base frame of all poses.")
    lidar_frame: FrameName = field("velodyne_top_base_link", help="Name of the LiDAR's frame.")
    camera_frame: FrameName = field(
        "camera0/camera_link", help="Name of the camera's frame; a name that ends in _link is a body frame, x forward."
    )
    base_from_lidar: tuple[float, float, float, float, float, float] = field(
        (0.0, 0.0, 0.0, 0.0, 0.0, 0.0), help="Pose of the LiDAR in the base frame: x y z in m, roll pitch yaw in rad."
    )


def write(calibration: Calibration, options: AutowareOptions) -> bytes:
    """Return the file with base_from_lidar of the options and the resulting base_from_camera."""
    place, angles = options.base_from_lidar[:3], options.base_from_lidar[3:]
    base_from_lidar = se3.check_rigid("base_from_lidar", se3.make(rotation_of(*angles), place))
    optical_from_camera, axes = optical_from(options.camera_frame)
    base_from_camera = base_from_lidar @ se3.inverse(calibration.extrinsic()) @ optical_from_camera
    lines = [
        f"# Autoware's sensor kit: places are {options.base_frame} from child. Metres; roll, pitch, yaw in rad",
        "# about fixed axes, R = Rz(yaw) Ry(pitch) Rx(roll).",
        f"# Axes of {options.camera_frame}: {axes}. Axes of {options.lidar_frame}: those of its points.",
        *comment_lines(calibration),
        f"{options.base_frame}:",
    ]
    for name, values in (
        (options.camera_frame, (*base_from_camera[:3, 3], *rpy_of(base_from_camera[:3, :3]))),
        (options.lidar_frame, options.base_from_lidar),
    ):
        lines.append(f"  {name}:")
        lines += [f"    {key}: {digits(value)}" for key, value in zip(_KEYS, plain(values), strict=True)]
    return ("\n".join(lines) + "\n").encode()


def recognises(source: Source) -> bool:
    """Return whether the file contains frames with x y z roll pitch yaw below another frame."""
    return any(_children(value) for value in source.tree.values())


def read(source: Source, reading: Reading) -> Calibration:
    """Return camera_from_lidar of the camera and the LiDAR that the reading or the frame names select.

    Raises InputError if no base frame connects the sensors, or if their poses are not rigid transforms.
    """
    if reading.camera_frame is None and reading.name:
        reading = reading.model_copy(update={"camera_frame": reading.name})
    transforms = [
        Edge(str(base), name, partial(read_pose, name, entry, source.path))
        for base, value in source.tree.items()
        for name, entry in _children(value).items()
    ]
    return calibration_of(transforms, reading, source.path)


def _children(value: Any) -> dict[str, dict[str, list[Any]]]:
    """Return the poses of the children of a frame by name, in the form of `read_pose`."""
    items = value.items() if isinstance(value, Mapping) else ()
    children = {str(name): child for name, child in items if isinstance(child, Mapping) and set(_KEYS) <= child.keys()}
    parts = {"translation_m": _KEYS[:3], "rpy_rad": _KEYS[3:]}
    return {name: {key: [c[k] for k in keys] for key, keys in parts.items()} for name, c in children.items()}


FORMAT = Format(
    name="autoware",
    summary="Autoware's sensor_kit_calibration.yaml: x y z roll pitch yaw of camera and LiDAR on the kit.",
    rank=42,
    holds=ONLY_EXTRINSIC,
    direction="base from child: sensor_kit_base_link from camera0/camera_link, and from the LiDAR",
    options=AutowareOptions,
    fields=FRAMES | {"name", "camera_axes"},
    recognises=recognises,
    read=read,
    write=write,
)
