"""What a matcher makes of the views at one pose: pairs for least squares, or a cost for scalar search."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from p2o import se3
from p2o.arrays import Float, Int, Int8, checked
from p2o.camera import Camera
from p2o.errors import InputError


@dataclass(frozen=True, eq=False)
class Objective:
    """A scalar cost: `cost` takes camera_from_lidar (B, 4, 4) and returns (B,), lower is better."""

    cost: Callable[[Float], Float]


@dataclass(frozen=True, eq=False)
class PointToLine:
    """3D points with a 2D line each (paper Eq. 2): residual r = normal . (pi(camera_from_lidar xyz) - centre).

    `xyz` (K, 3) m in the LiDAR frame; `centre` (K, 2) px; `normal` (K, 2) unit; `weight` (K,) >= 0; `side` (K,) int8;
    `frame` (K,) index into `cameras`, one camera a view; `huber_px` the width of the Huber kernel in pixels. The cost
    of all pairs is sum_k weight_k rho(r_k) with rho(r) = r^2 / 2 up to huber_px and linear beyond (paper Eq. 1).
    """

    xyz: Float
    centre: Float
    normal: Float
    weight: Float
    side: Int8
    frame: Int
    cameras: tuple[Camera, ...]
    huber_px: float = 1.0

    def __post_init__(self) -> None:
        object.__setattr__(self, "xyz", checked("xyz of the pairs", self.xyz, (None, 3), np.float64))
        count = len(self.xyz)
        object.__setattr__(self, "centre", checked("centre of the pairs", self.centre, (count, 2), np.float64))
        object.__setattr__(self, "normal", checked("normal of the pairs", self.normal, (count, 2), np.float64))
        object.__setattr__(self, "weight", checked("weight of the pairs", self.weight, (count,), np.float64))
        object.__setattr__(self, "side", checked("side of the pairs", self.side, (count,), np.int8))
        object.__setattr__(self, "frame", checked("frame of the pairs", self.frame, (count,), np.int64))
        if count and (self.frame.min() < 0 or self.frame.max() >= len(self.cameras)):
            raise InputError("a pair belongs to a frame that is not there", expected=f"0..{len(self.cameras) - 1}")
        if count and np.abs(np.linalg.norm(self.normal, axis=1) - 1).max() > 1e-6:
            raise InputError("a line normal is not a unit vector", expected="length 1")
        if self.huber_px <= 0:
            raise InputError("the Huber width is not positive", expected="> 0 px", got=self.huber_px)

    def __len__(self) -> int:
        return len(self.xyz)

    def _groups(self) -> list[tuple[Camera, slice | Int]]:
        """Rows of each distinct camera; one slice for the common case of a single camera."""
        distinct = list(dict.fromkeys(self.cameras))
        if len(distinct) <= 1:
            return [(camera, slice(None)) for camera in distinct]
        number = np.array([distinct.index(camera) for camera in self.cameras])[self.frame]
        return [(camera, np.flatnonzero(number == i)) for i, camera in enumerate(distinct)]

    def residuals(self, camera_from_lidar: Float) -> Float:
        """Return signed residuals in pixels, (K,) for one pose (4, 4) or (B, K) for (B, 4, 4); NaN where unseen."""
        xyz_camera = se3.apply(camera_from_lidar, self.xyz)
        out = np.empty(xyz_camera.shape[:-1])
        for camera, rows in self._groups():
            offset = camera.project(xyz_camera[..., rows, :]) - self.centre[rows]
            out[..., rows] = np.einsum("...ki,ki->...k", offset, self.normal[rows])
        return out

    def residuals_with_jacobian(self, camera_from_lidar: Float) -> tuple[Float, Float]:
        """Return residuals (K,) in px and derivatives (K, 6) for a left update exp(delta) @ camera_from_lidar.

        The tangent vector is (rotation in rad, translation in m), in the camera frame.
        """
        xyz_camera = se3.apply(camera_from_lidar, self.xyz)
        residuals, jacobian = np.empty(len(self)), np.empty((len(self), 6))
        for camera, rows in self._groups():
            points = xyz_camera[rows]
            uv, d_uv = camera.project_with_jacobian(points)
            along = np.einsum("ki,kij->kj", self.normal[rows], d_uv)
            residuals[rows] = np.einsum("ki,ki->k", uv - self.centre[rows], self.normal[rows])
            jacobian[rows, :3] = np.cross(points, along)
            jacobian[rows, 3:] = along
        return residuals, jacobian

    def cost(self, poses: Float) -> Float:
        """Return the robust sum (B,) of poses (B, 4, 4): what makes these pairs an `Objective` too.

        A point that a pose puts behind the camera costs as much as one a whole image away.
        """
        residuals = np.abs(self.residuals(poses))
        far = float(max((max(c.width, c.height) for c in self.cameras), default=1))
        residuals = np.where(np.isfinite(residuals), np.minimum(residuals, far), far)
        linear = self.huber_px * (residuals - 0.5 * self.huber_px)
        rho = np.where(residuals <= self.huber_px, 0.5 * residuals**2, linear)
        return np.asarray(rho @ self.weight)

    def as_objective(self) -> Objective:
        """Return the robust sum of these pairs for solvers that want a scalar cost."""
        return Objective(self.cost)


Problem = PointToLine | Objective
