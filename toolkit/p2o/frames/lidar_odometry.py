"""LiDAR odometry: poses of the sweeps of a sequence, by third-party packages (extras `gicp` and `kiss-icp`)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from p2o.arrays import Float
from p2o.errors import InputError
from p2o.frames.cloud import Cloud
from p2o.geometry import se3

_MIN_SHARE = 0.75
"""Minimum share of inliers between consecutive sweeps.

On KITTI it is 0.98 for consecutive sweeps, 0.86 at a distance of 4 m, and 0.6 at 8 m, where the alignment fails.
"""
_MAX_DRIFT_DEG, _MAX_DRIFT_M = 0.02, 0.005
"""Maximum change of a pose when its alignment is repeated, well below its error on KITTI (0.1 deg, 3 cm)."""


def poses_by_gicp(
    clouds: Sequence[Cloud], *, voxel_m: float = 0.25, max_distance_m: float = 1.0, then_m: float | None = None
) -> tuple[Float, ...]:
    """Return world_from_lidar (4, 4) of each sweep of a sequence; the world is the frame of the first.

    Each sweep is aligned with the previous one by small_gicp, with constant velocity as initial guess; errors
    accumulate. Motion-compensated sweeps give the poses at the times they were compensated to. Points are downsampled
    to voxels of `voxel_m` and paired up to `max_distance_m`; with `then_m` the alignment is repeated with pairs up to
    this smaller distance, which excludes dynamic objects. Raises ModuleNotFoundError without the package (pip install
    small-gicp), InputError if consecutive sweeps do not overlap.
    """
    import small_gicp

    poses: list[Float] = []
    step = np.eye(4)
    before = None
    for number, cloud in enumerate(clouds):
        points, tree = small_gicp.preprocess_points(cloud.xyz, voxel_m)
        if before is None:
            poses.append(np.eye(4))
        else:
            alignment, drift = _aligned(before, (points, tree), step, max_distance_m)
            share = alignment.num_inliers / max(points.size(), 1)
            angle_deg, distance_m = se3.angle_deg(drift), se3.distance_m(drift)
            text = f"sweeps {number - 1} and {number} of the sequence cannot be aligned"
            if share < _MIN_SHARE:
                expected = f">= {_MIN_SHARE:.0%} of the points within {max_distance_m:g} m of each other"
                raise InputError(text, expected=expected, got=f"{share:.0%}", hint="use consecutive sweeps")
            if angle_deg > _MAX_DRIFT_DEG or distance_m > _MAX_DRIFT_M:
                expected = f"a pose that repeated alignment changes by <= {_MAX_DRIFT_DEG:g} deg and {_MAX_DRIFT_M:g} m"
                got = f"{angle_deg:.2g} deg and {distance_m:.2g} m"
                raise InputError(text, expected=expected, got=got, hint="use consecutive sweeps")
            if then_m is not None:
                alignment, _ = _aligned(before, (points, tree), alignment.T_target_source, then_m)
            step = _rigid(alignment.T_target_source)
            poses.append(poses[-1] @ step)
        before = points, tree
    return tuple(poses)


def _aligned(before: Any, after: Any, begin: Float, distance_m: float) -> tuple[Any, Float]:
    """Align two sweeps (points, tree) with small_gicp from a transform (4, 4); return the alignment and its drift.

    At the minimum of sparse sweeps pairs come and go, so that no step is below the tolerance, or none lowers the cost.
    The alignment is then repeated from its result: the drift (4, 4) is how far that moves without converging.
    """
    import small_gicp

    def align(begin: Float, iterations: int, small: float) -> Any:
        pair, reach = (before[0], after[0], before[1]), {"max_correspondence_distance": distance_m}
        limits = {"max_iterations": iterations, "rotation_epsilon": small, "translation_epsilon": small}
        return small_gicp.align(*pair, begin, **reach, **limits)

    alignment = align(begin, 50, 1e-5)
    if alignment.converged:
        return alignment, np.eye(4)
    # A prime number of iterations: an oscillation does not end where it began.
    again = align(alignment.T_target_source, 17, 1e-4)
    drift = np.eye(4) if again.converged else se3.inverse(alignment.T_target_source) @ again.T_target_source
    return again, drift


def poses_by_kiss_icp(
    clouds: Sequence[Cloud], *, voxel_m: float = 1.0, max_range_m: float = 100.0
) -> tuple[Float, ...]:
    """Return world_from_lidar (4, 4) of each sweep of a sequence; the world is the frame of the first.

    Each sweep is aligned with a map of the previous ones by KISS-ICP, so that errors accumulate more slowly than in
    `poses_by_gicp`. The map has voxels of `voxel_m`. Raises ModuleNotFoundError without the package (pip install
    kiss-icp).
    """
    from kiss_icp.config.parser import load_config
    from kiss_icp.kiss_icp import KissICP

    config = load_config(None)
    config.data.max_range, config.data.deskew = max_range_m, False
    # One thread: the order of sums with more threads is not deterministic.
    config.mapping.voxel_size, config.registration.max_num_threads = voxel_m, 1
    odometry = KissICP(config)
    poses: list[Float] = []
    for cloud in clouds:
        # The binding accepts writeable arrays only.
        odometry.register_frame(cloud.xyz.copy(), np.zeros(len(cloud)))
        poses.append(_rigid(odometry.last_pose))
    return tuple(se3.inverse(poses[0]) @ pose for pose in poses)


def _rigid(transform: Float) -> Float:
    return np.array(se3.check_rigid("pose of a sweep", transform, tolerance=1e-3))
