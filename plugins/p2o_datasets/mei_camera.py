"""Fisheye cameras of the unified model (Mei, Rives: Single view point omnidirectional camera calibration. ICRA 2007).

A point is projected to the unit sphere, then from a centre at distance `xi` behind the sphere's centre to a plane,
distorted as in OpenCV (k1, k2, p1, p2), and scaled by the generalised focal lengths gamma. COLMAP has no such model:
its fisheye polynomial of degree 13 (RAD_TAN_THIN_PRISM_FISHEYE) is fitted to the half space in front of the camera, and
the residual is checked.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
from p2o import Camera, Float, InputError
from p2o.solving import import_keeping_signals

_MODEL = "RAD_TAN_THIN_PRISM_FISHEYE"
_EXTRA = 12
_MAX_ERROR_PX = 0.05
_MAX_ANGLE_DEG = 89.5


@dataclass(frozen=True)
class MeiLens:
    """Parameters of the unified model; gamma and the principal point in px, pixel centres at integers."""

    xi: float
    k1: float
    k2: float
    p1: float
    p2: float
    gamma1: float
    gamma2: float
    u0: float
    v0: float

    def project(self, xyz: Float) -> Float:
        """Return pixels (N, 2) of points (N, 3) in the optical frame."""
        x, y, z = (xyz / np.linalg.norm(xyz, axis=1, keepdims=True)).T
        x, y = x / (z + self.xi), y / (z + self.xi)
        square = x * x + y * y
        radial = 1 + self.k1 * square + self.k2 * square**2
        u = x * radial + 2 * self.p1 * x * y + self.p2 * (square + 2 * x * x)
        v = y * radial + 2 * self.p2 * x * y + self.p1 * (square + 2 * y * y)
        return np.stack([self.gamma1 * u + self.u0, self.gamma2 * v + self.v0], axis=1)


@cache
def mei_camera(lens: MeiLens, width: int, height: int) -> Camera:
    """Return a camera of COLMAP that approximates the lens in the half space in front of it, to 0.05 px.

    Raises InputError for invalid parameters, and for a lens that the model cannot approximate.
    """
    from scipy.optimize import least_squares

    values = (lens.gamma1, lens.gamma2, lens.u0, lens.v0)
    # This first camera, with the focal length on the axis, also validates size and focal length.
    if not lens.xi >= 0:
        raise InputError("the mirror parameter of the camera is invalid", expected="xi >= 0", got=lens.xi)
    on_axis = (lens.gamma1 / (1 + lens.xi), lens.gamma2 / (1 + lens.xi), lens.u0, lens.v0)
    first = Camera(_MODEL, width, height, (*on_axis, *(0.0,) * _EXTRA))
    # Directions (N, 3) that cover the half space in front of the camera.
    angles = np.radians(np.linspace(0.1, _MAX_ANGLE_DEG, 120))
    angle, around = (grid.ravel() for grid in np.meshgrid(angles, np.linspace(-np.pi, np.pi, 48, endpoint=False)))
    rays = np.stack([np.sin(angle) * np.cos(around), np.sin(angle) * np.sin(around), np.cos(angle)], axis=-1)
    with np.errstate(all="ignore"):
        expected = lens.project(rays)
        used = first.in_image(expected)
    rays, expected = rays[used], expected[used]
    pycolmap = import_keeping_signals("pycolmap")

    def residuals(params: Any) -> Any:
        camera = pycolmap.Camera(model=_MODEL, width=width, height=height, params=params.tolist())
        return (np.asarray(camera.img_from_cam(rays)) - expected).ravel()

    scale = np.array([*np.abs(values), *(0.01,) * _EXTRA]) + 1e-9
    camera, worst = first, np.inf
    if len(rays):
        try:
            fit = least_squares(residuals, np.array(first.params), x_scale=scale, max_nfev=60)
            camera = Camera(_MODEL, width, height, tuple(fit.x.tolist()))
            worst = float(np.abs(camera.project(rays) - expected).max())
        except (ValueError, InputError):  # the result is not finite, or not a valid camera
            worst = np.inf
    if not worst <= _MAX_ERROR_PX:
        fault, got = "no camera model fits the fisheye lens", f"{worst:.3g} px with {_MODEL}"
        limits = f"an error of at most {_MAX_ERROR_PX:g} px within {_MAX_ANGLE_DEG:g} deg of the axis"
        raise InputError(fault, expected=limits, got=got, hint="use a front camera")
    return camera
