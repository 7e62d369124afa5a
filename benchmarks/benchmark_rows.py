"""Measure time and memory of `p2o benchmark status`, `table` and `page` on many synthetic rows.

    python benchmarks/benchmark_rows.py [--rows 500000] [--keep FOLDER]

A suite with 20 rows on two datasets, five seeds and one frame per 100 rows of results is written to a temporary
folder (`--keep`: to this one, where existing rows are used again): 500,000 rows have 5,000 frames and 0.75 GB.
Poses are random, words, options and digests are those of real methods, so `status` finds every row fresh. Each command
runs in a process of its own on one core. Seconds are of one run, and of this machine.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from bench import Cost, machine, table
from memory import measured
from p2o.arrays import Float
from p2o.geometry import se3
from p2o_study.benchmark.measure import WORDS
from p2o_study.benchmark.row import METHODS_FILE, FrameData, MethodData
from p2o_study.benchmark.suite import SuiteFile, find_suite
from p2o_study.cells import Method
from p2o_study.worker import Plugins

METHODS, SEEDS = 20, 5
PROTOCOLS = ("1deg 0.05m", "4deg 0.3m")
SUITE = """name = "many"
question = "How long do the commands need?"
study = "study.toml"
groups = "drive"
seeds = 5
"""
STUDY = 'name = "many"\ntitle = "Many"\nseeds = 5\n' + "".join(
    f'[[dataset]]\nname = "{name}"\ndata = "kitti-raw:"\noptional = true\n' for name in ("first", "second")
)


def study() -> str:
    """Return a study of `METHODS` rows; every second one starts from the larger initial error."""
    rows = (
        f'[[row]]\nlabel = "method {n // 2}, from {PROTOCOLS[n % 2]}"\nextractor = "canny/rings"\nmatcher = "nearest"\n'
        f'solver = "lm"\ninit = "given"\nperturb = "{PROTOCOLS[n % 2]}"\noptions.pipeline.rounds = {5 + n // 2}\n'
        f'dataset = ["{("first", "second")[n // 2 % 2]}"]\n'
        for n in range(METHODS)
    )
    return STUDY + "".join(rows)


def write(folder: Path, count: int) -> None:
    """Write suite, study, frames and `count` rows to a folder."""
    for name, text in (("many.toml", SUITE), ("study.toml", study())):
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(text)
    (folder / "suites").mkdir(exist_ok=True)
    (folder / "results").mkdir(exist_ok=True)
    (folder / "suites/many.toml").write_text(SUITE.replace("study.toml", "../study.toml"))
    frames = -(-count // (METHODS * SEEDS))
    random = np.random.default_rng(0)
    truth = se3.exp(random.normal(size=6))
    known = {name: [frame(name, number, truth) for number in range(frames)] for name in ("first", "second")}
    lines = sorted((data.dataset, data.name, data.line) for some in known.values() for data in some)
    (folder / "results/frames.jsonl").write_text("".join(f"{line}\n" for *_, line in lines))
    plugins = Plugins.of()
    suite = find_suite("many", plugins.registry(), folder / "suites")
    methods: dict[str, MethodData] = {}
    with (folder / "results/many.jsonl").open("w") as file:
        for row in rows(suite, plugins, known, count, methods):
            file.write(f"{json.dumps(row, sort_keys=True, separators=(',', ':'))}\n")
    (folder / "results" / METHODS_FILE).write_text("".join(f"{data.line}\n" for data in methods.values()))


def frame(dataset: str, number: int, truth: Float) -> FrameData:
    """Return a frame; those of ten successive numbers are of one drive."""
    digest = f"{number:064x}"
    name = f"drive-{number // 10:05d}/{number:06d}"
    return FrameData(dataset=dataset, name=name, image=digest, sweep=digest, calibration=digest, truth=truth.tolist())


def rows(
    suite: SuiteFile,
    plugins: Plugins,
    known: dict[str, list[FrameData]],
    count: int,
    listed: dict[str, MethodData],
) -> Iterator[dict[str, Any]]:
    """Yield the rows as JSON values, with errors that differ between methods; methods are added to `listed`."""
    registry, random, written = plugins.registry(), np.random.default_rng(1), 0
    for number, line in enumerate(suite.rows):
        methods = {seed: Method.of(line, seed, "{}", {}, registry) for seed in line.seeds}
        described = methods[0].described
        words = {word: described[word] for word in WORDS if described.get(word)}
        options = {stage: values for stage, values in described["options"].items() if stage != "data"}
        method = MethodData.model_validate({"method": {"words": words, "options": options}})
        listed[method.method.digest] = method
        protocol = described["perturb"]
        for data in known[line.dataset.name]:
            truth = np.asarray(data.truth)
            for seed in line.seeds:
                if written == count:
                    return
                written += 1
                solved = random.random() > 0.03
                size = 0.002 * (1 + number // 4) * random.normal(size=6)
                bound = 0.15 * (1 + number // 4)
                yield {
                    "version": 1,
                    "suite": suite.name,
                    "row": line.label,
                    "section": line.section,
                    "dataset": line.dataset.name,
                    "frames": [{"name": data.name, "digest": data.digest}],
                    "joint": False,
                    "protocol": protocol,
                    "seed": seed,
                    "start": (truth @ se3.exp(0.02 * random.normal(size=6))).tolist(),
                    "method": method.method.digest,
                    "digest": methods[seed].digest,
                    "commit": "0" * 40,
                    "estimate": (truth @ se3.exp(size)).tolist() if solved else None,
                    "status": "converged" if solved else "too-few-matches",
                    "reason": "the last of 10 rounds moved the pose by 0.0072 deg and 0.0013 m",
                    "verdict": "trusted" if solved else "refused",
                    "predicted": {
                        "rotation_deg": bound,
                        "translation_m": bound / 50,
                        "rotation_deg_95": 2 * bound,
                        "translation_m_95": bound / 25,
                    },
                    "seconds": round(0.5 + random.random(), 6),
                    "machine": {
                        "processor": "AMD EPYC",
                        "cores": 2,
                        "load": 1.0,
                        "system": "Linux",
                        "python": "3.11.7",
                    },
                    "versions": {"numpy": "2.3.5", "p2o-calib": "0.2.0", "python": "3.11.7", "scipy": "1.16.3"},
                    "measured_by": "benchmarks/benchmark_rows.py",
                    "finished": "2026-01-01T00:00:00+00:00",
                }


def costs(folder: Path) -> dict[str, Cost]:
    """Return the cost of each command on the rows of a folder."""
    places = ["--results", str(folder / "results"), "--suites", str(folder / "suites")]
    words = {
        "status": ["status", "many", *places, "--quiet"],
        "table": ["table", "many", *places],
        "page": ["page", *places, "--out", str(folder / "page"), "--quiet"],
    }
    return {name: measured(["benchmark", *its]).cost for name, its in words.items()}


def main() -> None:
    """Write the rows and print the cost of each command as a Markdown table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rows", type=int, default=500_000, metavar="N")
    parser.add_argument("--keep", type=Path, metavar="FOLDER")
    words = parser.parse_args()
    with tempfile.TemporaryDirectory() as temporary:
        folder = words.keep or Path(temporary)
        if not (folder / "results/many.jsonl").exists():
            write(folder, words.rows)
        size = (folder / "results/many.jsonl").stat().st_size
        print(f"{size / 1e9:.2f} GB of rows, {machine()}, load {os.getloadavg()[0]:.1f}", file=sys.stderr)
        print(table(costs(folder), {}))


if __name__ == "__main__":
    main()
