"""Registry of the calibration file formats of this package."""

from __future__ import annotations

from collections.abc import Mapping

from p2o import UnknownNameError

from p2o_formats import (
    autoware,
    calib_anything,
    camera_info,
    colmap,
    fast_livo,
    kalibr,
    kitti_text,
    koide,
    matrix_file,
    opencalib,
    opencv_yaml,
    plain_text,
    result_file,
    ros_transform,
)
from p2o_formats.format import Format

_FORMATS = (
    matrix_file.NPY_FORMAT, ros_transform.FORMAT, opencv_yaml.FORMAT, result_file.FORMAT, koide.FORMAT,
    opencalib.FORMAT, opencalib.CAMERA_FORMAT, fast_livo.FORMAT, calib_anything.FORMAT, colmap.FORMAT,
    colmap.CAMERAS_FORMAT, camera_info.FORMAT, kalibr.FORMAT, autoware.FORMAT, kitti_text.FORMAT, plain_text.FORMAT,
    matrix_file.TEXT_FORMAT,
)  # fmt: skip
FORMATS: Mapping[str, Format] = {form.name: form for form in _FORMATS}
"""All formats by name."""

WRITTEN: Mapping[str, Format] = {name: form for name, form in FORMATS.items() if form.write is not None}
"""The formats that can be written."""


def format_named(name: str, where: object = None) -> Format:
    """Return the format of a name; raises UnknownNameError for any other name."""
    if name not in FORMATS:
        raise UnknownNameError("form of calibration file", name, WRITTEN, where=where)
    return FORMATS[name]
