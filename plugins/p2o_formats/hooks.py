"""Register the readers and exporters of this package; a format is imported when it is used."""

from __future__ import annotations

from collections.abc import Iterator

from p2o import Method, hookimpl, methods_at

WRITTEN = (
    "matrix_file:NPY_FORMAT", "matrix_file:TEXT_FORMAT", "ros_transform:FORMAT", "opencv_yaml:FORMAT", "koide:FORMAT",
    "opencalib:FORMAT", "opencalib:CAMERA_FORMAT", "fast_livo:FORMAT", "colmap:FORMAT", "colmap:CAMERAS_FORMAT",
    "camera_info:FORMAT", "kalibr:FORMAT", "autoware:FORMAT", "kitti_text:FORMAT", "plain_text:FORMAT",
)  # fmt: skip
"""The formats that can be written, as MODULE:NAME."""
READ_ONLY = ("result_file:FORMAT", "calib_anything:FORMAT")


@hookimpl
def p2o_calibration_readers() -> Iterator[Method]:
    """Offer the readers of all formats."""
    return methods_at("p2o_formats", [f"{place}.reader" for place in (*WRITTEN, *READ_ONLY)])


@hookimpl
def p2o_exporters() -> Iterator[Method]:
    """Offer the exporters of all formats that can be written, and the exporter of complete results."""
    return methods_at("p2o_formats", ["result_file:EXPORTER", *(f"{place}.exporter" for place in WRITTEN)])
