"""What does `p2o fleet` detect, how often is it wrong, and how much does it cost?

    python benchmarks/fleet.py real --out DIR              # 200 drives of real and simulated rigs, some with a slip
    python benchmarks/fleet.py detect                      # resampled fleets: slips, drifts, wrong types, false alarms
    python benchmarks/fleet.py store                       # queries over 1,000 vehicles and a year: seconds and memory
    python benchmarks/fleet.py capacity                    # checks per minute of 1, 2, 4 workers, and of 1000 simulated
    python benchmarks/fleet.py bank --store DIR --out FILE # evidence of `real` as noise of a simulation

Noise is resampled from measured evidence (`p2o_fleet/noise.json`). Each command prints a table; `kills.py` kills runs.
"""

from __future__ import annotations

import argparse
import csv
import json
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from common import SPLITS, table
from fleet_detection import detect
from fleet_drives import consecutive, real, seconds_of_checks
from p2o_fleet.fleet_state import fleet_state
from p2o_fleet.simulation import Fault, NoiseBank, Scenario, simulated_fleet, write_fleet
from p2o_fleet.store import Store
from p2o_study.parallel import Workers
from scaling import simulated

VEHICLES, DAYS, PER_DAY, JOBS = 1000, 365, 10, 2
CHECKS, SCHEDULED_S = 40, 1e-3
"""Checks of `capacity`, and the assumed time of a scheduler for each."""


def store() -> Iterator[str]:
    """Yield time and memory of queries over a year of checks, in files as daily runs leave them."""
    import pyarrow.dataset

    scenario = Scenario(VEHICLES, DAYS * PER_DAY, PER_DAY, ("kitti",), {Fault.SLIP: 0.1})
    with tempfile.TemporaryDirectory() as folder:
        own = Store(Path(folder))
        total = write_fleet(simulated_fleet(scenario, NoiseBank.shipped()), own)
        paths = list(own.checks_folder.rglob("*.parquet"))
        size = sum(path.stat().st_size for path in paths)

        def mean_by_vehicle() -> None:
            data = pyarrow.dataset.dataset(own.checks_folder, format="parquet")
            means = data.to_table(columns=["vehicle", "yaw_deg"]).group_by("vehicle").aggregate([("yaw_deg", "mean")])
            assert means.num_rows == VEHICLES

        def states() -> None:
            assert fleet_state(own, workers=Workers(JOBS)).checks == total

        queries = {
            "mean yaw of each vehicle, Arrow": mean_by_vehicle,
            f"states of all extrinsics, {JOBS} workers": states,
        }
        lines = []
        for name, query in queries.items():
            began, cores = time.monotonic(), _core_seconds()
            query()
            wall, cores = time.monotonic() - began, _core_seconds() - cores
            processes = (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)
            peak = max(resource.getrusage(process).ru_maxrss for process in processes) / 1024
            lines.append((name, f"{wall:.1f}", f"{cores / VEHICLES:.3f}", f"{peak:.0f}"))
    yield table(("query", "wall, s", "s of a core per vehicle", "MB of a process"), lines)
    counts = [(f"{VEHICLES:,}", f"{total:,}", f"{len(paths):,}", f"{size / total:.0f}")]
    yield table(("vehicles", "checks", "files", "bytes per check"), counts)


