"""Cameras of frame.yaml (a pycolmap model with its parameters, or K and D), and cameras in the terms of ROS and OpenCV.

plumb_bob has k1 k2 p1 p2 k3 of OpenCV, rational_polynomial k1 k2 p1 p2 k3 k4 k5 k6, equidistant the four of
cv::fisheye (names of sensor_msgs/distortion_models.hpp). Pixel centres are at integers, as in p2o.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from p2o import Camera, Float, InputError, Options, UnknownNameError, field
from p2o.reading import naming, numbers, validated

_FORMS = "model, width, height and params; or width, height, K and, with distortion, distortion_model and D"


class ModelEntry(Options):
    """Camera of frame.yaml with the name of its model."""

    model: str = field("PINHOLE", help="Name of a pycolmap camera model.")
    width: int = field(..., gt=0, help="Image width in pixels.")
    height: int = field(..., gt=0, help="Image height in pixels.")
    params: tuple[float, ...] = field(..., help="Parameters in pycolmap's order, pixel centres at integers.")


class MatrixEntry(Options):
    """Camera of frame.yaml with its intrinsic matrix and distortion coefficients."""

    width: int = field(..., gt=0, help="Image width in pixels.")
    height: int = field(..., gt=0, help="Image height in pixels.")
    K: Any = field(..., help="Intrinsic matrix, 3x3 or 9 numbers in a row, pixel centres at integers.")
    distortion_model: Literal["plumb_bob", "rational_polynomial", "equidistant"] | None = field(
        None, help="Distortion model of D, with the names of ROS."
    )
    D: tuple[float, ...] = field(
        (), help="k1 k2 p1 p2 [k3] of plumb_bob, ... k3 k4 k5 k6 of rational_polynomial, k1 k2 k3 k4 of equidistant."
    )


def read_camera(value: Any, where: Path) -> Camera:
    """Return the camera of an entry of frame.yaml; `where` appears in errors.

    plumb_bob becomes OPENCV, or FULL_OPENCV with k3; rational_polynomial FULL_OPENCV, equidistant OPENCV_FISHEYE, and
    a camera without distortion PINHOLE. Pixel centres are at integers in ROS, in OpenCV and in p2o.

    Raises UnknownNameError for unknown keys and models, and InputError for other invalid entries.
    """
    if not isinstance(value, Mapping) or ("params" in value) == ("K" in value):
        raise InputError("the entry is not a camera", where=where, expected=_FORMS, got=f"camera: {value}"[:80])
    entry_type: type[MatrixEntry] | type[ModelEntry] = MatrixEntry if "K" in value else ModelEntry
    unknown = next((key for key in value if key not in entry_type.model_fields), None)
    if unknown is not None:
        known = entry_type.model_fields
        raise UnknownNameError("key of camera", str(unknown), known, where=where, hint=f"a camera has {_FORMS}")
    entry = validated(entry_type, value, "camera", where=where)
    with naming(where):
        if isinstance(entry, ModelEntry):
            return Camera(entry.model, entry.width, entry.height, entry.params)
        matrix = numbers(entry.K, (3, 3))
        if matrix is None or not without_skew(matrix):
            expected = "fx 0 cx, 0 fy cy, 0 0 1, nested or in a row, without skew"
            raise InputError("camera.K is not an intrinsic matrix", expected=expected, got=str(entry.K)[:80])
        pinhole = (matrix[0, 0], matrix[1, 1], matrix[0, 2], matrix[1, 2])
        model, params = colmap_model(entry.distortion_model, entry.D, pinhole)
        return Camera(model, entry.width, entry.height, params)


def without_skew(matrix: Float) -> bool:
    """Return whether a matrix (3, 3) is fx 0 cx, 0 fy cy, 0 0 1."""
    return bool((np.abs(matrix[[0, 1, 2, 2, 2], [1, 0, 0, 1, 2]] - (0, 0, 0, 0, 1)) <= 1e-9).all())


COUNTS = {"plumb_bob": (0, 4, 5), "rational_polynomial": (0, 8, 12, 14), "equidistant": (4,)}
"""Valid numbers of coefficients of each distortion model; OpenCV's longer forms add a thin prism and a tilt."""
_COEFFICIENTS = {
    "plumb_bob": "k1 k2 p1 p2, or k1 k2 p1 p2 k3", "rational_polynomial": "k1 k2 p1 p2 k3 k4 k5 k6",
    "equidistant": "k1 k2 k3 k4",
}  # fmt: skip
_FISHEYE = ("SIMPLE_FISHEYE", "FISHEYE", "SIMPLE_RADIAL_FISHEYE", "RADIAL_FISHEYE", "OPENCV_FISHEYE")
"""Equidistant fisheye models of COLMAP."""


