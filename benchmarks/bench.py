"""Measure the run time of each step of a calibration against a reference on the same machine: `make bench`.

    python benchmarks/bench.py --keep build/bench/reference.json     # measure, and keep what was measured
    python benchmarks/bench.py --against build/bench/reference.json  # measure, with ratios to what was kept
    python benchmarks/bench.py --against-commit 5993b9f              # both commits in turns, ratios within one run
    python benchmarks/bench.py --against-commit 5993b9f --poses folder:build/data/rigs/waymo --poses ...

Steps of a frame are measured in one process with one thread (except the simulator's), the first frame of a process
separately; commands in a process of their own, as a user calls them. Figures are medians over frames and repeats.
Processor seconds are user and system time of a process and its children, peaks are of its memory, of the largest child
where it has children.

With `--poses` nothing is timed: the same frames are calibrated by both commits, and the largest differences of their
poses are reported.
"""

from __future__ import annotations

import argparse
import contextlib
import importlib.util
import json
import os
import platform
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from statistics import median
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
HOME = ROOT / "build" / "bench"
STEPS = ("frame", "grid")
COMMANDS = ("help", "run", "out", "folder", "joint", "study-1", "study-2", "study-4")
LONG = ("many",)
MANY, STUDY_FRAMES, STUDY_SEEDS = 500, 4, 20
STUDY = """name = "rows"
title = "Rows"
perturb = "1deg 0.05m"
seeds = {seeds}
[[dataset]]
name = "streets"
data = "{data}"
[[row]]
label = "ours"
"""
START = "2deg 0.15m"
ONE_THREAD = {"OMP_NUM_THREADS": "1", "OPENCV_FOR_THREADS_NUM": "1"}


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


def table(costs: Mapping[str, Cost], reference: Mapping[str, Cost], beside: str = "") -> str:
    """Return rows as a Markdown table, with ratios to a reference where that has them; `beside` names it."""
    compared = bool(reference)
    head = ["", "processor s", "wall s", "peak MiB"]
    head += [f"processor s, {beside}", "ratio", f"wall s, {beside}", "ratio"] if compared else []
    lines = [head, ["---"] * len(head)]
    for name, cost in costs.items():
        row = [name, _seconds(cost.cpu_s), _seconds(cost.wall_s), f"{cost.peak_mib:.0f}" if cost.peak_mib else ""]
        if compared:
            other = reference.get(name)
            row += ["", "", "", ""] if other is None else [
                _seconds(other.cpu_s), _ratio(cost.cpu_s, other.cpu_s),
                _seconds(other.wall_s), _ratio(cost.wall_s, other.wall_s),
            ]  # fmt: skip
        lines.append(row)
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def _seconds(value: float) -> str:
    return f"{value:.3f}" if value < 1 else f"{value:.2f}"


def _ratio(value: float, other: float) -> str:
    return f"{value / other:.2f}" if other > 0 else ""


def kept(text: str) -> tuple[str, dict[str, Cost]]:
    """Return what the content of a reference file says: of which machine it is, and its rows."""
    told = json.loads(text)
    return told["machine"], {name: Cost(**cost) for name, cost in told["rows"].items()}


def to_keep(costs: Mapping[str, Cost]) -> str:
    """Return the content of a reference file."""
    return json.dumps({"machine": machine(), "rows": {name: asdict(cost) for name, cost in costs.items()}}, indent=1)


def machine() -> str:
    """Return what tells machines apart whose seconds do not compare."""
    model = platform.processor() or platform.machine()
    with contextlib.suppress(OSError):
        for line in Path("/proc/cpuinfo").read_text().splitlines():
            if line.startswith("model name"):
                model = line.partition(":")[2].strip()
                break
    return f"{model}, {os.cpu_count()} cores, {platform.system()}"


# --- steps: these run in a process of their own, with the packages of either commit --------------------------------


class Clock:
    """Processor and wall seconds by row, in the order in which rows were first measured."""

    def __init__(self) -> None:
        self.costs: dict[str, list[Cost]] = {}

    @contextlib.contextmanager
    def of(self, row: str) -> Iterator[None]:
        """Count what happens within as one measurement of a row."""
        cpu, wall = time.process_time(), time.perf_counter()
        try:
            yield
        finally:
            cost = Cost(time.process_time() - cpu, time.perf_counter() - wall, peak_mib())
            self.costs.setdefault(row, []).append(cost)

    def rows(self) -> dict[str, Cost]:
        """Return the median cost of each row."""
        return {row: middle(costs) for row, costs in self.costs.items()}


