"""Explain the error of a given extrinsic by as few axes as the edges permit: scan of shifts, and model selection."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from p2o.arrays import Float
from p2o.features.view import View
from p2o.geometry import se3
from p2o.problems.directed_cost import DirectedCost

_FARTHEST = np.repeat([3.0, 0.6], 3)
_STEP = np.repeat([0.1, 0.02], 3)
"""Range and step in deg and m of the scan along each axis; 0.1 deg are 3.5 px at a focal length of 2000 px."""
_FINER = 5
_TRUNCATE_PX, _MOST_POINTS = 8.0, 6000
_LEAD_EDGES = 6.0
_EQUIVALENT = 9.0
"""Difference of chi-square, three standard deviations, up to which two explanations are equally possible."""
_LEAST_PART = 4.0
"""Smallest decrease of chi-square, two standard deviations, by each axis of an explanation."""
_ABOUT = (2, 0, 1)
"""Camera axes of roll, pitch and yaw."""


def corrected(camera_from_lidar: Float, axis: int, sizes: Float) -> Float:
    """Return poses (N, 4, 4): a given one (4, 4) without errors `sizes` (N,), in deg or m, on one axis.

    `axis` counts roll, pitch, yaw, x, y, z as `p2o.geometry.pose_error` defines them: to first order, rotations about
    the camera axes leave the position of the LiDAR unchanged.
    """
    out = np.repeat(camera_from_lidar[None], len(sizes), axis=0)
    if axis < 3:
        tangents = np.zeros((len(sizes), 6))
        tangents[:, _ABOUT[axis]] = -np.radians(sizes)
        out[:, :3, :3] = se3.exp(tangents)[:, :3, :3] @ camera_from_lidar[:3, :3]
    else:
        out[:, axis - 3, 3] -= sizes
    return out


def single_axis_pose(views: Sequence[View], camera_from_lidar: Float) -> Float:
    """Return the pose (4, 4) of the lowest directed cost among shifts along one axis of a given pose (4, 4).

    The given pose is returned unless another one matches `_LEAD_EDGES` more edges.
    """
    margin_px = max(view.camera.focal_px for view in views) * float(np.tan(np.radians(_FARTHEST[0])))
    cost = DirectedCost.of(
        views, camera_from_lidar, _TRUNCATE_PX, smooth=False, margin_px=margin_px, max_points=_MOST_POINTS
    )
    if not cost.points:
        return camera_from_lidar
    best, lowest = camera_from_lidar, cost.at(camera_from_lidar) - _LEAD_EDGES * cost.truncate_px / cost.edges
    for axis, (farthest, step) in enumerate(zip(_FARTHEST, _STEP, strict=True)):
        size = 0.0
        for grid in (np.arange(-farthest, farthest + step / 2, step), step * np.linspace(-1, 1, 2 * _FINER + 1)):
            poses = corrected(camera_from_lidar, axis, size + grid)
            values = cost(poses)
            at = int(np.argmin(values))
            size += float(grid[at])
        if values[at] < lowest:
            best, lowest = poses[at], float(values[at])
    return best


@dataclass(frozen=True, eq=False)
class Explanation:
    """Errors on some axes, which explain a step within its covariance: `axes` (K,) count as in `corrected`.

    `sizes` (K,) are the errors if all other axes are correct.
    """

    axes: tuple[int, ...]
    sizes: Float


def explanations(
    error: Float, covariance: Float, most: Callable[[int], float], most_more: float
) -> tuple[Explanation, ...]:
    """Return the explanations of an error (N,) by the fewest axes, best first; all have the same number of axes.

    An explanation is accepted if its chi-square is at most `most` of its degrees of freedom, no further axis lowers it
    by more than `most_more`, and each of its axes, unless it has all, lowers it by `_LEAST_PART`. Others with a
    chi-square within `_EQUIVALENT` of the best are equally possible.
    """
    weight = np.linalg.inv(covariance)
    count = len(error)

    def chi_square(axes: tuple[int, ...]) -> tuple[float, Float]:
        """Return the lowest chi-square if only these axes are wrong, and their errors."""
        if len(axes) == count:
            # Solved numerically, an ill-conditioned covariance would leave a residual.
            return 0.0, error.copy()
        rows = list(axes)
        sizes = np.linalg.solve(weight[np.ix_(rows, rows)], weight[rows] @ error) if rows else np.zeros(0)
        residual = error.copy()
        residual[rows] -= sizes
        return float(residual @ weight @ residual), sizes

    values = {axes: chi_square(axes) for size in range(count + 1) for axes in combinations(range(count), size)}
    for size in range(1, count + 1):
        accepted = []
        for axes in combinations(range(count), size):
            value, sizes = values[axes]
            more = [values[tuple(sorted((*axes, other)))][0] for other in range(count) if other not in axes]
            fewer = [values[tuple(a for a in axes if a != other)][0] for other in axes]
            needed = size == count or min(fewer) - value >= _LEAST_PART
            if needed and value <= most(count - size) and all(value - other <= most_more for other in more):
                accepted.append((value, Explanation(axes, sizes)))
        accepted.sort(key=lambda each: each[0])
        if accepted:
            return tuple(each for value, each in accepted if value <= accepted[0][0] + _EQUIVALENT)
    raise AssertionError("all axes together explain every error")
