"""Read and write sensor_msgs/CameraInfo of ROS, as YAML of camera_calibration_parsers or of `ros2 topic echo`.

Source: camera_calibration_parsers (image_width, camera_matrix: {rows, cols, data}, distortion_model,
distortion_coefficients, ...) and the message itself (width, k, d; in ROS 1 K, D). K and D describe the raw image
(`image_raw`); the rectified image has the first three columns of P and no distortion.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from p2o import InputError, Options, field
from p2o.reading import Calibration, FrameName, Reading, Source, listed, parse_yaml

from p2o_formats.camera_entry import Lens, lens_of, read_matrix
from p2o_formats.format import ONLY_CAMERA, SIZE, Format, comment_lines, data_of, required_numbers, size_of


class CameraInfoOptions(Options):
    """Name of the camera."""

    camera_frame: FrameName = field("camera", help="Name of the camera (camera_name).")


def write(calibration: Calibration, options: CameraInfoOptions) -> bytes:
    """Return the YAML text, with R = I and P = [K | 0]; a pinhole camera becomes plumb_bob with zero coefficients."""
    lens = lens_of(calibration.intrinsics(), "camera-info")
    projection = [value for row in lens.matrix for value in (*row, 0.0)]
    lines = [
        "# sensor_msgs/CameraInfo of the raw image, for camera_calibration_parsers. Pixel centres at integers.",
        *comment_lines(calibration),
        f"image_width: {lens.width}",
        f"image_height: {lens.height}",
        f"camera_name: {options.camera_frame}",
        *_matrix("camera_matrix", 3, 3, [value for row in lens.matrix for value in row]),
        f"distortion_model: {lens.model}",
        *_matrix("distortion_coefficients", 1, len(lens.coefficients), lens.coefficients),
        *_matrix("rectification_matrix", 3, 3, [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]),
        *_matrix("projection_matrix", 3, 4, projection),
    ]
    return ("\n".join(lines) + "\n").encode()


def _matrix(name: str, rows: int, columns: int, values: Any) -> list[str]:
    return [f"{name}:", f"  rows: {rows}", f"  cols: {columns}", f"  data: {listed(values)}"]


def recognises(source: Source) -> bool:
    """Return whether the file is a calibration of camera_calibration_parsers or a CameraInfo message."""
    tree = _tree(source)
    return ("camera_matrix" in tree and "image_width" in tree and not source.is_opencv) or _is_message(tree)


def _tree(source: Source) -> Mapping[str, Any]:
    """Return the mapping of the file; of several messages of `ros2 topic echo` the first."""
    if source.tree or "distortion_model" not in source.text:
        return source.tree
    try:
        value = parse_yaml(source.text.partition("\n---\n")[0], "CameraInfo", source.path)
    except InputError:
        return {}
    return value if isinstance(value, dict) else {}


def _is_message(tree: Mapping[str, Any]) -> bool:
    return "distortion_model" in tree and ("k" in tree or "K" in tree) and ("d" in tree or "D" in tree)


def read(source: Source, reading: Reading) -> Calibration:
    """Return the camera of the raw image.

    Raises InputError for invalid cameras, and for messages of binned or cropped images, whose K is of the full image.
    """
    tree = _tree(source)
    if _is_message(tree):
        _check_whole(tree, source)
        matrix, d = (tree.get(key, tree.get(key.upper())) for key in "kd")
        size = size_of(tree.get("width"), tree.get("height"), reading, source.path)
    else:
        matrix, d = (data_of(tree.get(key)) for key in ("camera_matrix", "distortion_coefficients"))
        size = size_of(tree.get("image_width"), tree.get("image_height"), reading, source.path)
    if size is None:
        return Calibration(lacks_image_size=True)
    header = tree.get("header")
    name = header.get("frame_id", "") if isinstance(header, Mapping) else tree.get("camera_name", "")
    lens = lens_from_matrix("K", matrix, "D", d, tree.get("distortion_model"), size, source)
    return Calibration(lens.camera(), camera_frame=name if isinstance(name, str) else "", remarks=lens.remarks)


def _check_whole(tree: Mapping[str, Any], source: Source) -> None:
    region = roi if isinstance(roi := tree.get("roi"), Mapping) else {}
    values = [region.get(key) or 0 for key in ("x_offset", "y_offset", "width", "height")]
    # Some drivers state the whole image.
    cropped = values not in ([0] * 4, [0, 0, tree.get("width"), tree.get("height")])
    binned = any(tree.get(key) not in (None, 0, 1) for key in ("binning_x", "binning_y"))
    if cropped or binned:
        fault = "the message describes a binned or cropped image, but its K the full image"
        raise InputError(fault, where=source.path, expected="binning of 0 or 1, and no region of interest (roi)")


def lens_from_matrix(
    matrix_key: str, matrix: Any, d_key: str, d: Any, model: Any, size: tuple[int, int], source: Source
) -> Lens:
    """Return the camera of an intrinsic matrix, distortion coefficients and the name of a distortion model.

    Without a name, up to 5 coefficients are plumb_bob and more are rational_polynomial, as in OpenCV. Raises
    InputError that names the keys of the file.
    """
    pinhole, remarks = read_matrix(matrix_key, matrix, size[1], source.path)
    rows = [] if d is None else d
    flat = [v for row in rows for v in (row if isinstance(row, list) else [row])] if isinstance(rows, list) else rows
    coefficients = required_numbers(d_key, flat, None, source.path, "finite numbers")
    if model in (None, ""):
        model = "plumb_bob" if len(coefficients) <= 5 else "rational_polynomial"
    if not isinstance(model, str):
        fault = "the distortion model is not a name"
        raise InputError(fault, where=source.path, expected="plumb_bob", got=repr(model)[:60])
    return Lens(*size, *pinhole, model, tuple(coefficients), remarks)


FORMAT = Format(
    name="camera-info",
    summary="Camera of ROS: CameraInfo YAML of camera_calibration_parsers; also reads output of `ros2 topic echo`.",
    rank=35,
    holds=ONLY_CAMERA,
    options=CameraInfoOptions,
    fields=SIZE,
    recognises=recognises,
    read=read,
    write=write,
)
