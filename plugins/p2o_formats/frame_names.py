"""Sensors and axes of frames, and directions of transforms, inferred from their names.

REP 103 and REP 105 of ROS: a sensor's body frame has x forward, y left, z up; the optical frame of a camera, whose name
ends in `_optical` or `_optical_frame`, has x right, y down, z forward, like cameras of p2o.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from p2o import Float, InputError, se3
from p2o.reading import read_pose

_CAMERA = re.compile(r"cam|optical|rgb|image|fisheye")
_LIDAR = re.compile(r"lidar|laser|velo|livox|ouster|hesai|pandar|rslidar|robosense|^os[0-9_]|vlp|hdl|points|scan")
_LINK = re.compile(r"(^|_)link$")

OPTICAL_FROM_LINK = se3.make([[0, -1, 0], [0, 0, -1], [1, 0, 0]])
"""Transform (4, 4) from a camera's body frame (x forward, y left, z up) to its optical frame."""
OPTICAL_FROM_LINK.flags.writeable = False


def optical_from(camera_frame: str) -> tuple[Float, str]:
    """Return optical_from_camera (4, 4) of a camera frame with this name, and a description of its axes.

    `camera_link`, or a camera name that ends in `_link` without `optical`, is a body frame; all others are optical.
    """
    last = camera_frame.rpartition("/")[2].lower()
    if "optical" not in last and _LINK.search(last):
        return OPTICAL_FROM_LINK, "x forward, y left, z up (body frame of the camera)"
    return np.eye(4), "x right, y down, z forward (optical frame)"


def is_camera(name: str) -> bool:
    """Return whether a frame name denotes a camera."""
    return bool(_CAMERA.search(name.lower()))


def is_lidar(name: str) -> bool:
    """Return whether a frame name denotes a LiDAR."""
    return bool(_LIDAR.search(name.lower())) and not is_camera(name)


def chosen(names: Iterable[str], wanted: str | None, sensor: str, where: object) -> str:
    """Return the frame of the `sensor` ("camera" or "LiDAR") among the frame names of a file: `wanted`, if given.

    Raises InputError if `wanted` is missing, or if not exactly one name denotes the sensor.
    """
    known = list(dict.fromkeys(names))
    option = f"{sensor.lower()}_frame"
    if wanted:
        if wanted not in known:
            fault = f"the file has no frame {wanted!r}"
            raise InputError(fault, where=where, expected=f"{option}: one of {_listed(known)}", got=wanted)
        return wanted
    matching = [name for name in known if (is_camera if sensor == "camera" else is_lidar)(name)]
    if len(matching) != 1:
        fault = f"{len(matching) or 'no'} frame names denote the {sensor}"
        hint = f"name it: FILE?{option}=NAME"
        raise InputError(fault, where=where, expected=f"one of {_listed(matching or known)}", hint=hint)
    return matching[0]


def _listed(names: list[str]) -> str:
    return ", ".join(names[:8]) + (", ..." if len(names) > 8 else "")


def roles(parent: str, child: str, lidar: str | None, camera: str | None, where: object) -> bool:
    """Return whether of two frames the parent is the LiDAR; `lidar` and `camera` are the known names, or None.

    Raises InputError if neither these nor the frame names decide it.
    """
    for name in (lidar, camera):
        if name is not None and name not in (parent, child):
            raise InputError(f"there is no frame {name!r}", where=where, expected=f"{parent} or {child}", got=name)
    if lidar is not None or camera is not None:
        if lidar == camera:
            raise InputError("one frame cannot be both LiDAR and camera", where=where, got=lidar)
        return parent == lidar or child == camera
    signs = {True: is_lidar(parent) + is_camera(child), False: is_camera(parent) + is_lidar(child)}
    if signs[True] == signs[False]:
        fault, hint = "the frame names do not determine which one is the camera", f"FILE?camera_frame={child}"
        expected = "one name with camera, the other with lidar"
        raise InputError(fault, where=where, expected=expected, got=f"{parent}, {child}", hint=f"name it: {hint}")
    return signs[True] > signs[False]


CAMERA_FROM_LIDAR = ("camera_from_lidar", "T_cam_lidar", "T_camera_lidar", "lidar_to_camera")
LIDAR_FROM_CAMERA = ("lidar_from_camera", "T_lidar_cam", "T_lidar_camera", "camera_to_lidar")
"""`T_b_a` and `b_from_a` map points of a to b (Kalibr, Koide, p2o); "a to b" does the same."""


def named_transform(tree: Mapping[str, Any], where: Path, within: str = "") -> tuple[Float | None, tuple[str, ...]]:
    """Return camera_from_lidar (4, 4) of the key that states it or its inverse, and remarks; (None, ()) without one.

    Raises InputError for a value that is not a rigid transform, and if two keys contradict each other.
    """
    named: list[tuple[str, Float, tuple[str, ...]]] = []
    for key in (*CAMERA_FROM_LIDAR, *LIDAR_FROM_CAMERA):
        if key in tree:
            pose, remarks = read_pose(f"{within}.{key}" if within else key, tree[key], where)
            named.append((key, se3.inverse(pose) if key in LIDAR_FROM_CAMERA else pose, remarks))
            check_same(*named[0][:2], *named[-1][:2], where)
    return named[0][1:] if named else (None, ())


def check_same(name: str, pose: Float, other_name: str, other: Float, where: object) -> None:
    """Raise InputError where two forms of one camera_from_lidar (4, 4) in a file are not the same transform."""
    between = se3.inverse(pose) @ other
    angle_deg, shift_m = se3.angle_deg(between), se3.distance_m(between)
    # Rounded to four digits, as people write them.
    if angle_deg > 0.02 or shift_m > 1e-3 * (1 + se3.distance_m(pose)):
        expected = "the same transform in all forms"
        got = f"{angle_deg:.3g} deg and {shift_m:.3g} m between them"
        raise InputError(f"{name} and {other_name} are not the same transform", where=where, expected=expected, got=got)
