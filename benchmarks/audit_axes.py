"""Which axis does `p2o check` name when an extrinsic is wrong on one axis?

    python benchmarks/audit_axes.py --out DIR                  # some minutes a rig on one core

Groups of two and of four frames of each rig are checked at the true extrinsic, and at extrinsics with an error on one
axis: 0.3, 0.5 and 1 deg, 5, 10 and 20 cm, on each of six axes, with a random sign. Views are kept in DIR/NAME.pickle:
a second run, also of another version of p2o, evaluates the same edges.
"""

from __future__ import annotations

import argparse
import pickle
import re
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
from audit import slipped
from p2o.arrays import Float
from p2o.confidence.audit import AXES, Evidence, Rates, audit
from p2o.features.view import View
from p2o.host.registry import Registry
from p2o.results.check import Check, CheckStatus
from p2o.run.pipeline import Pipeline
from p2o.run.recipe import Recipe

STREET = "synthetic:?right=false&scenes=8&frames_per_scene=1"
RIGS = {
    "waymo": "folder:build/data/rigs/waymo",
    "kitti-odometry": "kitti-odometry:build/data/kitti_odometry",
    "sim-hdl64": f"{STREET}&seed=31&lidar=hdl-64e&width_px=800&height_px=300",
    "sim-os1-64": f"{STREET}&seed=32&lidar=os1-64&width_px=800&height_px=500",
    "sim-raw": f"{STREET}&seed=33&lidar=hdl-64e&width_px=1242&height_px=375&deskew=false",
}
FRAMES = 8
GROUPS = (2, 4)
ANGLES_DEG, SHIFTS_M = (0.3, 0.5, 1.0), (0.05, 0.1, 0.2)
NAMES = [name for name, _ in AXES]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, required=True, help="folder of the views")
    parser.add_argument("--rigs", nargs="+", choices=RIGS, default=list(RIGS))
    arguments = parser.parse_args()
    arguments.out.mkdir(parents=True, exist_ok=True)
    print("| rig | correct | off | cannot tell | wrong | off | only its axis | its axis among others | another axis |")
    print("|---|---|---|---|---|---|---|---|---|")
    total: Counter[str] = Counter()
    for rig in arguments.rigs:
        counts = counted(*frames_of(rig, arguments.out))
        total += counts
        print(line(rig, counts), flush=True)
    print(line("all", total))


def frames_of(rig: str, out: Path) -> tuple[Pipeline, list[View], list[Float]]:
    """Return the pipeline, the views of some frames of a rig, and their true extrinsics."""
    plan = Recipe.of(data=RIGS[rig], joint=True).resolve(Registry.load())
    pipeline = plan.calibrator()
    assert isinstance(pipeline, Pipeline)
    file = out / f"{rig}.pickle"
    if not file.exists():
        dataset = plan.dataset()
        frames = [dataset[int(at)] for at in np.linspace(0, len(dataset) - 1, FRAMES).round()]
        views = [pipeline.prepare(frame.without_truth()) for frame in frames]
        file.write_bytes(pickle.dumps((views, [frame.camera_from_lidar for frame in frames])))
    return pipeline, *pickle.loads(file.read_bytes())  # noqa: S301  (written above)


def cases() -> Iterator[tuple[tuple[int, ...], int | None, float]]:
    """Return the frames, the axis and the error of each case; no axis for correct extrinsics."""
    rng = np.random.default_rng(0)
    for count in GROUPS:
        for _ in range(4):
            yield tuple(sorted(rng.choice(FRAMES, count, replace=False).tolist())), None, 0.0
        for axis in range(len(AXES)):
            for size in ANGLES_DEG if axis < 3 else SHIFTS_M:
                group = tuple(sorted(rng.choice(FRAMES, count, replace=False).tolist()))
                yield group, axis, float(rng.choice([-1.0, 1.0])) * size


def counted(pipeline: Pipeline, views: Sequence[View], truths: Sequence[Float]) -> Counter[str]:
    """Return how many cases had which outcome, and the duration of all checks."""
    counts: Counter[str] = Counter()
    for group, axis, size in cases():
        given = truths[group[0]] if axis is None else slipped(truths[group[0]], axis, size)
        begin = time.perf_counter()
        check = audit(Evidence.of([views[at] for at in group], given, pipeline), pipeline.options, Rates())
        counts["ms"] += round(1000 * (time.perf_counter() - begin))
        counts["checks"] += 1
        kind = "correct" if axis is None else "wrong"
        counts[kind] += 1
        counts[f"{kind} {check.holding.value}"] += 1
        if axis is not None and check.holding is CheckStatus.OFF:
            counts[outcome(check, NAMES[axis])] += 1
    return counts


def outcome(check: Check, axis: str) -> str:
    """Return whether the reason names only this axis, this axis among others, others alone, or none."""
    about = check.reason.partition(";")[0]
    named = [name for name in NAMES if re.search(rf"\b{name} [+-]", about)]
    if named == [axis]:
        return "only"
    return "among" if axis in named else "other" if named else "none"


def line(rig: str, counts: Counter[str]) -> str:
    """Return a row of the table; the duration goes to the first column."""
    keys = ("correct", "correct off", "correct cannot-tell", "wrong", "wrong off", "only", "among", "other")
    cells = " | ".join(str(counts[key]) for key in keys)
    return f"| {rig} ({counts['ms'] / max(1, counts['checks']):.0f} ms) | {cells} |"


if __name__ == "__main__":
    main()
