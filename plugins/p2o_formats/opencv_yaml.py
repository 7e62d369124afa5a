"""Read and write cv::FileStorage of OpenCV: camera_matrix, distortion_coefficients, camera_from_lidar.

YAML is written; XML and JSON are read, too.

Source: cv::FileStorage ("%YAML:1.0", `!!opencv-matrix`) with the keys of OpenCV's calibration sample; with
`fisheye_model` the coefficients are those of cv::fisheye. OpenCV defines no key for a LiDAR; p2o writes
`camera_from_lidar` (4, 4) and reads all keys of `frame_names`. Files of
Autoware.AI's calibration toolkit are read, too: CameraMat, DistCoeff, ImageSize, and CameraExtrinsicMat, which is
lidar_from_camera (its publisher uses it as the transform of the camera in the LiDAR's frame).
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any
from xml.etree import ElementTree

import numpy as np
from p2o import InputError, Options
from p2o.reading import Calibration, Reading, Source, digits, plain

from p2o_formats.camera_entry import lens_of
from p2o_formats.camera_info import lens_from_matrix
from p2o_formats.format import SIZE, Format, comment_lines, required_numbers, size_of
from p2o_formats.frame_names import CAMERA_FROM_LIDAR, LIDAR_FROM_CAMERA, named_transform

_MATRIX = ("camera_matrix", "CameraMat", "K", "cameraMatrix")
_DISTORTION = ("distortion_coefficients", "DistCoeff", "D", "distCoeffs")
_AUTOWARE_AI = "CameraExtrinsicMat"


def write(calibration: Calibration, options: Options) -> bytes:
    """Return the text with the available parts of the calibration."""
    lines = ["%YAML:1.0", "---", *comment_lines(calibration)]
    if calibration.camera is not None:
        lens = lens_of(calibration.camera, "opencv")
        lines += [
            "# Pixels, centres at integers. equidistant is cv::fisheye.",
            f"image_width: {lens.width}",
            f"image_height: {lens.height}",
            *_matrix("camera_matrix", lens.matrix),
            f'distortion_model: "{lens.model}"',
            *_matrix("distortion_coefficients", [[value] for value in lens.coefficients]),
        ]
    if calibration.camera_from_lidar is not None:
        lines.append("# Maps points of the LiDAR to the camera (x right, y down, z forward), in metres.")
        lines += _matrix("camera_from_lidar", calibration.camera_from_lidar)
    return ("\n".join(lines) + "\n").encode()


def _matrix(name: str, values: Any) -> list[str]:
    array = np.asarray(values, dtype=np.float64)
    rows, columns = array.shape
    data = [digits(value) for value in plain(array)]
    size = [f"   rows: {rows}", f"   cols: {columns}", "   dt: d"]
    return [f"{name}: !!opencv-matrix", *size, f"   data: [ {', '.join(data)} ]"]


def recognises(source: Source) -> bool:
    """Return whether cv::FileStorage wrote the file and it contains a camera matrix or a transform."""
    keys = (*_MATRIX, *CAMERA_FROM_LIDAR, *LIDAR_FROM_CAMERA, _AUTOWARE_AI)
    storage = source.is_opencv or "opencv-matrix" in source.text[:100_000]
    return storage and any(key in _tree(source) for key in keys)


def _tree(source: Source) -> Mapping[str, Any]:
    """Return the keys of a file in YAML or XML; empty for other XML."""
    text = source.text
    if not text.startswith("<") or "<opencv_storage" not in text[:1000] or "<!" in text.replace("<!--", ""):
        return source.tree
    try:
        return {element.tag: _xml_value(element) for element in ElementTree.fromstring(text)}
    except (ElementTree.ParseError, ValueError, RecursionError):
        return {}


def _xml_value(element: ElementTree.Element) -> Any:
    """Return the rows, cols and data of a matrix, and the numbers or the text of another element."""
    if len(element):
        return {part.tag: _xml_value(part) for part in element}
    words = (element.text or "").strip().strip('"').split()
    values = [_number(word) for word in words]
    return values if element.tag == "data" or len(values) != 1 else values[0]


def _number(word: str) -> int | float | str:
    try:
        return int(word) if word.lstrip("+-").isdecimal() else float(word)
    except ValueError:
        return word


def read(source: Source, reading: Reading) -> Calibration:
    """Return the camera and the transform of the file; raises InputError for invalid matrices."""
    where = source.path
    tree = {str(key): _array(str(key), value, source) for key, value in _tree(source).items()}
    pose, remarks = named_transform(tree, where)
    if pose is None and _AUTOWARE_AI in tree:
        pose, remarks = named_transform({"lidar_from_camera": tree[_AUTOWARE_AI]}, where)
    key = next((key for key in _MATRIX if key in tree), None)
    sizes = tree.get("ImageSize")
    width, height = sizes if isinstance(sizes, list) and len(sizes) == 2 else (None, None)
    size = size_of(tree.get("image_width", width), tree.get("image_height", height), reading, where)
    if key is None or size is None:
        return Calibration(None, pose, remarks=remarks, lacks_image_size=key is not None)
    d_key = next((name for name in _DISTORTION if name in tree), _DISTORTION[0])
    model = tree.get("distortion_model", tree.get("DistModel"))
    if model is None and tree.get("fisheye_model"):
        model = "equidistant"
    lens = lens_from_matrix(key, tree[key], d_key, tree.get(d_key), model, size, source)
    return Calibration(lens.camera(), pose, remarks=remarks + lens.remarks)


def _array(name: str, value: Any, source: Source) -> Any:
    """Return the rows of an opencv-matrix, and every other value unchanged."""
    if not (isinstance(value, Mapping) and {"rows", "cols", "data"} <= value.keys()):
        return value
    rows, columns, data = value["rows"], value["cols"], value["data"]
    if not isinstance(rows, int) or not isinstance(columns, int) or min(rows, columns) < 0:
        got = f"{rows}x{columns}"[:40]
        raise InputError(f"the matrix {name} has no size", where=source.path, expected="rows and cols", got=got)
    flat = required_numbers(f"data of {name}", data, rows * columns, source.path, f"{rows}x{columns} finite numbers")
    return [flat[start : start + columns] for start in range(0, len(flat), max(columns, 1))]


FORMAT = Format(
    name="opencv",
    summary="YAML of OpenCV's FileStorage: camera_matrix, distortion_coefficients, camera_from_lidar.",
    rank=15,
    direction="camera_from_lidar",
    fields=SIZE,
    recognises=recognises,
    read=read,
    write=write,
)
