"""Names of frames: which of two is the LiDAR's and which the camera's, and which axes the camera's frame has.

REP 103 and REP 105 of ROS: a sensor's body frame has x forward, y left, z up; the optical frame of a camera, whose name
ends in `_optical` or `_optical_frame`, has x right, y down, z forward, as the camera here.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from typing import Annotated

import numpy as np
from pydantic import Field

from p2o.arrays import Float
from p2o.errors import InputError
from p2o.geometry import se3

FrameName = Annotated[str, Field(min_length=1, max_length=120, pattern=r"^[A-Za-z0-9_][A-Za-z0-9_/.-]*$")]
"""A name that shells, XML, YAML and Python all take as it is."""

_CAMERA = re.compile(r"cam|optical|rgb|image|fisheye")
_LIDAR = re.compile(r"lidar|laser|velo|livox|ouster|hesai|pandar|rslidar|robosense|^os[0-9_]|vlp|hdl|points|scan")
_LINK = re.compile(r"(^|_)link$")

OPTICAL_FROM_LINK = se3.make([[0, -1, 0], [0, 0, -1], [1, 0, 0]])
"""Takes points of a camera's body frame (x forward, y left, z up) to its optical frame."""
OPTICAL_FROM_LINK.flags.writeable = False


def optical_from(camera_frame: str) -> tuple[Float, str]:
    """Return what takes points of a camera's frame of this name to the optical frame, (4, 4), and its axes in words.

    `camera_link`, or a camera's name that ends in `_link` without `optical`, is a body frame; all others are optical.
    """
    last = camera_frame.rpartition("/")[2].lower()
    if "optical" not in last and _LINK.search(last):
        return OPTICAL_FROM_LINK, "x forward, y left, z up (body frame of the camera)"
    return np.eye(4), "x right, y down, z forward (optical frame)"


def is_camera(name: str) -> bool:
    """Return whether a name says that the frame is a camera's."""
    return bool(_CAMERA.search(name.lower()))


def is_lidar(name: str) -> bool:
    """Return whether a name says that the frame is a LiDAR's."""
    return bool(_LIDAR.search(name.lower())) and not is_camera(name)


def chosen(names: Iterable[str], wanted: str | None, sensor: str, where: object) -> str:
    """Return the one frame of the `sensor` ("camera" or "LiDAR") among those of a file; `wanted` is asked for by name.

    Raises InputError where that one is not there, or where names do not tell a single one.
    """
    known = list(dict.fromkeys(names))
    option = f"{sensor.lower()}_frame"
    if wanted:
        if wanted not in known:
            raise InputError(
                f"there is no frame {wanted!r}", where=where, expected=f"{option}: one of {_listed(known)}", got=wanted
            )
        return wanted
    found = [name for name in known if (is_camera if sensor == "camera" else is_lidar)(name)]
    if len(found) != 1:
        raise InputError(
            f"which frame is the {sensor}'s? names tell {len(found) or 'none'}",
            where=where,
            expected=f"one of {_listed(found or known)}",
            hint=f"say it: FILE?{option}=NAME",
        )
    return found[0]


def _listed(names: list[str]) -> str:
    return ", ".join(names[:8]) + (", ..." if len(names) > 8 else "")


def roles(parent: str, child: str, lidar: str | None, camera: str | None, where: object) -> bool:
    """Return whether of two frames the parent is the LiDAR's; `lidar` and `camera` are names that are known.

    Raises InputError where neither those nor the names tell.
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
        raise InputError(
            "which frame is the camera's? their names do not tell",
            where=where,
            expected="one name with camera, the other with lidar",
            got=f"{parent}, {child}",
            hint=f"say it: FILE?camera_frame={child}",
        )
    return signs[True] > signs[False]
