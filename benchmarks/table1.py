"""Table 1 of the paper: mean absolute errors of each axis under LiDAR noise and missing edges, beside the published.

    python benchmarks/table1.py --jobs 2
    python benchmarks/table1.py --data "vkitti2:PATH?mount=camera" --scenes 200

The study file says what is run (table1.toml beside this file); each row is what `p2o run` with its words gives.
A frame is read once for all rows with the same LiDAR. Refused frames count with the error of their start, which is what
the user is left with. The joint line solves 10 frames at once, from three starts each.
"""

from __future__ import annotations

import argparse
import time
import tomllib
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from joblib import Parallel, delayed
from p2o import PoseError, Recipe, Registry, Result, View, pose_error
from p2o.metrics import AXES
from p2o.perturb import parse_perturbation, wrong_start
from p2o.recipe import Plan, open_dataset, split_data

JOINT_STARTS = 3
"""Starts of each joint calibration."""
WORDS = ("data", "seed", "extractor", "matcher", "solver", "init", "perturb")


@dataclass(frozen=True)
class Row:
    """One line of the table: options of the data and of the pipeline, and what the paper found."""

    name: str
    summary: str
    data: Mapping[str, Any]
    pipeline: Mapping[str, Any]
    paper: Mapping[str, float]


@dataclass(frozen=True, eq=False)
class Seen:
    """One frame under one row: its view, its truth, and the results of single-frame runs with their errors."""

    view: View
    truth: np.ndarray
    errors: list[PoseError]
    statuses: list[str]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", help="DATASET:PATH to run on instead (it takes lidar, noise_m, angle_noise_deg)")
    parser.add_argument("--scenes", type=int, help="number of frames (default: the study's)")
    parser.add_argument("--rows", help="only these rows: test1,test5")
    parser.add_argument("--starts", type=int, default=1, help="starts of each frame")
    parser.add_argument("--extractor", help="IMAGE/CLOUD instead of the study's")
    parser.add_argument("--init", help="initializer instead of the study's")
    parser.add_argument("--sides", default="LRUB", help="directions that are matched")
    parser.add_argument("--jobs", type=int, default=1, help="processes")
    arguments = parser.parse_args()
    study = tomllib.loads(Path(__file__).with_suffix(".toml").read_text(encoding="utf-8"))
    rows = [Row(**row) for row in study["row"] if arguments.rows is None or row["name"] in arguments.rows.split(",")]
    words = {name: study[name] for name in WORDS}
    words |= {name: value for name in ("data", "extractor", "init") if (value := getattr(arguments, name)) is not None}
    words["options"] = {"matcher": {"sides": arguments.sides}} if arguments.sides != "LRUB" else {}
    count = arguments.scenes or study["scenes"]

    began = time.perf_counter()
    with Parallel(n_jobs=arguments.jobs) as pool:
        seen: dict[str, list[Seen]] = {}
        for group in grouped(rows):
            chosen = frame_numbers(words, group[0], count)
            jobs = (delayed(single)(words, group, count, index, arguments.starts) for index in chosen)
            for row, results in zip(group, zip(*pool(jobs), strict=True), strict=True):
                seen[row.name] = list(results)
        tables = {}
        for row in rows:
            own, size = seen[row.name], study["joint_frames"]
            batches = [own[i : i + size] for i in range(0, len(own) - size + 1, size)]
            jobs = (delayed(jointly)(words, row, b, n, s) for n, b in enumerate(batches) for s in range(JOINT_STARTS))
            tables[row.name] = list(pool(jobs))
    print(f"{words['data']} {words['extractor']} {words['matcher']} {words['solver']} {words['init']}, ", end="")
    print(f"{count} frames x {arguments.starts} starts, {time.perf_counter() - began:.0f} s\n")
    print(table(rows, seen, tables))


def plan_of(words: Mapping[str, Any], row: Row, count: int) -> Plan:
    """Return the resolved recipe of a row."""
    options = {**words["options"], "data": data_options(words, row, count), "pipeline": dict(row.pipeline)}
    return Recipe.of(**{**words, "options": options}).resolve(Registry.load())


