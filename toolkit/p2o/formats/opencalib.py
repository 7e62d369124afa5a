"""JSON files of OpenCalib (PJLab-ADG, SensorsCalibration): one file for the extrinsic, one for the camera.

Source: the samples and loaders of its `lidar2camera` tools. `param.sensor_calib.data` of
"LIDAR-to-CAMERA-extrinsic" is camera_from_lidar (4, 4), in metres; `cam_K` and `cam_dist` of "CAMERA-intrinsic" are
OpenCV's K and k1 k2 p1 p2 [k3], and four coefficients of `cv::fisheye` where `device_type` says fisheye.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

from p2o.errors import InputError
from p2o.formats.calibration import Calibration
from p2o.formats.camera_entry import without_skew
from p2o.formats.format import ONLY_CAMERA, ONLY_EXTRINSIC, Format, Reading, matrix_rows, size_of
from p2o.formats.frame_names import FrameName, roles
from p2o.formats.lens import Lens, lens_of, no_word_for
from p2o.formats.source import Source
from p2o.geometry import se3
from p2o.geometry.pose_text import numbers, read_pose
from p2o.options import Options, field


class OpenCalibOptions(Options):
    """Names of the sensors in the file."""

    lidar_frame: FrameName = field("top_center_lidar", help="Name of the LiDAR.")
    camera_frame: FrameName = field("center_camera", help="Name of the camera.")


def write(calibration: Calibration, options: OpenCalibOptions) -> bytes:
    """Return the JSON text of the extrinsic."""
    lidar, camera = options.lidar_frame, options.camera_frame
    tree = {
        f"{lidar}-to-{camera}-extrinsic": {
            "sensor_name": lidar,
            "target_sensor_name": camera,
            "device_type": "relational",
            "param_type": "extrinsic",
            "comment": "data takes points of the LiDAR to the camera (x right, y down, z forward), in metres",
            "param": {"time_lag": 0, "sensor_calib": _matrix(calibration.extrinsic())},
        }
    }
    return (json.dumps(tree, indent=2, allow_nan=False) + "\n").encode()


def write_camera(calibration: Calibration, options: OpenCalibOptions) -> bytes:
    """Return the JSON text of the camera; raises InputError for models that are not OpenCV's with five numbers."""
    camera = calibration.intrinsics()
    lens = lens_of(camera, "opencalib-camera")
    if lens.model != "plumb_bob":
        raise no_word_for(camera, "opencalib-camera", "a pinhole with k1 k2 p1 p2 k3")
    name = options.camera_frame
    tree = {
        f"{name}-intrinsic": {
            "sensor_name": name,
            "target_sensor_name": name,
            "device_type": "camera",
            "param_type": "intrinsic",
            "comment": "pixels, centres at whole numbers; cam_dist is k1 k2 p1 p2 k3 of OpenCV",
            "param": {
                "img_dist_w": lens.width,
                "img_dist_h": lens.height,
                "cam_K": _matrix(lens.matrix),
                "cam_dist": _matrix([lens.coefficients]),
            },
        }
    }
    return (json.dumps(tree, indent=2, allow_nan=False) + "\n").encode()


def _matrix(values: Any) -> dict[str, Any]:
    rows = matrix_rows(values)
    return {"rows": len(rows), "cols": len(rows[0]), "type": 6, "continuous": True, "data": rows}


def _entries(source: Source, kind: str) -> dict[str, Mapping[str, Any]]:
    """Return the sensors of a kind of file by their key."""
    return {
        str(key): value
        for key, value in source.tree.items()
        if isinstance(value, Mapping)
        and isinstance(value.get("param"), Mapping)
        and value.get("param_type", kind) == kind
        and ("sensor_calib" in value["param"]) == (kind == "extrinsic")
    }


def recognises(source: Source) -> bool:
    """Return whether it holds an extrinsic of OpenCalib."""
    return bool(_entries(source, "extrinsic"))


