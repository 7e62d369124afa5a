"""Whether the ranking of `p2o compare`, which uses no ground truth, agrees with the ranking by the true error.

    python benchmarks/compare_without_truth.py --methods ours,nid,mi,canny,gmm,idt --frames 10 --out OUT

The simulated drives have exact ground truth. For each of them the table gives Spearman's rank correlation over the
methods between the true error (root mean square displacement of a point at 10 m) and each figure of the comparison,
and whether the method with the smallest true error is in the top group.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import numpy as np
from p2o.geometry.pose_error import pose_error
from p2o_study.compare import compare, contenders_of
from p2o_study.comparison import size_m
from p2o_study.parallel import Workers
from p2o_study.worker import Plugins
from scipy.stats import spearmanr

COLUMNS = ("score", "repeatability", "to other families", "held-out edges", "held-out nid")
DRIVES = ("place=street", "place=suburb&lidar=os1-64", "place=yard&lidar=os1-64")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--methods", default="ours,nid,mi,canny,gmm,idt")
    parser.add_argument("--drives", nargs="+", default=DRIVES, help="options of the synthetic data")
    parser.add_argument("--frames", type=int, default=10, help="frames of each drive")
    parser.add_argument("--groups", type=int, default=5)
    parser.add_argument("--seeds", type=int, default=2)
    parser.add_argument("--size", default="width_px=621&height_px=188", help="options of all drives")
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--out", default="p2o-out/compare_without_truth")
    arguments = parser.parse_args()
    plugins = Plugins.of()
    contenders = contenders_of(arguments.methods.split(","), plugins.registry())
    names = ("score", "repeatability", "consensus", "edges", "nid")
    print(f"| drive | {' | '.join(COLUMNS)} | smallest true error | group 1 |\n|---|{'---|' * (len(names) + 2)}")
    for number, drive in enumerate(arguments.drives):
        done, comparison = compare(
            contenders,
            f"synthetic:?scenes={arguments.frames}&right=false&{arguments.size}&{drive}",
            Path(arguments.out) / str(number),
            groups=arguments.groups,
            seeds=arguments.seeds,
            plugins=plugins,
            workers=Workers(arguments.jobs),
        )
        if comparison is None:
            return
        errors: dict[str, list[float]] = {}
        for row in done.rows:
            error = pose_error(row.estimate if row.solved else row.start, row.truth)
            errors.setdefault(row.section, []).append(
                float(size_m(np.array([error.rotation_deg, error.translation_m])))
            )
        true = {name: float(np.sqrt(np.mean(np.square(values)))) for name, values in errors.items()}
        ranking = comparison.ranking
        columns = [_correlation([true[s.name] for s in ranking], [_value(s, name) for s in ranking]) for name in names]
        best = min((s.name for s in ranking), key=true.__getitem__)
        top = ", ".join(s.name for s in ranking if s.tier == 1)
        print(f"| {drive} | {' | '.join(columns)} | {best} | {top} |", flush=True)
        for s in ranking:
            line = f"{s.name}: {100 * true[s.name]:.1f} cm, score {s.score:.2f}, group {s.tier}"
            print(f"{drive}: {line}", file=sys.stderr, flush=True)


def _value(standing: object, name: str) -> float:
    """Return a figure of a method; lengths as the displacement of a point at 10 m, NaN if it is unknown."""
    if name == "score":
        return standing.score
    figures = standing.figures
    if name in figures:
        return figures[name].value
    if f"{name}_deg" not in figures:
        return float("nan")
    return float(size_m(np.array([figures[f"{name}_{unit}"].value for unit in ("deg", "m")])))


def _correlation(true: list[float], values: list[float]) -> str:
    return "-" if np.isnan(values).any() else f"{spearmanr(true, values)[0]:.2f}"


if __name__ == "__main__":
    main()
