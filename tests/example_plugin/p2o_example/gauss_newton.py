"""Damped Gauss-Newton on point-to-line pairs."""

import numpy as np
import p2o
from p2o.solving import PointToLine


class GaussNewtonOptions(p2o.Options):
    """Options of `gauss-newton`."""

    iterations: int = p2o.field(30, ge=1, le=1000, help="Number of steps.")
    damping: float = p2o.field(1e-6, ge=0, le=1, help="Share of the Hessian's trace that is added to its diagonal.")


def build(options: GaussNewtonOptions) -> p2o.Solver:
    """Return the solver."""

    def solve(problem: PointToLine, camera_from_lidar):
        pose = start = np.asarray(camera_from_lidar)
        if len(problem) < 6:
            return p2o.Solution(start, 0.0, 0, "singular", reason=f"{len(problem)} pairs, at least 6 are needed")
        for _ in range(options.iterations):
            residuals, jacobian = problem.residuals_with_jacobian(pose)
            seen = np.isfinite(residuals)
            residuals, jacobian = residuals[seen], jacobian[seen]
            weight = problem.weight[seen] * problem.huber_px / np.maximum(np.abs(residuals), problem.huber_px)
            hessian = (jacobian * weight[:, None]).T @ jacobian
            hessian += options.damping * np.diag(np.diag(hessian))
            pose = p2o.se3.exp(-np.linalg.solve(hessian, jacobian.T @ (weight * residuals))) @ pose
        before, after = problem.cost(np.stack([start, pose]))
        if after > before:
            return p2o.Solution(start, float(before), options.iterations, "iterations-spent")
        return p2o.Solution(pose, float(after), options.iterations)

    return solve


METHOD = p2o.Method(
    name="gauss-newton",
    build=build,
    options=GaussNewtonOptions,
    summary="Damped Gauss-Newton with Huber weights.",
    needs={"pairs"},
)
