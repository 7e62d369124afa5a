"""`lm` against Ceres, SciPy and GTSAM on the same pairs, one by one and many at once: `python benchmarks/solvers.py`.

The problem is synthetic: 24 frames of 600 pairs, 1 px of noise, one line in five wrong, start 1 deg and 5 cm off. All
solvers minimise the same cost from the same start with their default options, and again with the default tolerances
of SciPy and Ceres (1e-8 and 1e-6). GTSAM (`pip install gtsam`, else left out) minimises it in two ways:
all pairs as one custom factor, and a compiled projection factor for each pair, whose noise is 1 across the line and 1e4
along it, with the point held by a hard constraint. Then 64 single frames: `lm` on one after another, and a batched one
that takes every step for all of them at once. Printed are medians of runs that take turns, as ratios to lm of the same
turn, and how far each answer lies from that of lm.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from importlib.util import find_spec
from statistics import median
from typing import Any

import numpy as np
from p2o import Camera, Method, Solution, SolverStatus, se3
from p2o.arrays import Float
from p2o.problems.normal_equations import linearise
from p2o.solving import PointToLine
from p2o_plugins.solve import ceres, lm, scipy_least_squares

FRAMES, PAIRS, TURNS, SINGLE = 24, 600, 7, 64
CAMERA = Camera.pinhole(720.0, 720.0, 610.0, 172.0, 1242, 375)
TRUTH = se3.make(np.array([[0.0, -1, 0], [0, 0, -1], [1, 0, 0]]), [0.02, -0.08, -0.27])
START = TRUTH @ se3.exp(np.array([0.0098, -0.0112, 0.0092, 0.03, -0.025, 0.031]))


def synthetic(seed: int = 0, frames: int = FRAMES) -> PointToLine:
    rng, count = np.random.default_rng(seed), frames * PAIRS
    uv = rng.uniform([0, 0], [CAMERA.width, CAMERA.height], (count, 2))
    rays = CAMERA.rays(uv)
    points = rays / rays[:, 2:] * rng.uniform(5, 50, (count, 1))
    angle = np.where(rng.random(count) < 0.6, 0.0, np.pi / 2) + rng.normal(0, 0.1, count)
    normal = np.column_stack([np.cos(angle), np.sin(angle)])
    shift = rng.normal(0, 1, count) + (rng.random(count) < 0.2) * rng.uniform(-20, 20, count)
    return PointToLine(
        se3.apply(se3.inverse(TRUTH), points),
        uv + shift[:, None] * normal,
        normal,
        rng.uniform(0.3, 2.0, count),
        np.zeros(count, np.int8),
        np.repeat(np.arange(frames), PAIRS),
        (CAMERA,) * frames,
    )


def timed(solve: Callable[..., Solution], problem: PointToLine) -> tuple[float, Solution]:
    fresh = replace(problem)  # what a problem keeps between calls is paid for by every solver
    began = time.perf_counter()
    solution = solve(fresh, START)
    return time.perf_counter() - began, solution


def built(method: Method, **options: float) -> Callable[..., Solution]:
    return method.build(method.options(**options))


def by_custom_factor(problem: PointToLine, start: Float) -> Solution:
    """Return what GTSAM makes of all pairs as one factor, driven from Python as Ceres is."""
    import gtsam

    root_weight, huber = np.sqrt(problem.weight), problem.huber

    def misfit(factor: Any, values: Any, jacobians: Any) -> Float:
        right = values.atPose3(factor.keys()[0]).matrix()
        raw, jacobian = linearise(problem, right)
        roots, slope = ceres.robust_roots(raw, huber)
        if jacobians is not None:  # GTSAM updates from the right: exp(Ad d) pose = pose exp(d)
            jacobians[0] = np.asfortranarray((jacobian @ adjoint(right)) * (slope * root_weight)[:, None])
        return roots * root_weight

    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    graph.add(gtsam.CustomFactor(gtsam.noiseModel.Unit.Create(len(problem)), [0], misfit))
    values.insert(0, gtsam.Pose3(start))
    return of_gtsam(graph, values, problem, lambda pose: pose.matrix())


def by_projection_factors(problem: PointToLine, start: Float) -> Solution:
    """Return what GTSAM makes of compiled factors: a projection and a fixed point for each pair."""
    import gtsam

    focal = gtsam.Cal3_S2(CAMERA.params[0], CAMERA.params[1], 0.0, CAMERA.params[2], CAMERA.params[3])
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    values.insert(0, gtsam.Pose3(se3.inverse(start)))
    for number, (xyz, uv, normal, weight) in enumerate(
        zip(problem.xyz, problem.centre, problem.normal, problem.weight, strict=True), start=1
    ):
        along = np.array([-normal[1], normal[0]])
        information = weight * (np.outer(normal, normal) + 1e-8 * np.outer(along, along))
        across = gtsam.noiseModel.Gaussian.Information(information, False)
        kernel = gtsam.noiseModel.mEstimator.Huber.Create(float(problem.huber * np.sqrt(weight)))
        noise = gtsam.noiseModel.Robust.Create(kernel, across)
        graph.add(gtsam.GenericProjectionFactorCal3_S2(uv, noise, 0, number, focal))
        graph.add(gtsam.NonlinearEqualityPoint3(number, xyz))
        values.insert(number, xyz)
    return of_gtsam(graph, values, problem, lambda pose: se3.inverse(pose.matrix()))


def of_gtsam(graph: Any, values: Any, problem: PointToLine, pose_of: Callable[[Any], Float]) -> Solution:
    import gtsam

    params = gtsam.LevenbergMarquardtParams()
    params.setRelativeErrorTol(1e-12)
    params.setAbsoluteErrorTol(0.0)
    optimizer = gtsam.LevenbergMarquardtOptimizer(graph, values, params)
    pose = pose_of(optimizer.optimize().atPose3(0))
    cost = float(problem.loss(problem.residuals(pose)))
    return Solution(pose, cost, optimizer.iterations(), SolverStatus.CONVERGED, None)


def adjoint(pose: Float) -> Float:
    """Return the adjoint (6, 6) of a pose (4, 4): exp(Ad d) pose = pose exp(d), rotation first."""
    out = np.zeros((6, 6))
    out[:3, :3] = out[3:, 3:] = pose[:3, :3]
    out[3:, :3] = se3.skew(pose[:3, 3]) @ pose[:3, :3]
    return out


def batched(problems: list[PointToLine], starts: Float) -> Float:
    """Return poses (B, 4, 4): damped steps as of `lm`, with iterated reweighting alone, for all problems at once."""
    xyz = np.stack([problem.xyz for problem in problems])
    centre = np.stack([problem.centre for problem in problems])
    normal = np.stack([problem.normal for problem in problems])
    weight = np.stack([problem.weight for problem in problems])
    fx, fy, cx, cy = CAMERA.params
    huber, count = problems[0].huber, len(problems)

    def linear(poses: Float) -> tuple[Float, Float, Float]:
        x, y, z = np.moveaxis(np.einsum("bij,bkj->bki", poses[:, :3, :3], xyz) + poses[:, None, :3, 3], -1, 0)
        a, b = normal[..., 0] * fx / z, normal[..., 1] * fy / z
        residuals = a * x + b * y + normal[..., 0] * (cx - centre[..., 0]) + normal[..., 1] * (cy - centre[..., 1])
        c = -(a * x + b * y) / z
        jacobian = np.stack([y * c - z * b, z * a - x * c, x * b - y * a, a, b, c], axis=-1)
        size = np.abs(residuals)
        cost = np.where(size > huber, huber * (size - huber / 2), size**2 / 2)
        return residuals, jacobian, (weight * cost).sum(axis=1)

    poses, damping = starts.copy(), np.full(count, 1e-4)
    residuals, jacobian, cost = linear(poses)
    for _ in range(100):
        curvature = weight * np.minimum(1.0, huber / np.maximum(np.abs(residuals), 1e-12))
        weighed = jacobian * curvature[..., None]
        hessian = weighed.swapaxes(1, 2) @ jacobian
        gradient = np.einsum("bki,bk->bi", weighed, residuals)
        scaled = np.einsum("bii->bi", hessian)[:, :, None] * np.eye(6)
        step = -np.linalg.solve(hessian + damping[:, None, None] * scaled, gradient[..., None])[..., 0]
        if np.abs(step).max() < 1e-10:
            break
        trial = np.stack([se3.exp(s) for s in step]) @ poses
        new_residuals, new_jacobian, new_cost = linear(trial)
        better = new_cost < cost
        poses[better], residuals[better], jacobian[better] = trial[better], new_residuals[better], new_jacobian[better]
        cost[better] = new_cost[better]
        damping = np.where(better, damping / 3, damping * 4)
        if not better.any() and damping.min() > 1e3:
            break
    return poses


def print_batched() -> None:
    problems = [synthetic(seed, frames=1) for seed in range(SINGLE)]
    solve, ratios, apart = built(lm.METHOD), [], 0.0
    for _ in range(TURNS + 1):
        began = time.perf_counter()
        singly = np.stack([solve(problem, START).camera_from_lidar for problem in problems])
        between = time.perf_counter()
        together = batched(problems, np.repeat(START[None], SINGLE, axis=0))
        ratios.append((time.perf_counter() - between) / (between - began))
        steps = [se3.inverse(a) @ b for a, b in zip(singly, together, strict=True)]
        apart = max(max(se3.angle_deg(step), se3.distance_m(step)) for step in steps)
        each_ms = 1e3 * (between - began) / SINGLE
    print(
        f"\n{SINGLE} single frames: lm {each_ms:.2f} ms each; batched x {median(ratios[1:]):.1f}, "
        f"apart {apart:.1e} deg or m"
    )


def main() -> None:
    problem = synthetic()
    solvers = {
        "lm": built(lm.METHOD),
        "scipy": built(scipy_least_squares.METHOD),
        "scipy, tolerance 1e-8": built(scipy_least_squares.METHOD, tolerance=1e-8),
        "ceres": built(ceres.METHOD),
        "ceres, tolerance 1e-6": built(ceres.METHOD, tolerance=1e-6),
    }
    if find_spec("gtsam"):
        solvers |= {"gtsam, one factor": by_custom_factor, "gtsam, compiled factors": by_projection_factors}
    turns = [{name: timed(solve, problem) for name, solve in solvers.items()} for _ in range(TURNS + 1)][1:]
    reference = turns[0]["lm"][1].camera_from_lidar
    print(f"{FRAMES} frames x {PAIRS} pairs, median of {TURNS} turns\n")
    print("| solver | ms | times lm | steps | deg from lm | m from lm | cost - that of lm |")
    print("|---|---|---|---|---|---|---|")
    for name in solvers:
        seconds = [turn[name][0] for turn in turns]
        ratio = median(turn[name][0] / turn["lm"][0] for turn in turns)
        solution = turns[0][name][1]
        difference = se3.inverse(reference) @ solution.camera_from_lidar
        print(
            f"| {name} | {1e3 * median(seconds):.1f} | {ratio:.1f} | {solution.iterations} "
            f"| {se3.angle_deg(difference):.1e} | {se3.distance_m(difference):.1e} "
            f"| {solution.cost - turns[0]['lm'][1].cost:.1e} |"
        )
    print_batched()


if __name__ == "__main__":
    main()
