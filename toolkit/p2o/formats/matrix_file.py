"""A bare matrix of 4x4 numbers: NumPy's .npy, or text that numpy.loadtxt reads.

Such files have no room for a direction: `.npy` says nothing at all, and the text says it in a comment, which p2o reads
again. Without it a matrix is taken for camera_from_lidar unless the reading says otherwise.
"""

from __future__ import annotations

import io
import re
from typing import Any, Literal

import numpy as np

from p2o.errors import InputError
from p2o.files.array_file import read_npy
from p2o.formats.calibration import Calibration
from p2o.formats.format import ONLY_EXTRINSIC, Format, Reading, spaced
from p2o.formats.source import Source
from p2o.geometry import se3
from p2o.geometry.pose_text import numbers, read_pose
from p2o.options import Options, field

_SAID = re.compile(r"^\s*#.*?\bdirection:\s*(camera_from_lidar|lidar_from_camera)\b", re.MULTILINE)
_NUMBERS = re.compile(r"[-+0-9.eEnaifNIF\s,;\[\]]+")


class MatrixOptions(Options):
    """Which way the matrix goes."""

    direction: Literal["camera_from_lidar", "lidar_from_camera"] = field(
        "camera_from_lidar", help="Which way the matrix goes."
    )


def _directed(calibration: Calibration, options: MatrixOptions) -> Any:
    pose = calibration.extrinsic()
    return np.array(pose if options.direction == "camera_from_lidar" else se3.inverse(pose), dtype=np.float64)


def write_npy(calibration: Calibration, options: MatrixOptions) -> bytes:
    """Return the bytes of an array (4, 4) of float64."""
    data = io.BytesIO()
    np.save(data, _directed(calibration, options), allow_pickle=False)
    return data.getvalue()


def write_text(calibration: Calibration, options: MatrixOptions) -> bytes:
    """Return four rows of numbers below comments."""
    a, b = options.direction.split("_from_")
    lines = [
        f"# direction: {options.direction} (takes points of the {b} to the {a}, as columns)",
        "# Metres. Camera x right, y down, z forward; LiDAR as its points.",
        *(spaced(row) for row in _directed(calibration, options)),
    ]
    return ("\n".join(lines) + "\n").encode()


def recognises_npy(source: Source) -> bool:
    """Return whether it is an .npy file."""
    return source.data.startswith(b"\x93NUMPY")


def recognises_text(source: Source) -> bool:
    """Return whether it holds nothing but 12 or 16 numbers beside comments."""
    text = " ".join(source.lines)
    return len(text) < 10_000 and bool(_NUMBERS.fullmatch(text)) and len(_words(text)) in (12, 16)


def _words(text: str) -> list[str]:
    return re.sub(r"[,;\[\]]", " ", text).split()


def read_npy_matrix(source: Source, reading: Reading) -> Calibration:
    """Return the transform; raises InputError for other arrays than 4x4 or 3x4 numbers that are one."""
    array = read_npy(source.data, source.path)
    if array.shape not in ((4, 4), (3, 4)) or array.dtype.kind not in "iuf":
        raise InputError(
            "the array is no transform", where=source.path, expected="4x4 numbers", got=f"{array.dtype} {array.shape}"
        )
    return _read(array.astype(np.float64).tolist(), source, reading)


def read_text_matrix(source: Source, reading: Reading) -> Calibration:
    """Return the transform of 12 or 16 numbers; raises InputError for what is none."""
    words = _words(" ".join(source.lines))
    values = numbers(words, (len(words),))
    if values is None:
        raise InputError("the matrix does not hold finite numbers", where=source.path, got=" ".join(words)[:80])
    return _read(values.tolist(), source, reading)


def _read(values: Any, source: Source, reading: Reading) -> Calibration:
    said = _SAID.search(source.text)
    direction = reading.direction or (said[1] if said else None)
    name = direction or "camera_from_lidar"
    pose, remarks = read_pose(name, values, source.path)
    if direction is None:
        remarks = (*remarks, f"{source.path}: the file does not say its direction, and camera_from_lidar is taken")
    if reading.direction and said and said[1] != reading.direction:
        raise InputError("the file says another direction", where=source.path, expected=reading.direction, got=said[1])
    return Calibration(None, se3.inverse(pose) if name == "lidar_from_camera" else pose, remarks=remarks)


NPY_FORMAT = Format(
    name="npy",
    summary="NumPy .npy of a 4x4 matrix; its direction is not in the file.",
    holds=ONLY_EXTRINSIC,
    needs=ONLY_EXTRINSIC,
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
    holds=ONLY_EXTRINSIC,
    needs=ONLY_EXTRINSIC,
    direction="camera_from_lidar, or lidar_from_camera with direction=",
    suffix=".txt",
    options=MatrixOptions,
    recognises=recognises_text,
    read=read_text_matrix,
    write=write_text,
)
