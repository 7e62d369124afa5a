"""What does `p2o fleet` detect, how often is it wrong, how much does it cost, and what is lost when it is killed?

    python benchmarks/fleet.py real --out DIR             # 200 drives of real and simulated rigs, some with a slip
    python benchmarks/fleet.py detect                     # resampled fleets: slips, drifts, wrong types, false alarms
    python benchmarks/fleet.py store --jobs 2             # queries over 1,000 vehicles and a year: seconds and memory
    python benchmarks/fleet.py capacity                   # checks per minute of 1, 2, 4 workers, and what 100 would do
    python benchmarks/fleet.py kills --kills 100          # runs that are killed again and again
    python benchmarks/fleet.py kills --cluster            # the same for scheduler and workers of a dask cluster
    python benchmarks/fleet.py bank --store DIR --out FILE # evidence of `real` as noise of a simulation

Noise is resampled from measured evidence (`p2o_fleet/noise.json`). Each command prints a table; `kills` has exit
status 1 if evidence was lost or counted twice.
"""

from __future__ import annotations

import argparse
import csv
import heapq
import itertools
import json
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from fleet_detection import detect
from fleet_drives import consecutive, real, seconds_of_checks
from fleet_kills import kills, kills_of_cluster
from p2o.arrays import Float
from p2o_fleet.evidence import UPPER
from p2o_fleet.fleet_state import fleet_state
from p2o_fleet.simulation import Fault, NoiseBank, Scenario, simulated_fleet, write_fleet
from p2o_fleet.store import Store
from p2o_study.parallel import Workers


def store(vehicles: int, days: int, per_day: int, jobs: int) -> list[str]:
    """Return time and memory of queries over a year of checks, in files as daily runs leave them."""
    import pyarrow.dataset

    lines = ["| query | wall, s | s of a core per vehicle | MB of a process |", "|---|---|---|---|"]
    scenario = Scenario(vehicles, days * per_day, per_day, ("kitti",), {Fault.SLIP: 0.1})
    with tempfile.TemporaryDirectory() as home:
        own = Store(Path(home))
        total = write_fleet(simulated_fleet(scenario, NoiseBank.shipped()), own)
        paths = list(own.checks_folder.rglob("*.parquet"))
        size = sum(path.stat().st_size for path in paths)

        def mean_by_vehicle() -> None:
            data = pyarrow.dataset.dataset(own.checks_folder, format="parquet")
            table = data.to_table(columns=["vehicle", "yaw_deg"]).group_by("vehicle").aggregate([("yaw_deg", "mean")])
            assert table.num_rows == vehicles

        def states() -> None:
            assert fleet_state(own, workers=Workers(jobs)).checks == total

        queries = {
            "mean yaw of each vehicle, Arrow": mean_by_vehicle,
            f"states of all extrinsics, {jobs} workers": states,
        }
        for name, query in queries.items():
            began, cores = time.monotonic(), _core_seconds()
            query()
            wall, cores = time.monotonic() - began, _core_seconds() - cores
            who = (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)
            peak = max(resource.getrusage(one).ru_maxrss for one in who) / 1024
            lines.append(f"| {name} | {wall:.1f} | {cores / vehicles:.3f} | {peak:.0f} |")
    lines += ["", "| vehicles | checks | files | bytes per check |", "|---|---|---|---|"]
    return [*lines, f"| {vehicles:,} | {total:,} | {len(paths):,} | {size / total:.0f} |"]


def _core_seconds() -> float:
    """Return the processor time of this process and of its children that ended."""
    usages = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(usage.ru_utime + usage.ru_stime for usage in usages)


