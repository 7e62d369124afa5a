"""Errors of the intrinsics of a camera: focal length and radial distortion."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from p2o.arrays import Float
from p2o.errors import InputError
from p2o.geometry.camera import Camera
from p2o.geometry.projection import LENSES, Projection

LARGEST = 0.2
"""Maximum error of the intrinsics of a calibrated camera."""
_STEP = 1e-6
_FIRST_RADIAL = {name: lens.radial[0] for name, lens in LENSES.items() if lens.radial} | {"THIN_PRISM_FISHEYE": 4}
"""Index of the first radial coefficient, after the focal lengths and the principal point."""
_WITH_RADIAL = {"PINHOLE": ("OPENCV", 4), "SIMPLE_PINHOLE": ("SIMPLE_RADIAL", 1)}
"""Models that get a radial coefficient: the model with one, and the number of parameters, 0, that are appended."""


@dataclass(frozen=True)
class RadialError:
    """An error of a camera's calibration: the true focal length is 1 + `focal` times that of the calibration.

    `radial` is to be added to the first radial coefficient of the camera's model (k1; of distortion as in Brown,
    Close-range camera calibration, 1971, or of the angle for fisheye models), `x_px` and `y_px` to its principal point.
    Raises InputError for values that are not finite, and for focal or radial larger than 0.2, which no calibrated
    camera has.
    """

    focal: float = 0.0
    radial: float = 0.0
    x_px: float = 0.0
    y_px: float = 0.0

    def __post_init__(self) -> None:
        if not np.isfinite([self.x_px, self.y_px]).all():
            raise InputError("the error of the principal point is not finite", got=f"{self.x_px:g}, {self.y_px:g}")
        size = np.abs([self.focal, self.radial])
        if not (np.isfinite(size).all() and size.max() <= LARGEST):
            text = "the error of the camera's calibration is out of bounds"
            expected = f"focal and radial of at most {LARGEST}"
            raise InputError(text, expected=expected, got=f"{self.focal:g}, {self.radial:g}")

    def __bool__(self) -> bool:
        return bool(self.focal or self.radial or self.x_px or self.y_px)

    def corrected(self, camera: Camera) -> Camera:
        """Return the camera without the error; a pinhole becomes an OPENCV camera.

        Raises InputError for a model that has no radial coefficient.
        """
        if not self:
            return camera
        return _corrected_camera(camera, self)

    def seen(self, camera: Camera, uv: Float) -> Float:
        """Return the observed pixels (..., 2) of points that the calibration projects to pixels (..., 2)."""
        return self.corrected(camera).project(camera.rays(uv))

    def calibrated(self, camera: Camera, uv: Float) -> Float:
        """Return the pixels (..., 2) of the calibration for observed pixels (..., 2): the inverse of `seen`."""
        return camera.project(self.corrected(camera).rays(uv))

    def shift_px(self, camera: Camera) -> float:
        """Return the maximum distance in pixels between observed and calibrated projections."""
        uv = _grid(camera)
        return float(np.nanmax(np.linalg.norm(self.seen(camera, uv) - uv, axis=-1), initial=0.0))


def is_correctable(camera: Camera) -> bool:
    """Return whether the camera's model has a radial coefficient, or is a pinhole."""
    return camera.model in _WITH_RADIAL or camera.model in _FIRST_RADIAL


@lru_cache(maxsize=256)
def _corrected_camera(camera: Camera, error: RadialError) -> Camera:
    """Return the camera without an error, the same object again with what it has computed."""
    model, params = _corrected(camera, error)
    return Camera(model, camera.width, camera.height, tuple(params))


def _corrected(camera: Camera, error: RadialError) -> tuple[str, list[float]]:
    """Return the model, one with a radial coefficient, and the parameters of the camera without the error."""
    model, appended = _WITH_RADIAL.get(camera.model, (camera.model, 0))
    if model not in _FIRST_RADIAL:
        text = f"camera model {model} has no radial coefficient"
        raise InputError(text, expected=", ".join(["PINHOLE", *_FIRST_RADIAL]), hint="use pipeline.camera=trust")
    params, first = [*camera.params, *[0.0] * appended], _FIRST_RADIAL[model]
    params[: first - 2] = [f * (1 + error.focal) for f in params[: first - 2]]
    params[first] += error.radial
    params[first - 2] += error.x_px
    params[first - 1] += error.y_px
    return model, params


def _grid(camera: Camera) -> Float:
    """Return a grid of pixels (33, 33, 2) over the image."""
    u, v = np.meshgrid(np.linspace(-0.5, camera.width - 0.5, 33), np.linspace(-0.5, camera.height - 0.5, 33))
    return np.stack([u, v], axis=-1)


def slopes(camera: Camera, error: RadialError, xyz: Float, uv: Float | None = None) -> Float:
    """Return derivatives (K, 2, 2) of pixels of points (K, 3) by focal and radial error: [k, axis, parameter].

    Pixels are affine in the focal length and in the radial coefficient of every model. `uv` (K, 2) are those of the
    camera without the error, where they are known.
    """
    if uv is None:
        uv = error.corrected(camera).project(xyz)
    model, params = _corrected(camera, error)
    first = _FIRST_RADIAL[model]
    by_error = np.empty((len(xyz), 2, 2))
    by_error[..., 0] = (uv - params[first - 2 : first]) / (1 + error.focal)
    if model in LENSES:
        inverse_depth = 1 / np.where(np.isnan(uv[:, 0]), np.nan, xyz[:, 2])
        lens = Projection(LENSES[model], tuple(params))
        by_error[:, 0, 1], by_error[:, 1, 1] = lens.by_first_radial(
            xyz[:, 0] * inverse_depth, xyz[:, 1] * inverse_depth
        )
    else:
        ahead, behind = (replace(error, radial=error.radial + step).corrected(camera) for step in (_STEP, -_STEP))
        by_error[..., 1] = (ahead.project(xyz) - behind.project(xyz)) / (2 * _STEP)
    return by_error


@dataclass(frozen=True, eq=False)
class RadialFit:
    """The error of one `camera` estimated from pairs, with the covariance (N, N), first of focal and radial."""

    camera: Camera
    error: RadialError
    covariance: Float

    def apart_px(self, other: RadialFit) -> float:
        """Return the maximum distance in pixels between projections with this error and another of the same camera."""
        focal, radial = self.error.focal - other.error.focal, self.error.radial - other.error.radial
        return RadialError(focal, radial).shift_px(self.camera)

    @property
    def sigma_px(self) -> float:
        """Maximum standard deviation of observed projections over the image, in pixels."""
        uv = _grid(self.camera).reshape(-1, 2)
        ray = self.camera.rays(uv)
        ray = ray[np.isfinite(ray).all(axis=1)]
        if not len(ray):
            return float("inf")
        slope = slopes(self.camera, RadialError(), ray)
        variance = np.einsum("kij,jl,kil->k", slope, self.covariance[:2, :2], slope)
        return float(np.sqrt(np.nanmax(variance, initial=0.0)))
