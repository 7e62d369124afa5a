"""The camera of a CameraInfo message: K and D of the picture as it is, or P of the rectified one."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from p2o import Camera, InputError, se3
from p2o.arrays import Float
from p2o.bags.messages import CameraInfoMessage
from p2o.formats.camera_entry import read_camera
from p2o.formats.files import camera_words

# Other drivers' words for the models of ROS.
_MODELS = {"fisheye": "equidistant", "kannala_brandt": "equidistant", "rational": "rational_polynomial"}
_UNDISTORTED = ("", "none")


@dataclass(frozen=True, eq=False)
class RosCamera:
    """The camera of a topic's pictures; `rotation` (3, 3) takes its optical frame to that of the pictures."""

    camera: Camera
    rotation: Float
    warnings: tuple[str, ...] = ()


def camera_of_info(message: CameraInfoMessage, where: Path, *, rectified: bool) -> RosCamera:
    """Return the camera of a message, for pictures as they are or rectified ones.

    A part of the picture (ROI) and binning change its size and parameters: a pixel of the picture is a square of
    `binning` pixels of the sensor. Rectified pictures have P and no distortion, and are turned by R.

    Raises InputError where the camera is not calibrated, of another model, or no camera.
    """
    matrix = message.P[:, :3] if rectified else message.K
    if not matrix.any():
        raise InputError(
            f"the camera is not calibrated: {'P' if rectified else 'K'} is zero",
            where=where,
            expected="a CameraInfo of a calibrated camera",
            hint="name a file with the camera: --set data.camera=FILE",
        )
    width, height, matrix = _cut(message, np.array(matrix), where)
    value = {"width": width, "height": height, "K": matrix.tolist()}
    model = _MODELS.get(message.distortion_model, message.distortion_model)
    if not rectified and (model not in _UNDISTORTED or message.D.any()):
        # Coefficients that are left out are zero.
        d = message.D.tolist() if len(message.D) or model != "equidistant" else [0.0] * 4
        value |= {"distortion_model": model, "D": d}
    camera = read_camera(value, where)
    if not rectified:
        return RosCamera(camera, np.eye(3))
    warnings = ()
    if message.P[:, 3].any():
        warnings = (f"{where}: P is that of a second camera of a pair; its frame is taken to be its own",)
    return RosCamera(camera, _rotation(message.R, where), warnings)


def camera_of_file(path: Path) -> RosCamera:
    """Return the camera of a calibration file of any form (FILE, FILE#NAME), or of what frame.yaml holds."""
    return RosCamera(camera_words(str(path)), np.eye(3))


def _cut(message: CameraInfoMessage, matrix: Float, where: Path) -> tuple[int, int, Float]:
    """Return width, height and intrinsic matrix (3, 3) of the part of the picture that is sent, binned."""
    x, y, height, width = message.roi
    width, height = width or message.width, height or message.height
    bins = tuple(max(number, 1) for number in message.binning)
    if x + width > message.width or y + height > message.height or width % bins[0] or height % bins[1]:
        raise InputError(
            "ROI and binning do not fit the size of the camera",
            where=where,
            expected=f"a part of {message.width}x{message.height} px that binning divides",
            got=f"{width}x{height} px at ({x}, {y}), binning {bins[0]}x{bins[1]}",
        )
    # Pixel centres are at whole numbers: the middle of a square of pixels is not at its first one.
    for axis, (start, size) in enumerate(zip((x, y), bins, strict=True)):
        matrix[axis, axis] /= size
        matrix[axis, 2] = (matrix[axis, 2] - start + 0.5) / size - 0.5 if size > 1 else matrix[axis, 2] - start
    return width // bins[0], height // bins[1], matrix


def _rotation(rotation: Float, where: Path) -> Float:
    if not rotation.any():
        return np.eye(3)
    return se3.check_rigid("R", se3.make(rotation), where=where)[:3, :3]
