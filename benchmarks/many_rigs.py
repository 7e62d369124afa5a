"""Train one network on 1, 10 and 100 simulated rigs and measure its error on unseen rigs, beside our method.

    python benchmarks/many_rigs.py simulate --out build/many-rigs    # 2.5 minutes of one core
    python benchmarks/many_rigs.py train --out build/many-rigs       # 2.5 minutes
    python benchmarks/many_rigs.py test --out build/many-rigs        # 4 minutes
    python benchmarks/many_rigs.py table build/many-rigs

Every command continues where it was stopped. All networks are trained on frames of the same places, the same number of
frames and of steps: scene s is observed by rig s modulo the number of rigs. The network is that of `lccnet` of size
`small`; it begins with the shipped weights, because 100 frames do not suffice from random ones. Tests:

- `unseen rigs`: rigs and streets that no training contains;
- `training rig`: the rig of the training with one rig, which is part of all trainings, in streets that none contains.

Initial guesses: `2deg 0.15m`, and the range of the training, `euler camera 5deg 0.3m` (each axis). They are the same
for all methods. Training frames have 0.05 megapixels and rays without divergence, frames of tests 0.5 megapixels.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations, groupby
from pathlib import Path
from typing import Any

import numpy as np
import p2o
from joblib import Parallel, delayed
from p2o import Registry, TrainingGroup
from p2o.arrays import Float
from p2o.files.whole_file import write_whole
from p2o.geometry.perturb import parse_perturbation
from p2o.run.recipe import open_dataset
from p2o_baselines.learned.lccnet import DESIGN
from p2o_baselines.regressors.method import FOLDER
from p2o_baselines.regressors.options import TrainingOptions
from p2o_baselines.regressors.sample import Sample, sample_of, shrunk
from p2o_sim import random_rig
from p2o_sim.synthetic import SyntheticOptions, frame
from p2o_sim.write.folder import write
from p2o_study.report.bootstrap import interval

STAGES = ((5.0, 0.3), (2.0, 0.15))
NEAR, WIDE = "2deg 0.15m", "euler camera 5deg 0.3m"
FIRST = {NEAR: (2, 4), WIDE: (1, 3)}
"""First stage of our trainings and of the shipped weights, by initial error."""
OURS: dict[str, Mapping[str, Any]] = {
    NEAR: {},
    WIDE: {"init": "far", "options": {"init": {"reach_deg": 7.5, "reach_m": 0.45}}},
}
"""What is changed of our defaults, by initial error."""
CASES = (("unseen rigs", NEAR), ("training rig", NEAR), ("unseen rigs", WIDE))
"""Tests and their initial errors."""
TESTS = {"unseen rigs": ("rig", "rigs"), "training rig": ("scene", "streets")}
"""What is resampled for the intervals: rigs, or streets of the one rig."""
FALSE_DEG, FALSE_M = 1.0, 0.3
"""A trusted result with a larger error is a false accept."""
_TEST_RIGS, _TRAIN_SCENES, _TEST_SCENES, _RIG_SCENES = 10_000, 41, 42, 43
_LEAST_POINTS = 1000  # of a sweep in the image of a rig
_MOST_POINTS = 8000


@dataclass(frozen=True)
class Sizes:
    """How much is simulated, trained and tested."""

    rigs: tuple[int, ...] = (1, 10, 100)
    scenes: int = 150
    frames: int = 5
    test_rigs: int = 24
    test_scenes: int = 1
    own_scenes: int = 12
    repeats: int = 1
    steps: int = 2600
    batch: int = 64
    seeds: int = 2
    workers: int = 2
    train_megapixels: float = 0.05
    test_megapixels: float = 0.5


# ---- simulation


def options_of(stream: int, number: int, scenes: int, megapixels: float, **rest: Any) -> SyntheticOptions:
    """Return the options of frames of a rig that is drawn from its stream of random numbers and its number."""
    rig = random_rig(np.random.default_rng([stream, number]), megapixels=megapixels, rings=True)
    return SyntheticOptions(**vars(rig), place="street", right=False, period_s=1.5, seed=scenes, **rest)


def usable_rigs(out: Path, stream: int, count: int) -> list[int]:
    """Return the numbers of the first rigs of a stream whose cameras see enough points of a street; kept in a file."""
    path = out / f"rigs-{stream}.json"
    numbers: list[int] = json.loads(path.read_text()) if path.exists() else []
    if len(numbers) >= count:
        return numbers[:count]
    numbers = []
    number = 0
    while len(numbers) < count:
        seen = frame(options_of(stream, number, _RIG_SCENES, 0.05, divergence_mrad=0), 0)
        assert seen.camera_from_lidar is not None
        pixels = seen.camera.project(p2o.se3.apply(seen.camera_from_lidar, seen.cloud.xyz))
        if seen.camera.in_image(pixels).sum() >= _LEAST_POINTS:
            numbers.append(number)
        number += 1
    write_whole(path, json.dumps(numbers).encode())
    return numbers


def label_files(out: Path, rigs: int, repeat: int, sizes: Sizes) -> dict[Path, tuple[int, int, int]]:
    """Return the label files of a training, each with scene, number of the frame in it, and rig: i modulo `rigs`."""
    moments = [(scene, number) for scene in range(sizes.scenes) for number in range(sizes.frames)]
    entries = [(scene, number, at % rigs) for at, (scene, number) in enumerate(moments)]
    folder = out / "train" / f"repeat-{repeat}"
    return {folder / f"rig-{rig:03d}" / f"scene-{scene:04d}-{n}.npz": (scene, n, rig) for scene, n, rig in entries}


def simulate(out: Path, sizes: Sizes) -> None:
    """Write the label files of all trainings, and the frames of tests in the layout of the data set `folder`."""
    out.mkdir(parents=True, exist_ok=True)
    for repeat in range(sizes.repeats):
        numbers = usable_rigs(out, repeat, max(sizes.rigs))
        wanted = {path: at for rigs in sizes.rigs for path, at in label_files(out, rigs, repeat, sizes).items()}
        missing = sorted((at, path) for path, at in wanted.items() if not path.exists())
        # One job per scene, so that a street is generated once for all rigs.
        scenes = [list(group) for _, group in groupby(missing, key=lambda entry: entry[0][0])]
        jobs = (delayed(simulate_scene)(entries, repeat, numbers, sizes) for entries in scenes)
        for done, scene in enumerate(Parallel(n_jobs=sizes.workers, return_as="generator")(jobs), 1):
            print(f"repeat {repeat}: scene {scene}, {done} of {len(scenes)}", flush=True)
    unseen = usable_rigs(out, _TEST_RIGS, sizes.test_rigs)
    for test, repeat, rig, scene in tested(sizes):
        folder = test_folder(out, test, repeat, rig) / f"scene-{scene:04d}"
        if not (folder / "frame.yaml").exists():
            of_training = test == "training rig"
            number = usable_rigs(out, repeat, max(sizes.rigs))[rig] if of_training else unseen[rig]
            stream = repeat if of_training else _TEST_RIGS
            options = options_of(stream, number, _TEST_SCENES, sizes.test_megapixels)
            list(write([frame(options, scene)], folder.parent))
            print(folder, flush=True)


def simulate_scene(
    entries: Sequence[tuple[tuple[int, int, int], Path]], repeat: int, numbers: Sequence[int], sizes: Sizes
) -> int:
    """Write the label files of a scene, given scene, number and rig of each, and return the scene."""
    for (scene, number, rig), path in entries:
        rest = {"divergence_mrad": 0, "frames_per_scene": sizes.frames}
        options = options_of(repeat, numbers[rig], _TRAIN_SCENES, sizes.train_megapixels, **rest)
        path.parent.mkdir(parents=True, exist_ok=True)
        write_whole(path, small(sample_of(frame(options, scene, number))).packed())
    return entries[0][0][0]


def small(sample: Sample) -> Sample:
    """Return a sample with the image at the resolution of the network and few points."""
    sample = shrunk(sample, DESIGN.inputs["small"], 1.25)
    return replace(sample, xyz=sample.xyz[:_MOST_POINTS], reflectance=sample.reflectance[:_MOST_POINTS])


def tested(sizes: Sizes) -> Iterator[tuple[str, int, int, int]]:
    """Yield test, repeat, rig and scene of all frames that are tested; unseen rigs are the same in every repeat."""
    for rig in range(sizes.test_rigs):
        for number in range(sizes.test_scenes):
            yield "unseen rigs", 0, rig, rig * sizes.test_scenes + number
    for repeat in range(sizes.repeats):
        for number in range(sizes.own_scenes):
            yield "training rig", repeat, 0, 1000 + number


def test_folder(out: Path, test: str, repeat: int, rig: int) -> Path:
    """Return the folder of the frames of a rig."""
    return out / "test" / test.replace(" ", "-") / f"repeat-{repeat}-rig-{rig:03d}"


# ---- training


def training_folder(out: Path, rigs: int, repeat: int, steps: int) -> Path:
    """Return the folder of a training."""
    return out / "trained" / f"rigs-{rigs}-repeat-{repeat}-steps-{steps}"


def train(out: Path, sizes: Sizes) -> None:
    """Train a network for each number of rigs, or resume its training."""
    from p2o_baselines.regressors import training

    for repeat in range(sizes.repeats):
        for rigs in sizes.rigs:
            paths = list(label_files(out, rigs, repeat, sizes))
            options = TrainingOptions(
                stages=STAGES,
                iterations=sizes.steps,
                batch=sizes.batch,
                validate_every=1000,
                match=0.5,
                from_weights=str(FOLDER / "lccnet-small.safetensors"),
                seed=repeat,
                workers=sizes.workers,
            )
            group = TrainingGroup("simulated", paths, 1.0)
            folder = training_folder(out, rigs, repeat, sizes.steps)
            training.train(DESIGN, options, [group], (), folder, lambda progress: print(progress, flush=True))
            print(f"{folder}: {len(paths)} frames", flush=True)


# ---- test


def methods(out: Path, repeat: int, guess: str, sizes: Sizes) -> dict[str, Mapping[str, Any]]:
    """Return the arguments of `p2o.calibrate` for each method."""
    first, of_shipped = FIRST[guess]
    words: dict[str, Mapping[str, Any]] = {"ours": OURS[guess], "shipped": network("small", of_shipped)}
    for rigs in sizes.rigs:
        words[f"{rigs}"] = network(training_folder(out, rigs, repeat, sizes.steps) / "weights.safetensors", first)
    return words


def network(weights: Path | str, first: int) -> dict[str, Any]:
    """Return the arguments of a calibration by a network."""
    options = {"calibrator": {"weights": str(weights), "first": first}}
    return {"calibrator": DESIGN.name, "witness": "none", "options": options}


def test(out: Path, sizes: Sizes) -> None:
    """Calibrate all frames of tests from all initial guesses; add what is missing to results.jsonl."""
    path, registry = out / "results.jsonl", Registry.load()
    done = {key_of(row) for row in read(path)}
    # An interrupted test has one seed of all cases first, and what takes longest last.
    seeds = {NEAR: range(sizes.seeds), WIDE: range(1)}
    cases = [((case, guess), seed) for case, guess in CASES for seed in seeds[guess]]
    cases.sort(key=lambda case: (case[0][1] == WIDE, case[1]))
    for (case, guess), seed in cases:
        for test, repeat, rig, scene in tested(sizes):
            if test != case:
                continue
            folder = test_folder(out, test, repeat, rig)
            [seen] = open_dataset(f"folder:{folder / f'scene-{scene:04d}'}", registry)
            for trained in range(sizes.repeats) if test == "unseen rigs" else [repeat]:
                for method, words in methods(out, trained, guess, sizes).items():
                    # Neither our method nor the shipped network depends on the training.
                    of, steps = (trained, sizes.steps) if method.isdigit() else (repeat, 0)
                    row = {"test": test, "rig": f"{repeat}/{rig}", "scene": scene, "method": method}
                    row |= {"trained": of, "steps": steps, "guess": guess, "seed": seed}
                    if key_of(row) not in done:
                        done.add(key_of(row))
                        row |= calibrated(seen, start_of(seen, guess, scene, seed), words, registry)
                        with path.open("a", encoding="utf-8") as file:
                            file.write(json.dumps(row) + "\n")
            print(f"{test}, {guess}, seed {seed}: rig {rig}, scene {scene}", flush=True)


def start_of(seen: p2o.Frame, guess: str, scene: int, seed: int) -> Float:
    """Return the initial guess (4, 4) of a frame, the same for all methods."""
    truth = seen.camera_from_lidar
    assert truth is not None
    return parse_perturbation(guess).start(truth, np.random.default_rng([scene, seed]), seed)


def calibrated(seen: p2o.Frame, start: Float, words: Mapping[str, Any], registry: Registry) -> dict[str, Any]:
    """Return status, verdict, errors and seconds; a refused calibration has the error of its initial guess."""
    done = p2o.calibrate(seen, start=start, registry=registry, **words)
    truth = seen.camera_from_lidar
    assert truth is not None
    pose, status, trusted, seconds = start, "failed", False, 0.0
    if done.rows:
        result = done.rows[0].result
        status, trusted = str(result.status), bool(result.verdict.trusted)
        pose = result.camera_from_lidar if result.status.solved else start
        status = status if result.status.solved else "failed"
        seconds = float(sum(result.seconds.values()))
    off, initial = p2o.pose_error(pose, truth), p2o.pose_error(start, truth)
    return {
        "status": status,
        "trusted": trusted,
        "rotation_deg": round(off.rotation_deg, 4),
        "translation_m": round(off.translation_m, 5),
        "start_deg": round(initial.rotation_deg, 4),
        "start_m": round(initial.translation_m, 5),
        "seconds": round(seconds, 3),
    }


def key_of(row: Mapping[str, Any]) -> tuple[Any, ...]:
    """Return what identifies a row."""
    return tuple(row[name] for name in ("test", "rig", "scene", "method", "trained", "steps", "guess", "seed"))


def read(path: Path) -> list[dict[str, Any]]:
    """Return the rows of a file, none without it."""
    return [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines()] if path.exists() else []


# ---- table


def table(rows: Sequence[Mapping[str, Any]]) -> str:
    """Return a table of each test and initial error in Markdown, one row per method."""
    lines: list[str] = []
    for test, guess in CASES:
        these = [row for row in rows if row["test"] == test and row["guess"] == guess]
        if not these:
            continue
        cluster, plural = TESTS[test]
        lines += [
            "",
            f"| {test}, {guess} | n ({plural}) | failed | trusted, false accepts | rotation worse than initially "
            "| rotation mean [deg] | median | translation mean [cm] | median |",
            "|---|---|---|---|---|---|---|---|---|",
        ]
        initial = [
            {**row, "rotation_deg": row["start_deg"], "translation_m": row["start_m"]}
            for row in these
            if row["method"] == "shipped"
        ]
        lines.append(f"| initial guess | {line(initial, cluster, initial=True)} |")
        networks = sorted({(int(row["method"]), row["steps"]) for row in these if row["steps"]})
        for method, steps in (("shipped", 0), *((f"{rigs}", steps) for rigs, steps in networks), ("ours", 0)):
            of = [row for row in these if (row["method"], row["steps"]) == (method, steps)]
            if of:
                lines.append(f"| {label(method, steps)} | {line(of, cluster, initial=False)} |")
    return "\n".join([*lines, "", *differences(rows)]).strip("\n")


def differences(rows: Sequence[Mapping[str, Any]]) -> list[str]:
    """Return a table of paired differences of the rotation error between trainings of equal length, with intervals."""
    lines = [
        "| mean difference of rotation errors [deg] | test | of the same frames and initial guesses |",
        "|---|---|---|",
    ]
    for test, guess in CASES:
        errors: dict[int, dict[tuple[Any, ...], float]] = {}
        for row in rows:
            if row["test"] == test and row["guess"] == guess and row["steps"]:
                key = (row["rig"], row["scene"], row["seed"], row["trained"], row["steps"])
                errors.setdefault(int(row["method"]), {})[key] = row["rotation_deg"]
        for few, many in combinations(sorted(errors), 2):
            keys = sorted(errors[few].keys() & errors[many].keys())
            clusters = [str(key[TESTS[test][0] == "scene"]) for key in keys]
            estimate = interval([errors[many][key] - errors[few][key] for key in keys], clusters, "mean")
            if estimate is not None and estimate.low is not None:
                value = f"{estimate.value:+.2f} [{estimate.low:+.2f}, {estimate.high:+.2f}]"
                lines.append(f"| {many} rigs minus {few} | {test}, {guess} | {value} |")
    return lines if len(lines) > 2 else []


def label(method: str, steps: int) -> str:
    """Return the name of a method in the table."""
    words = {"shipped": "network as shipped, KITTI alone", "ours": "p2o"}
    return words.get(method) or f"network, {method} rig{'s' * (method != '1')}, {steps} steps"


def line(rows: Sequence[Mapping[str, Any]], cluster: str, *, initial: bool) -> str:
    """Return counts, errors with the 95 % interval of mean and median over clusters."""
    clusters = [str(row[cluster]) for row in rows]
    failed = sum(row["status"] == "failed" for row in rows)
    worse = sum(row["rotation_deg"] > row["start_deg"] for row in rows)
    trusted = [row for row in rows if row["trusted"]]
    wrong = sum(row["rotation_deg"] > FALSE_DEG or row["translation_m"] > FALSE_M for row in trusted)
    counts = ["-", "-", "-"] if initial else [f"{failed}", f"{len(trusted)}, {wrong}", f"{worse}"]
    cells = [f"{len(rows)} ({len(set(clusters))})", *counts]
    for name, scale, digits in (("rotation_deg", 1, 2), ("translation_m", 100, 1)):
        values = [scale * row[name] for row in rows]
        for statistic in ("mean", "median"):
            estimate = interval(values, clusters, statistic)
            assert estimate is not None
            bounds = "" if estimate.low is None else f" [{estimate.low:.{digits}f}, {estimate.high:.{digits}f}]"
            cells.append(f"{estimate.value:.{digits}f}{bounds}")
    return " | ".join(cells)


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    commands = parser.add_subparsers(dest="command", required=True)
    for name, run in (("simulate", simulate), ("train", train), ("test", test)):
        command = commands.add_parser(name, help=str(run.__doc__).strip().split("\n")[0])
        command.add_argument("--out", type=Path, default=Path("build/many-rigs"))
        command.add_argument("--repeats", type=int, default=Sizes.repeats, help="trainings with other rigs and seeds")
        numbers = ",".join(map(str, Sizes.rigs))
        command.add_argument("--rigs", default=numbers, help="numbers of rigs, separated by commas")
        command.add_argument("--steps", type=int, default=Sizes.steps, help="steps of each training")
        command.add_argument(
            "--scenes", type=int, default=Sizes.scenes, help="streets of the trainings, five frames each"
        )
        command.add_argument(
            "--workers", type=int, default=Sizes.workers, help="processes that simulate or draw samples"
        )
        command.set_defaults(run=run)
    tabling = commands.add_parser("table", help="print the tables")
    tabling.add_argument("out", type=Path)
    asked = parser.parse_args(arguments)
    if asked.command == "table":
        print(table(read(asked.out / "results.jsonl")))
    else:
        rigs = tuple(int(number) for number in asked.rigs.split(","))
        sizes = Sizes(rigs, asked.scenes, repeats=asked.repeats, steps=asked.steps, workers=asked.workers)
        asked.run(asked.out, sizes)


if __name__ == "__main__":
    main()
