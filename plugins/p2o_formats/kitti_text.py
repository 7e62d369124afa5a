"""Read and write calibration files of KITTI: four layouts of the extrinsic, and cameras P0 to P3, K_0x, P_rect_0x.

Source: Geiger et al., IJRR 2013, and the readmes of KITTI's development kits. All transforms map LiDAR coordinates to
camera coordinates. p2o writes camera_from_lidar of the camera itself, in metres, row by row, with 17 digits. KITTI's
own files contain the transform to camera 0 and projections P0 to P3, from which p2o composes camera_from_lidar =
[I | K^-1 p4] R0_rect Tr_velo_to_cam. Files of the tracking benchmark have R_rect and Tr_velo_cam, without colon.
"""

from __future__ import annotations

import re
from typing import Literal

import numpy as np
from p2o import Float, InputError, Options, field
from p2o.reading import Calibration, Reading, Source

from p2o_formats.camera_entry import skew_remarks
from p2o_formats.format import NAMED_SIZE, ONLY_EXTRINSIC, Format, size_of
from p2o_formats.kitti_calibration import KittiCalibration, calibration_of, rectified_camera, rectified_extrinsic

Layout = Literal["object", "raw", "odometry", "tracking"]
_LINE = re.compile(
    r"^(?:(?:Tr_velo_to_cam|Tr_velo_cam|Tr|R|P[0-3]|P_rect_0[0-3]|K_0[0-3]):|(?:Tr_velo_cam|R_rect) +[-+\d.])",
    re.MULTILINE,
)
_CAMERA = re.compile(r"(?:P|P_rect_0|K_0)([0-3])")


class KittiOptions(Options):
    """Layout of the file."""

    layout: Layout = field("object", help="Data set of KITTI whose layout the file has.")


def write(calibration: Calibration, options: KittiOptions) -> bytes:
    """Return the lines "key: numbers" of a layout; those of tracking have no colon.

    The keys state the direction, because KITTI's readers do not accept comments.
    """
    both = calibration.extrinsic()[:3]
    layouts = {"object": {"R0_rect:": np.eye(3), "Tr_velo_to_cam:": both}, "raw": {"R:": both[:, :3], "T:": both[:, 3]}}
    layouts |= {"odometry": {"Tr:": both}, "tracking": {"R_rect": np.eye(3), "Tr_velo_cam": both}}
    lines = layouts[options.layout].items()
    return "".join(f"{key} {' '.join(f'{v:.16e}' for v in values.ravel())}\n" for key, values in lines).encode()


def recognises(source: Source) -> bool:
    """Return whether the file contains a line "key: numbers" of KITTI."""
    return _LINE.search(source.text) is not None and not source.text.startswith("%YAML")


def read(source: Source, reading: Reading) -> Calibration:
    """Return the camera that the reading names (P2, 02, 02-raw; default P2 or 02, or the first) and the extrinsic.

    The camera is None if neither the file nor the reading gives its image size, which only calib_cam_to_cam.txt
    contains. Raises InputError for invalid numbers, cameras and transforms.
    """
    lines = calibration_of("\n".join(source.lines) + "\n" * source.text.endswith("\n"), source.path)
    if {"R", "T"} <= lines.lines.keys() and "imu" in source.path.name.lower():
        fault, hint = "R and T of this file map the IMU to the LiDAR", "give calib_velo_to_cam.txt"
        raise InputError(fault, where=source.path, expected="a transform of camera and LiDAR", hint=hint)
    numbers = sorted({match[1] for key in lines.lines if (match := _CAMERA.fullmatch(key))})
    default = "2" if "2" in numbers or not numbers else numbers[0]
    match = re.fullmatch(r"P?0?([0-3])(-raw)?", reading.name or default)
    number = None if match is None else match[1]
    keys = (f"P{number}", f"P_rect_0{number}", f"K_0{number}")
    if reading.name and not any(key in lines.lines for key in keys):
        expected = "FILE#P0 to P3, or 00 to 03, 02-raw"
        raise InputError(f"there is no camera {reading.name!r}", where=source.path, expected=expected)
    rectified = next((key for key in keys[:2] if key in lines.lines and not (match and match[2])), None)
    size_key = f"S_{'rect_' * (rectified is not None)}0{number}"
    width, height = lines.size(size_key) if size_key in lines.lines else (None, None)
    size = size_of(width, height, reading, source.path)
    extrinsic = _extrinsic(lines, lines.projection(keys[0]) if keys[0] in lines.lines else None)
    has_camera = any(key in lines.lines for key in keys)
    if size is None or not has_camera:
        return Calibration(None, extrinsic, lacks_image_size=has_camera)
    if rectified is not None:
        projection = lines.projection(rectified)
        remarks = skew_remarks(rectified, projection[:, :3], size[1], source.path)
        return Calibration(rectified_camera(projection, *size), extrinsic, remarks=remarks)
    camera, remarks = lines.distorted_camera(f"0{number}", size)
    return Calibration(camera, extrinsic, remarks=remarks)


def _extrinsic(lines: KittiCalibration, projection: Float | None) -> Float | None:
    velo = next((key for key in ("Tr_velo_to_cam", "Tr_velo_cam", "Tr") if key in lines.lines), None)
    if velo is None:
        return lines.rigid("R", "T") if {"R", "T"} <= lines.lines.keys() else None
    pose = lines.rigid_12(velo)
    rectifying = next((key for key in ("R0_rect", "R_rect") if key in lines.lines), None)
    if rectifying is not None and velo != "Tr":
        pose = lines.rigid(rectifying) @ pose
    return pose if projection is None else np.asarray(rectified_extrinsic(projection, pose))


FORMAT = Format(
    name="kitti",
    summary="The extrinsic as text in the layout of KITTI's calibration files (Tr_velo_to_cam).",
    rank=45,
    cite="Geiger et al., IJRR 2013",
    holds=ONLY_EXTRINSIC,
    direction="camera_from_lidar (Tr_velo_to_cam)",
    suffix=".txt",
    options=KittiOptions,
    fields=NAMED_SIZE,
    recognises=recognises,
    read=read,
    write=write,
)
