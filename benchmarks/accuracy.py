"""Accuracy on frames with known truth: every combination under one protocol, means and medians, failures counted.

    python benchmarks/accuracy.py --data kitti-raw:build/data/kitti_raw --frames @splits.json#test --seeds 10

Each row is what `p2o run` with these words gives for seeds 0 to N-1; features are extracted once a frame and shared.
A frame that is refused counts with the error of its start, which is what the user is left with.
"""

from __future__ import annotations

import argparse
import time
from collections import Counter
from dataclasses import dataclass

import numpy as np
from p2o.metrics import pose_error, summarise
from p2o.perturb import parse_perturbation, wrong_start
from p2o.recipe import Recipe
from p2o.registry import Registry
from p2o.selection import select


@dataclass(frozen=True)
class Row:
    """One combination of methods and starts."""

    extractor: str
    matcher: str
    init: str
    perturb: str
    joint: bool
    sides: str = "LRUB"


PAPER = "2deg 0.15m"
ROWS = {
    "joint": [
        Row("stereo/rings", "ogm", "search", PAPER, True),
        Row("stereo/rings", "ogm", "given", PAPER, True),
        Row("stereo/rings", "nearest", "search", PAPER, True),
        Row("stereo/rings", "nearest", "given", PAPER, True),
        Row("canny/rings", "nearest", "search", PAPER, True),
        Row("canny/rings", "nearest", "given", PAPER, True),
    ],
    "wide": [
        Row("stereo/rings", "ogm", "search", "5deg 0.15m", True),
        Row("stereo/rings", "ogm", "grid", "10deg 0.15m", True),
    ],
    "single": [
        Row("stereo/rings", "ogm", "search", PAPER, False),
        Row("stereo/rings", "ogm", "given", PAPER, False),
        Row("stereo/rings", "ogm", "search", PAPER, False, "LR"),
        Row("stereo/rings", "nearest", "search", PAPER, False),
        Row("stereo/rings", "nearest", "given", PAPER, False),
        Row("canny/rings", "nearest", "search", PAPER, False),
        Row("canny/rings", "nearest", "given", PAPER, False),
    ],
}
COLUMNS = (
    "| extractor | matcher | init | start | rotation deg, median / mean | translation cm, median / mean "
    "| within {} | status | s |"
)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", required=True, help="DATASET:PATH as for p2o run")
    parser.add_argument("--frames", default="all", help="as for p2o run")
    parser.add_argument("--groups", default="joint,wide,single", help=f"any of {','.join(ROWS)}")
    parser.add_argument("--seeds", type=int, default=10, help="starts per joint row")
    parser.add_argument("--single-seeds", type=int, default=3, help="starts per frame of the single-frame rows")
    parser.add_argument("--good", default="0.3deg 0.10m", help="what counts as a good result")
    arguments = parser.parse_args()
    registry = Registry.load()
    good = parse_perturbation(arguments.good)
    views: dict[str, list] = {}
    truths: list = []
    for group in arguments.groups.split(","):
        print(f"\n{group}: {arguments.data}, {arguments.frames}\n\n" + COLUMNS.format(good))
        print("|---|---|---|---|---|---|---|---|---|")
        for row in ROWS[group]:
            words = {"data": arguments.data, "frames": arguments.frames, "joint": row.joint, "perturb": row.perturb}
            words |= {"extractor": row.extractor, "matcher": row.matcher, "init": row.init}
            if row.matcher == "ogm":
                words["options"] = {"matcher": {"sides": row.sides}}
            if row.extractor not in views:
                plan = Recipe.of(**words).resolve(registry)
                dataset = plan.dataset()
                chosen = select(dataset.names, arguments.frames)
                pipeline = plan.calibrator()
                loaded = [(index, dataset[index]) for index in chosen]
                truths = [(index, frame.camera_from_lidar) for index, frame in loaded]
                # With directions where the extractor gives them; `without_sides` below forgets them where unused.
                views[row.extractor] = [
                    type(pipeline)(**{**vars(pipeline), "directed": True}).extract(frame) for _, frame in loaded
                ]
            errors, statuses, began = [], Counter(), time.perf_counter()
            size = parse_perturbation(row.perturb)
            for seed in range(arguments.seeds if row.joint else arguments.single_seeds):
                pipeline = Recipe.of(**words, seed=seed).resolve(registry).calibrator()
                own = views[row.extractor]
                if not pipeline.directed:
                    own = [view.without_sides() for view in own]
                jobs = (
                    [(own, truths[0][1], [seed])]
                    if row.joint
                    else [([view], truth, [seed, index]) for view, (index, truth) in zip(own, truths, strict=True)]
                )
                for batch, truth, numbers in jobs:
                    start = wrong_start(truth, size.angle_deg, size.distance_m, np.random.default_rng(numbers))
                    result = pipeline.solve(batch, start)
                    errors.append(pose_error(result.camera_from_lidar, truth))
                    statuses[result.status.value] += 1
            s = summarise(errors, good.angle_deg, good.distance_m)
            within = next(value for key, value in s.items() if key.startswith("within"))
            matcher = row.matcher if row.sides == "LRUB" else f"{row.matcher} ({row.sides})"
            print(
                f"| {row.extractor} | {matcher} | {row.init} | {row.perturb} "
                f"| {s['rotation_deg_median']:.3f} / {s['rotation_deg_mean']:.3f} "
                f"| {100 * s['translation_m_median']:.1f} / {100 * s['translation_m_mean']:.1f} "
                f"| {within} of {s['count']} | {', '.join(f'{n} {k}' for k, n in sorted(statuses.items()))} "
                f"| {(time.perf_counter() - began) / len(errors):.1f} |",
                flush=True,
            )


if __name__ == "__main__":
    main()
