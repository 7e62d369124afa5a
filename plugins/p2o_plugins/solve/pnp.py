"""Perspective-n-point on pairs of points, `--solver pnp`: what methods do that match points of picture and sweep.

RANSAC over triples, ranked by truncated squares of reprojection errors in pixels, then least squares on the pairs that
agree; the start is not used. A pair of a point and a line is taken for a pair of two points, the second the centre of
the line (the mean of the image edges that make it). Edges tell nothing along themselves: where a pair is some pixels
off along its edge, point-to-point holds it there, and the pose stays near that at which the pairs were made. `lm` lets
it slide. The code is that of `picked`, whose pairs are points indeed.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import p2o
from p2o.arrays import Float
from p2o.problems.normal_equations import MIN_PAIRS, judged
from p2o.problems.points_on_rays import consensus


class PnpOptions(p2o.Options):
    """Options of `pnp`."""

    reach_px: float = p2o.field(10.0, gt=0, le=1000, help="Pairs that are off by more pixels than this are left out.")
    trials: int = p2o.field(200, ge=1, le=100_000, help="Triples of pairs that are tried, at most.")
    max_condition: float = p2o.field(
        1e5, gt=1, help="Condition of the scaled Hessian beyond which a direction counts as not observable."
    )
    seed: int = p2o.field(0, ge=0, help="Seed of the triples.")


def build(options: PnpOptions) -> p2o.Solver:
    """Return the solver `(PointToLine, camera_from_lidar (4, 4)) -> Solution`; it never raises on poor pairs."""

    def solve(problem: p2o.Problem, camera_from_lidar: Float) -> p2o.Solution:
        if not isinstance(problem, p2o.PointToLine):
            raise p2o.InputError("solver pnp needs pairs", expected="p2o.PointToLine", got=type(problem).__name__)
        start = np.asarray(camera_from_lidar, dtype=np.float64)
        points = problem.point_pairs()
        count = len(points.xyz)

        def refused(reason: str) -> p2o.Solution:
            cost = float(problem.cost(start[None])[0])
            return p2o.Solution(start, cost, options.trials, p2o.SolverStatus.SINGULAR, None, reason)

        if count < MIN_PAIRS:
            return refused(f"{count} pairs, at least {MIN_PAIRS} are needed")
        best = consensus(points, options.reach_px, np.random.default_rng(options.seed), options.trials)
        agree = 0 if best is None else int(best.agree.sum())
        if best is None or agree < MIN_PAIRS:
            return refused(f"{agree} of {count} pairs agree on a pose within {options.reach_px:g} px")
        found = judged(
            points.select(best.agree),
            start,
            best.camera_from_lidar,
            options.trials,
            p2o.SolverStatus.CONVERGED,
            options.max_condition,
        )
        return replace(found, cost=float(problem.cost(found.camera_from_lidar[None])[0]))

    return solve


METHOD = p2o.Method(
    name="pnp",
    build=build,
    options=PnpOptions,
    summary="Perspective-n-point: RANSAC over three pairs and least squares, each line taken for its centre.",
    needs={"pairs"},
    cite="Ke and Roumeliotis, CVPR 2017; Fischler and Bolles, Communications of the ACM 24, 1981",
)