@dataclass(frozen=True)
class Lens:
    """Camera of width x height px, focal lengths and principal point in px, and a distortion model of `COUNTS`."""

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    model: str
    coefficients: tuple[float, ...]

    @property
    def matrix(self) -> list[list[float]]:
        """The intrinsic matrix K (3, 3)."""
        return [[self.fx, 0.0, self.cx], [0.0, self.fy, self.cy], [0.0, 0.0, 1.0]]

    def camera(self) -> Camera:
        """Return the camera; raises InputError for invalid values."""
        model, params = colmap_model(self.model, self.coefficients, (self.fx, self.fy, self.cx, self.cy))
        return Camera(model, self.width, self.height, params)


def lens_of(camera: Camera, format_name: str) -> Lens:
    """Return the lens that is exactly equal to a camera; a pinhole camera becomes plumb_bob with zero coefficients.

    Raises InputError, with `format_name`, for camera models without an equal.
    """
    model, params = camera.model, camera.params
    if model.startswith("SIMPLE") or model in ("RADIAL", "RADIAL_FISHEYE"):
        params = (params[0], *params)
    (fx, fy, cx, cy), rest = params[:4], params[4:]
    d: tuple[float, ...]
    if model in ("PINHOLE", "SIMPLE_PINHOLE"):
        name, d = "plumb_bob", (0.0,) * 5
    elif model in ("SIMPLE_RADIAL", "RADIAL", "OPENCV"):
        name, d = "plumb_bob", (*rest, 0.0, 0.0, 0.0, 0.0)[:5]
    elif model == "FULL_OPENCV":
        name, d = ("rational_polynomial", rest) if any(rest[5:]) else ("plumb_bob", rest[:5])
    elif model in _FISHEYE:
        name, d = "equidistant", (*rest, 0.0, 0.0, 0.0, 0.0)[:4]
    else:
        raise unsupported_model(camera, format_name, "a pinhole, OpenCV's polynomials, or an equidistant fisheye")
    return Lens(camera.width, camera.height, fx, fy, cx, cy, name, d)


def unsupported_model(camera: Camera, format_name: str, known: str) -> InputError:
    """Return the error for a camera model that a format cannot express."""
    fault = f"{format_name} has no name for the camera model {camera.model}"
    got = f"{camera.model} {' '.join(f'{value:g}' for value in camera.params)}"
    return InputError(fault, expected=known, got=got, hint="colmap-cameras and text can express every model")


def colmap_model(
    name: str | None, d: Sequence[float], pinhole: tuple[float, float, float, float]
) -> tuple[str, tuple[float, ...]]:
    """Return model and parameters of COLMAP for a distortion model, its coefficients and (fx, fy, cx, cy) in px.

    plumb_bob becomes OPENCV, or FULL_OPENCV with k3; rational_polynomial FULL_OPENCV, equidistant OPENCV_FISHEYE, and
    a camera without distortion PINHOLE. Raises InputError for other names or counts, and for coefficients beyond k6.
    """
    if name is None or name == "":
        if any(d):
            raise InputError("camera.distortion_model is missing", expected=" or ".join(COUNTS), got=f"D of {d}")
        return "PINHOLE", pinhole
    if name not in COUNTS:
        raise InputError(f"the distortion {name!r} is unknown", expected=" or ".join(COUNTS), got=repr(name)[:60])
    if len(d) not in COUNTS[name] or any(d[8:]):
        got = f"{len(d)} numbers" if len(d) not in COUNTS[name] else "coefficients beyond k6"
        raise InputError(f"camera.D does not fit {name}", expected=_COEFFICIENTS[name], got=got)
    if name == "equidistant":
        return "OPENCV_FISHEYE", (*pinhole, *d)
    if not any(d):
        return "PINHOLE", pinhole
    if not any(d[4:]):
        return "OPENCV", (*pinhole, *d[:4])
    return "FULL_OPENCV", (*pinhole, *(*d, 0.0, 0.0, 0.0)[:8])
