"""A solver from docs/plugins.md alone: Levenberg-Marquardt on any least squares."""

import numpy as np
import p2o
from p2o.solving import checked_solution, linearise, normal_equations, require_residuals

PLUGIN_API = 1


class Options(p2o.Options):
    iterations: int = p2o.field(50, ge=1, le=1000, help="Largest number of steps.")
    max_condition: float = p2o.field(1e7, gt=1, help="Condition of the Hessian from which the pose is singular.")


def build(options):
    def solve(problem, camera_from_lidar):
        problem = require_residuals(problem, "damped")
        start = pose = np.asarray(camera_from_lidar, dtype=float)
        damping, status, steps = 1e-4, "iterations-spent", 0
        cost = problem.cost(pose[None])[0]
        while steps < options.iterations and status != "converged":
            steps += 1
            hessian, gradient = normal_equations(problem, *linearise(problem, pose))
            scale = np.diag(np.maximum(np.diag(hessian), 1e-9))
            delta = -np.linalg.solve(hessian + damping * scale, gradient)
            trial = p2o.se3.exp(delta) @ pose
            trial_cost = problem.cost(trial[None])[0]
            if trial_cost <= cost:
                pose, cost, damping = trial, trial_cost, max(damping / 10, 1e-12)
            else:
                damping *= 10
            if np.abs(delta).max() < 1e-10 or damping > 1e12:
                status = "converged"
        return checked_solution(problem, start, pose, steps, p2o.SolverStatus(status), options.max_condition)

    return solve


@p2o.hookimpl
def p2o_solvers():
    yield p2o.Method(
        name="damped",
        build=build,
        options=Options,
        summary="Levenberg-Marquardt with Huber weights.",
        needs={"residuals"},
    )
