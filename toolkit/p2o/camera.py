"""The camera: any pycolmap model behind one interface, with a fast pinhole path."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from p2o.arrays import Bool, Float
from p2o.errors import InputError, UnknownNameError

if TYPE_CHECKING:
    import pycolmap

_PINHOLE = "PINHOLE"


@dataclass(frozen=True)
class Camera:
    """Intrinsics of one camera; pixel centres at integers (docs/conventions.md), optical axis +z, x right, y down.

    `model` is a pycolmap model name (PINHOLE, OPENCV, OPENCV_FISHEYE, ...), `params` its parameters in pycolmap's
    order but with the principal point in our pixel convention (COLMAP's own files are 0.5 px larger), `width` and
    `height` the image size in pixels. Equal cameras compare and hash equal.

    Raises UnknownNameError for an unknown model and InputError for a wrong number of parameters, a size or focal
    length that is not positive, or values that are not finite.
    """

    model: str
    width: int
    height: int
    params: tuple[float, ...]

    def __post_init__(self) -> None:
        object.__setattr__(self, "params", tuple(float(p) for p in self.params))
        if self.width <= 0 or self.height <= 0:
            raise InputError(
                "the camera has no pixels", expected="positive width and height", got=f"{self.width}x{self.height}"
            )
        if not np.isfinite(self.params).all():
            raise InputError("camera parameters are not finite", expected="finite numbers", got=self.params)
        if self.model == _PINHOLE:
            count_ok, focal = len(self.params) == 4, self.params[:2]
        else:
            import pycolmap

            names = sorted(m for m in pycolmap.CameraModelId.__members__ if m != "INVALID")
            if self.model not in names:
                raise UnknownNameError("camera model", self.model, names)
            blank = pycolmap.Camera.create_from_model_name(0, self.model, 1.0, self.width, self.height)
            count_ok = len(self.params) == len(blank.params)
            focal = tuple(self.params[i] for i in blank.focal_length_idxs()) if count_ok else ()
        if not count_ok:
            raise InputError(
                f"camera model {self.model} has another number of parameters",
                expected="fx fy cx cy" if self.model == _PINHOLE else blank.params_info,
                got=f"{len(self.params)} numbers",
            )
        if any(f <= 0 for f in focal):
            raise InputError("the focal length is not positive", expected="> 0 px", got=focal)

    @classmethod
    def pinhole(cls, fx: float, fy: float, cx: float, cy: float, width: int, height: int) -> Camera:
        """Return a camera without distortion; all in pixels."""
        return cls(_PINHOLE, width, height, (fx, fy, cx, cy))

    @property
    def is_pinhole(self) -> bool:
        """True where the fast pinhole path is used."""
        return self.model == _PINHOLE

    @cached_property
    def _colmap(self) -> pycolmap.Camera:
        import pycolmap

        return pycolmap.Camera(model=self.model, width=self.width, height=self.height, params=list(self.params))

    @cached_property
    def focal_px(self) -> float:
        """Mean focal length in pixels: the size in pixels of one radian near the image centre."""
        if self.is_pinhole:
            return 0.5 * (self.params[0] + self.params[1])
        return float(self._colmap.mean_focal_length())

    @cached_property
    def _max_tangent(self) -> float:
        """Largest distance from the axis, on the plane z = 1, that the image (plus a fifth) can show.

        Distortion polynomials fold far outside the image and would bring points there back into it.
        """
        step = np.linspace(-0.2, 1.2, 57)
        border = np.concatenate(
            [np.stack([step, np.full_like(step, e)], 1) for e in (-0.2, 0.0, 1.0, 1.2)]
            + [np.stack([np.full_like(step, e), step], 1) for e in (-0.2, 0.0, 1.0, 1.2)]
        ) * [self.width, self.height]
        plane = np.asarray(self._colmap.cam_from_img(border))
        plane = plane[np.isfinite(plane).all(1)]
        # Where the inverse does not exist (outside of a fisheye's circle) it returns anything: keep what round-trips.
        again = np.asarray(self._colmap.img_from_cam(np.column_stack([plane, np.ones(len(plane))])))
        radius = np.linalg.norm(plane, axis=1)
        inside = (again >= -0.21 * np.array([self.width, self.height])).all(1) & (
            again <= 1.21 * np.array([self.width, self.height])
        ).all(1)
        return float(radius[inside].max()) if inside.any() else np.inf

    def project(self, xyz: Float) -> Float:
        """Return pixels (..., 2) of points (..., 3) in the camera frame in metres; NaN where nothing is seen.

        Not seen: points at or behind the image plane, and points beyond the field of view of a distorted model.
        Pixels outside the image are returned as they are; `in_image` tells them.
        """
        xyz = np.asarray(xyz, dtype=np.float64)
        if self.is_pinhole:
            fx, fy, cx, cy = self.params
            depth = xyz[..., 2]
            scale = 1.0 / np.where(depth > 1e-6, depth, np.nan)
            uv = np.empty((*xyz.shape[:-1], 2))
            np.multiply(xyz[..., 0], scale, out=uv[..., 0])
            np.multiply(xyz[..., 1], scale, out=uv[..., 1])
            uv *= (fx, fy)
            uv += (cx, cy)
            return uv
        flat = np.ascontiguousarray(xyz.reshape(-1, 3))
        uv = np.array(self._colmap.img_from_cam(flat), dtype=np.float64)
        with np.errstate(invalid="ignore"):
            seen = (flat[:, 2] > 1e-6) & (np.hypot(flat[:, 0], flat[:, 1]) <= self._max_tangent * flat[:, 2])
        uv[~seen] = np.nan
        return uv.reshape(*xyz.shape[:-1], 2)

    def project_with_jacobian(self, xyz: Float) -> tuple[Float, Float]:
        """Return pixels (N, 2) and their derivatives (N, 2, 3) in px/m with respect to points (N, 3).

        Analytic for the pinhole; central differences of pycolmap's projection for every other model.
        """
        xyz = np.asarray(xyz, dtype=np.float64)
        uv = self.project(xyz)
        jacobian = np.zeros((len(xyz), 2, 3))
        if self.is_pinhole:
            fx, fy, cx, cy = self.params
            inverse_depth = 1.0 / xyz[:, 2]
            jacobian[:, 0, 0] = fx * inverse_depth
            jacobian[:, 1, 1] = fy * inverse_depth
            jacobian[:, 0, 2] = -(uv[:, 0] - cx) * inverse_depth
            jacobian[:, 1, 2] = -(uv[:, 1] - cy) * inverse_depth
            return uv, jacobian
        step = 1e-6 * np.maximum(1.0, np.abs(xyz).max(axis=1, initial=0.0))
        for axis in range(3):
            offset = np.zeros_like(xyz)
            offset[:, axis] = step
            ahead, behind = (np.asarray(self._colmap.img_from_cam(xyz + s * offset)) for s in (1, -1))
            jacobian[:, :, axis] = (ahead - behind) / (2 * step[:, None])
        return uv, jacobian

    def in_image(self, uv: Float, margin_px: float = 0.0) -> Bool:
        """Return which pixels (..., 2) lie inside the image grown by `margin_px` on each side; NaN is outside."""
        u, v = uv[..., 0], uv[..., 1]
        with np.errstate(invalid="ignore"):
            inside: Bool = (
                (u >= -0.5 - margin_px)
                & (u <= self.width - 0.5 + margin_px)
                & (v >= -0.5 - margin_px)
                & (v <= self.height - 0.5 + margin_px)
            )
        return inside

    def rays(self, uv: Float) -> Float:
        """Return unit viewing directions (..., 3) in the camera frame of pixels (..., 2)."""
        uv = np.asarray(uv, dtype=np.float64)
        if self.is_pinhole:
            fx, fy, cx, cy = self.params
            plane = (uv - (cx, cy)) / (fx, fy)
        else:
            plane = np.asarray(self._colmap.cam_from_img(np.ascontiguousarray(uv.reshape(-1, 2)))).reshape(uv.shape)
        rays = np.concatenate([plane, np.ones((*plane.shape[:-1], 1))], axis=-1)
        return np.asarray(rays / np.linalg.norm(rays, axis=-1, keepdims=True))
