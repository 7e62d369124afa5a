"""Calibration files of KITTI (raw, object, odometry): reading, checking, and composing the exact extrinsic."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from p2o.arrays import Float
from p2o.errors import InputError, UnknownNameError
from p2o.files.input_file import read_text
from p2o.geometry import se3
from p2o.geometry.camera import Camera

_LARGEST = 1e7
"""Pixels, or pixels times metres: no calibration holds more."""
MAX_BASELINE_M = 100.0
"""No two cameras of a car stand further apart."""


@dataclass(frozen=True)
class KittiCalibration:
    """The lines "key: numbers" of one calibration file; numbers are checked when they are asked for."""

    path: Path
    lines: Mapping[str, str]

    def numbers(self, key: str, shape: tuple[int, ...]) -> Float:
        """Return the finite numbers of a key; raises InputError for a missing key, other counts, or no numbers."""
        if key not in self.lines:
            # What stands before a colon may be anything in a damaged file.
            raise UnknownNameError("key", key, (known[:20] for known in self.lines), where=self.path)
        count = int(np.prod(shape))
        try:
            values = np.array(self.lines[key].split(), dtype=np.float64)
        except ValueError as problem:
            raise InputError(
                f"{key} does not hold numbers",
                where=self.path,
                expected=f"{count} numbers",
                got=self.lines[key].strip()[:60] or "none",
            ) from problem
        if values.size != count or not np.isfinite(values).all():
            raise InputError(
                f"{key} does not hold {count} finite numbers",
                where=self.path,
                got=self.lines[key].strip()[:60] or "none",
            )
        return values.reshape(shape)

    def size(self, key: str) -> tuple[int, int]:
        """Return width and height of a picture in pixels; raises InputError unless they are whole and positive."""
        width, height = self.numbers(key, (2,)).tolist()
        if not all(value.is_integer() and 0 < value <= _LARGEST for value in (width, height)):
            raise InputError(
                f"{key} is no size of a picture",
                where=self.path,
                expected="whole width and height in pixels",
                got=f"{width:g} {height:g}",
            )
        return int(width), int(height)

    def rigid(self, rotation_key: str, translation_key: str | None = None) -> Float:
        """Return the transform (4, 4) of a rotation (9 numbers) and a translation (3 numbers, in metres).

        Raises InputError if the rotation is not orthonormal or mirrors space.
        """
        translation = None if translation_key is None else self.numbers(translation_key, (3,))
        return self._checked(rotation_key, se3.make(self.numbers(rotation_key, (3, 3)), translation))

    def rigid_12(self, key: str) -> Float:
        """Return the transform (4, 4) of 12 numbers [R | t]; raises InputError as `rigid`."""
        both = self.numbers(key, (3, 4))
        return self._checked(key, se3.make(both[:, :3], both[:, 3]))

    def projection(self, key: str) -> Float:
        """Return the projection (3, 4) of a rectified camera.

        Raises InputError unless its left part is an intrinsic matrix without skew, focal lengths a pixel or more.
        """
        matrix = self.numbers(key, (3, 4))
        if (
            min(matrix[0, 0], matrix[1, 1]) < 1
            or np.abs(matrix).max() > _LARGEST
            or np.abs(matrix[[0, 1, 2, 2, 2], [1, 0, 0, 1, 2]] - (0, 0, 0, 0, 1)).max() > 1e-9
        ):
            raise InputError(
                f"{key} is not the projection of a rectified camera",
                where=self.path,
                expected="fx 0 cx ., 0 fy cy ., 0 0 1 .",
                got=self.lines[key].strip()[:120],
            )
        return matrix

    def _checked(self, key: str, matrix: Float) -> Float:
        return se3.check_rigid(key, matrix, where=self.path)


def read_calibration(path: Path) -> KittiCalibration:
    """Return the lines of a calibration file; raises InputError if it is missing, empty or of another format."""
    return calibration_of(read_text(path, "calibration file"), path)


def calibration_of(text: str, path: Path) -> KittiCalibration:
    """Return the lines of the text of a calibration file; raises InputError as `read_calibration`."""
    lines = [line for line in text.splitlines() if line.strip()]
    pairs = [line.partition(":") for line in lines]
    bad = next((line for line, (_, colon, _) in zip(lines, pairs, strict=True) if not colon), None)
    if bad is not None or not pairs:
        raise InputError(
            "this is not a KITTI calibration file",
            where=path,
            expected='lines "key: numbers"',
            got=repr((bad or "")[:60]),
        )
    return KittiCalibration(path, {key.strip(): value for key, _, value in pairs})


def rectified_camera(projection: Float, width: int, height: int) -> Camera:
    """Return the pinhole camera of a projection (3, 4) and an image size in pixels.

    Raises InputError if the principal point lies outside the image: the calibration of other images.
    """
    fx, fy, cx, cy = projection[0, 0], projection[1, 1], projection[0, 2], projection[1, 2]
    if not (0 <= cx < width and 0 <= cy < height):
        raise InputError(
            "the image size does not fit the camera",
            expected=f"the principal point ({cx:.0f}, {cy:.0f}) inside the image",
            got=f"{width}x{height} px",
        )
    return Camera.pinhole(fx, fy, cx, cy, width, height)


def camera_offset(projection: Float, *, pykitti_compat: bool = False) -> Float:
    """Return where cam0's origin lies in the rectified camera of a projection (3, 4), (3,) in metres.

    Exact: K^-1 p4. pykitti keeps only P[0, 3] / P[0, 0], which is 3.6 to 6.8 mm off.
    """
    if pykitti_compat:
        return np.array([projection[0, 3] / projection[0, 0], 0.0, 0.0])
    return np.asarray(np.linalg.solve(projection[:, :3], projection[:, 3]))


def rectified_extrinsic(projection: Float, rectified_from_lidar: Float, *, pykitti_compat: bool = False) -> Float:
    """Return camera_from_lidar (4, 4) = [I | K^-1 p4] . rectified_from_lidar (R_rect_00 . T_velo_cam)."""
    return se3.make(translation=camera_offset(projection, pykitti_compat=pykitti_compat)) @ rectified_from_lidar


def baseline_m(left: Float, right: Float) -> float:
    """Return the distance along x between the rectified cameras of two projections (3, 4), in metres."""
    return float(camera_offset(left)[0] - camera_offset(right)[0])
