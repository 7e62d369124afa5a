"""Plain text for people and programs: both directions as quaternion, roll pitch yaw and matrix, and the camera.

It is YAML, and what stands below `camera_from_lidar` and `camera` may be pasted into frame.yaml. Read are also other
YAML and JSON files with keys that say their direction (`T_cam_lidar`, `lidar_from_camera`, ...).
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from p2o.arrays import Float
from p2o.formats.calibration import Calibration
from p2o.formats.camera_entry import read_camera
from p2o.formats.format import BOTH, Format, Reading, listed, quaternion_xyzw
from p2o.formats.source import Source
from p2o.formats.transform_names import CAMERA_FROM_LIDAR, LIDAR_FROM_CAMERA, check_same, named_transform
from p2o.geometry import se3
from p2o.geometry.pose_text import read_pose
from p2o.geometry.rpy import rpy_of
from p2o.options import Options

_FORMS = ("rotation_xyzw", "rpy_deg", "rpy_rad", "rotation")


def write(calibration: Calibration, options: Options) -> bytes:
    """Return the text, with what the calibration holds."""
    lines = ["# Calibration of a camera and a LiDAR. Metres, degrees; pixels with centres at whole numbers."]
    if calibration.camera_from_lidar is not None:
        pose = calibration.camera_from_lidar
        lines += [
            "# Axes: camera x right, y down, z forward; LiDAR as its points.",
            "# rpy_deg: roll, pitch, yaw about the fixed axes x, y, z: R = Rz(yaw) Ry(pitch) Rx(roll).",
            "",
            "# Takes points of the LiDAR to the camera: p_camera = R p_lidar + t.",
            *_section("camera_from_lidar", pose),
            "",
            "# Its inverse: t is the place of the camera in the LiDAR's frame.",
            *_section("lidar_from_camera", se3.inverse(pose)),
        ]
    if calibration.camera is not None:
        camera = calibration.camera
        lines += ["", "# A model of COLMAP, with pixel centres at whole numbers.", "camera:"]
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
    """Return whether keys say a direction, or a camera of frame.yaml stands in it."""
    directed = any(key in source.tree for key in (*CAMERA_FROM_LIDAR, *LIDAR_FROM_CAMERA))
    return directed or _camera(source) is not None


def _camera(source: Source) -> Mapping[str, Any] | None:
    """Return the camera of frame.yaml that stands below its key, or is the whole file; None without."""
    for told in (source.tree.get("camera"), source.tree):
        if isinstance(told, Mapping) and {"width", "height"} <= told.keys() and told.keys() & {"params", "K"}:
            return told
    return None


def read(source: Source, reading: Reading) -> Calibration:
    """Return what the file holds; raises InputError where its forms of the transform contradict each other."""
    tree: dict[str, Any] = {}
    remarks: tuple[str, ...] = ()
    for key in (*CAMERA_FROM_LIDAR, *LIDAR_FROM_CAMERA):
        if key in source.tree:
            tree[key], more = _pose(key, source.tree[key], source)
            remarks += more
    found = named_transform(tree, source.path)
    told = _camera(source)
    camera = None if told is None else read_camera(told, source.path)
    return Calibration(camera, None if found is None else found[0], remarks=remarks)


def _pose(name: str, value: Any, source: Source) -> tuple[list[list[float]], tuple[str, ...]]:
    """Return the matrix of a pose that may be told in several forms at once, and remarks."""
    several = isinstance(value, Mapping) and "translation_m" in value
    forms = [key for key in _FORMS if several and key in value]
    if several and "matrix" in value:
        told = {key: part for key, part in value.items() if key not in (*_FORMS, "matrix", "translation_m")}
        parts = [{**told, "translation_m": value["translation_m"], key: value[key]} for key in forms]
        parts = [value["matrix"], *parts]
    elif several and len(forms) > 1:
        parts = [{"translation_m": value["translation_m"], key: value[key]} for key in forms]
    else:
        parts = [value]
    poses = [read_pose(name, part, source.path) for part in parts]
    for (pose, _), form in zip(poses[1:], forms[-len(poses) + 1 :] if len(poses) > 1 else (), strict=True):
        check_same(name, poses[0][0], f"its {form}", pose, source.path)
    return poses[0][0].tolist(), poses[0][1]


FORMAT = Format(
    name="text",
    summary="Plain text (YAML) with both directions as quaternion, rpy and matrix, and the camera.",
    holds=BOTH,
    direction="camera_from_lidar and lidar_from_camera, each under its name",
    suffix=".yaml",
    recognises=recognises,
    read=read,
    write=write,
)
