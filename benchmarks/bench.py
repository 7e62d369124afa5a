"""Measure the run time of each step of a calibration, also against another commit: `make bench`.

    python benchmarks/bench.py                          # this tree
    python benchmarks/bench.py --against-commit REV     # both commits in turns, ratios within one run
    python benchmarks/bench.py --rows frame --data kitti-odometry:build/data/kitti_odometry       # steps of real frames
    python benchmarks/bench.py --against-commit REV --poses folder:build/data/rigs/waymo --poses ...

Steps of a frame are measured in one process with one thread (except the simulator's), the first frame of a process
separately; commands in a process of their own, as a user calls them. Figures are medians over frames and repeats.
Processor seconds are user and system time of a process and its children, peaks are of its memory, of the largest child
where it has children. Rows `joint-N` calibrate N frames jointly; of more than 25, images and sweeps repeat under other
names, but p2o reads, keeps and solves each of them. Steps have the same weights of the network in both commits.

With `--poses` nothing is timed: the same frames are calibrated by both commits; reported are the number of poses that
are equal to the last digit, and the largest differences.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import resource
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from statistics import median
from typing import Any

from limits_and_tables import STUDY, table

ROOT = Path(__file__).resolve().parents[1]
HOME = ROOT / "build" / "bench"
STEPS = ("frame", "grid")
COMMANDS = ("help", "run", "out", "folder", "check", "simulate", "joint-24", "study-1", "study-2", "study-4")
LONG = ("joint-50", "joint-125", "joint-500", "joint-2000", "show", "train")
"""Rows that are measured only if they are asked for."""
FRAMES, DISTINCT, STUDY_FRAMES, STUDY_SEEDS = 24, 25, 4, 20
START = "2deg 0.15m"
WEIGHTS = ROOT / "plugins" / "p2o_plugins" / "weights" / "p2ornet-free.safetensors"
ONE_THREAD = {"OMP_NUM_THREADS": "1", "OPENCV_FOR_THREADS_NUM": "1"}
MAXRSS_PER_MIB = 1024 if sys.platform != "darwin" else 1 << 20
"""Linux counts KiB, macOS bytes."""


@dataclass(frozen=True)
class Cost:
    """What a row costs: processor and wall seconds, and the peak of memory in MiB, 0 where it was not measured."""

    cpu_s: float
    wall_s: float
    peak_mib: float = 0.0


def middle(costs: Sequence[Cost]) -> Cost:
    """Return the median of each column."""
    columns = zip(*((cost.cpu_s, cost.wall_s, cost.peak_mib) for cost in costs), strict=True)
    return Cost(*(median(column) for column in columns))


def compared(costs: Mapping[str, Cost], reference: Mapping[str, Cost], name: str = "") -> str:
    """Return rows as a Markdown table, with ratios to a reference of this name where that has them."""
    head = ["", "processor s", "wall s", "peak MiB"]
    head += [f"processor s, {name}", "ratio", f"wall s, {name}", "ratio"] if reference else []
    lines = []
    for row, cost in costs.items():
        cells = [row, _seconds(cost.cpu_s), _seconds(cost.wall_s), f"{cost.peak_mib:.0f}" if cost.peak_mib else ""]
        if reference:
            other = reference.get(row)
            pairs = [(cost.cpu_s, other.cpu_s), (cost.wall_s, other.wall_s)] if other else []
            ratios = [(_seconds(before), f"{now / before:.2f}" if before > 0 else "") for now, before in pairs]
            cells += [cell for pair in ratios or [("", ""), ("", "")] for cell in pair]
        lines.append(cells)
    return table(head, lines)


def _seconds(value: float) -> str:
    return f"{value:.3f}" if value < 1 else f"{value:.2f}"


def machine() -> str:
    """Return a description of this machine: seconds of different machines do not compare."""
    from p2o_study.machine import machine_info

    return "{processor}, {cores} cores, {system}, load {load}".format(**machine_info())


# --- steps: these run in a process of their own, with the packages of either commit --------------------------------


class Clock:
    """Processor and wall seconds by row, in the order in which rows were first measured."""

    def __init__(self) -> None:
        self.costs: dict[str, list[Cost]] = {}

    @contextlib.contextmanager
    def of(self, row: str) -> Iterator[None]:
        """Count the enclosed statements as one measurement of a row."""
        cpu, wall = time.process_time(), time.perf_counter()
        try:
            yield
        finally:
            peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / MAXRSS_PER_MIB
            cost = Cost(time.process_time() - cpu, time.perf_counter() - wall, peak)
            self.costs.setdefault(row, []).append(cost)

    def rows(self) -> dict[str, Cost]:
        """Return the median cost of each row."""
        return {row: middle(costs) for row, costs in self.costs.items()}


def step_frame(data: str) -> dict[str, Cost]:
    """Measure all steps of a frame, from imports to images."""
    clock = Clock()
    with clock.of("import what computes the network"):
        import onnxruntime  # noqa: F401
    with clock.of("import the rest, find the methods"):
        from p2o.frames.scale import image_at_scale
        from p2o.host.registry import Registry
        from p2o.run.recipe import Recipe

        registry = Registry.load()
        options = {"extractor": {"weights": str(WEIGHTS)}}
        plan = Recipe.of(data=data, perturb=START, options=options).resolve(registry)
    with clock.of("simulate a frame"):
        scene = Recipe.of(data="synthetic:").resolve(registry).dataset()[0]
        _ = scene.image.rgb, scene.cloud.xyz
    with clock.of("weights"):
        calibrator = plan.assembly().calibrator
    dataset, features = plan.dataset(), []
    for number in range(min(FRAMES, len(dataset))):
        first = ", first frame" if not number else ""
        with clock.of("decode" + first):
            frame = dataset[number]
            _ = frame.image.rgb, frame.cloud.xyz
        with clock.of("network" + first):
            image = calibrator.image_extractor(image_at_scale(frame.image))
        with clock.of("rings" + first):
            cloud = calibrator.cloud_extractor(frame.cloud)
        start = wrong_start(frame.camera_from_lidar, number)
        features.append(((frame.name, frame.camera, image, cloud, frame.twist), start))
    solve(calibrator, features, clock)
    return clock.rows()


def step_grid(data: str) -> dict[str, Cost]:
    """Measure `grid` from 10 deg away, ten frames jointly, after their extraction."""
    from p2o.host.registry import Registry
    from p2o.run.recipe import Recipe

    plan = Recipe.of(data=data, init="grid").resolve(Registry.load())
    calibrator, dataset, clock = plan.assembly().calibrator, plan.dataset(), Clock()
    frames = [dataset[number] for number in range(10)]
    views = [calibrator.prepare(frame) for frame in frames]
    start = wrong_start(frames[0].camera_from_lidar, 0, "10deg 0.15m")
    with clock.of(f"grid from 10 deg, {len(frames)} frames, after extraction"):
        calibrator.solve(views, start)
    return clock.rows()


_STAGES = {"initialize": "search", "refine": "rounds", "adjust": "adjustment", "agree": "verdict"}


def solve(pipeline: Any, features: Sequence[tuple[tuple[Any, ...], Any]], clock: Clock) -> None:
    """Measure the steps from features to a pose of each frame, in total and stage by stage."""
    from p2o.run import pipeline as module

    class Stages(module.Clock):
        """The clock of a calibration, which also counts processor time."""

        def of(self, stage: str) -> contextlib.AbstractContextManager[None]:
            return clock.of(_STAGES.get(stage, stage) + first)

    before, first = module.Clock, ", first frame"
    module.Clock = Stages  # type: ignore[misc]
    try:
        for parts, start in features:
            with clock.of("features to pose" + first):
                pipeline.solve([pipeline.view(*parts)], start)
            first = ""
        first = ", jointly"
        with clock.of(f"features to pose, {len(features)} frames jointly"):
            pipeline.solve([pipeline.view(*parts) for parts, _ in features], features[0][1])
    finally:
        module.Clock = before  # type: ignore[misc]


def wrong_start(truth: Any, number: int, error: str = START) -> Any:
    """Return the initial guess (4, 4) of a frame, the same in every repeat."""
    import numpy as np
    from p2o.geometry.perturb import parse_perturbation

    return parse_perturbation(error).start(truth, np.random.default_rng([0, number]))


def step_poses(data: str) -> dict[str, Any]:
    """Calibrate the frames of DATASET:PATH[#FRAMES][+joint], for the comparison of poses between commits."""
    import p2o

    name, _, frames = data.removesuffix("+joint").partition("#")
    words = {"frames": frames or "all", "joint": data.endswith("+joint") or None}
    try:
        run = p2o.calibrate(name, perturb=START, seed=1, **words)
    except p2o.InputError:
        # There is no truth to perturb.
        run = p2o.calibrate(name, **words)
    return {
        "+".join(row.result.frames): {
            "pose": row.result.camera_from_lidar.tolist(),
            "verdict": [row.result.status.value, row.result.verdict.trust.value],
        }
        for row in run.rows
    }


# --- around them: processes, repeats, commits ----------------------------------------------------------------------


def environment(tree: Path, **more: str) -> dict[str, str]:
    """Return the environment in which the packages of a tree are the ones that are imported."""
    rooms = [tree / room for room in ("toolkit", "plugins", "baselines") if (tree / room).is_dir()] or [tree]
    path = os.pathsep.join(map(str, rooms))
    # Installed packages are compiled once: so are these, wherever their sources are.
    compiled = {"PYTHONDONTWRITEBYTECODE": "", "PYTHONPYCACHEPREFIX": str(HOME / "compiled")}
    return {**os.environ, "PYTHONPATH": path, **compiled, **more}


def in_process(tree: Path, step: str, data: str) -> dict[str, Any]:
    """Return what a step prints that runs with the packages of a tree."""
    command = [sys.executable, str(Path(__file__).resolve()), "--step", step, "--data", data]
    done = subprocess.run(command, env=environment(tree, **ONE_THREAD), stdout=subprocess.PIPE, check=True)
    printed: dict[str, Any] = json.loads(done.stdout.splitlines()[-1])
    return printed


def of_step(tree: Path, step: str, data: str) -> dict[str, Cost]:
    """Return the rows of a step that is measured with the packages of a tree."""
    return {row: Cost(**cost) for row, cost in in_process(tree, step, data).items()}


def cost_of(words: Sequence[str], tree: Path = ROOT) -> Cost:
    """Return the cost of a command of p2o in a process of its own."""
    command, began = [sys.executable, "-m", "p2o", *words], time.perf_counter()
    process = subprocess.Popen(command, env=environment(tree), stdout=subprocess.DEVNULL)
    _, status, used = os.wait4(process.pid, 0)
    wall = time.perf_counter() - began
    process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode not in (0, 1):
        raise SystemExit(f"p2o {' '.join(words)} ended with status {process.returncode}")
    return Cost(used.ru_utime + used.ru_stime, wall, used.ru_maxrss / MAXRSS_PER_MIB)


def of_command(tree: Path, name: str, data: str) -> dict[str, Cost]:
    """Return the row of a command as a user calls it."""
    with tempfile.TemporaryDirectory() as out:
        label, words = command(name, data, out)
        return {label: cost_of(words, tree)}


def command(name: str, data: str, out: str) -> tuple[str, list[str]]:
    """Return label and words of a command; `out` is an empty folder for it."""
    kind, _, number = name.partition("-")
    if kind == "joint":
        words = ["run", "--data", frames_on_disk(int(number)), "--joint", "--perturb", START]
        return f"`p2o run --joint`, {number} frames", words
    if kind == "study":
        study = Path(out) / "rows.toml"
        text = STUDY.format(name="rows", seeds=STUDY_SEEDS, data=frames_on_disk(STUDY_FRAMES))
        study.write_text(f'{text}[[row]]\nlabel = "ours"\n')
        label = f"`p2o ablate`, {STUDY_FRAMES * STUDY_SEEDS} rows, {number} workers"
        return label, ["ablate", str(study), "--out", out, "--quiet", "--jobs", number]
    training = ["train", "p2ornet", "--data", "synthetic:?scenes=2&width_px=621&height_px=188", "--out", out]
    return {
        "help": ("`p2o --help`", ["--help"]),
        "run": ("`p2o run`", ["run"]),
        "out": ("`p2o run --out DIR`", ["run", "--out", out]),
        "folder": ("`p2o run`, a folder frame", ["run", "--data", data, "--frames", "0", "--perturb", START]),
        "check": ("`p2o check`, 4 frames", ["check", data, "--extrinsic", "truth", "--frames", "0-3"]),
        "show": ("`p2o data show`, a frame", ["data", "show", data, "--frames", "0", "--out", out]),
        "simulate": (
            "`p2o simulate`, 2 frames",
            ["simulate", f"{out}/frames", "--layout", "folder", "--set", "scenes=2"],
        ),
        "train": ("`p2o train p2ornet`, 4 steps", [*training, "--set", "iterations=4", "--set", "batch=4"]),
    }[name]


@contextlib.contextmanager
def tree_of(commit: str) -> Iterator[Path]:
    """Yield the installed packages of another commit, with the list of their own plugins."""
    with tempfile.TemporaryDirectory() as folder:
        sources, packages = Path(folder) / "sources", Path(folder) / "packages"
        sources.mkdir()
        archive = subprocess.run(["git", "archive", commit], cwd=ROOT, stdout=subprocess.PIPE, check=True)
        subprocess.run(["tar", "-x", "-C", sources], input=archive.stdout, check=True)
        install = [sys.executable, "-m", "pip", "install", "-q", "--disable-pip-version-check", "--no-build-isolation"]
        subprocess.run([*install, "--no-deps", "--target", packages, sources], check=True)
        yield packages


def frames_on_disk(count: int) -> str:
    """Return the data of N synthetic frames, generated if they do not exist; `DISTINCT` of them differ."""
    folder = HOME / f"frames-{count}"
    if not (folder / "complete").exists():
        shutil.rmtree(folder, ignore_errors=True)
        if count > DISTINCT:
            frames = Path(frames_on_disk(DISTINCT).partition(":")[2])
            sources = sorted(path for path in frames.iterdir() if path.is_dir())
            for number in range(count):  # hard links need no space
                copy = folder / f"frame-{number:04d}"
                shutil.copytree(sources[number % DISTINCT], copy, copy_function=os.link)
        else:
            words = ["simulate", str(folder), "--layout", "folder", "--set", f"scenes={count}", "--seed", "7"]
            cost_of(words)
        (folder / "complete").touch()
    return f"folder:{folder}"


def measured(trees: Sequence[Path], names: Sequence[str], repeats: int, data: str) -> list[dict[str, Cost]]:
    """Return the rows of each tree; the trees take turns, so that other work affects them equally."""
    costs = [dict[str, list[Cost]]() for _ in trees]
    for name in names:
        measure: Callable[..., dict[str, Cost]] = of_step if name in STEPS else of_command
        for _ in range(repeats):
            for tree, rows in zip(trees, costs, strict=True):
                for row, cost in measure(tree, name, data).items():
                    rows.setdefault(row, []).append(cost)
                print(".", end="", flush=True, file=sys.stderr)
    print(file=sys.stderr)
    return [{row: middle(each) for row, each in rows.items()} for rows in costs]


def differences(ours: Mapping[str, Any], theirs: Mapping[str, Any]) -> str:
    """Return in a line how many poses of two commits are equal, and their largest distances."""
    import numpy as np
    from p2o.geometry.pose_error import pose_error

    apart = [pose_error(np.array(ours[name]["pose"]), np.array(theirs[name]["pose"])) for name in theirs]
    equal = sum(ours[name]["pose"] == theirs[name]["pose"] for name in theirs)
    changed = sum(ours[name]["verdict"] != theirs[name]["verdict"] for name in theirs)
    return (
        f"{equal} of {len(apart)} poses are equal, apart at most {max(e.rotation_deg for e in apart):.5f} deg and "
        f"{1000 * max(e.translation_m for e in apart):.3f} mm; {changed} with another status or verdict"
    )


def main() -> None:
    """Measure rows, or compare poses."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    rows = (*STEPS, *COMMANDS, *LONG)
    parser.add_argument("--rows", nargs="+", choices=rows, default=rows[: -len(LONG)], help="what is measured")
    parser.add_argument("--repeats", type=int, default=3, help="the median counts (default: 3)")
    parser.add_argument("--against-commit", metavar="REV", help="measure this commit too, in turns")
    parser.add_argument(
        "--poses", action="append", metavar="DATASET:PATH[#FRAMES]", help="compare poses instead; +joint at the end"
    )
    parser.add_argument("--step", help=argparse.SUPPRESS)
    parser.add_argument("--data", metavar="DATASET:PATH", help="frames to measure (default: synthetic ones)")
    options = parser.parse_args()
    if options.step == "poses":
        print(json.dumps(step_poses(options.data)))
        return
    if options.step:
        costs = {"frame": step_frame, "grid": step_grid}[options.step](options.data)
        print(json.dumps({row: asdict(cost) for row, cost in costs.items()}))
        return
    with contextlib.ExitStack() as stack:
        trees = [ROOT]
        if options.against_commit:
            trees.append(stack.enter_context(tree_of(options.against_commit)))
        if options.poses:
            if len(trees) == 1:
                raise SystemExit("--poses needs --against-commit")
            for text in options.poses:
                ours, theirs = (in_process(tree, "poses", text) for tree in trees)
                print(f"{text}: {differences(ours, theirs)}", flush=True)
            return
        measurements = measured(trees, options.rows, options.repeats, options.data or frames_on_disk(FRAMES))
    reference = measurements[1] if len(trees) > 1 else {}
    print(
        f"{machine()}, load {os.getloadavg()[0]:.1f}\n\n{compared(measurements[0], reference, options.against_commit)}"
    )


if __name__ == "__main__":
    main()
