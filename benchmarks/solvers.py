"""How much faster lm is than SciPy and Ceres on the same pairs: `python benchmarks/solvers.py` (no data needed).

The problem is synthetic: 24 frames of 600 pairs, 1 px of noise, one line in five wrong, start 1 deg and 5 cm off. All
solvers minimise the same cost from the same start with their default options, and again with the default tolerances
of SciPy and Ceres (1e-8 and 1e-6). Printed are medians of runs that take turns, as ratios to lm of the same turn, and
how far each answer lies from that of lm.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from statistics import median

import numpy as np
from p2o import Camera, Method, PointToLine, Solution, se3
from p2o_plugins.solve import ceres, lm, scipy_least_squares

FRAMES, PAIRS, TURNS = 24, 600, 7
CAMERA = Camera.pinhole(720.0, 720.0, 610.0, 172.0, 1242, 375)
TRUTH = se3.make(np.array([[0.0, -1, 0], [0, 0, -1], [1, 0, 0]]), [0.02, -0.08, -0.27])
START = TRUTH @ se3.exp(np.array([0.0098, -0.0112, 0.0092, 0.03, -0.025, 0.031]))


def made_up(seed: int = 0) -> PointToLine:
    rng, count = np.random.default_rng(seed), FRAMES * PAIRS
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
        np.repeat(np.arange(FRAMES), PAIRS),
        (CAMERA,) * FRAMES,
    )


def timed(solve: Callable[..., Solution], problem: PointToLine) -> tuple[float, Solution]:
    fresh = replace(problem)  # what a problem keeps between calls is paid for by every solver
    began = time.perf_counter()
    solution = solve(fresh, START)
    return time.perf_counter() - began, solution


def built(method: Method, **options: float) -> Callable[..., Solution]:
    return method.build(method.options(**options))


def main() -> None:
    problem = made_up()
    solvers = {
        "lm": built(lm.METHOD),
        "scipy": built(scipy_least_squares.METHOD),
        "scipy, tolerance 1e-8": built(scipy_least_squares.METHOD, tolerance=1e-8),
        "ceres": built(ceres.METHOD),
        "ceres, tolerance 1e-6": built(ceres.METHOD, tolerance=1e-6),
    }
    turns = [{name: timed(solve, problem) for name, solve in solvers.items()} for _ in range(TURNS + 1)][1:]
    reference = turns[0]["lm"][1].camera_from_lidar
    print(f"{FRAMES} frames x {PAIRS} pairs, median of {TURNS} turns")
    print(f"{'solver':24}{'ms':>8}{'x lm':>8}{'steps':>7}{'from lm, deg':>14}{'m':>10}{'cost - lm':>12}")
    for name in solvers:
        seconds = [turn[name][0] for turn in turns]
        ratio = median(turn[name][0] / turn["lm"][0] for turn in turns)
        solution = turns[0][name][1]
        difference = se3.inverse(reference) @ solution.camera_from_lidar
        print(
            f"{name:24}{1e3 * median(seconds):8.1f}{ratio:8.1f}{solution.iterations:7d}"
            f"{se3.angle_deg(difference):14.1e}{se3.distance_m(difference):10.1e}"
            f"{solution.cost - turns[0]['lm'][1].cost:12.1e}"
        )


if __name__ == "__main__":
    main()
