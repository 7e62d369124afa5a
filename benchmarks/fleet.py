"""What does `p2o fleet` detect, how often is it wrong, and how much does it cost?

    python benchmarks/fleet.py real --out DIR              # 200 drives of real and simulated rigs, some with a slip
    python benchmarks/fleet.py detect                      # resampled fleets: slips, drifts, wrong types, false alarms
    python benchmarks/fleet.py store                       # queries over 1,000 vehicles and a year: seconds and memory

Noise is resampled from measured evidence (`p2o_fleet/noise.json`). Each command prints tables; `kills.py` kills runs.
"""

from __future__ import annotations

import argparse
import resource
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

from fleet_detection import detect
from fleet_drives import real
from limits_and_tables import table
from p2o_fleet.fleet_state import fleet_state
from p2o_fleet.simulation import Fault, NoiseBank, Scenario, simulated_fleet, write_fleet
from p2o_fleet.store import Store
from p2o_study.parallel import Workers

VEHICLES, DAYS, PER_DAY, JOBS = 1000, 365, 10, 2


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


def main() -> None:
    """Print the tables of a command."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    commands = parser.add_subparsers(dest="command", required=True)
    commands.add_parser("detect")
    commands.add_parser("store")
    drives = commands.add_parser("real")
    drives.add_argument("--root", type=Path, default=Path("build/data"), help="folder of the real frames")
    drives.add_argument("--out", type=Path, required=True, help="folder of the table, the store and the report")
    options = parser.parse_args()
    tables = {"real": lambda: real(options.root, options.out), "detect": detect, "store": store}[options.command]()
    print("\n\n".join(tables))


if __name__ == "__main__":
    main()
