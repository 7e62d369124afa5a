"""The forward speed of a car from a sweep and a depth map of the same moment, where no oxts packet tells it."""

from __future__ import annotations

import numpy as np
from p2o import Camera, Cloud, se3
from p2o.arrays import Float

_LEAST = 500
"""Fewer points with a known depth tell no speed."""
_DENSE = 0.6
_SLOWEST, _FASTEST = -5.0, 60.0
_SURE_M_S = 1.0


def forward_speed(cloud: Cloud, depth_m: Float, camera: Camera, camera_from_lidar: Float) -> float | None:
    """Return the speed in m/s along the LiDAR's x axis at which the sweep agrees best with depth (H, W), or None.

    What a turning LiDAR sees to its left is older than what it sees straight ahead (at time 0), and what it sees to its
    right newer, so that forward motion makes the left side too far and the right side too near, by speed and time.
    The speed is the robust slope of the difference of inverse depths (that is: disparities) over it. The map has to be
    sparse and made from the same returns, as KITTI's disparity truth is: on a dense one, what has moved along the road
    finds the depth of its new place. None for a dense map, where the sweep has no times, where too few points have a
    known depth, and where the answer is no speed of a car.
    """
    if cloud.time_s is None or np.isfinite(depth_m).mean() > _DENSE:
        return None
    xyz = se3.apply(camera_from_lidar, cloud.xyz)
    near = camera.in_image(camera.project(xyz), margin_px=-3.0) & (xyz[:, 2] > 2) & (xyz[:, 2] < 60)
    if near.sum() < _LEAST:
        return None
    part = cloud.select(near)
    inverse = 1 / depth_m
    height, width = depth_m.shape
    speed = 0.0
    for _ in range(20):
        xyz = se3.apply(camera_from_lidar, part.untwisted(_forward(speed)).xyz)
        u, v = np.rint(camera.project(xyz)).astype(np.int64).T
        known = np.flatnonzero((u >= 0) & (v >= 0) & (u < width) & (v < height))
        difference = 1 / xyz[known, 2] - inverse[v[known], u[known]]
        known, difference = known[np.isfinite(difference)], difference[np.isfinite(difference)]
        if len(known) < _LEAST:
            return None
        # d(1/z)/dv = -t/z^2 for what lies along the optical axis, which is the car's direction of travel.
        slope = -np.asarray(part.time_s)[known] / xyz[known, 2] ** 2
        difference = difference - np.median(difference)
        spread = 1.4826 * float(np.median(np.abs(difference))) + 1e-9
        weight = 1 / (1 + (difference / (2 * spread)) ** 2) ** 2
        slope = slope - np.average(slope, weights=weight)
        information = float(np.sum(weight * slope**2))
        step = -float(np.sum(weight * slope * difference)) / information if information > 0 else np.inf
        speed += step
        if not _SLOWEST < speed < _FASTEST:
            return None
        if abs(step) < 1e-3:
            break
    return speed if spread / np.sqrt(information) < _SURE_M_S else None


def _forward(speed_m_s: float) -> Float:
    return np.array([0.0, 0.0, 0.0, speed_m_s, 0.0, 0.0])