def peak_mib() -> float:
    """Return the peak of this process's memory so far."""
    # Linux counts KiB, macOS bytes.
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / (1024 if sys.platform != "darwin" else 1 << 20)


def step_frame(data: str, count: int) -> dict[str, Cost]:
    """Measure what a frame goes through, from imports to images."""
    clock = Clock()
    with clock.of("import what computes the network"):
        # Before ONNX Runtime it was torch.
        if importlib.util.find_spec("p2o_plugins.p2ornet.graph") is None:
            import torch  # noqa: F401
        else:
            import onnx.helper  # noqa: F401
            import onnxruntime  # noqa: F401
    with clock.of("import the rest, find the methods"):
        from p2o.host.registry import Registry
        from p2o.run.recipe import Recipe

        registry = Registry.load()
        plan = Recipe.of(data=data, perturb=START).resolve(registry)
    with clock.of("simulate a frame"):
        scene = Recipe.of(data="synthetic:").resolve(registry).dataset()[0]
        _ = scene.image.rgb, scene.cloud.xyz
    with clock.of("weights"):
        assembly = plan.assembly()
    dataset, views = plan.dataset(), []
    for number in range(min(count, len(dataset))):
        first = ", first frame" if not number else ""
        with clock.of("decode" + first):
            frame = dataset[number]
            _ = frame.image.rgb, frame.cloud.xyz
        from p2o.frames.scale import image_at_scale

        with clock.of("network" + first):
            image = assembly.calibrator.image_extractor(image_at_scale(frame.image))
        with clock.of("rings" + first):
            cloud = assembly.calibrator.cloud_extractor(frame.cloud)
        start = wrong_start(frame.camera_from_lidar, number)
        views.append(((frame.name, frame.camera, image, cloud, frame.twist), start))
    solve(assembly.calibrator, views, clock)
    return clock.rows()


def step_grid(data: str, count: int) -> dict[str, Cost]:
    """Measure `grid` from 10 deg away, ten frames jointly, after their extraction."""
    from p2o.host.registry import Registry
    from p2o.run.recipe import Recipe

    plan = Recipe.of(data=data, init="grid").resolve(Registry.load())
    assembly, dataset, clock = plan.assembly(), plan.dataset(), Clock()
    frames = [dataset[number] for number in range(min(count, 10))]
    views = [assembly.calibrator.prepare(frame) for frame in frames]
    start = wrong_start(frames[0].camera_from_lidar, 0, "10deg 0.15m")
    with clock.of(f"grid from 10 deg, {len(frames)} frames, after extraction"):
        assembly.calibrator.solve(views, start)
    return clock.rows()


_STAGES = {"initialize": "search", "refine": "rounds", "adjust": "adjustment", "agree": "verdict"}


def solve(pipeline: Any, views: Sequence[tuple[tuple[Any, ...], Any]], clock: Clock) -> None:
    """Measure the way from features to a pose of each frame, whole and stage by stage."""
    try:
        from p2o.run import pipeline as module
    except ImportError:  # where it was until 0.1.0
        from p2o.calibration import pipeline as module

    class Stages(module.Clock):  # type: ignore[misc,name-defined]
        """The clock of a calibration, which counts processor time for us as well."""

        def of(self, stage: str) -> contextlib.AbstractContextManager[None]:
            return clock.of(_STAGES.get(stage, stage) + first)

    before, first = module.Clock, ", first frame"
    module.Clock = Stages
    try:
        for features, start in views:
            with clock.of("features to pose" + first):
                pipeline.solve([pipeline.view(*features)], start)
            first = ""
    finally:
        module.Clock = before


def wrong_start(truth: Any, number: int, size: str = START) -> Any:
    """Return the start (4, 4) of a frame, the same in every repeat."""
    import numpy as np
    from p2o.geometry.perturb import parse_perturbation

    return parse_perturbation(size).start(truth, np.random.default_rng([0, number]))


def step_poses(data: str, frames: str, joint: bool) -> dict[str, Any]:
    """Calibrate frames, for the comparison of poses between commits."""
    import p2o

    try:
        done = p2o.calibrate(data, frames=frames, perturb=START, seed=1, joint=joint or None)
    except p2o.InputError:
        # There is no truth to perturb.
        done = p2o.calibrate(data, frames=frames, joint=joint or None)
    told = {}
    for row in done.rows:
        result, error = row.result, row.error
        told["+".join(result.frames)] = {
            "pose": result.camera_from_lidar.tolist(),
            "said": [result.status.value, result.verdict.trust.value],
            "error": None if error is None else [error.rotation_deg, error.translation_m],
        }
    return told


