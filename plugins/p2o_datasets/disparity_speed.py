"""Estimate the forward speed of a vehicle from a sweep and a depth map of the same moment, without oxts packets."""

from __future__ import annotations

import numpy as np
from p2o import Camera, Cloud, Float, se3

_MIN_POINTS = 500
"""Minimum number of points with known depth."""
_DENSE_SHARE = 0.6
_MIN_SPEED_M_S, _MAX_SPEED_M_S = -5.0, 60.0
_MAX_SIGMA_M_S = 1.0


def forward_speed(cloud: Cloud, depth_m: Float, camera: Camera, camera_from_lidar: Float) -> float | None:
    """Estimate the speed in m/s along the LiDAR's x axis that aligns the sweep with depth (H, W); None if unobservable.

    A rotating LiDAR measures its left side before time 0 (straight ahead) and its right side after it, so that forward
    motion increases the depth of the left side and decreases that of the right side, in proportion to speed and time.
    The speed is the robust slope of the differences of inverse depth over time. The map must be sparse and made from
    the same returns, like KITTI's disparity ground truth: in a dense map, a displaced point takes the depth of its new
    position. Returns None for a dense map, a sweep without times, too few points with known depth, and implausible or
    uncertain speeds.
    """
    if cloud.time_s is None or np.isfinite(depth_m).mean() > _DENSE_SHARE:
        return None
    xyz = se3.apply(camera_from_lidar, cloud.xyz)
    near = camera.in_image(camera.project(xyz), margin_px=-3.0) & (xyz[:, 2] > 2) & (xyz[:, 2] < 60)
    if near.sum() < _MIN_POINTS:
        return None
    part = cloud.select(near)
    inverse = 1 / depth_m
    height, width = depth_m.shape
    speed = 0.0
    for _ in range(20):
        xyz = se3.apply(camera_from_lidar, part.untwisted(np.array([0.0, 0.0, 0.0, speed, 0.0, 0.0])).xyz)
        u, v = np.rint(camera.project(xyz)).astype(np.int64).T
        known = np.flatnonzero((u >= 0) & (v >= 0) & (u < width) & (v < height))
        difference = 1 / xyz[known, 2] - inverse[v[known], u[known]]
        known, difference = known[np.isfinite(difference)], difference[np.isfinite(difference)]
        if len(known) < _MIN_POINTS:
            return None
        # d(1/z)/dv = -t/z^2 for points along the optical axis, which is the direction of travel.
        slope = -np.asarray(part.time_s)[known] / xyz[known, 2] ** 2
        difference = difference - np.median(difference)
        spread = 1.4826 * float(np.median(np.abs(difference))) + 1e-9
        weight = 1 / (1 + (difference / (2 * spread)) ** 2) ** 2
        slope = slope - np.average(slope, weights=weight)
        information = float(np.sum(weight * slope**2))
        step = -float(np.sum(weight * slope * difference)) / information if information > 0 else np.inf
        speed += step
        if not _MIN_SPEED_M_S < speed < _MAX_SPEED_M_S:
            return None
        if abs(step) < 1e-3:
            break
    return speed if spread / np.sqrt(information) < _MAX_SIGMA_M_S else None
