"""Read the configuration of CalibAnything (calib.json: cam_K, cam_dist, T_lidar_to_cam) and its result (extrinsic.txt).

Source: the README of CalibAnything and the files that it reads and writes. `T_lidar_to_cam` (4, 4) maps points of the
LiDAR to the camera, in metres: camera_from_lidar. `cam_dist` is k1 k2 p1 p2 [k3] of OpenCV. Neither file contains the
image size.
"""

from __future__ import annotations

from p2o import InputError
from p2o.reading import Calibration, Reading, Source, matrix_rows, read_pose

from p2o_formats.camera_entry import lens_of
from p2o_formats.camera_info import lens_from_matrix
from p2o_formats.format import EXAMPLE, NAMED_SIZE, Format, data_of, json_text, size_of

_INITIAL, _TRUTH = "T_lidar_to_cam", "T_lidar_to_cam_gt"
_RESULT = "Estimate extrinsic Matrix:"


def recognises(source: Source) -> bool:
    """Return whether the file has the keys of the configuration, or the first line of the result."""
    return _INITIAL in source.tree or source.text.startswith(_RESULT)


def read(source: Source, reading: Reading) -> Calibration:
    """Return the extrinsic, and the camera if the reading gives the image size.

    The transform of a configuration is its initial guess; FILE#gt is its ground truth. Raises InputError for invalid
    matrices and coefficients, and for a ground truth that is not available.
    """
    if source.text.startswith(_RESULT):
        text = source.text.removeprefix(_RESULT).translate(str.maketrans("[],;", "    "))
        pose, remarks = read_pose("the extrinsic", text.split(), source.path)
        return Calibration(None, pose, remarks=remarks)
    key = _TRUTH if reading.name == "gt" else _INITIAL
    if reading.name not in ("", "gt"):
        raise InputError(f"there is no {reading.name!r}", where=source.path, expected="FILE or FILE#gt")
    rows = data_of(source.tree.get(key))
    if not rows and key == _TRUTH:
        raise InputError(f"{_TRUTH} is not available", where=source.path, expected="a matrix (4, 4)")
    pose, remarks = read_pose(key, rows, source.path)
    size = size_of(None, None, reading, source.path)
    if "cam_K" not in source.tree or size is None:
        return Calibration(None, pose, remarks=remarks, lacks_image_size="cam_K" in source.tree)
    matrix, d = (data_of(source.tree.get(name)) for name in ("cam_K", "cam_dist"))
    lens = lens_from_matrix("cam_K", matrix, "cam_dist", d, None, size, source)
    return Calibration(lens.camera(), pose, remarks=remarks + lens.remarks)


def example() -> bytes:
    """Return a configuration with the calibration of `EXAMPLE`."""
    lens = lens_of(EXAMPLE.intrinsics(), "calib-anything")
    tree = {
        "cam_K": {"rows": 3, "cols": 3, "data": lens.matrix},
        "cam_dist": {"cols": len(lens.coefficients), "data": list(lens.coefficients)},
        _INITIAL: {"rows": 4, "cols": 4, "data": matrix_rows(EXAMPLE.extrinsic())},
        _TRUTH: {"available": False, "rows": 0, "cols": 0, "data": []},
    }
    return json_text(tree)


FORMAT = Format(
    name="calib-anything",
    summary="CalibAnything: cam_K, cam_dist and T_lidar_to_cam of calib.json, and its result extrinsic.txt.",
    rank=29,
    cite="Luo et al., 2023",
    direction="camera_from_lidar (T_lidar_to_cam)",
    suffix=".json",
    fields=NAMED_SIZE,
    recognises=recognises,
    read=read,
    example=example,
)
