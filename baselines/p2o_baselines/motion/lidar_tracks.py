"""Estimate the metric motion of the camera from LiDAR points tracked in its images (sensor fusion odometry).

After Ishikawa et al. 2018: points of the sweep are projected by the current extrinsic into its image and tracked to
later images by the method of Lucas and Kanade. The motion aligns the points in the first camera frame with the rays of
their tracks: perspective-n-point, refined by the angles between rays.

Points are selected where the image has a corner, one per cell, except points that other surfaces occlude or that lie at
a depth discontinuity, where a small error of the extrinsic assigns the depth of another object. All constants are ours.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import p2o
from p2o import Bool, Float, UInt8
from p2o.solving import hidden

_NEAR_M, _FAR_M = 2.0, 80.0
_MARGIN_PX = 12.0
_STEP = 0.12  # neighbours whose depth differs by a larger share belong to another object
_USUAL_PX = 0.4  # typical residual of a well tracked point
_FEWEST = 20


@dataclass(frozen=True, eq=False)
class MetricStep:
    """Metric motion (4, 4) of the camera, covariance (6, 6) of a left update (rad, m), inliers, residual."""

    second_from_first: Float
    covariance: Float
    points: int
    off_px: float


def trackable(
    grey: UInt8,
    camera: p2o.Camera,
    masked: Bool | None,
    xyz: Float,
    camera_from_lidar: Float,
    *,
    most: int = 800,
    cell_px: float = 10.0,
) -> tuple[Float, Float]:
    """Select points of a sweep (N, 3) to track: positions in a grey image (M, 2) px and in the camera frame (M, 3)."""
    import cv2
    from scipy.spatial import cKDTree

    points = p2o.se3.apply(camera_from_lidar, xyz)
    uv = camera.project(points)
    seen = camera.in_image(uv, 1.0) & (points[:, 2] > 0.1)
    uv, points, source = uv[seen], points[seen], xyz[seen]
    distance = np.linalg.norm(points, axis=1)
    if len(uv) < _FEWEST:
        return np.zeros((0, 2)), np.zeros((0, 3))
    away, neighbours = cKDTree(uv).query(uv, k=6, distance_upper_bound=3 * cell_px)
    depth = np.concatenate([distance, [np.nan]])[neighbours]
    known = np.isfinite(away)
    apart = np.where(known, np.abs(depth / distance[:, None] - 1), 0.0).max(axis=1)
    last = [camera.width - 1 - _MARGIN_PX, camera.height - 1 - _MARGIN_PX]
    inside = (uv > _MARGIN_PX).all(axis=1) & (uv < last).all(axis=1)
    good = inside & (apart < _STEP) & (known.sum(axis=1) > 3) & (distance > _NEAR_M) & (distance < _FAR_M)
    pixel = np.clip(np.rint(uv).astype(np.int64), 0, [camera.width - 1, camera.height - 1])
    corner = cv2.cornerMinEigenVal(np.ascontiguousarray(grey), 7)[pixel[:, 1], pixel[:, 0]]
    if masked is not None:
        good &= ~masked[pixel[:, 1], pixel[:, 0]]
    good[good] = ~hidden(source[good], source, camera, camera_from_lidar)
    good &= corner > 0.002 * float(np.quantile(corner, 0.99))
    rows = np.flatnonzero(good)
    # The best corner of each cell, then the best cells.
    cell = (uv[rows] // cell_px).astype(np.int64) @ [1, 1 << 20]
    rows = rows[np.lexsort((-corner[rows], cell))]
    cell = (uv[rows] // cell_px).astype(np.int64) @ [1, 1 << 20]
    rows = rows[np.concatenate([[True], cell[1:] != cell[:-1]])] if len(rows) else rows
    rows = np.sort(rows[np.argsort(-corner[rows], kind="stable")][:most])
    return uv[rows], points[rows]


def metric_step(xyz: Float, rays: Float, focal_px: float, guess: Float) -> MetricStep | None:
    """Return the motion (4, 4) of points (N, 3) onto rays (N, 3) near a guess, by Cauchy; None with few inliers."""
    known = np.isfinite(rays).all(axis=1)
    xyz, rays = xyz[known], rays[known] / np.linalg.norm(rays[known], axis=1)[:, None]
    if len(xyz) < _FEWEST:
        return None
    basis = across(rays)
    pose = np.array(guess, np.float64)

    def equations(pose: Float, width_px: float) -> tuple[Float, Float, Float]:
        moved = p2o.se3.apply(pose, xyz)
        distance = np.maximum(np.linalg.norm(moved, axis=1), 1e-6)
        direction = moved / distance[:, None]
        off = np.einsum("nij,nj->ni", basis, direction) * focal_px
        # Behind the camera the angle is far larger than its sine.
        off[(direction * rays).sum(axis=1) < 0] = 1e3
        slope = np.einsum("nij,njk->nik", basis, np.eye(3) - np.einsum("ni,nj->nij", direction, direction))
        slope *= (focal_px / distance)[:, None, None]
        jacobian = np.concatenate([-slope @ p2o.se3.skew(moved), slope], axis=2)
        weight = 1.0 / (1.0 + (off**2).sum(axis=1) / width_px**2)
        return off, jacobian, weight

    # Wide first: the guess may be off by many pixels.
    for width_px, turns in ((8 * _USUAL_PX, 8), (3 * _USUAL_PX, 12)):
        for _ in range(turns):
            off, jacobian, weight = equations(pose, width_px)
            normal = np.einsum("n,nji,njk->ik", weight, jacobian, jacobian)
            gradient = np.einsum("n,nji,nj->i", weight, jacobian, off)
            update = -np.linalg.solve(normal + 1e-9 * np.trace(normal) * np.eye(6), gradient)
            pose = p2o.se3.exp(update) @ pose
            if np.linalg.norm(update) < 1e-7:
                break
    off, jacobian, weight = equations(pose, 3 * _USUAL_PX)
    square = (off**2).sum(axis=1)
    agree = square < (5 * _USUAL_PX) ** 2
    if agree.sum() < _FEWEST or agree.mean() < 0.3:
        return None
    normal = np.einsum("n,nji,njk->ik", weight, jacobian, jacobian)
    off_px = float(np.sqrt(square[agree].mean()))
    covariance = np.linalg.inv(normal + 1e-9 * np.trace(normal) * np.eye(6)) * max(off_px, 0.05) ** 2 / 2
    return MetricStep(pose, covariance, int(agree.sum()), off_px)


def across(rays: Float) -> Float:
    """Return two directions (N, 2, 3) across each of rays (N, 3) of length 1."""
    helper = np.where(np.abs(rays[:, :1]) < 0.7, np.array([[1.0, 0.0, 0.0]]), np.array([[0.0, 1.0, 0.0]]))
    one = np.cross(rays, helper)
    one /= np.linalg.norm(one, axis=1)[:, None]
    return np.stack([one, np.cross(rays, one)], axis=1)
