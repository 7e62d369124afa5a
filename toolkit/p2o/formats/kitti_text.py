"""Calibration files of KITTI: the extrinsic in the three layouts, and cameras P0 to P3, K_0x and P_rect_0x.

Source: Geiger et al., IJRR 2013, and the readmes of KITTI's development kits. All transforms take points of the LiDAR
to a camera. What p2o writes holds camera_from_lidar of the camera itself, in metres, row by row, with 17 digits.
KITTI's own files go through camera 0 and projections P0 to P3, and reading them multiplies all in:
camera_from_lidar = [I | K^-1 p4] R0_rect Tr_velo_to_cam.
"""

from __future__ import annotations

import re
from typing import Literal

import numpy as np

from p2o.arrays import Float
from p2o.errors import InputError
from p2o.files.input_file import naming
from p2o.formats.calibration import Calibration
from p2o.formats.camera_info import told_lens
from p2o.formats.format import ONLY_EXTRINSIC, Format, Reading, size_of
from p2o.formats.kitti_calibration import (
    KittiCalibration,
    calibration_of,
    rectified_camera,
    rectified_extrinsic,
)
from p2o.formats.source import Source
from p2o.geometry.camera import Camera
from p2o.options import Options, field

Layout = Literal["object", "raw", "odometry"]
_LINE = re.compile(r"^(Tr_velo_to_cam|Tr_velo_cam|Tr|R|P[0-3]|P_rect_0[0-3]|K_0[0-3]):", re.MULTILINE)


class KittiOptions(Options):
    """Which of KITTI's files is written."""

    layout: Layout = field("object", help="The data set of KITTI whose file it is like.")


def calibration_text(camera_from_lidar: Float, layout: Layout) -> str:
    """Return the lines "key: numbers" of a transform (4, 4) in one of the layouts."""
    rotation, translation, both = camera_from_lidar[:3, :3], camera_from_lidar[:3, 3], camera_from_lidar[:3]
    lines: dict[str, Float]
    match layout:
        case "object":
            lines = {"R0_rect": np.eye(3), "Tr_velo_to_cam": both}
        case "raw":
            lines = {"R": rotation, "T": translation}
        case "odometry":
            lines = {"Tr": both}
    return "".join(f"{key}: {' '.join(f'{v:.16e}' for v in values.ravel())}\n" for key, values in lines.items())


def write(calibration: Calibration, options: KittiOptions) -> bytes:
    """Return the text; KITTI's readers take no comments, so that the direction is in the names alone."""
    return calibration_text(calibration.extrinsic(), options.layout).encode()


def recognises(source: Source) -> bool:
    """Return whether a line "key: numbers" of KITTI's stands in it."""
    return _LINE.search(source.text) is not None and not source.text.startswith("%YAML")


def read(source: Source, reading: Reading) -> Calibration:
    """Return the camera that is asked for (P2, 02, 02-raw; P2 or 02 unless said) and the extrinsic, as far as known.

    Sizes of pictures stand in calib_cam_to_cam.txt only: without one, and unless the reading says it, the camera is
    left out. Raises InputError for lines that are no numbers, no camera or no transform.
    """
    lines = calibration_of("\n".join(source.lines), source.path)
    number, raw = _camera_number(reading.name, source)
    remarks: tuple[str, ...] = ()
    camera = None
    projection = lines.projection(f"P{number}") if f"P{number}" in lines.lines else None
    if f"P_rect_0{number}" in lines.lines or f"K_0{number}" in lines.lines:
        camera = _raw_camera(lines, number, raw, reading, source)
    elif projection is not None and reading.width is not None and reading.height is not None:
        with naming(source.path):
            camera = rectified_camera(projection, reading.width, reading.height)
    elif projection is not None:
        remarks = (f"{source.path}: the camera is left out, as the size of its image is not said (?width=W&height=H)",)
    elif reading.name:
        raise InputError(f"there is no camera {reading.name!r}", where=source.path, expected="P0 to P3, 00 to 03")
    return Calibration(camera, _extrinsic(lines, projection), remarks=remarks)


def _camera_number(name: str, source: Source) -> tuple[int, bool]:
    match = re.fullmatch(r"P?0?([0-3])(-raw)?", name or "P2")
    if match is None:
        raise InputError(
            f"there is no camera {name!r}", where=source.path, expected="FILE#P0 to P3, or 00 to 03, 02-raw", got=name
        )
    return int(match[1]), match[2] is not None


def _raw_camera(lines: KittiCalibration, number: int, raw: bool, reading: Reading, source: Source) -> Camera:
    if not raw and f"P_rect_0{number}" in lines.lines:
        key = f"S_rect_0{number}"
        width, height = lines.size(key) if key in lines.lines else (None, None)
        with naming(source.path):
            size = size_of(width, height, reading, source.path)
            return rectified_camera(lines.projection(f"P_rect_0{number}"), *size)
    width, height = lines.size(f"S_0{number}") if f"S_0{number}" in lines.lines else (None, None)
    matrix, d = lines.numbers(f"K_0{number}", (3, 3)), lines.numbers(f"D_0{number}", (5,))
    size = size_of(width, height, reading, source.path)
    names = (f"K_0{number}", f"D_0{number}")
    return told_lens(names[0], matrix.tolist(), names[1], d.tolist(), "plumb_bob", size, source).camera()


def _extrinsic(lines: KittiCalibration, projection: Float | None) -> Float | None:
    known = lines.lines
    velo = next((key for key in ("Tr_velo_to_cam", "Tr_velo_cam", "Tr") if key in known), None)
    if velo is not None:
        pose = lines.rigid_12(velo)
        rectifying = next((key for key in ("R0_rect", "R_rect") if key in known), None)
        if rectifying is not None and velo != "Tr":
            pose = lines.rigid(rectifying) @ pose
    elif {"R", "T"} <= known.keys():
        return lines.rigid("R", "T")
    else:
        return None
    return pose if projection is None else np.asarray(rectified_extrinsic(projection, pose))


FORMAT = Format(
    name="kitti",
    summary="The extrinsic as text in the layout of KITTI's calibration files (Tr_velo_to_cam).",
    holds=ONLY_EXTRINSIC,
    needs=ONLY_EXTRINSIC,
    direction="camera_from_lidar (Tr_velo_to_cam)",
    suffix=".txt",
    options=KittiOptions,
    recognises=recognises,
    read=read,
    write=write,
)
