"""Walk to the best of the 3^6 neighbours of a pose with decreasing steps, for any scalar cost.

Levinson and Thrun, Automatic Online Calibration of Cameras and Lasers, RSS 2013: every unknown is changed by one step
down, none or one up; the best of all 729 becomes the pose. The original takes one such step per frame. Here the walk
continues until no neighbour is better, then the steps shrink. All neighbours are evaluated in one call. Step sizes are
ours.
"""

from __future__ import annotations

from itertools import product

import numpy as np
import p2o
from p2o import Float
from p2o.solving import Problem, pose_from_chart

from p2o_plugins.solve.scalar_cost import ended, unsolvable

NEIGHBOURS = np.array(list(product((-1.0, 0.0, 1.0), repeat=6)))
"""The changes (729, 6) in steps; number 364, the middle one, is zero."""
_SHRINK = 0.5  # factor on the steps if no neighbour is better
_LEVELS = 6  # number of step sizes
_MAX_MOVES = 60  # largest number of moves over all step sizes
_STEP_DEG = 0.25  # first step of the three rotations
_STEP_M = 0.025  # first step of the three translations


def build(options: p2o.Options) -> p2o.Solver:
    """Return the solver `(Problem, camera_from_lidar (4, 4)) -> Solution`, without covariance."""
    first = np.repeat([np.radians(_STEP_DEG), _STEP_M], 3)

    def solve(problem: Problem, camera_from_lidar: Float) -> p2o.Solution:
        start = pose = np.asarray(camera_from_lidar, np.float64)
        least = float(problem.cost(pose[None])[0])
        refused = unsolvable(problem, pose, least)
        if refused is not None:
            return refused
        moves, looks = 0, 0
        for level in range(_LEVELS):
            steps = NEIGHBOURS * (first * _SHRINK**level)
            while moves < _MAX_MOVES:
                around = pose_from_chart(pose, steps)
                costs = np.asarray(problem.cost(around), np.float64)
                costs = np.where(np.isfinite(costs), costs, np.inf)
                best, looks = int(np.argmin(costs)), looks + 1
                if not costs[best] < least:
                    break
                pose, least, moves = around[best], float(costs[best]), moves + 1
        # A cost in a batch may differ from that of the pose alone by rounding.
        cost = float(problem.cost(pose[None])[0])
        return ended(start, pose, cost, looks, converged=moves < _MAX_MOVES)

    return solve


METHOD = p2o.Method(
    name="grid729",
    build=build,
    summary="Walk to the best of all 729 neighbours with decreasing steps, on any scalar cost.",
    needs={"objective"},
    cite="Levinson and Thrun, Automatic Online Calibration of Cameras and Lasers, RSS 2013",
)
