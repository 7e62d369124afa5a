"""Read and write a bare 4x4 matrix: NumPy's .npy, or text for numpy.loadtxt.

An .npy file cannot state the direction of the transform; the text states it in a comment, which p2o reads. Otherwise
the reading specifies it, or the name of the file (calib_cam_to_velo.txt); without these it is camera_from_lidar.
"""

from __future__ import annotations

import io
import re
from dataclasses import replace
from typing import Any, Literal, get_args

import numpy as np
from p2o import InputError, Options, field, se3
from p2o.reading import Calibration, Reading, Source, read_npy, read_pose, spaced

from p2o_formats.format import ONLY_EXTRINSIC, Format, comment_lines, required_numbers
from p2o_formats.frame_names import is_camera, is_lidar

_DIRECTION = re.compile(r"^\s*#.*?\bdirection:\s*(camera_from_lidar|lidar_from_camera)\b", re.MULTILINE)
_NUMBERS = re.compile(r"[-+0-9.eEnaifNIF\s]+")
_NAMED = re.compile(r"(?P<a>[a-z]+)\d*_?(?P<word>to|from)_?(?P<b>[a-z]+)|^T_(?P<to>[a-z]+)\d*_(?P<of>[a-z]+)\d*$")

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
    text = _numbers_of(source)
    return len(text) < 10_000 and bool(_NUMBERS.fullmatch(text)) and len(text.split()) in (12, 16)


def _numbers_of(source: Source) -> str:
    """Return the text without comments, brackets, separators, and the dashes of lists in YAML."""
    text = " ".join(line.partition("#")[0] for line in source.lines)
    return re.sub(r"[,;\[\]]|(?<!\S)-(?=\s)", " ", text)


def read_npy_matrix(source: Source, reading: Reading) -> Calibration:
    """Return the transform; raises InputError unless the array is a rigid transform (4, 4) or (3, 4)."""
    array = read_npy(source.data, source.path)
    if array.shape not in ((4, 4), (3, 4)) or array.dtype.kind not in "iuf":
        got = f"{array.dtype} {array.shape}"
        raise InputError("the array is not a transform", where=source.path, expected="4x4 numbers", got=got)
    return _read(array.astype(np.float64).tolist(), source, reading)


def read_text_matrix(source: Source, reading: Reading) -> Calibration:
    """Return the transform of 12 or 16 numbers; raises InputError if they are not finite or not rigid."""
    words = _numbers_of(source).split()
    return _read(required_numbers("the values", words, None, source.path, "finite numbers"), source, reading)


def _read(values: Any, source: Source, reading: Reading) -> Calibration:
    match = _DIRECTION.search(source.text)
    stated = match[1] if match else None
    if reading.direction and stated and stated != reading.direction:
        raise InputError("the file states another direction", where=source.path, expected=reading.direction, got=stated)
    named = None if stated else _named_direction(source.path.stem)
    direction = reading.direction or stated or named
    name = direction or "camera_from_lidar"
    pose, remarks = read_pose(name, values, source.path)
    if direction is None:
        remarks = (*remarks, f"{source.path}: the file does not state a direction; camera_from_lidar is assumed")
    elif reading.direction is None and stated is None:
        text = f"{source.path}: read as {named} because of the file's name; if not: FILE?direction="
        remarks = (*remarks, text + next(other for other in get_args(Direction) if other != named))
    return Calibration(None, se3.inverse(pose) if name == "lidar_from_camera" else pose, remarks=remarks)


def _named_direction(stem: str) -> Direction | None:
    """Return the direction that a file name states, as calib_cam_to_velo (KITTI-360) or T_lidar_camera, or None."""
    for match in _NAMED.finditer(stem):
        a, b = (match["to"], match["of"]) if match["to"] else (match["a"], match["b"])
        to, of = (b, a) if match["word"] == "to" else (a, b)
        if is_camera(to) and is_lidar(of):
            return "camera_from_lidar"
        if is_lidar(to) and is_camera(of):
            return "lidar_from_camera"
    return None


NPY_FORMAT = Format(
    name="npy",
    summary="NumPy .npy of a 4x4 matrix; its direction is not in the file.",
    rank=5,
    holds=ONLY_EXTRINSIC,
    direction="camera_from_lidar, or lidar_from_camera with direction=",
    suffix=".npy",
    options=MatrixOptions,
    fields=frozenset({"direction"}),
    recognises=recognises_npy,
    read=read_npy_matrix,
    write=write_npy,
)

TEXT_FORMAT = replace(
    NPY_FORMAT,
    name="matrix",
    summary="4 rows of 4 numbers as text, for numpy.loadtxt, with the direction in a comment.",
    rank=90,
    suffix=".txt",
    recognises=recognises_text,
    read=read_text_matrix,
    write=write_text,
)
