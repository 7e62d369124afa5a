"""Are synthetic scenes as hard as real frames? The same figures of both, side by side, for `stereo` and for `canny`.

    python benchmarks/difficulty.py --data kitti-raw:build/data/kitti_raw --frames @benchmarks/splits.json#test --jobs 2

Edges a frame of both sensors; the share of LiDAR edges that have an image edge of their direction (`canny`: any edge)
within 3 px at the true pose, beside the share that chance gives; errors of single frames, each row what `p2o run` with
`--init search` and seeds 0 to N-1 gives. A frame that is refused counts with the error of its start, which is what the
user is left with. LiDAR edges are those that the method works on: in the image, and not hidden from the camera.
"""

from __future__ import annotations

import argparse
import time
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from joblib import Parallel, delayed
from p2o.features.side import SIDES
from p2o.frames.selection import select
from p2o.geometry.perturb import parse_perturbation
from p2o.geometry.pose_error import PoseError, pose_error, summarise
from p2o.host.registry import Registry
from p2o.problems.agreement import NEAR_PX, agreement
from p2o.results.evidence import Agreement
from p2o.results.verdict import Trust
from p2o.run.recipe import Recipe, open_dataset
from p2o_study.parallel import limit_threads

MATCHERS = {"stereo": "ogm", "canny": "nearest"}
"""Image sides to look at, each with the matcher that can use it."""


@dataclass(frozen=True)
class Measured:
    """What one image side gives on one frame; `edges` counts those of the image by direction."""

    edges: Mapping[str, int]
    meeting: Agreement
    errors: tuple[PoseError, ...]
    statuses: tuple[str, ...]
    trusts: tuple[Trust, ...]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", required=True, help="real frames, DATASET:PATH as for p2o run")
    parser.add_argument("--frames", default="all", help="as for p2o run")
    parser.add_argument("--most", type=int, help="only so many of the real frames, spread evenly")
    parser.add_argument(
        "--synthetic", default="synthetic:?seed=1", help="synthetic frames, DATASET:PATH as for p2o run"
    )
    parser.add_argument("--scenes", type=int, default=24, help="number of synthetic scenes")
    parser.add_argument("--extractors", default=",".join(MATCHERS), help=f"any of {','.join(MATCHERS)}")
    parser.add_argument("--perturb", default="2deg 0.15m", help="start, as for p2o run")
    parser.add_argument("--seeds", type=int, default=1, help="starts of each frame")
    parser.add_argument("--jobs", type=int, default=1, help="processes")
    arguments = parser.parse_args()
    synthetic = arguments.synthetic
    if synthetic.startswith("synthetic:"):
        synthetic += f"{'&' if '?' in synthetic else '?'}scenes={arguments.scenes}"
    sources = {
        "synthetic": (synthetic, "all", arguments.scenes),
        "real": (arguments.data, arguments.frames, arguments.most),
    }
    images = arguments.extractors.split(",")
    began = time.perf_counter()
    found: dict[str, list[dict[str, Measured]]] = {}
    with Parallel(n_jobs=arguments.jobs) as pool:
        for kind, (data, frames, most) in sources.items():
            numbers = chosen(data, frames, most)
            jobs = (delayed(measure)(images, data, n, arguments.perturb, arguments.seeds) for n in numbers)
            found[kind] = list(pool(jobs))
    print(f"start {arguments.perturb}, {arguments.seeds} a frame, {time.perf_counter() - began:.0f} s")
    for image in images:
        print(f"\n{image}/rings, {MATCHERS[image]}, search\n")
        print(table({kind: [frame[image] for frame in frames] for kind, frames in found.items()}), flush=True)


def chosen(data: str, frames: str, most: int | None) -> list[int]:
    """Return the numbers of the frames, at most `most` of them."""
    dataset = open_dataset(data, Registry.load())
    numbers = select(dataset.names, frames, skipped=dataset.skipped)
    places = np.linspace(0, len(numbers) - 1, min(most or len(numbers), len(numbers))).round().astype(int)
    return [numbers[place] for place in places]


