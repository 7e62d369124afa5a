"""Camera of a CameraInfo message: K and D of the raw image, or P of the rectified image."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from p2o import Camera, Float, InputError, se3
from p2o.reading import read_camera_file
from p2o_formats.camera_entry import read_camera_entry

from p2o_datasets.bags.messages import CameraInfoMessage

_SAME_PX = 0.5


@dataclass(frozen=True, eq=False)
class RosCamera:
    """Camera of an image topic; `rotation` (3, 3) maps the camera's optical frame to that of the images.

    `advice` are remarks as those of `Frame.advice`.
    """

    camera: Camera
    rotation: Float
    warnings: tuple[str, ...] = ()
    advice: tuple[str, ...] = ()


def camera_of_info(message: CameraInfoMessage, where: Path, *, rectified: bool) -> RosCamera:
    """Return the camera of a message, for raw or rectified images.

    A region of interest (ROI) and binning change image size and parameters: one pixel of the image is a block of
    `binning` pixels of the sensor. Rectified images have P and no distortion, and are rotated by R.

    Raises InputError for cameras that are not calibrated, of another model, or invalid.
    """
    matrix = message.P[:, :3] if rectified else message.K
    if not matrix.any():
        fault = f"the camera is not calibrated: {'P' if rectified else 'K'} is zero"
        hint = "give a file with the camera: --set data.camera=FILE"
        raise InputError(fault, where=where, expected="a CameraInfo of a calibrated camera", hint=hint)
    width, height, matrix = _cut(message, np.array(matrix), where)
    value = {"width": width, "height": height, "K": matrix.tolist()}
    if not rectified:
        # Missing coefficients are zero.
        value |= {"distortion_model": message.distortion_model, "D": message.D.tolist() or [0.0] * 4}
    camera, warnings = read_camera_entry(value, where)
    if not rectified:
        return RosCamera(camera, np.eye(3), warnings)
    if message.P[:, 3].any():
        warnings += (f"{where}: P is the second camera of a stereo pair; its frame is assumed to be its own",)
    rotation = se3.check_rigid("R", se3.make(message.R), where=where)[:3, :3] if message.R.any() else np.eye(3)
    return RosCamera(camera, rotation, warnings)


def camera_by_name(message: CameraInfoMessage, where: Path, *, rectified: bool) -> RosCamera:
    """Return the camera as `camera_of_info`, where only the name of the topic states whether images are `rectified`.

    If the cameras of raw and rectified images differ, the advice states both and how to choose the other one.
    """
    camera = camera_of_info(message, where, rectified=rectified)
    matrices = {False: message.K, True: message.P[:, :3]}
    differ = np.abs(matrices[True] - matrices[False]).max() > _SAME_PX or bool(message.D.any())
    if not (differ and matrices[not rectified].any()):
        return camera
    centres = {key: f"({m[0, 2]:.0f}, {m[1, 2]:.0f}) px, focal length {m[0, 0]:.0f} px" for key, m in matrices.items()}
    used = "P, for rectified images," if rectified else "K and D, for raw images,"
    text = (
        f"{where}: {used} are used because of the topic's name. K has the centre {centres[False]}, P {centres[True]}. "
        f"If the images are {'raw' if rectified else 'rectified'}: --set data.rectified={str(not rectified).lower()}"
    )
    return replace(camera, advice=(text,))


def camera_of_file(path: Path) -> RosCamera:
    """Return the camera of a calibration file of any format (FILE, FILE#NAME), or of a frame.yaml."""
    return RosCamera(read_camera_file(str(path)), np.eye(3))


def _cut(message: CameraInfoMessage, matrix: Float, where: Path) -> tuple[int, int, Float]:
    """Return width, height and intrinsic matrix (3, 3) of the transmitted region after binning."""
    x, y, height, width = message.roi
    width, height = width or message.width, height or message.height
    bins = tuple(max(number, 1) for number in message.binning)
    if x + width > message.width or y + height > message.height or width % bins[0] or height % bins[1]:
        expected = f"a region of {message.width}x{message.height} px that is divisible by the binning"
        got = f"{width}x{height} px at ({x}, {y}), binning {bins[0]}x{bins[1]}"
        raise InputError("ROI and binning do not fit the size of the camera", where=where, expected=expected, got=got)
    # Pixel centres are at integers: the centre of a block of pixels is not at its first pixel.
    for axis, (start, size) in enumerate(zip((x, y), bins, strict=True)):
        matrix[axis, axis] /= size
        matrix[axis, 2] = (matrix[axis, 2] - start + 0.5) / size - 0.5 if size > 1 else matrix[axis, 2] - start
    return width // bins[0], height // bins[1], matrix
