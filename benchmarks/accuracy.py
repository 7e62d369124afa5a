"""Accuracy on frames with known truth: every combination under one protocol, means and medians, failures counted.

    python benchmarks/accuracy.py --data kitti-raw:build/data/kitti_raw --frames @benchmarks/splits.json#test --seeds 10

Each row is what `p2o run` with these words gives for seeds 0 to N-1; features are extracted once a frame and shared.
A frame that is refused counts with the error of its start, which is what the user is left with.
"""

from __future__ import annotations

import argparse
import time
from collections import Counter
from dataclasses import dataclass

import numpy as np
from p2o import PoseError, View, se3
from p2o.arrays import Float
from p2o.frames.selection import select
from p2o.geometry.perturb import Perturbation, parse_perturbation, wrong_start
from p2o.geometry.pose_error import pose_error, summarise
from p2o.host.registry import Registry
from p2o.results.verdict import Trust, Verdict
from p2o.run.recipe import Recipe, parse_settings
from p2o.solving import Accuracy
from scipy import stats


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
        Row("p2ornet/rings", "ogm", "search", PAPER, True),
        Row("p2ornet/rings", "ogm", "given", PAPER, True),
        Row("p2ornet/rings", "nearest", "search", PAPER, True),
        Row("p2ornet/rings", "nearest", "given", PAPER, True),
        Row("stereo/rings", "ogm", "search", PAPER, True),
        Row("stereo/rings", "ogm", "given", PAPER, True),
        Row("stereo/rings", "nearest", "search", PAPER, True),
        Row("stereo/rings", "nearest", "given", PAPER, True),
        Row("canny/rings", "nearest", "search", PAPER, True),
        Row("canny/rings", "nearest", "given", PAPER, True),
    ],
    "wide": [
        Row("p2ornet/rings", "ogm", "search", "5deg 0.15m", True),
        Row("p2ornet/rings", "ogm", "grid", "10deg 0.15m", True),
        Row("stereo/rings", "ogm", "search", "5deg 0.15m", True),
        Row("stereo/rings", "ogm", "grid", "10deg 0.15m", True),
    ],
    "ten": [
        Row("p2ornet/rings", "ogm", "grid", "10deg 0.15m", True),
        Row("stereo/rings", "ogm", "grid", "10deg 0.15m", True),
    ],
    "single": [
        Row("p2ornet/rings", "ogm", "search", PAPER, False),
        Row("p2ornet/rings", "ogm", "given", PAPER, False),
        Row("p2ornet/rings", "ogm", "search", PAPER, False, "LR"),
        Row("p2ornet/rings", "nearest", "search", PAPER, False),
        Row("p2ornet/rings", "nearest", "given", PAPER, False),
        Row("stereo/rings", "ogm", "search", PAPER, False),
        Row("stereo/rings", "ogm", "given", PAPER, False),
        Row("stereo/rings", "ogm", "search", PAPER, False, "LR"),
        Row("stereo/rings", "nearest", "search", PAPER, False),
        Row("stereo/rings", "nearest", "given", PAPER, False),
        Row("canny/rings", "nearest", "search", PAPER, False),
        Row("canny/rings", "nearest", "given", PAPER, False),
    ],
}
MANY_EDGES = 1500
"""Frames with more LiDAR edges in the image than this are full of leaves: trees, hedges, embankments."""
COLUMNS = (
    "| extractor | matcher | init | start | rotation deg, median / mean | translation cm, median / mean "
    "| within {} | status | s |"
)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", required=True, help="DATASET:PATH as for p2o run")
    parser.add_argument("--frames", default="all", help="as for p2o run")
    parser.add_argument("--groups", default="joint,wide,ten,single", help=f"any of {','.join(ROWS)}")
    parser.add_argument("--extractors", help="only rows with these image extractors, such as p2ornet,stereo")
    parser.add_argument(
        "--set", action="append", default=[], metavar="[STAGE.]FIELD=VALUE", help="option (default stage: extractor)"
    )
    parser.add_argument("--starts", help="only rows with these initializers, such as search")
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
        print("|---|---|---|---|---|---|---|---|---|", flush=True)
        for row in ROWS[group]:
            wanted = (arguments.extractors or row.extractor.partition("/")[0]).split(",")
            if row.extractor.partition("/")[0] not in wanted or row.init not in (arguments.starts or row.init).split(
                ","
            ):
                continue
            words = {"data": arguments.data, "frames": arguments.frames, "joint": row.joint, "perturb": row.perturb}
            words |= {"extractor": row.extractor, "matcher": row.matcher, "init": row.init}
            options = parse_settings(
                [text if "." in text.split("=")[0] else f"extractor.{text}" for text in arguments.set]
            )
            if row.matcher == "ogm":
                options["matcher"] = {**options.get("matcher", {}), "sides": row.sides}
            words["options"] = options
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
            likely: list[Accuracy | None] = []
            verdicts: list[Verdict] = []
            size = parse_perturbation(row.perturb)
            for seed in range(arguments.seeds if row.joint else arguments.single_seeds):
                pipeline = Recipe.of(**words, seed=seed).resolve(registry).calibrator()
                own = views[row.extractor]
                if not pipeline.directed:
                    own = [view.without_sides() for view in own]
                if group == "ten":
                    # Ten frames are sampled again for every seed.
                    drawn = np.random.default_rng([seed, 10]).choice(len(own), 10, replace=False)
                    own = [own[i] for i in sorted(drawn)]
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
                    likely.append(result.accuracy)
                    verdicts.append(result.verdict)
            seconds = (time.perf_counter() - began) / len(errors)
            matcher = row.matcher if row.sides == "LRUB" else f"{row.matcher} ({row.sides})"
            ends = ", ".join(f"{n} {k}" for k, n in sorted(statuses.items()))
            head = f"| {row.extractor} | {matcher} | {row.init} | {row.perturb} "
            print(f"{head}{figures(errors, good)}| {ends} | {seconds:.1f} |", flush=True)
            print(promises(errors, likely), flush=True)
            if not row.joint:
                for third, part in thirds(errors, likely).items():
                    print(f"| | {third} | | {figures(part, good)}| | |", flush=True)
                many = [leafy(view, truth) for view, (_, truth) in zip(own, truths, strict=True)]
                for kind, wanted_kind in (("streets with objects", False), ("trees, embankments", True)):
                    part = [e for i, e in enumerate(errors) if many[i % len(many)] == wanted_kind]
                    if part:
                        print(f"| | {kind} | | {figures(part, good)}| | |", flush=True)
                for trust in Trust:
                    part = [e for e, verdict in zip(errors, verdicts, strict=True) if verdict.trust is trust]
                    if part:
                        print(f"| | {trust} | | {figures(part, good)}| | |", flush=True)


