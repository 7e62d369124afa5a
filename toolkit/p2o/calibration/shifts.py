"""What beams leave open for all edges alike: an error that no number of pairs takes away, and no residual shows."""

from __future__ import annotations

import numpy as np

from p2o.arrays import Float
from p2o.features.side import SIDES, Side
from p2o.problems.point_to_line import PointToLine


def beam_covariance(problem: PointToLine, camera_from_lidar: Float) -> Float:
    """Return the covariance (6, 6) of a left update in rad and m if beams shift all edges of a direction alike.

    Where an outline lies between two beams is a guess, and the same guess for all edges of one direction: each of them
    off by one `sigma_px` to the same side moves the pose by what least squares makes of it; directions count on their
    own. Only what these edges determine becomes wider: few rings leave pitch and roll open, not yaw. Pairs without a
    direction count as those that shift sideways, and those that shift up or down.
    """
    residuals, rows = problem.residuals_with_jacobian(camera_from_lidar)
    seen = np.isfinite(residuals) & np.isfinite(rows).all(axis=1)
    residuals, rows = np.where(seen, residuals, 0.0), np.where(seen[:, None], rows, 0.0)
    weight = problem.weight * problem.huber_px / np.maximum(np.abs(residuals), problem.huber_px)
    inverse = np.linalg.pinv((rows * weight[:, None]).T @ rows)
    shift = (weight * problem.sigma_px)[:, None] * rows
    ways = [(Side.NONE, (1, 0)), (Side.NONE, (0, 1)), *((side, side.background) for side in SIDES)]
    gradients = [np.where(problem.side == side, problem.normal @ np.array(way), 0.0) @ shift for side, way in ways]
    moved = np.stack(gradients) @ inverse
    return np.asarray(moved.T @ moved)
