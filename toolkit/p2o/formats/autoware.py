"""Autoware's sensor_kit_calibration.yaml: places of sensors on the kit, as x y z (m) and roll pitch yaw (rad).

Source: the files of Autoware's *_sensor_kit_description packages. Below the name of the base frame stands each child
with its place: base_from_child, with R = Rz(yaw) Ry(pitch) Rx(roll). Cameras are told by their body frame
`camera0/camera_link` (x forward, y left, z up); the optical frame hangs below it in the camera's own URDF.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from p2o.arrays import Float
from p2o.errors import InputError
from p2o.formats.calibration import Calibration
from p2o.formats.format import ONLY_EXTRINSIC, Format, Reading, digits, plain
from p2o.formats.frame_names import FrameName, chosen, is_camera, is_lidar, optical_from
from p2o.formats.source import Source
from p2o.geometry import se3
from p2o.geometry.pose_text import read_pose
from p2o.geometry.rpy import rotation_of, rpy_of
from p2o.options import Options, field

_KEYS = ("x", "y", "z", "roll", "pitch", "yaw")


class AutowareOptions(Options):
    """The names of the kit's frames, and where the LiDAR is on it."""

    base_frame: FrameName = field("sensor_kit_base_link", help="The frame that places count from.")
    lidar_frame: FrameName = field("velodyne_top_base_link", help="Name of the LiDAR's frame.")
    camera_frame: FrameName = field(
        "camera0/camera_link", help="Name of the camera's frame; one that ends in _link is its body frame, x forward."
    )
    base_from_lidar: tuple[float, float, float, float, float, float] = field(
        (0.0, 0.0, 0.0, 0.0, 0.0, 0.0), help="Place of the LiDAR on the kit: x, y, z in m, roll, pitch, yaw in rad."
    )


def write(calibration: Calibration, options: AutowareOptions) -> bytes:
    """Return the file: base_from_lidar as given, and base_from_camera that follows."""
    place, angles = options.base_from_lidar[:3], options.base_from_lidar[3:]
    base_from_lidar = se3.check_rigid("base_from_lidar", se3.make(rotation_of(*angles), place))
    optical_from_camera, axes = optical_from(options.camera_frame)
    base_from_camera = base_from_lidar @ se3.inverse(calibration.extrinsic()) @ optical_from_camera
    lines = [
        f"# Autoware's sensor kit: places are {options.base_frame} from child. Metres; roll, pitch, yaw in rad",
        "# about fixed axes, R = Rz(yaw) Ry(pitch) Rx(roll).",
        f"# Axes of {options.camera_frame}: {axes}. Axes of {options.lidar_frame}: those of its points.",
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
    """Return whether frames with x y z roll pitch yaw stand below the name of another frame."""
    return any(_children(value) for value in source.tree.values())


def read(source: Source, reading: Reading) -> Calibration:
    """Return camera_from_lidar of the camera and the LiDAR that names tell, or that are asked for.

    Raises InputError where the file has no such pair below one base, or their places are no transforms.
    """
    where = source.path
    camera = reading.camera_frame or reading.name or None
    bases = {base: _children(value) for base, value in source.tree.items()}
    fitting = [children for children in bases.values() if _sensors(children) == {True, False}]
    children = fitting[0] if len(fitting) == 1 else {name: value for c in bases.values() for name, value in c.items()}
    camera_name = chosen(children, camera, "camera", where)
    lidar_name = chosen([name for name in children if name != camera_name], reading.lidar_frame, "LiDAR", where)
    pair = [group for group in bases.values() if camera_name in group and lidar_name in group]
    if len(pair) != 1:
        raise InputError(
            f"{camera_name} and {lidar_name} do not stand below one base frame",
            where=where,
            expected="both on the sensor kit",
        )
    base_from_camera, remarks = _place(camera_name, pair[0][camera_name], source)
    base_from_lidar, more = _place(lidar_name, pair[0][lidar_name], source)
    optical_from_camera, _ = optical_from(camera_name)
    pose = optical_from_camera @ se3.inverse(base_from_camera) @ base_from_lidar
    return Calibration(None, pose, lidar_name, camera_name, remarks + more)


def _children(value: Any) -> dict[str, Mapping[str, Any]]:
    if not isinstance(value, Mapping):
        return {}
    return {
        str(name): child for name, child in value.items() if isinstance(child, Mapping) and set(_KEYS) <= child.keys()
    }


def _sensors(children: Mapping[str, Any]) -> set[bool]:
    """Return {True, False} where both a camera and a LiDAR are among the names."""
    return {is_camera(name) for name in children if is_camera(name) or is_lidar(name)}


def _place(name: str, child: Mapping[str, Any], source: Source) -> tuple[Float, tuple[str, ...]]:
    values = [child[key] for key in _KEYS]
    told = {"translation_m": values[:3], "rpy_rad": values[3:]}
    pose, remarks = read_pose(name, told, source.path)
    return np.asarray(pose), remarks


FORMAT = Format(
    name="autoware",
    summary="Autoware's sensor_kit_calibration.yaml: x y z roll pitch yaw of camera and LiDAR on the kit.",
    holds=ONLY_EXTRINSIC,
    needs=ONLY_EXTRINSIC,
    direction="base from child: sensor_kit_base_link from camera0/camera_link, and from the LiDAR",
    suffix=".yaml",
    options=AutowareOptions,
    recognises=recognises,
    read=read,
    write=write,
)
