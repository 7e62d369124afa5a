"""The camera as frame.yaml may tell it: a pycolmap model with its parameters, or K and D as in ROS and OpenCV."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal

import numpy as np

from p2o.arrays import Float
from p2o.errors import InputError, UnknownNameError
from p2o.files.input_file import naming
from p2o.formats.lens import colmap_model
from p2o.geometry.camera import Camera
from p2o.geometry.pose_text import numbers
from p2o.host.validation import validated
from p2o.options import Options, field

_FORMS = "model, width, height and params; or width, height, K and, with distortion, distortion_model and D"


class ModelEntry(Options):
    """A camera of frame.yaml by the name of its model."""

    model: str = field("PINHOLE", help="Name of a pycolmap camera model.")
    width: int = field(..., gt=0, help="Image width in pixels.")
    height: int = field(..., gt=0, help="Image height in pixels.")
    params: tuple[float, ...] = field(..., help="Parameters in pycolmap's order, pixel centres at integers.")


class MatrixEntry(Options):
    """A camera of frame.yaml by its intrinsic matrix and coefficients of distortion."""

    width: int = field(..., gt=0, help="Image width in pixels.")
    height: int = field(..., gt=0, help="Image height in pixels.")
    K: Any = field(..., help="Intrinsic matrix, 3x3 or 9 numbers in a row, pixel centres at integers.")
    distortion_model: Literal["plumb_bob", "rational_polynomial", "equidistant"] | None = field(
        None, help="What D means: the names of ROS."
    )
    D: tuple[float, ...] = field(
        (), help="k1 k2 p1 p2 [k3] of plumb_bob, ... k3 k4 k5 k6 of rational_polynomial, k1 k2 k3 k4 of equidistant."
    )


def read_camera(value: Any, where: Path) -> Camera:
    """Return the camera that frame.yaml tells; `where` is named in errors.

    plumb_bob becomes OPENCV, or FULL_OPENCV with k3; rational_polynomial FULL_OPENCV, equidistant OPENCV_FISHEYE, and
    what has no distortion PINHOLE. Pixel centres are at whole numbers in ROS and OpenCV as here: nothing is shifted.

    Raises UnknownNameError for unknown keys and models, and InputError for everything else that is no camera.
    """
    if not isinstance(value, Mapping) or ("params" in value) == ("K" in value):
        raise InputError("this is no camera", where=where, expected=_FORMS, got=f"camera: {value}"[:80])
    entry_type: type[MatrixEntry] | type[ModelEntry] = MatrixEntry if "K" in value else ModelEntry
    unknown = next((key for key in value if key not in entry_type.model_fields), None)
    if unknown is not None:
        known = entry_type.model_fields
        raise UnknownNameError("key of camera", str(unknown), known, where=where, hint=f"a camera has {_FORMS}")
    entry = validated(entry_type, value, "camera", where=where)
    with naming(where):
        if isinstance(entry, ModelEntry):
            return Camera(entry.model, entry.width, entry.height, entry.params)
        model, params = _colmap(entry)
        return Camera(model, entry.width, entry.height, params)


def _colmap(entry: MatrixEntry) -> tuple[str, tuple[float, ...]]:
    """Return the pycolmap model and its parameters."""
    matrix = numbers(entry.K, (3, 3))
    if matrix is None or not without_skew(matrix):
        raise InputError(
            "camera.K is no intrinsic matrix",
            expected="fx 0 cx, 0 fy cy, 0 0 1, nested or in a row, without skew",
            got=str(entry.K)[:80],
        )
    pinhole = (matrix[0, 0], matrix[1, 1], matrix[0, 2], matrix[1, 2])
    return colmap_model(entry.distortion_model, entry.D, pinhole)


def without_skew(matrix: Float) -> bool:
    """Return whether a matrix (3, 3) is fx 0 cx, 0 fy cy, 0 0 1."""
    return bool((np.abs(matrix[[0, 1, 2, 2, 2], [1, 0, 0, 1, 2]] - (0, 0, 0, 0, 1)) <= 1e-9).all())