def measure(images: Sequence[str], data: str, index: int, perturb: str, seeds: int) -> dict[str, Measured]:
    """Return what each image side gives on one frame, which is read once."""
    limit_threads()
    registry, size, out = Registry.load(), parse_perturbation(perturb), {}
    frame = open_dataset(data, registry)[index]
    truth = frame.camera_from_lidar
    for image in images:
        words = {"data": data, "extractor": f"{image}/rings", "matcher": MATCHERS[image], "perturb": perturb}
        plans = [Recipe.of(**words, seed=seed).resolve(registry) for seed in range(seeds)]
        pipelines = [plan.calibrator() for plan in plans]
        view = pipelines[0].prepare(frame)
        starts = [size.start(truth, np.random.default_rng([seed, index])) for seed in range(seeds)]
        results = [pipeline.solve([view], start) for pipeline, start in zip(pipelines, starts, strict=True)]
        counts = Counter(view.image_edges.side.tolist())
        out[image] = Measured(
            edges={"all": len(view.image_edges), **{side.letter: counts[side] for side in SIDES if counts[side]}},
            meeting=agreement(pipelines[0].visible([view], truth).raw, truth),
            errors=tuple(pose_error(result.camera_from_lidar, truth) for result in results),
            statuses=tuple(result.status.value for result in results),
            trusts=tuple(result.verdict.trust for result in results),
        )
    return out


def table(kinds: Mapping[str, Sequence[Measured]]) -> str:
    """Return the Markdown table of one image side: a column for each kind of frames."""
    columns = [figures(frames) for frames in kinds.values()]
    names = dict.fromkeys(name for column in columns for name in column)
    lines = [[name, *(column.get(name, "-") for column in columns)] for name in names]
    head = [["", *kinds], ["---"] * (1 + len(kinds))]
    return "\n".join(f"| {' | '.join(cells)} |" for cells in [*head, *lines])


def figures(frames: Sequence[Measured]) -> dict[str, str]:
    """Return the figures of one image side on one kind of frames, by name."""
    out = {"frames": str(len(frames))}
    for side in dict.fromkeys(side for frame in frames for side in ("all", *(s.letter for s in SIDES), *frame.edges)):
        counts = [frame.edges.get(side, 0) for frame in frames]
        if any(counts):
            out[f"image edges a frame, {side}: median (quartiles)"] = spread(counts)
    out["LiDAR edges a frame: median (quartiles)"] = spread([frame.meeting.points for frame in frames])
    # All edges have the same weight, independent of their frame.
    points = np.array([frame.meeting.points for frame in frames], dtype=float)
    for name, word in (("with an image edge", "near"), ("expected under random alignment", "chance")):
        shares = np.array([getattr(frame.meeting, word) for frame in frames])
        pooled = f"{shares @ points / points.sum():.3f}" if points.any() else "-"
        title = f"share of LiDAR edges {name} within {NEAR_PX:g} px, all (median frame)"
        out[title] = f"{pooled} ({np.median(shares):.3f})"
    errors = summarise([error for frame in frames for error in frame.errors])
    out["rotation deg, median / mean"] = f"{errors['rotation_deg_median']:.3f} / {errors['rotation_deg_mean']:.3f}"
    shift = [100 * errors[f"translation_m_{statistic}"] for statistic in ("median", "mean")]
    out["translation cm, median / mean"] = f"{shift[0]:.1f} / {shift[1]:.1f}"
    out["within 0.3 deg and 10 cm"] = f"{errors['within_0.3deg_0.1m']} of {errors['count']}"
    statuses = Counter(status for frame in frames for status in frame.statuses)
    out["status"] = ", ".join(f"{count} {status}" for status, count in sorted(statuses.items()))
    trusts = Counter(trust for frame in frames for trust in frame.trusts)
    out["verdict"] = ", ".join(f"{trusts[trust]} {trust}" for trust in Trust if trusts[trust])
    return out


def spread(values: Sequence[float]) -> str:
    """Return the median of numbers with their quartiles."""
    low, middle, high = np.percentile(values, [25, 50, 75])
    return f"{middle:.0f} ({low:.0f} to {high:.0f})"


if __name__ == "__main__":
    main()