def recognises_camera(source: Source) -> bool:
    """Return whether it holds a camera of OpenCalib."""
    return any("cam_K" in value["param"] for value in _entries(source, "intrinsic").values())


def read(source: Source, reading: Reading) -> Calibration:
    """Return the extrinsic; raises InputError where there is not one, or its sensors are not a LiDAR and a camera."""
    key, entry = _only(_entries(source, "extrinsic"), reading, source)
    names = (entry.get("sensor_name"), entry.get("target_sensor_name"))
    if not all(isinstance(name, str) for name in names):
        parts = key.removesuffix("-extrinsic").split("-to-")
        names = (parts[0], parts[-1])
    sensor, target = (str(name)[:120] for name in names)
    to_camera = roles(sensor, target, reading.lidar_frame, reading.camera_frame, source.path)
    pose, remarks = read_pose(f"{key}.sensor_calib", _data(entry, "sensor_calib", source), source.path)
    lidar, camera = (sensor, target) if to_camera else (target, sensor)
    return Calibration(None, pose if to_camera else se3.inverse(pose), lidar, camera, remarks)


def read_camera(source: Source, reading: Reading) -> Calibration:
    """Return the camera; raises InputError for what is no camera."""
    key, entry = _only(_entries(source, "intrinsic"), reading, source)
    matrix = numbers(_data(entry, "cam_K", source), (3, 3))
    d = numbers(_data(entry, "cam_dist", source), (1, 4), (1, 5), (4, 1), (5, 1), (1, 8))
    if matrix is None or not without_skew(matrix) or d is None:
        raise InputError(
            f"{key} is no camera", where=source.path, expected="cam_K 3x3 without skew, cam_dist of 4 or 5"
        )
    param = entry["param"]
    size = size_of(param.get("img_dist_w"), param.get("img_dist_h"), reading, source.path)
    fisheye = "fisheye" in str(entry.get("device_type", "")).lower()
    model = "equidistant" if fisheye else "plumb_bob" if d.size < 8 else "rational_polynomial"
    fx, fy, cx, cy = (float(matrix[at]) for at in ((0, 0), (1, 1), (0, 2), (1, 2)))
    lens = Lens(*size, fx, fy, cx, cy, model, tuple(d.ravel().tolist()))
    return Calibration(lens.camera(), camera_frame=str(entry.get("sensor_name", "")))


def _only(entries: Mapping[str, Mapping[str, Any]], reading: Reading, source: Source) -> tuple[str, Mapping[str, Any]]:
    found = {key: value for key, value in entries.items() if not reading.name or reading.name in key}
    if len(found) != 1:
        raise InputError(
            f"{len(found) or 'none'} of the entries can be the one",
            where=source.path,
            expected="one, or FILE#NAME",
            got=", ".join(list(entries)[:6]),
        )
    return next(iter(found.items()))


def _data(entry: Mapping[str, Any], key: str, source: Source) -> Any:
    value = entry["param"].get(key)
    if not isinstance(value, Mapping) or "data" not in value:
        raise InputError(f"param.{key}.data is missing", where=source.path, expected="rows of numbers")
    return value["data"]


FORMAT = Format(
    name="opencalib",
    summary="Extrinsic JSON of OpenCalib (SensorsCalibration): LIDAR-to-CAMERA-extrinsic.",
    holds=ONLY_EXTRINSIC,
    needs=ONLY_EXTRINSIC,
    direction="camera_from_lidar (LIDAR-to-CAMERA)",
    suffix=".json",
    options=OpenCalibOptions,
    recognises=recognises,
    read=read,
    write=write,
)

CAMERA_FORMAT = Format(
    name="opencalib-camera",
    summary="Camera JSON of OpenCalib (SensorsCalibration): CAMERA-intrinsic.",
    holds=ONLY_CAMERA,
    needs=ONLY_CAMERA,
    direction="",
    suffix=".json",
    options=OpenCalibOptions,
    recognises=recognises_camera,
    read=read_camera,
    write=write_camera,
)