def capacity(root: Path, splits: Path, checks: int, workers: Sequence[int], link_gbit: float) -> list[str]:
    """Return the throughput of `p2o fleet run` with several numbers of local workers, and what many workers would do.

    A check reads 12 frames of KITTI, pieces of drive 0005, and uses eight. The wall time contains the start of the
    command and its workers.
    """
    names = json.loads(splits.read_text(encoding="utf-8"))["drive_0005_later"]
    parts = [part[:12] for part in consecutive(names, 12)]
    lines = ["| workers | checks | wall, s | checks per minute | per worker | s of work per check |", "|---" * 6 + "|"]
    durations = np.zeros(0)
    with tempfile.TemporaryDirectory() as home:
        table = Path(home) / "drives.csv"
        with table.open("w", encoding="utf-8", newline="") as file:
            rows = csv.writer(file)
            rows.writerow(["vehicle", "camera", "lidar", "data", "extrinsic", "time", "frames"])
            for number in range(checks):
                data, frames = f"kitti-raw:{root / 'kitti_raw'}", ",".join(parts[number % len(parts)])
                rows.writerow([f"v{number}", "front", "top", data, "truth", number, frames])
        for count in workers:
            command = [sys.executable, "-m", "p2o", "fleet", "run", str(table), "--store", f"{home}/{count}", "--json"]
            began = time.monotonic()
            done = subprocess.run([*command, "--jobs", str(count)], capture_output=True, text=True, check=True)
            wall, counts = time.monotonic() - began, json.loads(done.stdout)
            if not len(durations):
                durations = seconds_of_checks(Store(Path(f"{home}/{count}")))
            rate, work = 60 * counts["checked"] / wall, counts["seconds"] / counts["checked"]
            cells = [f"{wall:.0f}", f"{rate:.1f}", f"{rate / count:.1f}", f"{work:.2f}"]
            lines.append(f"| {count} | {counts['checked']} | {' | '.join(cells)} |")
    megabytes = float(np.mean([_megabytes(root / "kitti_raw", part) for part in parts]))
    lines += [
        "",
        "| s of a check: median | 95 % | longest | MB read | core hours for 1,000 vehicles, ten checks each |",
    ]
    median, most, longest = np.quantile(durations, [0.5, 0.95, 1.0])
    hours = 10_000 * durations.mean() / 3600
    lines += ["|---" * 5 + "|", f"| {median:.1f} | {most:.1f} | {longest:.1f} | {megabytes:.0f} | {hours:.1f} |"]
    return [*lines, "", *_clusters(durations, (megabytes, _WHOLE_BAG_MB), link_gbit)]


def _megabytes(root: Path, names: Sequence[str]) -> float:
    """Return the size of images and sweeps of frames DATE/DRIVE/NUMBER of KITTI."""
    total = 0
    for name in names:
        date, drive, number = name.split("/")
        for sensor in ("image_02", "velodyne_points"):
            total += sum(path.stat().st_size for path in root.glob(f"{date}/*_{drive}_sync/{sensor}/data/{number}.*"))
    return total / 1e6


_WHOLE_BAG_MB, _SCHEDULED_S = 200.0, 1e-3
"""Size of a log that is copied as a whole, and time of the scheduler for a task: both are assumed."""


def _clusters(seconds: Float, megabytes: Sequence[float], link_gbit: float, checks: int = 10_000) -> list[str]:
    """Return what a scheduler with many workers would do with checks of these durations (N,), by size of the logs.

    Each worker fetches a log over a link that all share, then computes.
    """
    rng = np.random.default_rng(0)
    lines = ["| workers | MB of a log | checks per hour | busy with work | limit |", "|---|---|---|---|---|"]
    durations = rng.choice(seconds, checks)
    for size, count in itertools.product(megabytes, (1, 10, 100, 1000)):
        free, link, scheduler = [0.0] * count, 0.0, 0.0
        fetch_s = 8e-3 * size / link_gbit
        for duration in durations.tolist():
            ready = heapq.heappop(free)
            scheduler = max(scheduler, ready) + _SCHEDULED_S
            link = max(link, scheduler) + fetch_s
            heapq.heappush(free, link + duration)
        last = max(free)
        busy = 100 * durations.sum() / (last * count)
        limit = "link" if fetch_s * count > durations.mean() else "workers"
        lines.append(f"| {count} | {size:.0f} | {3600 * checks / last:,.0f} | {busy:.0f} % | {limit} |")
    return lines


