"""Poses of the LiDAR along a sequence from its sweeps alone, by packages of others (extras `gicp` and `kiss-icp`)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from p2o.arrays import Float
from p2o.errors import InputError
from p2o.frames.cloud import Cloud
from p2o.geometry import se3

_MIN_SHARE = 0.75
"""Share of the points of a sweep that must lie on the sweep before it.

On KITTI it is 0.98 for the next sweep and 0.86 for one 4 m on; 8 m on, where the alignment fails, it is 0.6.
"""


def poses_by_gicp(
    clouds: Sequence[Cloud], *, voxel_m: float = 0.25, max_distance_m: float = 1.0, then_m: float | None = None
) -> tuple[Float, ...]:
    """Return world_from_lidar (4, 4) of each sweep of a sequence; the world is the frame of the first.

    Each sweep is aligned with the one before it by small_gicp, beginning where constant velocity leads to; errors add
    up along the way. The sweeps, in order of time, are taken as they are: corrected for motion they give the poses at
    the times that they were corrected to. Points are thinned to cubes of `voxel_m`, and paired up to `max_distance_m`;
    with `then_m` each alignment is done again with pairs up to this smaller distance, which leaves out what moves by
    itself.

    Raises ModuleNotFoundError without the package (pip install small-gicp), InputError where two sweeps in turn
    do not overlap.
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
            found = _aligned(before, (points, tree), step, max_distance_m)
            share = found.num_inliers / max(points.size(), 1)
            if not found.converged or share < _MIN_SHARE:
                raise InputError(
                    f"sweeps {number - 1} and {number} of the sequence do not fit together",
                    expected=f">= {_MIN_SHARE:.0%} of the points within {max_distance_m:g} m of each other",
                    got=f"{share:.0%}" + ("" if found.converged else ", and no minimum"),
                    hint="take sweeps that follow one another",
                )
            if then_m is not None:
                found = _aligned(before, (points, tree), found.T_target_source, then_m)
            step = _rigid(found.T_target_source)
            poses.append(poses[-1] @ step)
        before = points, tree
    return tuple(poses)


def _aligned(before: Any, after: Any, begin: Float, distance_m: float) -> Any:
    """Return what small_gicp makes of two sweeps, points and tree each, from one transform (4, 4).

    Pairs that come and go may keep it from ever standing still to a hundredth of a millimetre; a tenth will then do.
    """
    import small_gicp

    for small in (1e-5, 1e-4):
        found = small_gicp.align(
            before[0],
            after[0],
            before[1],
            begin,
            max_correspondence_distance=distance_m,
            max_iterations=50,
            rotation_epsilon=small,
            translation_epsilon=small,
        )
        if found.converged:
            break
        begin = found.T_target_source
    return found


def poses_by_kiss_icp(
    clouds: Sequence[Cloud], *, voxel_m: float = 1.0, max_range_m: float = 100.0
) -> tuple[Float, ...]:
    """Return world_from_lidar (4, 4) of each sweep of a sequence; the world is the frame of the first.

    Each sweep is aligned with a map of those before it by KISS-ICP, so that errors add up more slowly. The sweeps are
    taken as they are, as for `poses_by_gicp`; the map has cubes of `voxel_m`.

    Raises ModuleNotFoundError without the package (pip install kiss-icp).
    """
    from kiss_icp.config.parser import load_config
    from kiss_icp.kiss_icp import KissICP

    config = load_config(None)
    config.data.max_range, config.data.deskew = max_range_m, False
    # More threads add up in another order each time.
    config.mapping.voxel_size, config.registration.max_num_threads = voxel_m, 1
    odometry = KissICP(config)
    found: list[Float] = []
    for cloud in clouds:
        # Its binding takes writeable arrays only.
        odometry.register_frame(cloud.xyz.copy(), np.zeros(len(cloud)))
        found.append(_rigid(odometry.last_pose))
    return tuple(se3.inverse(found[0]) @ pose for pose in found)


def _rigid(transform: Float) -> Float:
    return np.array(se3.check_rigid("pose of a sweep", transform, tolerance=1e-3))
