"""Read and check calibration files of KITTI (raw, object, odometry) and compose the exact extrinsic."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from p2o import Camera, Float, InputError, UnknownNameError, se3
from p2o.reading import naming, numbers, read_text

from p2o_formats.camera_entry import colmap_model, is_intrinsic, read_matrix, skew_remarks

_MAX_VALUE = 1e7
"""Largest plausible value of a calibration, in pixels or pixels times metres."""
MAX_BASELINE_M = 100.0
"""Largest plausible distance between two cameras of one vehicle."""
_FAR_M = 10.0
"""Distance of camera and LiDAR above which a warning is given."""
_LINE = re.compile(r"\s*(?:([^:]*?)\s*:|([A-Za-z]\w*)\s(?=[\s\d.eE+-]+$))(.*)")
"""A line "key: numbers", or "key numbers" as in the tracking benchmark."""


@dataclass(frozen=True)
class KittiCalibration:
    """Lines "key: numbers" or "key numbers" of a calibration file; the methods check the numbers of requested keys."""

    path: Path
    lines: Mapping[str, str]
    ends_line: bool = True
    """False if the file does not end with a line end."""

    def remarks(self, extrinsic: Float) -> tuple[str, ...]:
        """Return what is unlikely about the file and the extrinsic (4, 4) in it, as warnings."""
        remarks = (f"{self.path}: the last line has no line end: is the file truncated?",) * (not self.ends_line)
        return remarks + far_apart(self.path, extrinsic)

    def numbers(self, key: str, shape: tuple[int, ...]) -> Float:
        """Return the numbers of a key; raises InputError if it is missing, or for another count or invalid numbers."""
        if key not in self.lines:
            # A damaged file may have arbitrarily long keys.
            raise UnknownNameError("key", key, (known[:20] for known in self.lines), where=self.path)
        values = numbers(self.lines[key].split(), shape)
        if values is None:
            got = self.lines[key].strip()[:60] or "none"
            raise InputError(f"{key} does not contain {np.prod(shape)} finite numbers", where=self.path, got=got)
        return values

    def size(self, key: str) -> tuple[int, int]:
        """Return width and height of an image in pixels; raises InputError unless they are positive integers."""
        width, height = self.numbers(key, (2,)).tolist()
        if not all(value.is_integer() and 0 < value <= _MAX_VALUE for value in (width, height)):
            fault, got = f"{key} is not an image size", f"{width:g} {height:g}"
            raise InputError(fault, where=self.path, expected="width and height in whole pixels", got=got)
        return int(width), int(height)

    def rigid(self, rotation_key: str, translation_key: str | None = None) -> Float:
        """Return the transform (4, 4) of a rotation (9 numbers) and a translation (3 numbers, in metres).

        Raises InputError if the rotation is not orthonormal or mirrors space.
        """
        translation = None if translation_key is None else self.numbers(translation_key, (3,))
        matrix = se3.make(self.numbers(rotation_key, (3, 3)), translation)
        return se3.check_rigid(rotation_key, matrix, where=self.path)

    def rigid_12(self, key: str) -> Float:
        """Return the transform (4, 4) of 12 numbers [R | t]; raises InputError as `rigid`."""
        both = self.numbers(key, (3, 4))
        return se3.check_rigid(key, se3.make(both[:, :3], both[:, 3]), where=self.path)

    def projection(self, key: str) -> Float:
        """Return the projection (3, 4) of a rectified camera.

        Raises InputError unless its left part is an intrinsic matrix with focal lengths of at least one pixel.
        """
        matrix = self.numbers(key, (3, 4))
        if min(matrix[0, 0], matrix[1, 1]) < 1 or np.abs(matrix).max() > _MAX_VALUE or not is_intrinsic(matrix[:, :3]):
            fault, got = f"{key} is not the projection of a rectified camera", self.lines[key].strip()[:120]
            raise InputError(fault, where=self.path, expected="fx 0 cx ., 0 fy cy ., 0 0 1 .", got=got)
        return matrix

    def distorted_camera(self, number: str, size: tuple[int, int]) -> tuple[Camera, tuple[str, ...]]:
        """Return the camera of raw images (K_NN, D_NN) of a size in pixels, and a remark on its skew."""
        matrix, d = self.numbers(f"K_{number}", (3, 3)), self.numbers(f"D_{number}", (5,))
        pinhole, remarks = read_matrix(f"K_{number}", matrix.tolist(), size[1], self.path)
        with naming(self.path):
            model, params = colmap_model("plumb_bob", d.tolist(), pinhole)
            return Camera(model, *size, params), remarks


def far_apart(where: object, extrinsic: Float) -> tuple[str, ...]:
    """Return a remark if camera and LiDAR are implausibly far apart in an extrinsic (4, 4), as in millimetres."""
    distance = float(np.linalg.norm(extrinsic[:3, 3]))
    return (f"{where}: camera and LiDAR are {distance:.3g} m apart: is a number damaged?",) * (distance > _FAR_M)


def read_calibration(path: Path) -> KittiCalibration:
    """Read the lines of a calibration file; raises InputError if it is missing, empty or of another format."""
    return calibration_of(read_text(path, "calibration file"), path)


def calibration_of(text: str, path: Path) -> KittiCalibration:
    """Return the calibration in a text; raises InputError as `read_calibration`."""
    refuse_cut_off(text, path)
    lines = [line for line in text.splitlines() if line.strip()]
    matches = [_LINE.match(line) for line in lines]
    entries = [(match[1] or match[2] or "", match[3].split()) for match in matches if match is not None]
    pairs = {key: " ".join(words) for key, words in entries}
    if not pairs or None in matches:
        got = repr(next((line for line, match in zip(lines, matches, strict=True) if match is None), "")[:60])
        raise InputError("this is not a KITTI calibration file", where=path, expected='lines "key: numbers"', got=got)
    twice = next((key for key, words in entries if pairs[key] != " ".join(words)), None)
    if twice is not None:
        raise InputError(f"{twice[:20]} is given twice with different values", where=path, expected="each key once")
    return KittiCalibration(path, pairs, text.endswith(("\n", "\r")))


def refuse_cut_off(text: str, path: Path, words_per_line: int = 1) -> None:
    """Raise InputError if a text ends without a line end in a number with fewer digits than the number before.

    Numbers are compared only in formats of fixed width: with an exponent, or times. e-01 cut to e-0 is still a number.
    """
    words = text[-1000:].split()
    if text.endswith(("\n", "\r")) or len(words) <= words_per_line:
        return
    last, before = (re.sub(r"\d", "0", words[-1 - i].lstrip("+-").replace("+", "-")) for i in (0, words_per_line))
    if any(mark in before for mark in "e:-") and before.startswith(last) and last != before:
        expected = f"a number as {words[-1 - words_per_line][:40]}, and a line end"
        hint = "copy the file again; if it is complete, add a line end"
        raise InputError("the file is truncated", where=path, expected=expected, got=words[-1][:40], hint=hint)


def rectified_camera(projection: Float, width: int, height: int) -> Camera:
    """Return the pinhole camera of a projection (3, 4) and an image size in pixels.

    Raises InputError if the principal point is outside the image, so that the image belongs to another camera, and as
    `skew_remarks`.
    """
    skew_remarks("the projection", projection[:, :3], height, None)
    check_centre(projection, width, height)
    return Camera.pinhole(projection[0, 0], projection[1, 1], projection[0, 2], projection[1, 2], width, height)


def check_centre(matrix: Float, width: int, height: int) -> None:
    """Raise InputError if the principal point of a matrix (3, 3) is outside an image of width x height or at its edge.

    Near the right and lower edges, and in the first third of both sides, the image was resized after the calibration.
    """
    cx, cy = matrix[0, 2], matrix[1, 2]
    share = cx / width, cy / height
    if not 0 <= min(share) <= max(share) < 0.9 or max(share) < 0.3:
        expected = f"the principal point ({cx:.0f}, {cy:.0f}) near its centre"
        raise InputError("the image size does not fit the camera", expected=expected, got=f"{width}x{height} px")


def camera_offset(projection: Float, *, pykitti_compat: bool = False) -> Float:
    """Return the origin of cam0 in the rectified camera of a projection (3, 4), as a vector (3,) in metres.

    The result is exact: K^-1 p4. pykitti uses only P[0, 3] / P[0, 0], with an error of 3.6 to 6.8 mm.
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