def data_options(words: Mapping[str, Any], row: Row, count: int) -> dict[str, Any]:
    """Return the options of the row's data; made-up data have as many scenes as frames, and no unused right picture."""
    name, _ = split_data(words["data"])
    made_up = {"scenes": count, "right": not words["extractor"].startswith("depth/")}
    return {**row.data, **(made_up if name == "synthetic" else {})}


def grouped(rows: Sequence[Row]) -> list[list[Row]]:
    """Return the rows by their data, so that frames are shared."""
    by_data: dict[str, list[Row]] = {}
    for row in rows:
        by_data.setdefault(repr(sorted(row.data.items())), []).append(row)
    return list(by_data.values())


def frame_numbers(words: Mapping[str, Any], row: Row, count: int) -> list[int]:
    """Return `count` frames spread evenly over the dataset."""
    there = len(open_dataset(words["data"], Registry.load(), data_options(words, row, count)))
    return sorted(set(np.linspace(0, there - 1, min(count, there)).round().astype(int).tolist()))


def single(words: Mapping[str, Any], rows: Sequence[Row], count: int, index: int, starts: int) -> list[Seen]:
    """Return what each row (all of one LiDAR) gives on one frame."""
    plans = [plan_of(words, row, count) for row in rows]
    frame = plans[0].dataset()[index]
    size, truth = parse_perturbation(words["perturb"]), frame.camera_from_lidar
    # One set of extractors, which remember the frame, for all rows.
    pipeline = plans[0].calibrator()
    out = []
    for plan in plans:
        own = replace(pipeline, options=plan.pipeline)
        view = own.extract(frame)
        results: list[Result] = []
        for start in range(starts):
            rng = np.random.default_rng([words["seed"] + start, index])
            results.append(own.solve([view], wrong_start(truth, size.angle_deg, size.distance_m, rng)))
        errors = [pose_error(result.camera_from_lidar, truth) for result in results]
        out.append(Seen(view, truth, errors, [result.status.value for result in results]))
    return out


def jointly(words: Mapping[str, Any], row: Row, batch: Sequence[Seen], number: int, start: int) -> PoseError:
    """Return the error of one joint calibration."""
    size, truth = parse_perturbation(words["perturb"]), batch[0].truth
    begin = wrong_start(truth, size.angle_deg, size.distance_m, np.random.default_rng([words["seed"], number, start]))
    pipeline = plan_of(words, row, 1).calibrator()
    return pose_error(pipeline.solve([seen.view for seen in batch], begin).camera_from_lidar, truth)


def table(rows: Sequence[Row], seen: Mapping[str, Sequence[Seen]], joint: Mapping[str, Sequence[PoseError]]) -> str:
    """Return the Markdown table; means above the published ones are marked by >."""
    lines = ["| row | | roll deg | pitch deg | yaw deg | x m | y m | z m | not solved |", "|---|---|" + "---|" * 7]
    above = 0
    for row in rows:
        errors = [error for frame in seen[row.name] for error in frame.errors]
        status = Counter(status for frame in seen[row.name] for status in frame.statuses)
        failed = ", ".join(
            f"{n} {name}" for name, n in sorted(status.items()) if name not in ("converged", "rounds-spent")
        )
        mean, median = (by_axis(errors, f) for f in (np.mean, np.median))
        over = {axis: mean[axis] > row.paper[axis] for axis in AXES}
        above += sum(over.values())
        cells = [("mean", mean, over), ("paper", row.paper, {}), ("median", median, {})]
        if joint[row.name]:
            cells.append(("joint mean", by_axis(joint[row.name], np.mean), {}))
        for label, values, marks in cells:
            numbers = " | ".join(("> " if marks.get(axis) else "") + f"{values[axis]:.3f}" for axis in AXES)
            title = f"{row.name}: {row.summary}" if label == "mean" else ""
            note = (failed or "none") + f" of {len(errors)}" if label == "mean" else ""
            lines.append(f"| {title} | {label} | {numbers} | {note} |")
    return "\n".join(
        [*lines, "", f"{len(AXES) * len(rows) - above} of {len(AXES) * len(rows)} means at or under the paper's"]
    )


def by_axis(errors: Sequence[PoseError], summary: Any) -> dict[str, float]:
    """Return mean or median of the absolute errors by axis."""
    return {axis: float(summary([abs(error.per_axis[axis]) for error in errors])) for axis in AXES}


if __name__ == "__main__":
    main()