def _core_seconds() -> float:
    """Return the processor time of this process and of its children that ended."""
    usages = [resource.getrusage(process) for process in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(usage.ru_utime + usage.ru_stime for usage in usages)


def capacity(root: Path) -> Iterator[str]:
    """Yield the throughput of `p2o fleet run` with several numbers of local workers, and that of a simulated cluster.

    A check reads 12 frames of KITTI, pieces of drive 0005, and uses eight. The wall time contains the start of the
    command and its workers. The link to the logs is not simulated.
    """
    parts = [part[:12] for part in consecutive(json.loads(SPLITS.read_text())["drive_0005_later"], 12)]
    lines, durations = [], np.zeros(0)
    with tempfile.TemporaryDirectory() as folder:
        drives = Path(folder) / "drives.csv"
        with drives.open("w", encoding="utf-8", newline="") as file:
            rows = csv.writer(file)
            rows.writerow(["vehicle", "camera", "lidar", "data", "extrinsic", "time", "frames"])
            for number in range(CHECKS):
                data, frames = f"kitti-raw:{root / 'kitti_raw'}", ",".join(parts[number % len(parts)])
                rows.writerow([f"v{number}", "front", "top", data, "truth", number, frames])
        for count in (1, 2, 4):
            words = ["fleet", "run", str(drives), "--store", f"{folder}/{count}", "--json", "--jobs", str(count)]
            began = time.monotonic()
            done = subprocess.run([sys.executable, "-m", "p2o", *words], capture_output=True, text=True, check=True)
            wall, counts = time.monotonic() - began, json.loads(done.stdout)
            if count == 1:
                durations = seconds_of_checks(Store(Path(f"{folder}/{count}")))
            rate, work = 60 * counts["checked"] / wall, counts["seconds"] / counts["checked"]
            cells = (f"{wall:.0f}", f"{rate:.1f}", f"{rate / count:.1f}", f"{work:.2f}")
            lines.append((count, counts["checked"], *cells))
    yield table(("workers", "checks", "wall, s", "checks per minute", "per worker", "s of work per check"), lines)
    figures = [f"{value:.1f}" for value in np.quantile(durations, [0.5, 0.95, 1.0])]
    hours = f"{10_000 * durations.mean() / 3600:.1f}"
    head = ("s of a check: median", "95 %", "longest", "core hours for 1,000 vehicles, ten checks each")
    yield table(head, [(*figures, hours)])
    outcomes = {count: simulated(10_000, count, durations.tolist(), SCHEDULED_S) for count in (1, 10, 100, 1000)}
    clusters = [(n, f"{60 * o.rows_a_minute:,.0f}", f"{o.workers_busy:.0%}") for n, o in outcomes.items()]
    yield table(("workers, simulated", "checks per hour", "busy with work"), clusters)


def bank(source: Path, out: Path) -> Iterator[str]:
    """Write the usable evidence of the vehicles without a slip in the store of `real` as the noise of a simulation."""
    own, rigs = Store.existing(source), ("kitti", "sim-hdl-64e")
    noise = NoiseBank.of_store(own, [name for name in own.vehicles() if not name.startswith("slip-")])
    rows = [row for row in noise.rows() if row["rig"] in rigs]
    about = "Evidence of python benchmarks/fleet.py real at published or exact extrinsics; docs/how-to/fleet.md"
    text = ",\n".join(json.dumps(row) for row in rows)
    out.write_text(f'{{"about": {json.dumps(about)},\n"checks": [\n{text}\n]}}\n')
    yield table(("rig", "checks"), [(rig, sum(row["rig"] == rig for row in rows)) for rig in rigs])


def main() -> None:
    """Print the tables of a command."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    commands = parser.add_subparsers(dest="command", required=True)
    detecting = commands.add_parser("detect")
    detecting.add_argument("--vehicles", type=int, default=1000)
    detecting.add_argument("--checks", type=int, default=125)
    detecting.add_argument("--fleets", type=int, default=100, help="number of fleets with a wrong nominal extrinsic")
    commands.add_parser("store")
    for command in (drives := commands.add_parser("real"), commands.add_parser("capacity")):
        command.add_argument("--root", type=Path, default=Path("build/data"), help="folder of the real frames")
    drives.add_argument("--out", type=Path, required=True, help="folder of the table, the store and the report")
    writing = commands.add_parser("bank")
    writing.add_argument("--store", type=Path, required=True, help="store of `real`")
    writing.add_argument("--out", type=Path, required=True)
    options = parser.parse_args()
    tables = {
        "real": lambda: real(options.root, options.out),
        "detect": lambda: detect(options.vehicles, options.checks, options.fleets),
        "store": store,
        "capacity": lambda: capacity(options.root),
        "bank": lambda: bank(options.store, options.out),
    }[options.command]()
    print("\n\n".join(tables))


if __name__ == "__main__":
    main()