# --- around them: processes, repeats, commits ----------------------------------------------------------------------


def surroundings(tree: Path, **more: str) -> dict[str, str]:
    """Return the environment in which the packages of a tree are the ones that are imported."""
    rooms = [tree / room for room in ("toolkit", "plugins", "baselines") if (tree / room).is_dir()] or [tree]
    path = os.pathsep.join(map(str, rooms))
    # Installed packages are compiled once: so are these, wherever their sources are.
    compiled = {"PYTHONDONTWRITEBYTECODE": "", "PYTHONPYCACHEPREFIX": str(HOME / "compiled")}
    return {**os.environ, "PYTHONPATH": path, **compiled, **more}


def of_step(tree: Path, step: str, data: str, count: int) -> dict[str, Cost]:
    """Return the rows of a step that is measured with the packages of a tree."""
    told = _asked(tree, ["--step", step, "--data", data, "--count", str(count)])
    return {row: Cost(**cost) for row, cost in told.items()}


def _asked(tree: Path, words: Sequence[str]) -> Any:
    command = [sys.executable, str(Path(__file__).resolve()), *words]
    done = subprocess.run(command, env=surroundings(tree, **ONE_THREAD), stdout=subprocess.PIPE, check=True)
    return json.loads(done.stdout.splitlines()[-1])


def of_command(tree: Path, name: str, data: str, count: int) -> dict[str, Cost]:
    """Return the row of a command as a user calls it."""
    with tempfile.TemporaryDirectory() as out:
        jointly = ["run", "--data", data, "--frames", f"0-{count - 1}", "--joint", "--perturb", START]
        study = Path(out) / "rows.toml"
        study.write_text(STUDY.format(data=frames_on_disk(STUDY_FRAMES), seeds=STUDY_SEEDS))
        ablate = ["ablate", str(study), "--out", out, "--quiet", "--jobs"]
        words = {
            "help": ["--help"],
            "run": ["run"],
            "out": ["run", "--out", out],
            "folder": ["run", "--data", data, "--frames", "0", "--perturb", START],
            "joint": jointly,
            "many": ["run", "--data", _many() if name == "many" else "", "--joint", "--perturb", START],
            "study-1": [*ablate, "1"],
            "study-2": [*ablate, "2"],
            "study-4": [*ablate, "4"],
        }[name]
        row = {
            "help": "`p2o --help`",
            "run": "`p2o run`",
            "out": "`p2o run --out DIR`",
            "folder": "`p2o run`, a folder frame",
            "joint": f"`p2o run --joint`, {count} frames",
            "many": f"`p2o run --joint`, {MANY} frames",
            **{f"study-{n}": f"`p2o ablate`, {STUDY_FRAMES * STUDY_SEEDS} rows, {n} workers" for n in (1, 2, 4)},
        }[name]
        began, own = time.perf_counter(), subprocess.Popen(
            [sys.executable, "-m", "p2o", *words], env=surroundings(tree), stdout=subprocess.DEVNULL
        )  # fmt: skip
        _, status, used = os.wait4(own.pid, 0)
        wall = time.perf_counter() - began
        own.returncode = os.waitstatus_to_exitcode(status)
        if own.returncode not in (0, 1):
            raise SystemExit(f"p2o {' '.join(words)} ended with status {own.returncode}")
        scale = 1024 if sys.platform != "darwin" else 1 << 20
        return {row: Cost(used.ru_utime + used.ru_stime, wall, used.ru_maxrss / scale)}


def _many() -> str:
    from memory import many

    return many(MANY, 25)


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
    """Return the dataset of synthetic frames that is measured on, written where it is not there yet."""
    folder = HOME / f"frames-{count}"
    if not (folder / "complete").exists():
        settings = ["--set", f"scenes={count}", "--seed", "7"]
        command = [sys.executable, "-m", "p2o", "simulate", str(folder), "--layout", "folder", "--force", *settings]
        subprocess.run(command, env=surroundings(ROOT), stdout=subprocess.DEVNULL, check=True)
        (folder / "complete").touch()
    return f"folder:{folder}"


def measured(trees: Sequence[Path], names: Sequence[str], data: str, count: int, repeats: int) -> list[dict[str, Cost]]:
    """Return the rows of each tree; the trees take turns, so that they meet the same other work."""
    found: list[dict[str, list[Cost]]] = [{} for _ in trees]
    for name in names:
        measure: Callable[..., dict[str, Cost]] = of_step if name in STEPS else of_command
        for _ in range(repeats):
            for tree, rows in zip(trees, found, strict=True):
                for row, cost in measure(tree, name, data, count).items():
                    rows.setdefault(row, []).append(cost)
                print(".", end="", flush=True, file=sys.stderr)
    print(file=sys.stderr)
    return [{row: middle(costs) for row, costs in rows.items()} for rows in found]


