"""Read and write a bare 4x4 matrix: NumPy's .npy, or text for numpy.loadtxt.

An .npy file cannot state the direction of the transform; the text states it in a comment, which p2o reads. A matrix
without a direction is taken as camera_from_lidar, unless the reading specifies it.
"""

from __future__ import annotations

import io
import re
from typing import Any, Literal

import numpy as np
from p2o import InputError, Options, field, se3
from p2o.reading import Calibration, Reading, Source, read_npy, read_pose, spaced

from p2o_formats.format import ONLY_EXTRINSIC, Format, comment_lines, required_numbers

_DIRECTION = re.compile(r"^\s*#.*?\bdirection:\s*(camera_from_lidar|lidar_from_camera)\b", re.MULTILINE)
_NUMBERS = re.compile(r"[-+0-9.eEnaifNIF\s,;\[\]]+")


Direction = Literal["camera_from_lidar", "lidar_from_camera"]


class MatrixOptions(Options):
    """Direction of the transform."""

    direction: Direction = field("camera_from_lidar", help="Direction of the transform.")


def _directed(calibration: Calibration, options: MatrixOptions) -> Any:
    pose = calibration.extrinsic()
    return np.array(pose if options.direction == "camera_from_lidar" else se3.inverse(pose), dtype=np.float64)


def write_npy(calibration: Calibration, options: MatrixOptions) -> bytes:
    """Return the bytes of a float64 array (4, 4)."""
    data = io.BytesIO()
    np.save(data, _directed(calibration, options), allow_pickle=False)
    return data.getvalue()


def write_text(calibration: Calibration, options: MatrixOptions) -> bytes:
    """Return comments and four rows of numbers."""
    a, b = options.direction.split("_from_")
    lines = [
        f"# direction: {options.direction} (maps points of the {b} to the {a}, as columns)",
        "# Metres. Camera x right, y down, z forward; LiDAR as its points.",
        *comment_lines(calibration),
        *(spaced(row) for row in _directed(calibration, options)),
    ]
    return ("\n".join(lines) + "\n").encode()


def recognises_npy(source: Source) -> bool:
    """Return whether the file starts with the magic number of .npy."""
    return source.data.startswith(b"\x93NUMPY")


def recognises_text(source: Source) -> bool:
    """Return whether the file contains exactly 12 or 16 numbers, apart from comments."""
    text = " ".join(source.lines)
    return len(text) < 10_000 and bool(_NUMBERS.fullmatch(text)) and len(_words(text)) in (12, 16)


def _words(text: str) -> list[str]:
    return re.sub(r"[,;\[\]]", " ", text).split()


def read_npy_matrix(source: Source, reading: Reading) -> Calibration:
    """Return the transform; raises InputError unless the array is a rigid transform (4, 4) or (3, 4)."""
    array = read_npy(source.data, source.path)
    if array.shape not in ((4, 4), (3, 4)) or array.dtype.kind not in "iuf":
        got = f"{array.dtype} {array.shape}"
        raise InputError("the array is not a transform", where=source.path, expected="4x4 numbers", got=got)
    return _read(array.astype(np.float64).tolist(), source, reading)


def read_text_matrix(source: Source, reading: Reading) -> Calibration:
    """Return the transform of 12 or 16 numbers; raises InputError if they are not finite or not rigid."""
    words = _words(" ".join(source.lines))
    return _read(required_numbers("the values", words, None, source.path, "finite numbers"), source, reading)


def _read(values: Any, source: Source, reading: Reading) -> Calibration:
    match = _DIRECTION.search(source.text)
    stated = match[1] if match else None
    if reading.direction and stated and stated != reading.direction:
        raise InputError("the file states another direction", where=source.path, expected=reading.direction, got=stated)
    direction = reading.direction or stated
    name = direction or "camera_from_lidar"
    pose, remarks = read_pose(name, values, source.path)
    if direction is None:
        remarks = (*remarks, f"{source.path}: the file does not state a direction; camera_from_lidar is assumed")
    return Calibration(None, se3.inverse(pose) if name == "lidar_from_camera" else pose, remarks=remarks)


NPY_FORMAT = Format(
    name="npy",
    summary="NumPy .npy of a 4x4 matrix; its direction is not in the file.",
    rank=5,
    holds=ONLY_EXTRINSIC,
    direction="camera_from_lidar, or lidar_from_camera with direction=",
    suffix=".npy",
    options=MatrixOptions,
    recognises=recognises_npy,
    read=read_npy_matrix,
    write=write_npy,
)

TEXT_FORMAT = Format(
    name="matrix",
    summary="4 rows of 4 numbers as text, for numpy.loadtxt, with the direction in a comment.",
    rank=90,
    holds=ONLY_EXTRINSIC,
    direction="camera_from_lidar, or lidar_from_camera with direction=",
    suffix=".txt",
    options=MatrixOptions,
    recognises=recognises_text,
    read=read_text_matrix,
    write=write_text,
)
