"""What beams leave open for all edges alike: an error that no number of pairs takes away, and no residual shows."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from p2o.arrays import Float
from p2o.features.side import SIDES, Side
from p2o.problems.point_to_line import PointToLine

_LEAST_DEPTH_M = 0.1


@dataclass(frozen=True, eq=False)
class Spread:
    """What errors are made of: `pairs` (6, 6), the covariance of a left update in rad and m that the scatter of pairs
    shows (`p2o.calibration.adjustment`), `beams` (6, 6) as of `beam_covariance`, and `rings` (6,) as of `ring_gaps`.
    """

    pairs: Float
    beams: Float
    rings: Float

    @classmethod
    def of(cls, pairs: Float, problem: PointToLine, camera_from_lidar: Float, views: float) -> Spread:
        """Return the spread of a pose (4, 4) with the pairs of `problem`, which come from so many different views.

        Outlines of other places lie elsewhere between the rings: what rings leave open falls with the root of `views`
        (`p2o.calibration.different_views`).
        """
        rings = ring_gaps(problem, camera_from_lidar) / np.sqrt(max(views, 1.0))
        return cls(pairs, beam_covariance(problem, camera_from_lidar), rings)


def ring_gaps(problem: PointToLine, camera_from_lidar: Float) -> Float:
    """Return how far (6,) a pose turns in rad and moves in m with an edge that is half a gap of beams off.

    Pitch and y by edges that lie level in the image, yaw and x by upright ones, roll by the worse of both; x and y at
    the harmonic mean of the depths. Unlike `beam_covariance` it does not matter how little such edges weigh: errors in
    pitch are about as large as these, with few rings and many. It is that of one view.
    """
    depth_m = (problem.xyz @ camera_from_lidar[:3, :3].T + camera_from_lidar[:3, 3])[:, 2]
    focal_px = np.array([camera.focal_px for camera in problem.cameras])[problem.frame]
    near = depth_m > _LEAST_DEPTH_M
    if not near.any():
        return np.zeros(6)
    level = np.abs(problem.normal[:, 1]) > np.abs(problem.normal[:, 0])
    angle = problem.sigma_px / focal_px
    upright_rad, level_rad = (
        float(np.median(angle[its & near])) if (its & near).any() else 0.0 for its in (~level, level)
    )
    harmonic_m = 1.0 / float(np.mean(1.0 / depth_m[near]))
    turns = (level_rad, upright_rad, max(level_rad, upright_rad))
    gaps = np.array([*turns, upright_rad * harmonic_m, level_rad * harmonic_m, 0.0])
    return np.asarray(gaps)


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
