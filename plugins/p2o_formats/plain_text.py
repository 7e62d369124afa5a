"""Read and write plain YAML text: both directions as quaternion, roll pitch yaw and matrix, and the camera.

The entries `camera_from_lidar` and `camera` can be copied into frame.yaml. Other YAML and JSON files whose keys name
the direction (`T_cam_lidar`, `lidar_from_camera`, ...) are read, too.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from p2o import Float, Options, se3
from p2o.reading import Calibration, Reading, Source, listed, quaternion_xyzw, read_pose, rpy_of

from p2o_formats.camera_entry import read_camera_entry
from p2o_formats.format import Format, comment_lines
from p2o_formats.frame_names import CAMERA_FROM_LIDAR, LIDAR_FROM_CAMERA, check_same, named_transform

_FORMS = ("rotation_xyzw", "rpy_deg", "rpy_rad", "rotation")


def write(calibration: Calibration, options: Options) -> bytes:
    """Return the text with the available parts of the calibration."""
    head = "# Calibration of a camera and a LiDAR. Metres, degrees; pixels with centres at integers."
    lines = [head, *comment_lines(calibration)]
    if calibration.camera_from_lidar is not None:
        pose = calibration.camera_from_lidar
        lines += [
            "# Axes: camera x right, y down, z forward; LiDAR as its points.",
            "# rpy_deg: roll, pitch, yaw about the fixed axes x, y, z: R = Rz(yaw) Ry(pitch) Rx(roll).",
            "",
            "# Maps points of the LiDAR to the camera: p_camera = R p_lidar + t.",
            *_section("camera_from_lidar", pose),
            "",
            "# Its inverse: t is the position of the camera in the LiDAR's frame.",
            *_section("lidar_from_camera", se3.inverse(pose)),
        ]
    if calibration.camera is not None:
        camera = calibration.camera
        lines += ["", "# A camera model of COLMAP, with pixel centres at integers.", "camera:"]
        lines += [f"  model: {camera.model}", f"  width: {camera.width}", f"  height: {camera.height}"]
        lines += [f"  params: {listed(camera.params)}"]
    return ("\n".join(lines) + "\n").encode()


def _section(name: str, pose: Float) -> list[str]:
    return [
        f"{name}:",
        f"  translation_m: {listed(pose[:3, 3])}",
        f"  rotation_xyzw: {listed(quaternion_xyzw(pose))}",
        f"  rpy_deg: {listed(np.degrees(rpy_of(pose[:3, :3])))}",
        "  matrix:",
        *(f"  - {listed(row)}" for row in pose),
    ]


def recognises(source: Source) -> bool:
    """Return whether the file contains a directed transform or a camera of frame.yaml."""
    directed = any(key in source.tree for key in (*CAMERA_FROM_LIDAR, *LIDAR_FROM_CAMERA))
    return directed or _camera(source) is not None


def _camera(source: Source) -> Mapping[str, Any] | None:
    """Return the camera of frame.yaml below the key `camera` or at the top level; None without one."""
    for entry in (source.tree.get("camera"), source.tree):
        if isinstance(entry, Mapping) and {"width", "height"} <= entry.keys() and entry.keys() & {"params", "K"}:
            return entry
    return None


def read(source: Source, reading: Reading) -> Calibration:
    """Return camera and transform of the file; raises InputError if several forms of the transform differ."""
    tree: dict[str, Any] = {}
    remarks: tuple[str, ...] = ()
    for key in (*CAMERA_FROM_LIDAR, *LIDAR_FROM_CAMERA):
        if key in source.tree:
            tree[key], more = _pose(key, source.tree[key], source)
            remarks += more
    entry = _camera(source)
    camera, more = (None, ()) if entry is None else read_camera_entry(entry, source.path)
    pose = named_transform(tree, source.path)[0]
    quaternion = any(states_quaternion(source.tree[key]) for key in tree)
    return Calibration(camera, pose, remarks=remarks + more, quaternion=quaternion)


def states_quaternion(value: Any) -> bool:
    """Return whether a pose of YAML, also below the key of a direction, has a quaternion, but no matrix."""
    if not isinstance(value, Mapping):
        return False
    return ("rotation_xyzw" in value and "matrix" not in value) or any(map(states_quaternion, value.values()))


def _pose(name: str, value: Any, source: Source) -> tuple[list[list[float]], tuple[str, ...]]:
    """Return the matrix of a pose that may be given in several forms, and remarks."""
    several = isinstance(value, Mapping) and "translation_m" in value
    forms = [key for key in _FORMS if several and key in value]
    parts = {"": value}
    if several and ("matrix" in value or len(forms) > 1):
        # Unknown keys beside a matrix are refused with its other forms.
        others = {key: part for key, part in value.items() if "matrix" in value and key not in (*_FORMS, "matrix")}
        parts = {key: {**others, "translation_m": value["translation_m"], key: value[key]} for key in forms}
        parts = {"": value["matrix"], **parts} if "matrix" in value else parts
    (pose, remarks), *poses = [read_pose(name, part, source.path) for part in parts.values()]
    for form, (other, _) in zip(list(parts)[1:], poses, strict=True):
        check_same(name, pose, f"its {form}", other, source.path)
    return pose.tolist(), remarks


FORMAT = Format(
    name="text",
    summary="Plain text (YAML) with both directions as quaternion, rpy and matrix, and the camera.",
    rank=80,
    direction="camera_from_lidar and lidar_from_camera, each under its name",
    recognises=recognises,
    read=read,
    write=write,
)
