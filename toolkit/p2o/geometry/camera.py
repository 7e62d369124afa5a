"""Camera models: common ones in closed form (`p2o.geometry.projection`), all others of pycolmap (extra `colmap`)."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache, cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from p2o.arrays import Bool, Float
from p2o.errors import InputError, MethodUnavailable, UnknownNameError
from p2o.geometry.projection import LENSES, Projection
from p2o.runtime.native import import_keeping_signals

if TYPE_CHECKING:
    import pycolmap

_PINHOLE = "PINHOLE"
_MIN_DEPTH_M = 1e-6
_MAX_ROUND_TRIP_PX = 0.01
_MAX_SIDE_PX, _MAX_PIXELS = 30_000, 200_000_000
"""Maximum image size: larger values in files would exhaust memory."""
_MIN_FOCAL_PX, _MAX_PARAMETER = 0.01, 1e7
"""Limits of parameters: projections overflow beyond them."""
_WIDEST_TAN = 1.7
"""Tangent of the largest angle from the optical axis that an image plane without distortion shows: 60 degrees."""
_OFF_CENTRE, _SAME_SCALE = 0.2, 0.1
"""Principal points of resized images: least offset from the centre, largest difference of x and y, in image sizes."""
_NEAR_AXIS, _ODD_PIXEL, _WIDE, _LONG = 1e-4, 1.2, 8.0, 5.0
"""Focal lengths of hardly any camera: tangent to read them at, ratio of x and y, of width to focal length and back."""


@dataclass(frozen=True)
class Camera:
    """Intrinsics of one camera; pixel centres at integers (docs/conventions.md), optical axis +z, x right, y down.

    `model` is a name of COLMAP (PINHOLE, OPENCV, OPENCV_FISHEYE, ...), `params` its parameters in COLMAP's order but
    with the principal point in our pixel convention (COLMAP's own files are 0.5 px larger), `width` and `height` the
    image size in pixels. Equal cameras compare and hash equal. Raises UnknownNameError for an unknown model,
    MethodUnavailable for one that needs pycolmap where that is not installed, and InputError for a wrong number of
    parameters, a size or focal length that is not positive, values that are not finite or too large (more than 30000 px
    per side or 200 million in all), or a panorama, which has no image plane.
    """

    model: str
    width: int
    height: int
    params: tuple[float, ...]

    def __post_init__(self) -> None:
        try:
            object.__setattr__(self, "params", tuple(float(p) for p in self.params))
            size = (int(self.width), int(self.height))
        except (TypeError, ValueError, OverflowError) as problem:
            raise InputError("the camera parameters are not numbers", expected="numbers", got=problem) from problem
        if size != (self.width, self.height) or min(size) <= 0:
            text = "the image size of the camera is not positive"
            raise InputError(text, expected="positive integers width and height", got=f"{self.width}x{self.height}")
        if max(size) > _MAX_SIDE_PX or size[0] * size[1] > _MAX_PIXELS:
            expected = f"at most {_MAX_SIDE_PX} px per side and {_MAX_PIXELS // 1_000_000} million in total"
            raise InputError("the camera has too many pixels", expected=expected, got=f"{self.width}x{self.height}")
        object.__setattr__(self, "width", size[0])
        object.__setattr__(self, "height", size[1])
        if not np.isfinite(self.params).all():
            raise InputError("camera parameters are not finite", expected="finite numbers", got=self.params)
        if np.abs(self.params).max(initial=0) > _MAX_PARAMETER:
            expected = f"-{_MAX_PARAMETER:g} to {_MAX_PARAMETER:g}"
            raise InputError("a camera parameter is too large", expected=expected, got=self.params)
        lens = LENSES.get(self.model)
        if lens is not None:
            count_ok, focal, names_of = len(self.params) == lens.count, self.params[: lens.focal], lens.names
        else:
            pycolmap = _pycolmap(self.model)
            names = sorted(m for m in pycolmap.CameraModelId.__members__ if m != "INVALID")
            if self.model not in names:
                raise UnknownNameError("camera model", self.model, names)
            blank = pycolmap.Camera.create_from_model_name(0, self.model, 1.0, self.width, self.height)
            if blank.is_spherical():
                text = f"camera model {self.model} has no image plane"
                hint = "extract a perspective image from the panorama"
                raise InputError(text, expected="a perspective or fisheye model", hint=hint)
            count_ok = len(self.params) == len(blank.params)
            focal = tuple(self.params[i] for i in blank.focal_length_idxs()) if count_ok else ()
            names_of = blank.params_info
        if not count_ok:
            text = f"camera model {self.model} has a different number of parameters"
            raise InputError(text, expected=names_of, got=f"{len(self.params)} numbers")
        if any(f <= 0 for f in focal):
            raise InputError("the focal length is not positive", expected="> 0 px", got=focal)
        if any(f < _MIN_FOCAL_PX for f in focal):
            raise InputError("the focal length is too short", expected=f">= {_MIN_FOCAL_PX:g} px", got=focal)

    def __getstate__(self) -> dict[str, Any]:
        """Return the state without the camera of pycolmap: loading it would import that library (`native`)."""
        return {name: value for name, value in self.__dict__.items() if name != "_colmap"}

    @classmethod
    def pinhole(cls, fx: float, fy: float, cx: float, cy: float, width: int, height: int) -> Camera:
        """Return a camera without distortion; all in pixels."""
        return cls(_PINHOLE, width, height, (fx, fy, cx, cy))

    @property
    def is_pinhole(self) -> bool:
        """True for a camera without distortion."""
        return self.model == _PINHOLE

    @cached_property
    def _closed(self) -> Projection | None:
        """The projection in closed form; None for models that pycolmap projects."""
        return Projection(LENSES[self.model], self.params) if self.model in LENSES else None

    @cached_property
    def _colmap(self) -> pycolmap.Camera:
        pycolmap = _pycolmap(self.model)
        return pycolmap.Camera(model=self.model, width=self.width, height=self.height, params=list(self.params))

    @cached_property
    def focal_px(self) -> float:
        """Focal length in pixels per radian on the optical axis, the mean of both image axes."""
        _, jacobian = self.project_with_jacobian(np.array([[0.0, 0.0, 1.0]]))
        return float(0.5 * (jacobian[0, 0, 0] + jacobian[0, 1, 1]))

    @cached_property
    def _max_tangent(self) -> float:
        """Largest tangent of the angle from the axis up to which the projection is injective in every direction.

        Beyond it, the polynomial of the distortion decreases and the determinant of the derivative changes its sign.
        """
        # A rotationally symmetric lens needs one direction only.
        angle, azimuth, a, b = _directions(1 if self._closed is not None and self._closed.is_radial else 64)
        if self._closed is not None:
            with np.errstate(over="ignore", invalid="ignore"):
                one_to_one = (self._closed.determinant(a, b) > 0).all(axis=1)
        else:
            sine, cosine, one = np.sin(angle), np.cos(angle), np.ones_like(azimuth)
            ray = np.stack([sine * np.cos(azimuth), sine * np.sin(azimuth), cosine * one], axis=-1)
            outward = np.stack([cosine * np.cos(azimuth), cosine * np.sin(azimuth), -sine * one], axis=-1)
            around = np.broadcast_to(np.stack([-np.sin(azimuth), np.cos(azimuth), 0 * azimuth], axis=-1), ray.shape)
            step = 1e-5
            at = np.stack([ray + step * outward, ray - step * outward, ray + step * around, ray - step * around])
            uv = np.asarray(self._colmap.img_from_cam(at.reshape(-1, 3))).reshape(*at.shape[:-1], 2)
            a, b = uv[0] - uv[1], uv[2] - uv[3]
            with np.errstate(invalid="ignore"):
                one_to_one = (a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0] > 0).all(axis=1)
        if one_to_one.all():
            return np.inf
        return float(np.tan(angle[max(int(np.argmin(one_to_one)) - 1, 0), 0]))

    @property
    def _centre(self) -> list[int]:
        """Indices of the principal point among the parameters."""
        focal = 0 if self._closed is None else self._closed.lens.focal
        return [focal, focal + 1] if focal else list(self._colmap.principal_point_idxs())

    def shifted(self, by_px: float) -> Camera:
        """Return the camera with its principal point moved by `by_px` pixels along both axes."""
        params = np.array(self.params)
        params[self._centre] += by_px
        return Camera(self.model, self.width, self.height, tuple(params))

    def resized(self, width: int, height: int) -> Camera:
        """Return the camera of the image resampled to another size in pixels."""
        grown = np.array([width / self.width, height / self.height])
        index = self._centre
        if self._closed is not None:
            focal, params = self._closed.lens.focal, np.array(self.params)
            params[:focal] *= grown if focal == 2 else grown.mean()
        else:
            camera = self._colmap.__copy__()
            camera.rescale(width, height)
            params = np.array(camera.params)
        # COLMAP's origin is the corner of the first pixel.
        before = np.array(self.params)[index] + 0.5
        params[index] = before * grown - 0.5
        return Camera(self.model, width, height, tuple(params))

    def project(self, xyz: Float) -> Float:
        """Project points (..., 3) in the camera frame in metres to pixels (..., 2); NaN for invisible points.

        Not visible are points at or behind the camera plane, and points so far from the axis that the distortion
        polynomial is not injective. Pixels outside the image are returned, too; see `in_image`.
        """
        xyz = np.asarray(xyz, dtype=np.float64)
        if self._closed is not None:
            uv = np.empty((*xyz.shape[:-1], 2))
            uv[..., 0], uv[..., 1] = self.pixels_of(xyz[..., 0], xyz[..., 1], xyz[..., 2])
            return uv
        flat = np.ascontiguousarray(xyz.reshape(-1, 3))
        uv = np.array(self._colmap.img_from_cam(flat), dtype=np.float64)
        with np.errstate(invalid="ignore"):
            visible = (flat[:, 2] > _MIN_DEPTH_M) & (np.hypot(flat[:, 0], flat[:, 1]) <= self._max_tangent * flat[:, 2])
        uv[~visible] = np.nan
        return uv.reshape(*xyz.shape[:-1], 2)

    def pixels_of(self, x: Float, y: Float, z: Float) -> tuple[Float, Float]:
        """Return pixels u, v of coordinates x, y, z of equal shape, as `project`, in the precision of the input."""
        closed = self._closed
        if closed is None:
            uv = self.project(np.stack([x, y, z], axis=-1)).astype(x.dtype)
            return uv[..., 0], uv[..., 1]
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            inverse = 1 / np.where(z > _MIN_DEPTH_M, z, z.dtype.type(np.nan))
            a, b = x * inverse, y * inverse
            if np.isfinite(self._max_tangent):
                a = np.where(a * a + b * b <= self._max_tangent**2, a, a.dtype.type(np.nan))
            return closed.pixels(a, b)

    def project_with_jacobian(self, xyz: Float) -> tuple[Float, Float]:
        """Return pixels (N, 2) and their derivatives (N, 2, 3) in px/m with respect to points (N, 3).

        Both are NaN for points that are not visible. Analytic for models in closed form; central differences of
        pycolmap's projection, with steps of 1e-6 times the distance, for others.
        """
        xyz = np.asarray(xyz, dtype=np.float64)
        uv = self.project(xyz)
        jacobian = np.zeros((len(xyz), 2, 3))
        if self.is_pinhole:
            fx, fy, cx, cy = self.params
            inverse_depth = 1.0 / np.where(xyz[:, 2] > _MIN_DEPTH_M, xyz[:, 2], np.nan)
            jacobian[:, 0, 0] = fx * inverse_depth
            jacobian[:, 1, 1] = fy * inverse_depth
            jacobian[:, 0, 2] = -(uv[:, 0] - cx) * inverse_depth
            jacobian[:, 1, 2] = -(uv[:, 1] - cy) * inverse_depth
            jacobian[np.isnan(inverse_depth)] = np.nan
            return uv, jacobian
        if self._closed is not None:
            inverse_depth = 1.0 / np.where(np.isnan(uv[:, 0]), np.nan, xyz[:, 2])
            a, b = xyz[:, 0] * inverse_depth, xyz[:, 1] * inverse_depth
            u_a, u_b, v_a, v_b = self._closed.slopes(a, b)
            for row, (by_a, by_b) in enumerate(((u_a, u_b), (v_a, v_b))):
                jacobian[:, row, 0], jacobian[:, row, 1] = by_a * inverse_depth, by_b * inverse_depth
                jacobian[:, row, 2] = -(by_a * a + by_b * b) * inverse_depth
            return uv, jacobian
        step = 1e-6 * np.linalg.norm(xyz, axis=1)
        for axis in range(3):
            offset = np.zeros_like(xyz)
            offset[:, axis] = step
            ahead, behind = (np.asarray(self._colmap.img_from_cam(xyz + s * offset)) for s in (1, -1))
            with np.errstate(divide="ignore", invalid="ignore"):  # the camera centre itself is not seen
                jacobian[:, :, axis] = (ahead - behind) / (2 * step[:, None])
        jacobian[np.isnan(uv[:, 0])] = np.nan
        return uv, jacobian

    def in_image(self, uv: Float, margin_px: float = 0.0) -> Bool:
        """Return whether pixels (..., 2) are inside the image extended by `margin_px` on each side; NaN is outside."""
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
        """Return unit viewing directions (..., 3) in the camera frame of pixels (..., 2); z > 0.

        NaN for pixels onto which no point in front of the camera projects: outside the circle of a fisheye image, or
        beyond the range of the distortion polynomial.
        """
        uv = np.asarray(uv, dtype=np.float64)
        if self.is_pinhole:
            fx, fy, cx, cy = self.params
            rays = np.ones((*uv.shape[:-1], 3))
            np.divide(uv[..., 0] - cx, fx, out=rays[..., 0])
            np.divide(uv[..., 1] - cy, fy, out=rays[..., 1])
        else:
            flat, rays = uv.reshape(-1, 2), np.ones((*uv.shape[:-1], 3))
            # Without an inverse values are arbitrary: verify by projecting back to the pixel.
            with np.errstate(all="ignore"):
                if self._closed is not None:
                    plane = np.stack(self._closed.plane(flat[:, 0], flat[:, 1]), axis=-1)
                else:
                    plane = np.asarray(self._colmap.cam_from_img(np.ascontiguousarray(flat)))
                rays[..., :2] = plane.reshape(uv.shape)
                is_inverse = np.abs(self.project(rays) - uv).max(axis=-1) < _MAX_ROUND_TRIP_PX
            rays[~is_inverse] = np.nan
        rays /= np.sqrt(np.einsum("...i,...i->...", rays, rays))[..., None]
        return rays

    def extent(self) -> tuple[Float, Float] | None:
        """Return the lowest and highest x / z and y / z (2,) of the image, up to 60 degrees off axis; None without."""
        u, v = np.linspace(0, self.width - 1, 25), np.linspace(0, self.height - 1, 25)
        rays = self.rays(np.stack(np.meshgrid(u, v), axis=-1).reshape(-1, 2))
        plane = rays[:, :2] / rays[:, 2:]
        plane = plane[np.isfinite(plane).all(axis=1)].clip(-_WIDEST_TAN, _WIDEST_TAN)
        return (plane.min(axis=0), plane.max(axis=0)) if len(plane) else None


def intrinsics_remark(camera: Camera) -> tuple[str, ...]:
    """Return warnings on a principal point or on focal lengths that hardly any camera has."""
    return (*_centre_remark(camera), *_focal_remark(camera))


def _focal_remark(camera: Camera) -> tuple[str, ...]:
    """Return a warning if the focal lengths differ much, or are very long or short for the width of the image.

    They are those at the optical axis, in pixels.
    """
    with np.errstate(all="ignore"):
        axis, right, down = camera.project(np.array([[0.0, 0.0, 1.0], [_NEAR_AXIS, 0.0, 1.0], [0.0, _NEAR_AXIS, 1.0]]))
        fx, fy = abs(right[0] - axis[0]) / _NEAR_AXIS, abs(down[1] - axis[1]) / _NEAR_AXIS
    if not np.isfinite([fx, fy]).all():
        return ()
    lengths = f"the focal lengths are {fx:.4g} and {fy:.4g} px"
    if max(fx, fy) > _ODD_PIXEL * min(fx, fy):
        return (f"{lengths}: pixels of cameras are about square, so verify fx and fy",)
    if not camera.width / _WIDE < fx < camera.width * _LONG:
        return (f"{lengths}, the image is {camera.width} px wide: verify that they are in pixels of this image",)
    return ()


def _centre_remark(camera: Camera) -> tuple[str, ...]:
    """Return a warning if the intrinsics seem to be those of a larger or smaller image, judged by the principal point.

    It is then outside the image, or off the centre by the same large share of the width and of the height.
    """
    centre = camera.project(np.array([[0.0, 0.0, 1.0]]))
    share = (centre[0] + 0.5) / (camera.width, camera.height)
    if not np.isfinite(share).all():
        return ()
    outside = not camera.in_image(centre)[0]
    scaled = bool(np.ptp(share) < _SAME_SCALE * max(1.0, share.mean()) and (np.abs(share - 0.5) > _OFF_CENTRE).all())
    if not outside and not scaled:
        return ()
    x, y = centre[0]
    where = "outside" if outside else "far from the centre of"
    # The principal point of most cameras is near the centre of the image.
    scale = f"by about {0.5 / float(share.mean()):.2g}" if scaled else "with the image"
    return (
        f"the principal point ({x:.4g}, {y:.4g}) is {where} the image of {camera.width}x{camera.height} px: if the "
        f"images were resized, scale fx, fy, cx, cy {scale}",
    )


def _pycolmap(model: str) -> Any:
    """Return pycolmap; raises MethodUnavailable, which names a camera model, where it is not installed."""
    try:
        return import_keeping_signals("pycolmap")
    except ModuleNotFoundError as problem:
        text = f"camera model {model} needs the package pycolmap, which is not installed"
        hint = 'run: pip install "p2o-calib[colmap]"'
        raise MethodUnavailable(text, expected=f"without it {', '.join(LENSES)}", got=model, hint=hint) from problem


@cache
def _directions(azimuths: int) -> tuple[Float, Float, Float, Float]:
    """Return angles from the axis (512, 1), azimuths (A,), and x / z and y / z (512, A) of these directions."""
    angle = np.radians(np.linspace(0.0, 89.95, 512))[:, None]
    azimuth = np.linspace(-np.pi, np.pi, azimuths, endpoint=False)
    return angle, azimuth, np.tan(angle) * np.cos(azimuth), np.tan(angle) * np.sin(azimuth)
