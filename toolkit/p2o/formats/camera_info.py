"""A camera as sensor_msgs/CameraInfo of ROS, in the YAML of camera_calibration_parsers or of `ros2 topic echo`.

Source: camera_calibration_parsers (image_width, camera_matrix: {rows, cols, data}, distortion_model,
distortion_coefficients, ...) and the message itself (width, k, d; in ROS 1 K, D). K and D belong to the raw picture
(`image_raw`); rectified pictures have the first three columns of P and no distortion.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from p2o.errors import InputError
from p2o.formats.calibration import Calibration
from p2o.formats.camera_entry import without_skew
from p2o.formats.format import ONLY_CAMERA, Format, Reading, listed, size_of
from p2o.formats.frame_names import FrameName
from p2o.formats.lens import Lens, lens_of
from p2o.formats.source import Source
from p2o.geometry.pose_text import numbers
from p2o.options import Options, field


class CameraInfoOptions(Options):
    """The name of the camera."""

    camera_frame: FrameName = field("camera", help="Name of the camera (camera_name).")


def write(calibration: Calibration, options: CameraInfoOptions) -> bytes:
    """Return the YAML text; a pinhole is plumb_bob without distortion, and R is identity, P = [K | 0]."""
    lens = lens_of(calibration.intrinsics(), "camera-info")
    projection = [value for row in lens.matrix for value in (*row, 0.0)]
    identity = [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]
    lines = [
        "# sensor_msgs/CameraInfo of the raw picture, for camera_calibration_parsers. Pixel centres at whole numbers.",
        f"image_width: {lens.width}",
        f"image_height: {lens.height}",
        f"camera_name: {options.camera_frame}",
        *_matrix("camera_matrix", 3, 3, [value for row in lens.matrix for value in row]),
        f"distortion_model: {lens.model}",
        *_matrix("distortion_coefficients", 1, len(lens.coefficients), lens.coefficients),
        *_matrix("rectification_matrix", 3, 3, identity),
        *_matrix("projection_matrix", 3, 4, projection),
    ]
    return ("\n".join(lines) + "\n").encode()


def _matrix(name: str, rows: int, columns: int, values: Any) -> list[str]:
    return [f"{name}:", f"  rows: {rows}", f"  cols: {columns}", f"  data: {listed(values)}"]


def recognises(source: Source) -> bool:
    """Return whether it is a calibration of camera_calibration_parsers, or a message."""
    tree = source.tree
    return ("camera_matrix" in tree and "image_width" in tree and not source.is_opencv) or _is_message(tree)


def _is_message(tree: Mapping[str, Any]) -> bool:
    return "distortion_model" in tree and ("k" in tree or "K" in tree) and ("d" in tree or "D" in tree)


def read(source: Source, reading: Reading) -> Calibration:
    """Return the camera of the raw picture.

    Raises InputError for what is no camera, and for messages of binned or cropped pictures: their K is of others.
    """
    tree = source.tree
    if _is_message(tree):
        _check_whole(tree, source)
        matrix, d = (tree.get(key, tree.get(key.upper())) for key in "kd")
        size = size_of(tree.get("width"), tree.get("height"), reading, source.path)
    else:
        matrix, d = (_data(tree.get(key)) for key in ("camera_matrix", "distortion_coefficients"))
        size = size_of(tree.get("image_width"), tree.get("image_height"), reading, source.path)
    header = tree.get("header")
    name = header.get("frame_id", "") if isinstance(header, Mapping) else tree.get("camera_name", "")
    lens = told_lens("K", matrix, "D", d, tree.get("distortion_model"), size, source)
    return Calibration(lens.camera(), camera_frame=name if isinstance(name, str) else "")


def _data(value: Any) -> Any:
    return value.get("data") if isinstance(value, Mapping) else value


def _check_whole(tree: Mapping[str, Any], source: Source) -> None:
    region = tree.get("roi")
    cropped = isinstance(region, Mapping) and any(
        region.get(key) for key in ("x_offset", "y_offset", "width", "height")
    )
    binned = any(tree.get(key) not in (None, 0, 1) for key in ("binning_x", "binning_y"))
    if cropped or binned:
        raise InputError(
            "the camera info is of a binned or cropped picture, and K of the whole one",
            where=source.path,
            expected="binning of 0 or 1, and no roi",
        )


def told_lens(
    matrix_key: str, matrix: Any, d_key: str, d: Any, model: Any, size: tuple[int, int], source: Source
) -> Lens:
    """Return the lens of an intrinsic matrix, coefficients and the name of a distortion in a file.

    Without a name four or five coefficients are plumb_bob, eight to fourteen rational_polynomial, as OpenCV has it.
    Raises InputError that names the keys.
    """
    k = numbers(matrix, (3, 3))
    if k is None or not without_skew(k):
        raise InputError(
            f"{matrix_key} is no intrinsic matrix",
            where=source.path,
            expected="fx 0 cx, 0 fy cy, 0 0 1, without skew",
            got=str(matrix)[:80],
        )
    count = _count(d)
    coefficients = None if count is None else numbers(d, (count,)) if count else ()
    if coefficients is None:
        raise InputError(
            f"{d_key} holds no coefficients", where=source.path, expected="finite numbers", got=str(d)[:80]
        )
    if model in (None, ""):
        model = "plumb_bob" if len(coefficients) <= 5 else "rational_polynomial"
    if model == "fisheye":
        model = "equidistant"
    if not isinstance(model, str):
        raise InputError(
            "the distortion model is no name", where=source.path, expected="plumb_bob", got=repr(model)[:60]
        )
    fx, fy, cx, cy = (float(k[at]) for at in ((0, 0), (1, 1), (0, 2), (1, 2)))
    return Lens(*size, fx, fy, cx, cy, model, tuple(float(value) for value in coefficients))


def _count(d: Any) -> int | None:
    """Return how many numbers a list holds, flat or as one row or column; None for anything else."""
    if d is None:
        return 0
    if not isinstance(d, list):
        return None
    return sum(len(row) if isinstance(row, list) else 1 for row in d)


FORMAT = Format(
    name="camera-info",
    summary="Camera of ROS: CameraInfo YAML of camera_calibration_parsers; messages of `ros2 topic echo` are read too.",
    holds=ONLY_CAMERA,
    needs=ONLY_CAMERA,
    direction="",
    suffix=".yaml",
    options=CameraInfoOptions,
    recognises=recognises,
    read=read,
    write=write,
)
