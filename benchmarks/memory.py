"""Measure peak memory and run time of joint calibrations by their number of frames, and of each command.

    python benchmarks/memory.py joint [--counts 50 125 250 500] [--distinct 25] [--out]
    python benchmarks/memory.py commands
    python benchmarks/memory.py bag [--gb 5]
    python benchmarks/memory.py report [--rows 100000]

`joint` calibrates synthetic frames (1242 x 375 px, HDL-64E) jointly, as `p2o run --joint --perturb "2deg 0.15m"` does:
`--distinct` of them are made once and stored in a folder dataset under the requested number of names. So images and
sweeps repeat, but p2o reads, holds and solves each name as a frame of its own. `commands` runs each command in a
process of its own on small data. `bag` writes a bag of ROS 2 of this size (images 1242 x 375, 120,000 points a sweep,
the same content under new time stamps) to the temporary folder, lists its topics, reads all of its frames, and deletes
it. `report` runs a small study (5 rows, 2 frames, 2 seeds), stores its calibrations again under other names of 100
frames, other seeds and with errors that are scaled at random, up to this number, and writes the report.
Peaks are of the largest process of a command; each job of a study has one of its own.
Frames are kept in build/bench and made again if that folder is away. Seconds are of one run, and of this machine.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from bench import HOME, ROOT, START, Cost, frames_on_disk, machine, surroundings

SMALL = "synthetic:?scenes=2&width_px=621&height_px=188"


@dataclass(frozen=True)
class Peak:
    """What a command came to: its cost, and seconds by stage where it tells them."""

    cost: Cost
    stages: Mapping[str, float]


def names_of(count: int, distinct: int) -> list[tuple[str, int]]:
    """Return the name of each of N frames and the number of the distinct frame that it repeats."""
    return [(f"frame-{number:04d}", number % distinct) for number in range(count)]


def per_frame(peaks: Mapping[int, Peak]) -> float:
    """Return the MiB a frame by which the peak grows between the two largest numbers of frames."""
    (fewer, low), (more, high) = sorted(peaks.items())[-2:]
    return (high.cost.peak_mib - low.cost.peak_mib) / (more - fewer)


def table(peaks: Mapping[int, Peak]) -> str:
    """Return a line for each number of frames as a Markdown table."""
    stages = list(dict.fromkeys(stage for peak in peaks.values() for stage in peak.stages))
    lines = [["frames", "peak MiB", "wall s", "processor s", *(f"{stage} s" for stage in stages)]]
    lines.append(["---"] * len(lines[0]))
    for count, peak in peaks.items():
        seconds = [f"{peak.stages[stage]:.1f}" if stage in peak.stages else "" for stage in stages]
        cost = peak.cost
        lines.append([str(count), f"{cost.peak_mib:.0f}", f"{cost.wall_s:.0f}", f"{cost.cpu_s:.0f}", *seconds])
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def measured(words: Sequence[str]) -> Peak:
    """Return what `p2o WORDS` costs in a process of its own."""
    with tempfile.TemporaryFile() as out:
        began = time.perf_counter()
        own = subprocess.Popen([sys.executable, "-m", "p2o", *words], env=surroundings(ROOT), stdout=out)
        _, status, used = os.wait4(own.pid, 0)
        wall = time.perf_counter() - began
        own.returncode = os.waitstatus_to_exitcode(status)
        if own.returncode not in (0, 1):
            raise SystemExit(f"p2o {' '.join(words)} ended with status {own.returncode}")
        out.seek(0)
        told = json.loads(out.read()) if "--json" in words else {}
    # Linux counts KiB, macOS bytes.
    peak = used.ru_maxrss / (1024 if sys.platform != "darwin" else 1 << 20)
    stages = told["results"][0]["seconds"] if told.get("results") else {}
    return Peak(Cost(used.ru_utime + used.ru_stime, wall, peak), stages)


def many(count: int, distinct: int) -> str:
    """Return the dataset of N names for the distinct frames, created if it does not exist."""
    source, folder = Path(frames_on_disk(distinct).partition(":")[2]), HOME / f"frames-{count}-of-{distinct}"
    shown = sorted(path for path in source.iterdir() if path.is_dir())
    if not (folder / "complete").exists():
        shutil.rmtree(folder, ignore_errors=True)
        for name, number in names_of(count, distinct):
            # Links take no room.
            shutil.copytree(shown[number], folder / name, copy_function=os.link)
        (folder / "complete").touch()
    return f"folder:{folder}"


def joint(counts: Sequence[int], distinct: int, pictures: bool) -> dict[int, Peak]:
    """Return the cost of joint calibrations of N frames."""
    data, peaks = many(max(counts), distinct), {}
    for count in counts:
        with tempfile.TemporaryDirectory() as out:
            words = ["run", "--data", data, "--frames", f"0-{count - 1}", "--joint", "--perturb", START, "--json"]
            peaks[count] = measured([*words, *(["--out", out] if pictures else [])])
        print(f"{count} frames: {peaks[count]}, load {os.getloadavg()[0]:.1f}", file=sys.stderr, flush=True)
    return peaks


def commands() -> dict[str, Cost]:
    """Return the cost of each command, by what it is called with."""
    found: dict[str, Cost] = {}
    frames = frames_on_disk(24)
    with tempfile.TemporaryDirectory() as folder:
        home = Path(folder)
        study = home / "small.toml"
        study.write_text(
            f'name = "small"\ntitle = "Small"\nperturb = "1deg 0.05m"\nseeds = 2\n[[dataset]]\nname = "streets"\n'
            f'data = "{SMALL}"\n[[row]]\nlabel = "ogm"\n'
        )
        joint = ["run", "--data", frames, "--joint", "--perturb", START]
        four = ["--set", "iterations=4", "--set", "batch=4"]
        asked: dict[str, list[str]] = {
            "run": ["run"],
            "run --out": ["run", "--out", f"{home}/run"],
            "run, a folder frame": ["run", "--data", frames, "--frames", "0", "--perturb", START],
            "run --joint, 8 frames": [*joint, "--frames", "0-7"],
            "run --joint, 24 frames": joint,
            "check, 4 frames": ["check", frames, "--extrinsic", "truth", "--frames", "0-3"],
            "data show, a frame": ["data", "show", frames, "--frames", "0", "--out", f"{home}/show"],
            "simulate, 2 frames": ["simulate", f"{home}/made", "--layout", "folder", "--set", "scenes=2"],
            "ablate, 4 rows, 1 process": ["ablate", str(study), "--out", f"{home}/study", "--jobs", "1"],
            "ablate, 4 rows, 2 processes": ["ablate", str(study), "--out", f"{home}/again", "--jobs", "2"],
            "report": ["report", f"{home}/study"],
            "train p2ornet, 4 steps": ["train", "p2ornet", "--data", SMALL, "--out", f"{home}/net", *four],
        }
        for name, words in asked.items():
            try:
                found[name] = measured(words).cost
            except SystemExit as problem:
                print(problem, file=sys.stderr)
    return found


def bag(size_gb: float) -> dict[str, Cost]:
    """Return the cost of listing the topics of a bag of this size, and of reading its frames."""
    sys.path.insert(0, str(ROOT))
    import numpy as np
    from p2o import Camera

    from tests import bag_files

    rng = np.random.default_rng(0)
    camera = Camera.pinhole(720, 720, 621, 187, 1242, 375)
    pixels = rng.integers(0, 256, (375, 1242, 3), dtype=np.uint8)
    columns = {axis: rng.uniform(2, 60, 120_000).astype(np.float32) for axis in "xyz"}
    columns |= {"t": np.linspace(0, 1e8, 120_000).astype(np.uint32)}
    columns |= {"ring": (np.arange(120_000) % 64).astype(np.uint16)}
    count = round(size_gb * 1e9 / (pixels.nbytes + sum(column.nbytes for column in columns.values())))

    def messages() -> Iterator[bag_files.Said]:
        yield bag_files.tf([bag_files.transform("lidar", "camera", np.eye(4))])
        for number in range(count):
            time_ns = 10**18 + number * 100_000_000
            yield bag_files.camera_info("/camera_info", time_ns, camera)
            yield bag_files.image("/image", time_ns, pixels)
            yield bag_files.cloud("/points", time_ns, columns)

    with tempfile.TemporaryDirectory() as folder:
        path = bag_files.write_bag(Path(folder), messages(), "mcap")
        size = sum(file.stat().st_size for file in path.iterdir()) / 1e9
        words = {"data topics": [str(path)], "data check": [f"ros:{path}"]}
        return {
            f"{name}, {size:.2f} GB, {count} frames": measured([*name.split(), *arguments]).cost
            for name, arguments in words.items()
        }


def report(count: int) -> dict[str, Cost]:
    """Return the cost of the report of a study with this number of calibrations."""
    with tempfile.TemporaryDirectory() as folder:
        store_of_many(Path(folder), count)
        cost = measured(["report", folder, "--quiet"]).cost
        size = (Path(folder) / "report/report.html").stat().st_size / 1e6
    return {f"report, {count} calibrations, page of {size:.1f} MB": cost}


def store_of_many(folder: Path, count: int) -> None:
    """Write a store with this number of calibrations, which repeat those of a small study."""
    import numpy as np
    from p2o_study.store import METRICS, Planned, Store

    rows = {
        "ours": "",
        "nearest": 'matcher = "nearest"',
        "canny": 'extractor = "canny/rings"\nmatcher = "nearest"',
        "given": 'init = "given"',
        "simplex": 'solver = "nelder-mead"',
    }
    text = 'name = "many"\ntitle = "Many"\nperturb = "1deg 0.05m"\nseeds = 2\n'
    text += f'[[dataset]]\nname = "streets"\ndata = "{SMALL}"\n'
    text += "".join(f'[[row]]\nlabel = "{label}"\n{words}\n' for label, words in rows.items())
    (folder / "many.toml").write_text(text)
    measured(["ablate", str(folder / "many.toml"), "--out", str(folder), "--jobs", "1", "--quiet"])
    rng = np.random.default_rng(0)
    with Store.open(folder) as store:
        [study], base, many = store.studies(), store.rows("many"), []
        for number in range(count):
            row = base[number % len(base)]
            place, seed = number // len(base) % 100, number // len(base) // 100
            changed = {m: error * rng.lognormal() for m in METRICS if (error := getattr(row, m)) is not None}
            many.append(replace(row, key=f"{number:064x}", frames=(f"frame-{place:03d}",), seed=seed, **changed))
        store.begin(study, [Planned(**{name: getattr(row, name) for name in Planned.__slots__}) for row in many])
        for row in many:
            store.put(row)


def commands_table(costs: Mapping[str, Cost]) -> str:
    """Return a line for each command as a Markdown table."""
    lines = ["| command | peak MiB | wall s | processor s |", "|---|---|---|---|"]
    return "\n".join(
        [*lines, *(f"| `{n}` | {c.peak_mib:.0f} | {c.wall_s:.1f} | {c.cpu_s:.1f} |" for n, c in costs.items())]
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    asked = parser.add_subparsers(dest="command", required=True)
    jointly = asked.add_parser("joint")
    jointly.add_argument("--counts", type=int, nargs="+", default=[50, 125, 250, 500])
    jointly.add_argument("--distinct", type=int, default=25)
    jointly.add_argument("--out", action="store_true", help="with pictures")
    asked.add_parser("commands")
    asked.add_parser("bag").add_argument("--gb", type=float, default=5.0)
    asked.add_parser("report").add_argument("--rows", type=int, default=100_000)
    said = parser.parse_args()
    if said.command == "joint":
        peaks = joint(said.counts, said.distinct, said.out)
        print(f"{machine()}, load {os.getloadavg()[0]:.1f}\n\n{table(peaks)}")
        if len(peaks) > 1:
            print(f"\n{per_frame(peaks):.2f} MiB for each further frame")
        return
    costs = bag(said.gb) if said.command == "bag" else report(said.rows) if said.command == "report" else commands()
    print(f"{machine()}, load {os.getloadavg()[0]:.1f}\n\n{commands_table(costs)}")


if __name__ == "__main__":
    main()
