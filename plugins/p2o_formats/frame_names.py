"""Sensors and axes of frames, and directions of transforms, inferred from their names.

REP 103 and REP 105 of ROS: a sensor's body frame has x forward, y left, z up; the optical frame of a camera, whose name
ends in `_optical` or `_optical_frame`, has x right, y down, z forward, like cameras of p2o.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from p2o import Float, InputError, se3
from p2o.reading import read_pose

_CAMERA = re.compile(
    r"cam|optical|rgb|image|fisheye|realsense|kinect|flir|basler|stereo|thermal|(?<![a-z])(zed|oak|ptz|d4\d\d)(?![a-z])"
)
_LIDAR = re.compile(
    r"lidar|laser|velo(?!c)|livox|ouster|hesai|pandar|robosense|innoviz|innovusion|seyond|luminar|aeva|cepton|ibeo"
    r"|helios|bpearl|vlp|hdl|vls|points|scan|(?<![a-z])(os[0-9_]|avia(?![a-z])|(mid|xt|qt|at|rs)[-_]?[0-9])"
)
# Other sensors and frames of the world, such as camera_imu_frame, and camera_init of LOAM.
_NEITHER = re.compile(
    r"(?<![a-z])(imu|odom|odometry|map|world|init|pose)(?![a-z])|gyro|accel|gps|gnss|radar|sonar|screw|mount(?!ed)|\$"
)
_LINK = re.compile(r"(^|_)link$")
_SIDE = re.compile(r"left|right|front|rear|back|top|bottom|upper|lower|(?<!\d)\d(?!\d)")
_BODY = re.compile(r"(^|[_/])(base|body|link|housing)$")

OPTICAL_FROM_LINK = se3.make([[0, -1, 0], [0, 0, -1], [1, 0, 0]])
"""Transform (4, 4) from a camera's body frame (x forward, y left, z up) to its optical frame."""
OPTICAL_FROM_LINK.flags.writeable = False


def optical_from(camera_frame: str, axes: str | None = None) -> tuple[Float, str]:
    """Return optical_from_camera (4, 4) of a camera frame, and a description of its axes.

    `axes` is "optical", "body", or None: then the name decides (`has_body_axes`).
    """
    if axes == "body" or (axes is None and has_body_axes(camera_frame)):
        return OPTICAL_FROM_LINK, "x forward, y left, z up (body frame of the camera)"
    return np.eye(4), "x right, y down, z forward (optical frame)"


def has_body_axes(camera_frame: str) -> bool:
    """Return whether a camera frame is a body frame by its name: it ends in `_link`, without `optical`."""
    return bool(_LINK.search(_last(camera_frame))) and not is_optical(camera_frame)


def axes_remark(camera_frame: str, axes: str | None, option: str, where: object) -> tuple[str, ...]:
    """Return a remark on the axes of a frame without `optical` in its name if no option states them, else nothing.

    `option` is how the user states them, without the value; `where` names the source.
    """
    if axes is not None or is_optical(camera_frame):
        return ()
    other = "optical" if has_body_axes(camera_frame) else "body"
    assumed = optical_from(camera_frame)[1]
    return (f"{where}: the axes of frame {camera_frame} are assumed to be {assumed}; if not: {option}={other}",)


def is_optical(name: str) -> bool:
    """Return whether a frame name denotes the optical frame of a camera."""
    return "optical" in _last(name)


def is_body(name: str) -> bool:
    """Return whether a frame name denotes the body or the base of a sensor."""
    return bool(_BODY.search(name.lower()))


def may_be_body_of(name: str, other: str) -> bool:
    """Return whether two names can be of one sensor: `other` has the sides and numbers of the body `name`."""
    return set(_SIDE.findall(name.lower())) <= set(_SIDE.findall(other.lower()))


def is_camera(name: str) -> bool:
    """Return whether a frame name denotes a camera."""
    return bool(_CAMERA.search(name.lower())) and not _NEITHER.search(name.lower())


def is_lidar(name: str) -> bool:
    """Return whether a frame name denotes a LiDAR."""
    return bool(_LIDAR.search(name.lower())) and not _CAMERA.search(name.lower()) and not _NEITHER.search(name.lower())


def _last(name: str) -> str:
    return name.rpartition("/")[2].lower()


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
