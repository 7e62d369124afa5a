"""Random search in a shrinking box around the best pose: the optimiser of CalibAnything, for any scalar cost.

`samples` poses are drawn uniformly from a box of half widths `range_deg` and `range_m`, and their costs are evaluated
in batches; the box is centred on the best pose so far and shrinks until it is narrower than `until_deg`. No box exceeds
the first one. More robust than descent for costs with steps and plateaus (masks, counted pixels).

Departures from the released code (OpenCalib/CalibAnything, src/calibration.cpp): the seed is an option instead of the
clock; poses are rotated in the camera frame instead of the LiDAR frame; no box exceeds the first one, where the
original may reach twice its rotations and three times its translations. The original begins with 5.5 deg and 0.55 m,
draws 4000 samples per box, divides rotations by 2 and translations by 1.5, and stops at 0.3 deg: `shrink_turns=2`,
`shrink_shifts=1.5`, `samples=4000`. On exact pairs its error is up to 0.1 deg after 32000 samples, because rotations
and translations form a narrow valley that such a fast shrinking box leaves. Our many slow boxes of 300 samples reach
0.1 deg after 6900. The ranges fit an initial error of 2 deg and 0.15 m.
"""

from __future__ import annotations

import numpy as np
import p2o
from p2o import Float
from p2o.solving import Problem, pose_from_chart

from p2o_plugins.solve.scalar_cost import ended, unsolvable

_AT_ONCE = 256  # Number of poses whose costs are evaluated in one call.


class RandomShrinkOptions(p2o.Options):
    """Options of `random-shrink`."""

    range_deg: float = p2o.field(2.5, gt=0, le=180, help="Half width of the first box in each rotation.")
    range_m: float = p2o.field(0.2, gt=0, le=100, help="Half width of the first box in each translation.")
    samples: int = p2o.field(300, ge=1, le=1_000_000, help="Samples per box (CalibAnything: 4000).")
    shrink_turns: float = p2o.field(1.2, gt=1, le=100, help="Factor by which boxes shrink in rotation.")
    shrink_shifts: float = p2o.field(1.2, gt=1, le=100, help="Factor by which boxes shrink in translation.")
    until_deg: float = p2o.field(0.05, gt=0, le=180, help="Stop after the first box of at most this width.")
    seed: int = p2o.field(0, ge=0, help="Random seed.")


def costs_of(problem: Problem, poses: Float) -> Float:
    """Return the costs (B,) of poses (B, 4, 4), infinite where they are NaN."""
    parts = [np.asarray(problem.cost(poses[i : i + _AT_ONCE])) for i in range(0, len(poses), _AT_ONCE)]
    costs = np.concatenate(parts).astype(np.float64)
    return np.where(np.isfinite(costs), costs, np.inf)


def build(options: RandomShrinkOptions) -> p2o.Solver:
    """Return the solver `(Problem, camera_from_lidar (4, 4)) -> Solution`, without covariance."""

    def solve(problem: Problem, camera_from_lidar: Float) -> p2o.Solution:
        start = np.asarray(camera_from_lidar, dtype=np.float64)
        rng = np.random.default_rng(options.seed)
        best, least, tried = np.zeros(6), float(costs_of(problem, start[None])[0]), 1
        refused = unsolvable(problem, start, least)
        if refused is not None:
            return refused
        whole = np.repeat([np.radians(options.range_deg), options.range_m], 3)
        turns, shifts, last = 1.0, 1.0, False
        while not last:
            last = options.range_deg * turns <= options.until_deg
            half = whole * np.repeat([turns, shifts], 3)
            low, high = np.maximum(best - half, -whole), np.minimum(best + half, whole)
            tries = rng.uniform(low, high, (options.samples, 6))
            costs = costs_of(problem, pose_from_chart(start, tries))
            tried += len(tries)
            lowest = int(np.argmin(costs))
            if costs[lowest] < least:
                best, least = tries[lowest], float(costs[lowest])
            turns, shifts = turns / options.shrink_turns, shifts / options.shrink_shifts
        return ended(start, pose_from_chart(start, best), least, tried, converged=True)

    return solve


METHOD = p2o.Method(
    name="random-shrink",
    build=build,
    options=RandomShrinkOptions,
    summary="Random search in a box that shrinks around the best pose, on any scalar cost.",
    needs={"objective"},
    cite="Luo et al., Calib-Anything: zero-training LiDAR-camera extrinsic calibration, arXiv 2306.02656, 2023",
)
