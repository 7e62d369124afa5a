"""Points of the sweep that belong on lines of the image: the pairs of P2O-Calib (paper Eq. 1 and 2)."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from p2o.arrays import Float, Int, Int8, checked
from p2o.errors import InputError
from p2o.geometry import se3
from p2o.geometry.camera import Camera
from p2o.problems.points_on_rays import PointsOnRays, px_per_rad
from p2o.problems.problem import LeastSquares

_MIN_DEPTH_M = 1e-6
OUTLINE_CELL_PX = 64.0
"""Edges of one direction within such a cell of the image count as one outline, whose errors are correlated."""


@dataclass(frozen=True, eq=False)
class PointToLine(LeastSquares):
    """3D points with a 2D line each (paper Eq. 2): residual r = normal . (pi(camera_from_lidar xyz) - centre).

    `xyz` (K, 3) m in the LiDAR frame; `centre` (K, 2) px; `normal` (K, 2) unit; `weight` (K,) >= 0; `side` (K,) int8;
    `frame` (K,) index into `cameras`, one camera a view; `huber_px` the width of the Huber kernel in pixels. The cost
    of all pairs is sum_k weight_k rho(r_k) with rho(r) = r^2 / 2 up to huber_px and linear beyond (paper Eq. 1).
    `time_s` (K,) as in `CloudEdges`: when a point was measured, 0 where its sweep is motion-compensated or has no
    times. `sigma_px` (K,) is the standard deviation of a point due to the beam spacing of the LiDAR, in pixels across
    its line; 0 where unknown. It is no part of the cost. Raises InputError for wrong shapes, values that are not
    finite, negative weights, normals that are not of length one, frames without a camera, or a Huber width that is not
    positive.
    """

    xyz: Float
    centre: Float
    normal: Float
    weight: Float
    side: Int8
    frame: Int
    cameras: tuple[Camera, ...]
    huber_px: float = 1.0
    time_s: Float = field(default=None)  # type: ignore[arg-type]  # zeros
    sigma_px: Float = field(default=None)  # type: ignore[arg-type]  # zeros

    def __post_init__(self) -> None:
        object.__setattr__(self, "xyz", checked("xyz of the pairs", self.xyz, (None, 3), np.float64))
        count = len(self.xyz)
        object.__setattr__(self, "centre", checked("centre of the pairs", self.centre, (count, 2), np.float64))
        object.__setattr__(self, "normal", checked("normal of the pairs", self.normal, (count, 2), np.float64))
        object.__setattr__(self, "weight", checked("weight of the pairs", self.weight, (count,), np.float64))
        object.__setattr__(self, "side", checked("side of the pairs", self.side, (count,), np.int8))
        object.__setattr__(self, "frame", checked("frame of the pairs", self.frame, (count,), np.int64))
        time_s = np.zeros(count) if self.time_s is None else self.time_s
        object.__setattr__(self, "time_s", checked("time_s of the pairs", time_s, (count,), np.float64))
        sigma_px = np.zeros(count) if self.sigma_px is None else self.sigma_px
        object.__setattr__(self, "sigma_px", checked("sigma_px of the pairs", sigma_px, (count,), np.float64))
        object.__setattr__(self, "cameras", tuple(self.cameras))
        if count and (self.frame.min() < 0 or self.frame.max() >= len(self.cameras)):
            text, got = "a pair belongs to a frame that is not there", f"{self.frame.min()}..{self.frame.max()}"
            raise InputError(text, expected=f"0..{len(self.cameras) - 1}", got=got)
        if count and self.weight.min() < 0:
            raise InputError("weight of the pairs is negative", expected="weights >= 0", got=f"{self.weight.min():g}")
        if count:
            length = np.linalg.norm(self.normal, axis=1)
            worst = float(length[np.abs(length - 1).argmax()])
            if abs(worst - 1) > 1e-6:
                raise InputError("a line normal is not a unit vector", expected="length 1", got=f"{worst:g}")
        if not self.huber_px > 0:
            raise InputError("the Huber width is not positive", expected="> 0 px", got=self.huber_px)

    def __len__(self) -> int:
        return len(self.xyz)

    @classmethod
    def empty(cls, cameras: tuple[Camera, ...] = (), huber_px: float = 1.0) -> PointToLine:
        """Return a problem without pairs: what a matcher gives that found none."""
        planar = np.zeros((0, 2))
        labels = np.zeros(0, np.int8), np.zeros(0, np.int64)
        return cls(np.zeros((0, 3)), planar, planar, np.zeros(0), *labels, cameras, huber_px)

    @cached_property
    def far_px(self) -> float:
        """The residual that an unseen point is charged with, and the largest that any is: one whole image."""
        return float(max((max(c.width, c.height) for c in self.cameras), default=1))

    @cached_property
    def huber(self) -> float:
        """The width of the Huber kernel in pixels."""
        return self.huber_px

    @cached_property
    def far(self) -> float:
        """`far_px`."""
        return self.far_px

    def depth_m(self, camera_from_lidar: Float) -> float:
        """Return the mean depth of the points along the optical axis."""
        return float(np.abs(self.xyz @ camera_from_lidar[2, :3] + camera_from_lidar[2, 3]).mean())

    @cached_property
    def _homogeneous(self) -> Float:
        return np.vstack([self.xyz.T, np.ones(len(self))])

    @cached_property
    def _pinhole(self) -> tuple[Float, Float, Float] | None:
        """Coefficients of r = (a x + b y) / z + c per pair, for any mixture of cameras without distortion."""
        if not all(camera.is_pinhole for camera in self.cameras):
            return None
        fx, fy, cx, cy = np.array([camera.params for camera in self.cameras]).reshape(-1, 4)[self.frame].T
        u, v = self.normal.T
        return u * fx, v * fy, u * (cx - self.centre[:, 0]) + v * (cy - self.centre[:, 1])

    @cached_property
    def _numerator(self) -> Float:
        """The (8, K) matrix that turns the first two rows of a pose into a x + b y of every pair."""
        assert self._pinhole is not None
        a, b, _ = self._pinhole
        return np.vstack([a * self._homogeneous, b * self._homogeneous])

    @cached_property
    def _groups(self) -> list[tuple[Camera, Int]]:
        """Rows of each distinct camera."""
        distinct = list(dict.fromkeys(self.cameras))
        number = np.array([distinct.index(camera) for camera in self.cameras], dtype=np.int64)[self.frame]
        return [(camera, np.flatnonzero(number == i)) for i, camera in enumerate(distinct)]

    def residuals(self, camera_from_lidar: Float) -> Float:
        """Return signed residuals in pixels, (K,) for one pose (4, 4) or (B, K) for (B, 4, 4); NaN where unseen."""
        pose = np.asarray(camera_from_lidar, dtype=np.float64)
        if self._pinhole is not None:
            depth = pose[..., 2, :] @ self._homogeneous
            _unseen_as_nan(depth)
            # One matrix product for all poses: a x + b y is linear in the entries of the pose.
            out: Float = pose[..., :2, :].reshape(*pose.shape[:-2], 8) @ self._numerator
            out /= depth
            out += self._pinhole[2]
            return out
        xyz_camera = se3.apply(pose, self.xyz)
        out = np.empty(xyz_camera.shape[:-1])
        for camera, rows in self._groups:
            offset = camera.project(xyz_camera[..., rows, :])
            offset -= self.centre[rows]
            offset *= self.normal[rows]
            out[..., rows] = offset.sum(axis=-1)
        return out

    def point_pairs(self) -> PointsOnRays:
        """Return each point with the centre of its line alone, as a perspective-n-point problem takes them.

        The centre is the mean of the image edges that make the line. Pairs of weight zero, and those at which the
        camera sees nothing, are excluded; the others have equal weights. The position of a point along its line is
        unobservable.
        """
        rays, scale = np.empty((len(self), 3)), np.empty(len(self))
        for camera, rows in self._groups:
            rays[rows], scale[rows] = camera.rays(self.centre[rows]), px_per_rad(camera, self.centre[rows])
        keep = np.isfinite(rays).all(axis=1) & (self.weight > 0)
        return PointsOnRays(self.xyz[keep], rays[keep], scale[keep], frame=self.frame[keep])

    def residuals_with_jacobian(self, camera_from_lidar: Float) -> tuple[Float, Float]:
        """Return residuals (K,) in px and derivatives (K, 6) for a left update exp(delta) @ camera_from_lidar.

        The tangent vector is (rotation in rad, translation in m), in the camera frame. Rows of unseen points hold
        NaN. The derivatives are stored column by column (Fortran order), which suits normal equations.
        """
        pose = np.asarray(camera_from_lidar, dtype=np.float64)
        points = pose[:3] @ self._homogeneous
        columns = np.empty((6, len(self)))
        if self._pinhole is not None:
            a, b, c = self._pinhole
            _unseen_as_nan(points[2])
            x, y, z = points
            inverse = 1.0 / z
            np.multiply(a, inverse, out=columns[3])
            np.multiply(b, inverse, out=columns[4])
            slope = columns[3] * x
            slope += columns[4] * y
            residuals = slope + c
            np.multiply(slope, inverse, out=columns[5])
            np.negative(columns[5], out=columns[5])
        else:
            residuals = np.empty(len(self))
            for camera, rows in self._groups:
                with np.errstate(divide="ignore", invalid="ignore"):  # points in the image plane: NaN in the pixels
                    uv, d_uv = camera.project_with_jacobian(np.ascontiguousarray(points[:, rows].T))
                normal = self.normal[rows]
                residuals[rows] = ((uv - self.centre[rows]) * normal).sum(axis=1)
                columns[3:, rows] = (normal[:, 0, None] * d_uv[:, 0] + normal[:, 1, None] * d_uv[:, 1]).T
            columns[3:, np.isnan(residuals)] = np.nan
            x, y, z = points
        scratch = np.empty(len(self))
        for i, (p, q, along_p, along_q) in enumerate(((y, z, 4, 5), (z, x, 5, 3), (x, y, 3, 4))):
            np.multiply(p, columns[along_q], out=columns[i])  # the cross product of point and derivative
            np.multiply(q, columns[along_p], out=scratch)
            columns[i] -= scratch
        return residuals, columns.T


def _unseen_as_nan(depth: Float) -> None:
    """Set depths (...) at or behind the image plane to NaN in place, so that all that follows from them is NaN."""
    if depth.size and not depth.min() > _MIN_DEPTH_M:  # also true where a depth is NaN
        depth[~(depth > _MIN_DEPTH_M)] = np.nan