def write_bank(source: Path, out: Path, rigs: Sequence[str]) -> list[str]:
    """Write the usable evidence of the vehicles without a slip in the store of `real` as the noise of a simulation."""
    own = Store.existing(source)
    rows = []
    for checks in own.checks([name for name in own.vehicles() if not name.startswith("slip-")]):
        for at in np.flatnonzero(checks.usable & np.isin(checks.texts["vehicle_type"].astype(str), list(rigs))):
            values = {"error": checks.error[at], "covariance": checks.covariance[at][UPPER]}
            plain = {name: [float(f"{value:.6g}") for value in numbers] for name, numbers in values.items()}
            rows.append({"rig": checks.texts["vehicle_type"][at], "frames": int(checks.frame_count[at]), **plain})
    about = "Evidence of python benchmarks/fleet.py real at published or exact extrinsics; docs/how-to/fleet.md"
    text = ",\n".join(json.dumps(row) for row in rows)
    out.write_text(f'{{"about": {json.dumps(about)},\n"checks": [\n{text}\n]}}\n')
    return [f"{rig}: {sum(row['rig'] == rig for row in rows)} checks" for rig in rigs]


def main(argv: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    commands = parser.add_subparsers(dest="command", required=True)
    own = commands.add_parser("real")
    own.add_argument("--root", type=Path, default=Path("build/data"))
    own.add_argument("--out", type=Path, required=True, help="folder of the table, the store and the report")
    own.add_argument("--splits", type=Path, default=Path("benchmarks/splits.json"))
    own.add_argument("--jobs", type=int, default=1)
    own = commands.add_parser("detect")
    own.add_argument("--vehicles", type=int, default=1000)
    own.add_argument("--checks", type=int, default=125)
    own.add_argument("--fleets", type=int, default=100, help="number of fleets with a wrong nominal extrinsic")
    own.add_argument("--rigs", default="kitti,sim-hdl-64e")
    own.add_argument("--seed", type=int, default=0)
    own = commands.add_parser("store")
    own.add_argument("--vehicles", type=int, default=1000)
    own.add_argument("--days", type=int, default=365)
    own.add_argument("--per-day", type=int, default=10)
    own.add_argument("--jobs", type=int, default=2)
    own = commands.add_parser("capacity")
    own.add_argument("--root", type=Path, default=Path("build/data"))
    own.add_argument("--splits", type=Path, default=Path("benchmarks/splits.json"))
    own.add_argument("--checks", type=int, default=40)
    own.add_argument("--workers", default="1,2,4")
    own.add_argument("--link-gbit", type=float, default=10.0)
    own = commands.add_parser("kills")
    own.add_argument("--kills", type=int, default=100)
    own.add_argument("--seed", type=int, default=0)
    kind = own.add_mutually_exclusive_group()
    kind.add_argument("--commands", action="store_true", help="start `p2o fleet run` each time: slower")
    kind.add_argument("--cluster", action="store_true", help="kill scheduler, workers and runs of a dask cluster")
    own = commands.add_parser("bank")
    own.add_argument("--store", type=Path, required=True)
    own.add_argument("--out", type=Path, required=True)
    own.add_argument("--rigs", default="kitti,sim-hdl-64e")
    words = vars(parser.parse_args(argv))
    command = words.pop("command")
    for name in ("workers", "rigs"):
        if name in words:
            words[name] = [int(word) if name == "workers" else word for word in words[name].split(",")]
    failed = False
    if command == "kills" and words["cluster"]:
        lines, failed = kills_of_cluster(words["kills"], words["seed"])
    elif command == "kills":
        lines, failed = kills(words["kills"], words["seed"], commands=words["commands"])
    elif command == "bank":
        lines = write_bank(words["store"], words["out"], words["rigs"])
    else:
        functions = (real, detect, store, capacity)
        lines = {function.__name__: function for function in functions}[command](**words)
    print("\n".join(lines))
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