def differences(ours: Mapping[str, Any], theirs: Mapping[str, Any]) -> str:
    """Return in a line how far the poses of two commits are apart, largest first, and whose are nearer the truth."""
    import numpy as np
    from p2o.geometry.pose_error import pose_error

    apart = [pose_error(np.array(ours[name]["pose"]), np.array(theirs[name]["pose"])) for name in theirs]
    changed = sum(ours[name]["said"] != theirs[name]["said"] for name in theirs)
    line = (
        f"{len(apart)} poses, apart at most {max(e.rotation_deg for e in apart):.5f} deg and "
        f"{1000 * max(e.translation_m for e in apart):.3f} mm; {changed} with another status or verdict"
    )
    known = [name for name in theirs if theirs[name]["error"] is not None]
    if known:
        means = [np.mean([told[name]["error"] for name in known], axis=0) for told in (ours, theirs)]
        now, then = (f"{deg:.4f} deg and {1000 * m:.2f} mm" for deg, m in means)
        line += f"; mean error {now}, before {then}"
    return line


def parser() -> argparse.ArgumentParser:
    asked = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    asked.add_argument("--rows", default=",".join((*STEPS, *COMMANDS)), help="what is measured, of: %(default)s,many")
    asked.add_argument("--count", type=int, default=24, help="frames of the joint calibration (default: 24)")
    asked.add_argument("--repeats", type=int, default=3, help="the median counts (default: 3)")
    asked.add_argument("--keep", type=Path, metavar="FILE", help="write what was measured here")
    asked.add_argument("--against", type=Path, metavar="FILE", help="show ratios to what was kept here")
    asked.add_argument("--against-commit", metavar="REV", help="measure this commit too, in turns")
    asked.add_argument(
        "--poses", action="append", metavar="DATASET:PATH[#FRAMES]", help="compare poses instead; +joint at the end"
    )
    for hidden in ("--step", "--data", "--frames"):
        asked.add_argument(hidden, help=argparse.SUPPRESS)
    asked.add_argument("--joint", action="store_true", help=argparse.SUPPRESS)
    return asked


def main() -> None:
    words = parser().parse_args()
    if words.step == "poses":
        print(json.dumps(step_poses(words.data, words.frames, words.joint)))
        return
    if words.step:
        rows = {"frame": step_frame, "grid": step_grid}[words.step](words.data, words.count)
        print(json.dumps({row: asdict(cost) for row, cost in rows.items()}))
        return
    with contextlib.ExitStack() as stack:
        trees = [ROOT]
        if words.against_commit:
            trees.append(stack.enter_context(tree_of(words.against_commit)))
        if words.poses:
            if len(trees) == 1:
                raise SystemExit("--poses needs --against-commit")
            for text in words.poses:
                compare(trees[0], trees[1], text)
            return
        names = [name for name in words.rows.split(",") if name]
        if unknown := sorted(set(names) - {*STEPS, *COMMANDS, *LONG}):
            raise SystemExit(f"unknown rows: {', '.join(unknown)}")
        data = frames_on_disk(words.count)
        found = measured(trees, names, data, words.count, words.repeats)
    reference, beside = (found[1], words.against_commit) if len(found) > 1 else ({}, "")
    if words.against is not None:
        whose, reference = kept(words.against.read_text())
        beside = words.against.stem
        if whose != machine():
            print(f"the reference was made on another machine: {whose}", file=sys.stderr)
    print(f"{machine()}, load {os.getloadavg()[0]:.1f}\n\n{table(found[0], reference, beside)}")
    if words.keep is not None:
        words.keep.parent.mkdir(parents=True, exist_ok=True)
        words.keep.write_text(to_keep(found[0]))


def compare(ours: Path, theirs: Path, text: str) -> None:
    """Print how far poses of both trees are apart on a dataset."""
    bare = text.removesuffix("+joint")
    data, _, frames = bare.partition("#")
    words = ["--step", "poses", "--data", data, "--frames", frames or "all", *(["--joint"] if bare != text else [])]
    told = [_asked(tree, words) for tree in (ours, theirs)]
    print(f"{text}: {differences(*told)}", flush=True)


if __name__ == "__main__":
    main()
