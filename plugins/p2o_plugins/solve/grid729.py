"""Walk to the best of the 3^6 neighbours of a pose, with steps that shrink: for any cost, all neighbours at once.

Levinson and Thrun, Automatic Online Calibration of Cameras and Lasers, RSS 2013: every unknown is changed by one step
down, none or one up; the best of all 729 becomes the pose. They take one such step with each frame. Here it goes on
until the pose is the best itself, then the steps shrink. All step sizes are ours.
"""

from __future__ import annotations

from itertools import product

import numpy as np
import p2o
from p2o.arrays import Float
from p2o.problems.chart import pose_at

NEIGHBOURS = np.array(list(product((-1.0, 0.0, 1.0), repeat=6)))
"""The changes (729, 6) in steps; the middle one, number 364, changes nothing."""


class Grid729Options(p2o.Options):
    """Options of `grid729`."""

    step_deg: float = p2o.field(0.25, gt=0, le=30, help="First step of the three rotations.")
    step_m: float = p2o.field(0.025, gt=0, le=10, help="First step of the three translations.")
    shrink: float = p2o.field(0.5, gt=0, lt=1, help="Factor on the steps once no neighbour is better.")
    levels: int = p2o.field(6, ge=1, le=30, help="How often the steps shrink, the first steps included.")
    max_moves: int = p2o.field(60, ge=1, help="Moves at most, over all levels.")


def build(options: Grid729Options) -> p2o.Solver:
    """Return the solver `(Problem, camera_from_lidar (4, 4)) -> Solution`, without covariance."""
    first = np.repeat([np.radians(options.step_deg), options.step_m], 3)

    def solve(problem: p2o.Problem, camera_from_lidar: Float) -> p2o.Solution:
        pose = np.asarray(camera_from_lidar, np.float64)
        least = float(problem.cost(pose[None])[0])
        if isinstance(problem, p2o.LeastSquares) and not len(problem):
            return p2o.Solution(pose, 0.0, 0, p2o.SolverStatus.SINGULAR, None, "there are no pairs")
        if not np.isfinite(least):
            return p2o.Solution(pose, np.inf, 0, p2o.SolverStatus.SINGULAR, None, "the cost of the start is not finite")
        moves, looks = 0, 0
        for level in range(options.levels):
            steps = NEIGHBOURS * (first * options.shrink**level)
            while moves < options.max_moves:
                around = pose_at(pose, steps)
                costs = np.asarray(problem.cost(around), np.float64)
                costs = np.where(np.isfinite(costs), costs, np.inf)
                best, looks = int(np.argmin(costs)), looks + 1
                if not costs[best] < least:
                    break
                pose, least, moves = around[best], float(costs[best]), moves + 1
        spent = moves >= options.max_moves
        status = p2o.SolverStatus.ITERATIONS_SPENT if spent else p2o.SolverStatus.CONVERGED
        # A cost in a batch may differ from that of the pose alone by rounding.
        return p2o.Solution(pose, float(problem.cost(pose[None])[0]), looks, status)

    return solve


METHOD = p2o.Method(
    name="grid729",
    build=build,
    options=Grid729Options,
    summary="Walks to the best of all 729 neighbours, with steps that shrink, on any scalar cost.",
    needs={"objective"},
    cite="Levinson and Thrun, Automatic Online Calibration of Cameras and Lasers, RSS 2013",
)
