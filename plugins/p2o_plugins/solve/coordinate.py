"""Search along the six axes with steps of their own that shrink and grow: for any scalar cost, without derivatives.

Hooke and Jeeves, Direct Search Solution of Numerical and Statistical Problems, JACM 8, 1961: each axis is tried one
step both ways; after a sweep over all axes the change of the sweep is tried once more, which follows valleys that no
axis points along. Steps that help grow and others shrink, by axis, as in adaptive coordinate search; all figures are
ours.
"""

from __future__ import annotations

import numpy as np
import p2o
from p2o.arrays import Float
from p2o.problems.chart import pose_at


class CoordinateOptions(p2o.Options):
    """Options of `coordinate`."""

    step_deg: float = p2o.field(0.2, gt=0, le=30, help="First step of the three rotations.")
    step_m: float = p2o.field(0.02, gt=0, le=10, help="First step of the three translations.")
    shrink: float = p2o.field(0.6, gt=0, lt=1, help="Factor on the step of an axis where neither way is better.")
    grow: float = p2o.field(1.3, ge=1, le=4, help="Factor on the step of an axis where one is; never above the first.")
    tolerance: float = p2o.field(4e-3, gt=0, lt=1, help="Ends where all steps are below this share of the first ones.")
    max_sweeps: int = p2o.field(300, ge=1, help="Sweeps over all axes at most.")


def build(options: CoordinateOptions) -> p2o.Solver:
    """Return the solver `(Problem, camera_from_lidar (4, 4)) -> Solution`, without covariance."""
    unit = np.repeat([np.radians(options.step_deg), options.step_m], 3)

    def solve(problem: p2o.Problem, camera_from_lidar: Float) -> p2o.Solution:
        start = np.asarray(camera_from_lidar, np.float64)

        def costs(x: Float) -> Float:
            found = np.asarray(problem.cost(pose_at(start, x * unit)), np.float64)
            return np.where(np.isfinite(found), found, np.inf)

        here, steps, sweeps = np.zeros(6), np.ones(6), 0
        least = float(costs(here[None])[0])
        if isinstance(problem, p2o.LeastSquares) and not len(problem):
            return p2o.Solution(start, 0.0, 0, p2o.SolverStatus.SINGULAR, None, "there are no pairs")
        if not np.isfinite(least):
            return p2o.Solution(
                start, np.inf, 0, p2o.SolverStatus.SINGULAR, None, "the cost of the start is not finite"
            )
        while sweeps < options.max_sweeps and steps.max() >= options.tolerance:
            before, sweeps = here.copy(), sweeps + 1
            for axis in range(6):
                both = here + np.outer((-steps[axis], steps[axis]), np.eye(6)[axis])
                found = costs(both)
                best = int(np.argmin(found))
                better = found[best] < least
                if better:
                    here, least = both[best], float(found[best])
                steps[axis] = min(steps[axis] * options.grow, 1.0) if better else steps[axis] * options.shrink
            if (here != before).any():
                # Several lengths of the same way at once.
                ahead = here + np.outer((1.0, 3.0, 9.0), here - before)
                found = costs(ahead)
                best = int(np.argmin(found))
                if found[best] < least:
                    here, least = ahead[best], float(found[best])
        status = p2o.SolverStatus.CONVERGED if steps.max() < options.tolerance else p2o.SolverStatus.ITERATIONS_SPENT
        pose = pose_at(start, here * unit)
        return p2o.Solution(pose, float(problem.cost(pose[None])[0]), sweeps, status)

    return solve


METHOD = p2o.Method(
    name="coordinate",
    build=build,
    options=CoordinateOptions,
    summary="Search along the six axes with steps of their own that shrink and grow, on any scalar cost.",
    needs={"objective"},
    cite="Hooke and Jeeves, Direct Search Solution of Numerical and Statistical Problems, JACM 8, 1961",
)
