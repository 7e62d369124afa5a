"""Cameras of frame.yaml (a pycolmap model with its parameters, or K and D), and cameras in the terms of ROS and OpenCV.

plumb_bob has k1 k2 p1 p2 k3 of OpenCV, rational_polynomial k1 k2 p1 p2 k3 k4 k5 k6, equidistant the four of
cv::fisheye (names of sensor_msgs/distortion_models.hpp). `distortion_model` maps the names of other tools to these, for
all readers of files and bags. Pixel centres are at integers, as in p2o.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from p2o import Camera, Float, InputError, Options, UnknownNameError, field
from p2o.reading import naming, numbers, validated

CAMERA_FORMS = (
    "model, width, height and params; or width, height, K and, with distortion, distortion_model and D; or FILE"
)


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
    distortion_model: str | None = field(
        None, max_length=100, help="Distortion model of D: plumb_bob, rational_polynomial, equidistant, or a synonym."
    )
    D: tuple[float, ...] = field(
        (), help="k1 k2 p1 p2 [k3] of plumb_bob, ... k3 k4 k5 k6 of rational_polynomial, k1 k2 k3 k4 of equidistant."
    )


def read_camera(value: Any, where: Path) -> Camera:
    """Return the camera of `read_camera_entry` without its remarks."""
    return read_camera_entry(value, where)[0]


def read_camera_entry(value: Any, where: Path) -> tuple[Camera, tuple[str, ...]]:
    """Return the camera of an entry of frame.yaml, and remarks; `where` appears in errors.

    plumb_bob becomes OPENCV, or FULL_OPENCV with k3; rational_polynomial FULL_OPENCV, equidistant OPENCV_FISHEYE, and
    a camera without distortion PINHOLE. Pixel centres are at integers in ROS, in OpenCV and in p2o.

    Raises UnknownNameError for unknown keys and models, and InputError for other invalid entries.
    """
    if not isinstance(value, Mapping) or ("params" in value) == ("K" in value):
        raise InputError("the entry is not a camera", where=where, expected=CAMERA_FORMS, got=f"camera: {value}"[:80])
    entry_type: type[MatrixEntry] | type[ModelEntry] = MatrixEntry if "K" in value else ModelEntry
    unknown = next((key for key in value if key not in entry_type.model_fields), None)
    if unknown is not None:
        known = entry_type.model_fields
        raise UnknownNameError("key of camera", str(unknown), known, where=where, hint=f"a camera has {CAMERA_FORMS}")
    entry = validated(entry_type, value, "camera", where=where)
    with naming(where):
        if isinstance(entry, ModelEntry):
            return Camera(entry.model, entry.width, entry.height, entry.params), ()
        pinhole, remarks = read_matrix("camera.K", entry.K, entry.height, where)
        model, params = colmap_model(entry.distortion_model, entry.D, pinhole)
        return Camera(model, entry.width, entry.height, params), remarks


Pinhole = tuple[float, float, float, float]
"""fx, fy, cx, cy in px."""


def read_matrix(name: str, value: Any, height: int, where: object) -> tuple[Pinhole, tuple[str, ...]]:
    """Return fx, fy, cx, cy of the intrinsic matrix of a file, nested or in a row, and a remark on its skew.

    Raises InputError, with `name`, for other values, for a transposed matrix, and as `skew_remarks`.
    """
    matrix = numbers(value, (3, 3))
    if matrix is None or not is_intrinsic(matrix):
        of_matlab = matrix is not None and is_intrinsic(matrix.T)
        hint = "transpose it, as MATLAB's matrices, whose principal point is also 1 px larger: subtract 1 from cx, cy"
        fault, expected, got = f"{name} is not an intrinsic matrix", "fx 0 cx, 0 fy cy, 0 0 1", str(value)[:80]
        raise InputError(fault, where=where, expected=expected, got=got, hint=hint if of_matlab else None)
    pinhole = (float(matrix[0, 0]), float(matrix[1, 1]), float(matrix[0, 2]), float(matrix[1, 2]))
    return pinhole, skew_remarks(name, matrix, height, where)


def is_intrinsic(matrix: Float) -> bool:
    """Return whether a matrix (3, 3) is fx s cx, 0 fy cy, 0 0 1."""
    return bool((np.abs(matrix[[1, 2, 2, 2], [0, 0, 1, 2]] - (0, 0, 0, 1)) <= 1e-9).all())


_MOST_SKEW_PX = 1.0
"""Largest effect of a skew that is neglected: below the noise of edges in the image."""


def skew_remarks(name: str, matrix: Float, height: int, where: object) -> tuple[str, ...]:
    """Return a remark if the skew of an intrinsic matrix (3, 3) is neglected, with its largest effect in px.

    A pixel moves by s (v - cy) / fy along u. Raises InputError if this exceeds 1 px in an image of `height` px.
    """
    skew, fy, cy = float(matrix[0, 1]), float(matrix[1, 1]), float(matrix[1, 2])
    effect_px = abs(skew) * max(abs(cy), abs(height - 1 - cy)) / max(abs(fy), 1e-9)
    if effect_px > _MOST_SKEW_PX:
        fault = f"{name} has a skew of {skew:g}, which shifts pixels by up to {effect_px:.2g} px"
        hint = "calibrate the camera without skew, as OpenCV and ROS do; or set it to 0, if this error is acceptable"
        raise InputError(fault, where=where, expected=f"at most {_MOST_SKEW_PX:g} px", hint=hint)
    text = f"{where}: the skew {skew:g} of {name} is neglected; its largest effect in the image is {effect_px:.2g} px"
    return (text,) if abs(skew) > 1e-9 else ()


COUNTS = {"plumb_bob": (0, 4, 5), "rational_polynomial": (0, 4, 5, 8, 12, 14), "equidistant": (4,)}
"""Valid numbers of coefficients of each distortion model; OpenCV's longer forms add a thin prism and a tilt."""
_COEFFICIENTS = {
    "plumb_bob": "k1 k2 p1 p2, or k1 k2 p1 p2 k3", "rational_polynomial": "k1 k2 p1 p2 k3 k4 k5 k6",
    "equidistant": "k1 k2 k3 k4",
}  # fmt: skip
_NAMES = {
    "plumb_bob": "plumbbob radtan radtan4 radtan5 radialtangential brown brownconrady modifiedbrownconrady opencv",
    "rational_polynomial": "rationalpolynomial rational radtan8 radialtangential8 fullopencv",
    "equidistant": "equidistant equi fisheye opencvfisheye kannalabrandt kannalabrandt4 kannalabrandt8 kb kb4 kb8",
    "": "none nodistortion undistorted rectified",
}  # fmt: skip
"""Names of the distortion models in other tools, in lower case and without separators."""
_MODELS = {name: model for model, names in _NAMES.items() for name in names.split()}


