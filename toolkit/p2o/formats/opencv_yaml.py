"""YAML of OpenCV's cv::FileStorage: camera_matrix, distortion_coefficients, and camera_from_lidar.

Source: cv::FileStorage ("%YAML:1.0", `!!opencv-matrix`) with the keys of OpenCV's calibration sample. OpenCV has no key
for a LiDAR; p2o writes `camera_from_lidar` (4, 4), and reads it and other keys that say their direction. The files of
Autoware.AI's calibration toolkit are read too: CameraMat, DistCoeff, ImageSize, and CameraExtrinsicMat, which is
lidar_from_camera there (its publisher takes it as the transform of the camera below the LiDAR).
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from p2o.errors import InputError
from p2o.formats.calibration import Calibration
from p2o.formats.camera_info import told_lens
from p2o.formats.format import BOTH, Format, Reading, digits, plain, size_of
from p2o.formats.lens import lens_of
from p2o.formats.source import Source
from p2o.formats.transform_names import CAMERA_FROM_LIDAR, LIDAR_FROM_CAMERA, named_transform
from p2o.geometry.pose_text import numbers
from p2o.options import Options

_MATRIX = ("camera_matrix", "CameraMat", "K", "cameraMatrix")
_DISTORTION = ("distortion_coefficients", "DistCoeff", "D", "distCoeffs")
_AUTOWARE_AI = "CameraExtrinsicMat"


def write(calibration: Calibration, options: Options) -> bytes:
    """Return the text, with what the calibration holds."""
    lines = ["%YAML:1.0", "---"]
    if calibration.camera is not None:
        lens = lens_of(calibration.camera, "opencv")
        lines += [
            "# Pixels, centres at whole numbers. equidistant is cv::fisheye.",
            f"image_width: {lens.width}",
            f"image_height: {lens.height}",
            *_matrix("camera_matrix", lens.matrix),
            f'distortion_model: "{lens.model}"',
            *_matrix("distortion_coefficients", [[value] for value in lens.coefficients]),
        ]
    if calibration.camera_from_lidar is not None:
        lines += [
            "# Takes points of the LiDAR to the camera (x right, y down, z forward), in metres.",
            *_matrix("camera_from_lidar", calibration.camera_from_lidar),
        ]
    return ("\n".join(lines) + "\n").encode()


def _matrix(name: str, values: Any) -> list[str]:
    array = np.asarray(values, dtype=np.float64)
    rows, columns = array.shape
    data = [digits(value) for value in plain(array)]
    return [
        f"{name}: !!opencv-matrix",
        f"   rows: {rows}",
        f"   cols: {columns}",
        "   dt: d",
        f"   data: [ {', '.join(data)} ]",
    ]


def recognises(source: Source) -> bool:
    """Return whether it is written by cv::FileStorage and has a matrix of a camera or a transform."""
    keys = (*_MATRIX, *CAMERA_FROM_LIDAR, *LIDAR_FROM_CAMERA, _AUTOWARE_AI)
    return source.is_opencv and any(key in source.tree for key in keys)


def read(source: Source, reading: Reading) -> Calibration:
    """Return what the file holds; raises InputError for matrices that are no camera or no transform."""
    where = source.path
    tree = {str(key): _array(str(key), value, source) for key, value in source.tree.items()}
    found = named_transform(tree, where)
    if found is None and _AUTOWARE_AI in tree:
        found = named_transform({"lidar_from_camera": tree[_AUTOWARE_AI]}, where)
    camera = None
    key = next((key for key in _MATRIX if key in tree), None)
    if key is not None:
        d_key = next((name for name in _DISTORTION if name in tree), _DISTORTION[0])
        sizes = tree.get("ImageSize")
        width, height = sizes if isinstance(sizes, list) and len(sizes) == 2 else (None, None)
        size = size_of(tree.get("image_width", width), tree.get("image_height", height), reading, where)
        model = tree.get("distortion_model", tree.get("DistModel"))
        camera = told_lens(key, tree[key], d_key, _flat(tree.get(d_key)), model, size, source).camera()
    if found is None:
        return Calibration(camera)
    return Calibration(camera, found[0], remarks=found[1])


def _array(name: str, value: Any, source: Source) -> Any:
    """Return an opencv-matrix as rows of numbers, and anything else as it is."""
    if not (isinstance(value, Mapping) and {"rows", "cols", "data"} <= value.keys()):
        return value
    rows, columns, data = value["rows"], value["cols"], value["data"]
    if not (isinstance(rows, int) and isinstance(columns, int) and isinstance(data, list)) or rows * columns != len(
        data
    ):
        raise InputError(
            f"the matrix {name} is not of the size that it says",
            where=source.path,
            expected=f"{rows}x{columns} numbers"[:40],
            got=len(data) if isinstance(data, list) else type(data).__name__,
        )
    if numbers(data, (len(data),)) is None and data:
        raise InputError(f"the matrix {name} does not hold finite numbers", where=source.path, got=str(data)[:60])
    return [data[start : start + columns] for start in range(0, len(data), columns)] if columns > 0 else []


def _flat(value: Any) -> Any:
    if isinstance(value, list) and all(isinstance(row, list) for row in value):
        return [item for row in value for item in row]
    return value


FORMAT = Format(
    name="opencv",
    summary="YAML of OpenCV's FileStorage: camera_matrix, distortion_coefficients, camera_from_lidar.",
    holds=BOTH,
    direction="camera_from_lidar",
    suffix=".yaml",
    recognises=recognises,
    read=read,
    write=write,
)
