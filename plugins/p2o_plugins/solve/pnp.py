"""Perspective-n-point on pairs of points, `--solver pnp`: for methods that match points of image and sweep.

RANSAC over triples, ranked by truncated squares of reprojection errors in pixels, then least squares on the inliers;
the initial pose is not used. A pair of a point and a line is converted to a pair of points, the second at the centre of
the line (the mean of its image edges). Edges do not constrain the pose along themselves: if a pair is some pixels off
along its edge, point-to-point residuals hold it there, and the result stays near the pose at which pairs were matched;
`lm` is not affected. The implementation is that of `picked`, whose pairs are points.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import p2o
from p2o import Float
from p2o.solving import MIN_PAIRS, PointToLine, Problem, checked_solution, consensus

from p2o_plugins.solve.lm import MAX_CONDITION

_TRIALS = 200  # largest number of sampled triples


class PnpOptions(p2o.Options):
    """Options of `pnp`."""

    reach_px: float = p2o.field(10.0, gt=0, le=1000, help="Largest residual of an inlier, in pixels.")
    seed: int = p2o.field(0, ge=0, help="Seed of the triples.")


def build(options: PnpOptions) -> p2o.Solver:
    """Return the solver `(PointToLine, camera_from_lidar (4, 4)) -> Solution`; it never raises on poor pairs."""

    def solve(problem: Problem, camera_from_lidar: Float) -> p2o.Solution:
        if not isinstance(problem, PointToLine):
            raise p2o.InputError(
                "solver pnp needs pairs", expected="p2o.solving.PointToLine", got=type(problem).__name__
            )
        start = np.asarray(camera_from_lidar, dtype=np.float64)
        points = problem.point_pairs()
        count = len(points.xyz)

        def refused(reason: str) -> p2o.Solution:
            cost = float(problem.cost(start[None])[0])
            return p2o.Solution(start, cost, _TRIALS, p2o.SolverStatus.SINGULAR, None, reason)

        if count < MIN_PAIRS:
            return refused(f"{count} pairs, at least {MIN_PAIRS} are needed")
        best = consensus(points, options.reach_px, np.random.default_rng(options.seed), _TRIALS)
        agree = 0 if best is None else int(best.agree.sum())
        if best is None or agree < MIN_PAIRS:
            return refused(f"{agree} of {count} pairs agree on a pose within {options.reach_px:g} px")
        pairs, pose, status = points.select(best.agree), best.camera_from_lidar, p2o.SolverStatus.CONVERGED
        solution = checked_solution(pairs, start, pose, _TRIALS, status, MAX_CONDITION)
        return replace(solution, cost=float(problem.cost(solution.camera_from_lidar[None])[0]))

    return solve


METHOD = p2o.Method(
    name="pnp",
    build=build,
    options=PnpOptions,
    summary="Perspective-n-point: RANSAC over three pairs and least squares; a line is replaced by its centre.",
    needs={"pairs"},
    cite="Ke and Roumeliotis, CVPR 2017; Fischler and Bolles, Communications of the ACM 24, 1981",
)