def distortion_model(name: str) -> str:
    """Return the distortion model of `COUNTS`, or "" without distortion, of a name of ROS or another tool.

    Upper and lower case, separators, and a leading `pinhole` are ignored. Raises InputError for other names.
    """
    word = re.sub(r"[^a-z0-9]", "", name.lower())
    model = _MODELS.get(word, _MODELS.get(word.removeprefix("pinhole"))) if name else ""
    if model is None:
        fault, known = f"the distortion {name[:60]!r} is unknown", " or ".join(COUNTS)
        hint = "other names of these models are accepted, such as radtan, brown_conrady, fisheye and kannala_brandt"
        raise InputError(fault, expected=known, got=repr(name)[:60], hint=hint)
    return model


_FISHEYE = ("SIMPLE_FISHEYE", "FISHEYE", "SIMPLE_RADIAL_FISHEYE", "RADIAL_FISHEYE", "OPENCV_FISHEYE")
"""Equidistant fisheye models of COLMAP."""


@dataclass(frozen=True)
class Lens:
    """Camera of width x height px, focal lengths and principal point in px, a distortion model, and remarks on it."""

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    model: str
    coefficients: tuple[float, ...]
    remarks: tuple[str, ...] = ()

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


def colmap_model(name: str | None, d: Sequence[float], pinhole: Pinhole) -> tuple[str, tuple[float, ...]]:
    """Return model and parameters of COLMAP for a distortion model, its coefficients and (fx, fy, cx, cy) in px.

    plumb_bob becomes OPENCV, or FULL_OPENCV with k3; rational_polynomial FULL_OPENCV, equidistant OPENCV_FISHEYE, and
    a camera without distortion PINHOLE. Raises InputError for other names or counts, for coefficients beyond k6, and
    for the inverse of a model unless its coefficients are zero.
    """
    if (name or "").lower().lstrip(" _-").startswith("inverse"):
        # Distortion models of RealSense that map distorted pixels to rays.
        if any(d):
            fault = f"the distortion {name!r} maps image pixels to rays, and p2o needs the map from rays to pixels"
            hint = "calibrate the camera with OpenCV or ROS (plumb_bob), or rectify the images and use none"
            raise InputError(fault, expected=" or ".join(COUNTS), got=f"D of {tuple(d)}"[:80], hint=hint)
        return "PINHOLE", pinhole
    name = distortion_model(name or "")
    if not name:
        if any(d):
            got = f"D of {tuple(d)}"[:80]
            raise InputError("camera.distortion_model is missing", expected=" or ".join(COUNTS), got=got)
        return "PINHOLE", pinhole
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
