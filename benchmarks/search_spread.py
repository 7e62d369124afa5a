"""Spread of single-frame results over seeds of the search: a result should not depend on random numbers.

    python benchmarks/search_spread.py --root build/data --kept build/search-spread --seeds 10

Each frame is calibrated from one initial guess (2 deg, 15 cm) with several seeds of the initializer. The spread of a
frame is the largest distance of its poses from their mean. KITTI raw frames are those of `train`.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path

import numpy as np
from p2o.geometry.perturb import wrong_start
from p2o.geometry.pose_error import pose_error
from p2o.run.rig_solve import mean_pose
from verdict_rigs import RIGS, seen

LIMIT_DEG, LIMIT_M = 0.03, 0.01


def main() -> None:
    """Print the spread of every frame, and its quantiles for each rig."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--root", default="build/data", help="folder of the real frames")
    parser.add_argument("--kept", type=Path, default=Path("build/search-spread"), help="folder of extracted features")
    parser.add_argument("--splits", default="../shared/data/splits.json", help="file of the splits")
    parser.add_argument("--rigs", nargs="+", default=["kitti-raw", "kitti-odometry", "waymo", "hitsz", "pjlab"])
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--most", type=int, help="frames of each rig, evenly chosen")
    parser.add_argument("--frames", action="store_true", help="print every frame")
    options = parser.parse_args()
    for name in options.rigs:
        rig = next(rig for rig in RIGS if rig.name == name)
        rig = replace(rig, data=rig.data.replace("build/data", options.root))
        plans = [replace(rig, options={**rig.options, "init": {"seed": seed}}).plan for seed in range(options.seeds)]
        pipelines = [plan.calibrator() for plan in plans]
        rows = []
        for number, frame in enumerate(seen(rig, options.kept, options.splits, most=options.most)):
            start = wrong_start(frame.truth, 2.0, 0.15, np.random.default_rng(number))
            poses = [pipeline.solve([frame.view], start).camera_from_lidar for pipeline in pipelines]
            mean = mean_pose(poses)
            away = [pose_error(pose, mean) for pose in poses]
            errors = [pose_error(pose, frame.truth) for pose in poses]
            rows.append(
                [
                    max(one.rotation_deg for one in away),
                    max(one.translation_m for one in away),
                    np.mean([one.rotation_deg for one in errors]),
                    np.mean([one.translation_m for one in errors]),
                ]
            )
            if options.frames:
                deg, m, error_deg, error_m = rows[-1]
                print(
                    f"  {frame.view.name:40} {deg:.3f} deg {100 * m:.1f} cm, error {error_deg:.2f} {100 * error_m:.1f}"
                )
        table = np.array(rows)
        within = np.mean((table[:, 0] < LIMIT_DEG) & (table[:, 1] < LIMIT_M))
        quantiles = np.quantile(table[:, :2], [0.5, 0.95], axis=0) * [1, 100]
        (deg_50, cm_50), (deg_95, cm_95) = quantiles
        print(
            f"{name:16} {len(table):3} frames, within {LIMIT_DEG} deg, {100 * LIMIT_M:.0f} cm: {100 * within:.0f} %; "
            f"median {deg_50:.3f} deg {cm_50:.1f} cm, 95 % {deg_95:.3f} deg {cm_95:.1f} cm; "
            f"error {np.median(table[:, 2]):.3f} deg {100 * np.median(table[:, 3]):.1f} cm",
            flush=True,
        )


if __name__ == "__main__":
    main()
