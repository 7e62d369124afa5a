"""Cameras in the words of ROS and OpenCV: an intrinsic matrix, the name of a distortion, and its coefficients.

plumb_bob is OpenCV's k1 k2 p1 p2 k3, rational_polynomial its k1 k2 p1 p2 k3 k4 k5 k6, equidistant the four of
cv::fisheye (the names are those of sensor_msgs/distortion_models.hpp). Pixel centres are at whole numbers, as here.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from p2o.errors import InputError
from p2o.geometry.camera import Camera

COUNTS = {"plumb_bob": (0, 4, 5), "rational_polynomial": (0, 8, 12, 14), "equidistant": (4,)}
"""How many coefficients each distortion has; OpenCV's longer forms end in a thin prism and a tilt."""
_COEFFICIENTS = {
    "plumb_bob": "k1 k2 p1 p2, or k1 k2 p1 p2 k3",
    "rational_polynomial": "k1 k2 p1 p2 k3 k4 k5 k6",
    "equidistant": "k1 k2 k3 k4",
}
_FISHEYE = {"SIMPLE_FISHEYE": 0, "FISHEYE": 0, "SIMPLE_RADIAL_FISHEYE": 1, "RADIAL_FISHEYE": 2, "OPENCV_FISHEYE": 4}
"""Models of COLMAP that are equidistant fisheyes, with the number of their coefficients."""


@dataclass(frozen=True)
class Lens:
    """A camera of width x height px with focal lengths and principal point in px, and a distortion of `COUNTS`."""

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
        """Return the camera; raises InputError for values that no camera has."""
        pinhole = (self.fx, self.fy, self.cx, self.cy)
        model, params = colmap_model(self.model, self.coefficients, pinhole)
        return Camera(model, self.width, self.height, params)


def lens_of(camera: Camera, format_name: str) -> Lens:
    """Return a camera in these words, where one of them means exactly the same; a pinhole is a plumb_bob of zeros.

    Raises InputError for other models of COLMAP; `format_name` says what cannot hold them.
    """
    model, params = camera.model, camera.params
    single = model.startswith("SIMPLE") or model in ("RADIAL", "RADIAL_FISHEYE")
    focal, middle, rest = (
        ((params[0], params[0]), params[1:3], params[3:]) if single else (params[:2], params[2:4], params[4:])
    )
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
        raise no_word_for(camera, format_name, "a pinhole, OpenCV's polynomials, or an equidistant fisheye")
    (fx, fy), (cx, cy) = focal, middle
    return Lens(camera.width, camera.height, fx, fy, cx, cy, name, d)


def no_word_for(camera: Camera, format_name: str, known: str) -> InputError:
    """Return the error to raise for a camera that a format cannot hold."""
    return InputError(
        f"{format_name} has no name for the camera model {camera.model}",
        expected=known,
        got=f"{camera.model} {' '.join(f'{value:g}' for value in camera.params)}",
        hint="colmap-cameras and text hold every model",
    )


def colmap_model(
    name: str | None, d: Sequence[float], pinhole: tuple[float, float, float, float], key: str = "camera.D"
) -> tuple[str, tuple[float, ...]]:
    """Return the model of COLMAP and its parameters, of a distortion and fx, fy, cx, cy.

    plumb_bob becomes OPENCV, or FULL_OPENCV with k3; rational_polynomial FULL_OPENCV, equidistant OPENCV_FISHEYE, and
    what has no distortion PINHOLE. `key` names the coefficients in errors.

    Raises InputError for other names, other counts, and coefficients beyond k6.
    """
    if name is None or name == "":
        if any(d):
            raise InputError(
                f"{key.removesuffix('D')}distortion_model is not said", expected=" or ".join(COUNTS), got=f"D of {d}"
            )
        return "PINHOLE", pinhole
    if name not in COUNTS:
        raise InputError(f"the distortion {name!r} is unknown", expected=" or ".join(COUNTS), got=repr(name)[:60])
    if len(d) not in COUNTS[name] or any(d[8:]):
        raise InputError(
            f"{key} does not fit {name}",
            expected=_COEFFICIENTS[name],
            got=f"{len(d)} numbers" if len(d) not in COUNTS[name] else "coefficients beyond k6",
        )
    if name == "equidistant":
        return "OPENCV_FISHEYE", (*pinhole, *d)
    if not any(d):
        return "PINHOLE", pinhole
    if not any(d[4:]):
        return "OPENCV", (*pinhole, *d[:4])
    return "FULL_OPENCV", (*pinhole, *(*d, 0.0, 0.0, 0.0)[:8])