def leafy(view: View, truth: Float) -> bool:
    """Return whether a frame shows mostly leaves, by the number of its LiDAR edges in the image."""
    edges = view.cloud_edges
    return int(view.camera.in_image(view.camera.project(se3.apply(truth, edges.xyz))).sum()) > MANY_EDGES


def promises(errors: list[PoseError], likely: list[Accuracy | None]) -> str:
    """Return a row: how many errors are within what two of three and nineteen of twenty should be, rank correlation."""
    told = [(e, a) for e, a in zip(errors, likely, strict=True) if a is not None]
    columns = []
    for name, wide, wider in (
        ("rotation_deg", "rotation_deg", "rotation_deg_95"),
        ("translation_m", "translation_m", "translation_m_95"),
    ):
        error = np.array([getattr(e, name) for e, _ in told])
        first, second = (np.array([getattr(a, bound) for _, a in told]) for bound in (wide, wider))
        rank = stats.spearmanr(first, error)[0] if len(told) > 2 else float("nan")
        columns.append(f"{100 * np.mean(error <= first):.0f} % / {100 * np.mean(error <= second):.0f} % ({rank:.2f})")
    return f"| | coverage (67 % / 95 %) | | | {columns[0]} | {columns[1]} | {len(told)} of {len(errors)} tell | | |"


def thirds(errors: list[PoseError], likely: list[Accuracy | None]) -> dict[str, list[PoseError]]:
    """Return the errors by thirds of the likely translation; those that do not tell are among the worst."""
    order = np.argsort([np.inf if a is None else a.translation_m for a in likely], kind="stable")
    parts = np.array_split(order, 3)
    return {
        f"{name} third by predicted error": [errors[i] for i in p]
        for name, p in zip(("best", "middle", "worst"), parts, strict=True)
    }


def figures(errors: list[PoseError], good: Perturbation) -> str:
    """Return the columns of medians, means and good results."""
    s = summarise(errors, good.angle_deg, good.distance_m)
    within = next(value for key, value in s.items() if key.startswith("within"))
    return (
        f"| {s['rotation_deg_median']:.3f} / {s['rotation_deg_mean']:.3f} "
        f"| {100 * s['translation_m_median']:.1f} / {100 * s['translation_m_mean']:.1f} | {within} of {s['count']} "
    )


if __name__ == "__main__":
    main()
