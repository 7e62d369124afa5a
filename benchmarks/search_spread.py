"""Spread of single-frame results over seeds of the search: a result should not depend on random numbers.

    python benchmarks/search_spread.py --seeds 10 --most 24

Each frame is calibrated from one initial guess (2 deg, 15 cm) with several seeds of the initializer. The spread of a
frame is the largest distance of its poses from their mean. KITTI raw frames are those of `train`.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path

import numpy as np
from limits_and_tables import START_DEG, START_M
from p2o.arrays import Float
from p2o.geometry.perturb import wrong_start
from p2o.geometry.pose_error import pose_error
from p2o.run.rig_solve import mean_pose
from rigs import Rig, rig_of

LIMIT_DEG, LIMIT_M = 0.03, 0.01
FEATURES = Path("build/search-spread")
RIGS = ("kitti-raw", "kitti-odometry", "waymo", "hitsz", "pjlab")


def main() -> None:
    """Print the quantiles of the spread of the frames of each rig."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--most", type=int, help="frames of each rig, evenly chosen")
    options = parser.parse_args()
    for name in RIGS:
        rows = spreads(rig_of(name), options.seeds, options.most)
        print(_line(f"{name}, all", rows))
        print(_line(f"{name}, trusted", rows[rows[:, 2] > 0]), flush=True)


def spreads(rig: Rig, seeds: int, most: int | None) -> Float:
    """Return for each frame (N, 4) the largest distances in deg and m, share of trusted results, all within 95 %."""
    plans = [replace(rig, options={**rig.options, "init": {"seed": seed}}).plan for seed in range(seeds)]
    pipelines, rows = [plan.calibrator() for plan in plans], []
    for number, frame in enumerate(rig.samples(FEATURES, most)):
        start = wrong_start(frame.truth, START_DEG, START_M, np.random.default_rng(number))
        results = [pipeline.solve([frame.view], start) for pipeline in pipelines]
        mean = mean_pose([result.camera_from_lidar for result in results])
        errors = [pose_error(result.camera_from_lidar, mean) for result in results]
        within = [
            e.rotation_deg <= r.accuracy.rotation_deg_95 and e.translation_m <= r.accuracy.translation_m_95
            for e, r in zip(errors, results, strict=True)
            if r.accuracy is not None
        ]
        trusted = np.mean([result.verdict.trusted for result in results])
        largest = max(e.rotation_deg for e in errors), max(e.translation_m for e in errors)
        rows.append([*largest, trusted, float(all(within))])
    return np.array(rows)


def _line(name: str, rows: Float) -> str:
    """Return the figures of the frames (N, 4) of `spreads`."""
    if not len(rows):
        return f"{name:24}   0 frames"
    near = np.mean((rows[:, 0] < LIMIT_DEG) & (rows[:, 1] < LIMIT_M))
    (deg_50, cm_50), (deg_95, cm_95) = np.quantile(rows[:, :2], [0.5, 0.95], axis=0) * [1, 100]
    share = f"{LIMIT_DEG} deg and {100 * LIMIT_M:.0f} cm {100 * near:.0f} %"
    share += f", their 95 % bound {100 * rows[:, 3].mean():.0f} %"
    sizes = f"median {deg_50:.3f} deg {cm_50:.1f} cm, 95 % {deg_95:.3f} deg {cm_95:.1f} cm"
    return f"{name:24} {len(rows):3} frames; within {share}; {sizes}"


if __name__ == "__main__":
    main()
