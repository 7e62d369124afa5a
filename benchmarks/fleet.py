"""What does `p2o fleet` detect, how often is it wrong, how much does it cost, and what is lost when it is killed?

    python benchmarks/fleet.py real --out DIR             # 200 drives of real and simulated rigs, some with a slip
    python benchmarks/fleet.py detect                     # resampled fleets: slips, false alarms, delays
    python benchmarks/fleet.py types                      # a wrong nominal extrinsic of 30 vehicles
    python benchmarks/fleet.py store --jobs 2             # queries over 1,000 vehicles and a year: seconds and memory
    python benchmarks/fleet.py throughput --data DIR      # checks per second with 1, 2 and 4 local workers
    python benchmarks/fleet.py cluster --seconds 4        # what 100 workers would do, from measured task times
    python benchmarks/fleet.py kills --kills 100          # a run that is killed again and again
    python benchmarks/fleet.py bank --store DIR --out FILE # evidence of a store as noise of a simulation

Noise is resampled from measured evidence (`p2o_fleet/noise.json`). Each command prints a table; `kills` has exit
status 1 if evidence was lost or counted twice.
"""

from __future__ import annotations

import argparse
import heapq
import json
import os
import random
import resource
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from fleet_drives import real
from p2o.arrays import Float
from p2o.confidence.audit import AXES
from p2o_fleet.drive import drives_of
from p2o_fleet.fleet_state import fleet_state
from p2o_fleet.run import run_fleet
from p2o_fleet.simulation import Fault, NoiseBank, Scenario, SimulatedVehicle, simulated_fleet, write_fleet
from p2o_fleet.statistics import NoiseModel, discoveries, e_process, local_deviations, noise_scale, systematic
from p2o_fleet.store import Store
from p2o_fleet.worker import CheckSettings
from p2o_study.parallel import Workers
from p2o_study.worker import Plugins

RATE = 0.01
_SAMPLED_VEHICLES = 100


def detect(vehicles: int, checks: int, rigs: Sequence[str], seed: int) -> list[str]:
    """Return the table of delays and false alarms: without faults, with slips, and with all faults."""
    bank = NoiseBank.shipped()
    others = dict.fromkeys((Fault.DRIFT, Fault.SWAPPED, Fault.DIRTY, Fault.BROKEN, Fault.CLOCK), 0.02)
    scenarios = [("no fault", {}, 0.5, 0.05), ("0.5 deg, 5 cm", {Fault.SLIP: 0.1}, 0.5, 0.05)]
    scenarios += [("0.3 deg, 3 cm", {Fault.SLIP: 0.1}, 0.3, 0.03), ("0.2 deg, 2 cm", {Fault.SLIP: 0.1}, 0.2, 0.02)]
    scenarios += [("0.5 deg, 5 cm, other faults", {Fault.SLIP: 0.1, **others}, 0.5, 0.05)]
    lines = [
        "| rig | slips | frames | found in 200 frames | delay in frames: median, 95 % | right axis | false alarms |"
    ]
    lines.append("|---|---|---|---|---|---|---|")
    for rig in rigs:
        for name, shares, turn, shift in scenarios:
            scenario = Scenario(vehicles, checks, 10.0, (rig,), shares, turn, shift, seed=seed)
            lines.append(f"| `{rig}` | {name} | " + " | ".join(_detected(scenario, bank)) + " |")
    return lines


def _detected(scenario: Scenario, bank: NoiseBank) -> list[str]:
    """Return the columns of a scenario; alarms are evaluated after every check of the fleet."""
    fleet = list(simulated_fleet(scenario, bank))
    model = noise_of(fleet)
    by_axis = [logs_of(vehicle, model) for vehicle in fleet]
    total = np.stack([np.logaddexp.reduce(logs, axis=1) - np.log(len(AXES)) for logs in by_axis])
    rejected = np.stack([discoveries(column, RATE) for column in total.T], axis=1)
    frames = sum(int(vehicle.checks.frame_count.sum()) for vehicle in fleet)
    delays, axes, false = [], 0, Counter[str]()
    for vehicle, alarms, logs in zip(fleet, rejected, by_axis, strict=True):
        began = {Fault.SLIP: vehicle.begin, Fault.DRIFT: 0}.get(vehicle.fault, scenario.checks)
        false[vehicle.fault.value] += bool(alarms[:began].any())
        if vehicle.fault is Fault.SLIP:
            first = np.flatnonzero(alarms[began:])
            last = began + int(first[0]) + 1 if len(first) else None
            delays.append(float(vehicle.checks.frame_count[began:last].sum()) if last else np.inf)
            axes += last is not None and int(logs[last - 1].argmax()) == vehicle.axis
    wrong = ", ".join(f"{number} ({fault})" for fault, number in false.items() if number) or "0"
    if not delays:
        return [f"{frames:,}", "", "", "", wrong]
    within = sum(delay <= 200 for delay in delays)
    slowest = np.sort(delays)[int(0.95 * len(delays))]
    delay = f"{np.median(delays):.0f}, {f'{slowest:.0f}' if np.isfinite(slowest) else 'not found'}"
    return [f"{frames:,}", f"{within} of {len(delays)}", delay, str(axes), wrong]


def noise_of(fleet: Sequence[SimulatedVehicle]) -> NoiseModel:
    """Return the noise that a report would estimate from this fleet of one type."""
    deviations = []
    for vehicle in fleet[:_SAMPLED_VEHICLES]:
        own = vehicle.checks.take(np.flatnonzero(vehicle.checks.usable))
        deviations.append(local_deviations(own.error, own.covariance))
    return NoiseModel(noise_scale(deviations))


def logs_of(vehicle: SimulatedVehicle, model: NoiseModel) -> Float:
    """Return the log e-process (T, 6) of a vehicle after each check; checks without an estimate do not change it."""
    usable = vehicle.checks.usable
    own = vehicle.checks.take(np.flatnonzero(usable))
    logs = np.concatenate([np.zeros((1, len(AXES))), e_process(own.error, own.covariance, model)])
    return logs[np.cumsum(usable)]


def types(fleets: int, vehicles: int) -> list[str]:
    """Return how often a common yaw error of 30 vehicles is found, and how often one is reported without an error."""
    bank, tolerance = NoiseBank.shipped(), np.repeat([0.03, 0.01], 3)
    lines = ["| rig | wrong by | fleets | found | other axes reported |", "|---|---|---|---|---|"]
    for rig in ("kitti", "sim-hdl-64e"):
        for size in (0.0, 0.1, 0.15):
            detected = other = 0
            for seed in range(fleets):
                scenario = Scenario(vehicles, 12, 10.0, (rig,), wrong_cad_deg=size, seed=1000 + seed)
                own = [vehicle.checks for vehicle in simulated_fleet(scenario, bank)]
                # Measured noise of a rig has a median of zero; its mean is the bias of the simulation, not of a type.
                means = np.stack([checks.error.mean(axis=0) for checks in own]) - _bias(bank, rig)
                sigmas = np.stack([np.sqrt(np.einsum("tii->ti", c.covariance).mean(axis=0) / len(c)) for c in own])
                alarms = discoveries(systematic(means, sigmas, tolerance).log_e, RATE)
                detected += bool(alarms[2]) and size > 0
                other += int(np.delete(alarms, 2).sum()) + (bool(alarms[2]) and size == 0)
            lines.append(f"| `{rig}` | {size:g} deg | {fleets} | {detected} | {other} |")
    return lines


def _bias(bank: NoiseBank, rig: str) -> Float:
    return np.asarray(bank.centred[bank.groups[rig]].mean(axis=0))


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


def throughput(data: Sequence[str], repeat: int, workers: Sequence[int]) -> list[str]:
    """Return checks per minute of drives (DATASET:PATH, extrinsic `truth`) with several numbers of local workers."""
    lines = ["| workers | checks | wall, s | checks per minute | s of work per check |", "|---|---|---|---|---|"]
    with tempfile.TemporaryDirectory() as home:
        table = Path(home) / "drives.csv"
        rows = [f"v{number},front,top,{text},truth,{number}" for number, text in enumerate(list(data) * repeat)]
        table.write_text("vehicle,camera,lidar,data,extrinsic,time\n" + "\n".join(rows) + "\n")
        for count in workers:
            command = [sys.executable, "-m", "p2o", "fleet", "run", str(table), "--store", f"{home}/{count}", "--json"]
            began = time.monotonic()
            done = subprocess.run([*command, "--jobs", str(count)], capture_output=True, text=True, check=True)
            wall, counts = time.monotonic() - began, json.loads(done.stdout)
            checks = counts["checked"]
            each = [f"{wall:.0f}", f"{60 * checks / wall:.1f}", f"{counts['seconds'] / checks:.2f}"]
            lines.append(f"| {count} | {checks} | " + " | ".join(each) + " |")
    return lines


def cluster(seconds: float, megabytes: float, workers: Sequence[int], checks: int, link_gbit: float) -> list[str]:
    """Return what a scheduler with many workers would do: durations vary as measured ones, logs share one link.

    Each worker fetches a log of `megabytes` over a link that all share, then computes; the scheduler needs 1 ms a task.
    """
    rng = np.random.default_rng(0)
    lines = ["| workers | hours for the checks | checks per hour | busy with work | limit |", "|---|---|---|---|---|"]
    durations = seconds * rng.lognormal(-0.02, 0.2, checks)
    fetch_s, schedule_s = 8e-3 * megabytes / link_gbit, 1e-3
    for count in workers:
        free, link, scheduler, end = [0.0] * count, 0.0, 0.0, 0.0
        for duration in durations:
            ready = heapq.heappop(free)
            scheduler = max(scheduler, ready) + schedule_s
            link = max(link, scheduler) + fetch_s
            end = link + float(duration)
            heapq.heappush(free, end)
        last = max(free)
        busy = durations.sum() / (last * count)
        limit = "link" if fetch_s * count > seconds else "workers"
        lines.append(f"| {count} | {last / 3600:.2f} | {3600 * checks / last:,.0f} | {100 * busy:.0f} % | {limit} |")
    return lines


_FRAME = """camera:
  model: PINHOLE
  width: 160
  height: 64
  params: [100, 100, 80, 32]
image: image.png
cloud: cloud.npy
depth: depth.npy
truth: [[0, -1, 0, 0], [0, 0, -1, -0.1], [1, 0, 0, -0.3], [0, 0, 0, 1]]
"""


def write_drives(folder: Path, count: int) -> Path:
    """Write drives of one tiny frame without edges, whose check takes a fraction of a second; return their table."""
    from PIL import Image

    rows = ["vehicle,camera,lidar,data,extrinsic,time"]
    for number in range(count):
        frame = folder / f"drive-{number}" / "frame"
        frame.mkdir(parents=True)
        Image.new("RGB", (160, 64), (number % 256, 90, 90)).save(frame / "image.png")
        angle = np.linspace(-0.5, 0.5, 200)
        cloud = np.column_stack([10 * np.cos(angle), 10 * np.sin(angle), np.full(200, number / count)])
        np.save(frame / "cloud.npy", cloud)
        np.save(frame / "depth.npy", np.full((64, 160), 10.0, np.float32))
        (frame / "frame.yaml").write_text(_FRAME)
        rows.append(f"van-{number % 5},front,top,folder:{frame.parent},truth,{1767225600 + 3600 * number}")
    table = folder / "drives.csv"
    table.write_text("\n".join(rows) + "\n")
    return table


def kills(count: int, seed: int, drives: int = 40, *, commands: bool = False) -> tuple[list[str], bool]:
    """Kill runs at random moments until `count` kills; return what was lost, and whether anything was.

    Two runs work on one store at a time in every third round. After each kill, evidence that was read before is there.
    Runs are forked from this process, which saves their start, or with `commands` started as `p2o fleet run`.
    """
    start = _start if commands else _fork
    rng, tally, broken = random.Random(seed), Counter[str](), list[str]()
    with tempfile.TemporaryDirectory() as home:
        table = write_drives(Path(home), drives)
        round_number = 0
        while tally.total() < count:
            round_number += 1
            folder = Path(home) / f"store-{round_number}"
            before: set[str] = set()
            while tally.total() < count:
                running = [start(table, folder, jobs=1 + round_number % 2) for _ in range(1 + (round_number % 3 == 0))]
                number = rng.choice((signal.SIGKILL, signal.SIGTERM, signal.SIGINT))
                ended = _wait(running, folder, len(before), rng)
                for process in running:
                    if process.poll() is None:
                        os.killpg(process.pid, number)
                        tally[number.name] += 1
                    process.wait(60)
                now = _stored(folder)
                broken += [f"round {round_number}: {len(before - now)} checks lost"] if before - now else []
                before = now
                if ended or len(now) == drives:
                    break
            start(table, folder, jobs=1).wait(600)
            broken += _judge(folder, drives, round_number)
            print(f"{tally.total()} kills, {len(broken)} faults", file=sys.stderr, flush=True)
    line = f"{tally.total()} kills ({', '.join(f'{n} {name}' for name, n in sorted(tally.items()))}), "
    line += f"{round_number} stores of {drives} drives: {len(broken)} faults"
    return [line, *broken], bool(broken)


def _start(table: Path, folder: Path, jobs: int) -> subprocess.Popen[bytes]:
    words = ["fleet", "run", str(table), "--store", str(folder), "--jobs", str(jobs), "--quiet"]
    words += ["--frames", "1", "--candidates", "1", "--extractor", "depth/rings"]
    nowhere = subprocess.DEVNULL
    return subprocess.Popen(
        [sys.executable, "-m", "p2o", *words], stdout=nowhere, stderr=nowhere, start_new_session=True
    )


@dataclass
class _Forked:
    """A run in a process that was forked from this one, with the methods of Popen that are used here."""

    pid: int
    status: int | None = None

    def poll(self) -> int | None:
        if self.status is None and os.waitpid(self.pid, os.WNOHANG)[0]:
            self.status = 0
        return self.status

    def wait(self, timeout_s: float) -> None:
        until = time.monotonic() + timeout_s
        while self.poll() is None and time.monotonic() < until:
            time.sleep(0.02)


def _fork(table: Path, folder: Path, jobs: int) -> _Forked:
    """Start a run of one process in a fork; `jobs` are for commands."""
    pid = os.fork()
    if pid:
        return _Forked(pid)
    os.setsid()
    try:
        run_fleet(
            drives_of(str(table)),
            Store(folder),
            settings=CheckSettings(1, 1, "depth/rings"),
            plugins=Plugins(),
            workers=Workers(),
        )
    finally:
        os._exit(0)


_Run = _Forked | subprocess.Popen[bytes]


def _wait(running: Sequence[_Run], folder: Path, before: int, rng: random.Random) -> bool:
    """Wait until some checks are added, then a random moment; return whether the runs ended before."""
    while len(_stored(folder)) <= before + rng.randrange(3):
        if all(process.poll() is not None for process in running):
            return True
        time.sleep(0.05)
    time.sleep(rng.random() * 0.5)
    return all(process.poll() is not None for process in running)


def _stored(folder: Path) -> set[str]:
    if not (folder / "checks").exists():
        return set()
    return {str(key) for checks in Store(folder).checks() for key in checks.texts["key"]}


def _judge(folder: Path, drives: int, number: int) -> list[str]:
    counts = {checks.vehicle: len(checks) for checks in Store(folder).checks()}
    expected = {f"van-{vehicle}": drives // 5 for vehicle in range(5)}
    faults = [] if counts == expected else [f"round {number}: checks by vehicle are {counts}"]
    left = list((folder / "journal").iterdir())
    return faults + ([f"round {number}: {len(left)} journals are left"] if left else [])


def write_bank(source: Path, out: Path, rigs: Sequence[str]) -> list[str]:
    """Write the usable evidence of a store, of at least six frames each, as the noise of a simulation."""
    bank = NoiseBank.of_store(Store.existing(source))
    rows = [row for row in bank.rows() if row["frames"] >= 6 and row["rig"] in rigs]
    about = "Evidence of p2o fleet run at published or exact extrinsics; docs/how-to/fleet.md"
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
    own.add_argument("--rigs", default="kitti,sim-hdl-64e")
    own.add_argument("--seed", type=int, default=0)
    own = commands.add_parser("types")
    own.add_argument("--fleets", type=int, default=100)
    own.add_argument("--vehicles", type=int, default=30)
    own = commands.add_parser("store")
    own.add_argument("--vehicles", type=int, default=1000)
    own.add_argument("--days", type=int, default=365)
    own.add_argument("--per-day", type=int, default=10)
    own.add_argument("--jobs", type=int, default=2)
    own = commands.add_parser("throughput")
    own.add_argument("--data", action="append", required=True, help="DATASET:PATH of a drive, more than once")
    own.add_argument("--repeat", type=int, default=1)
    own.add_argument("--workers", default="1,2,4")
    own = commands.add_parser("cluster")
    own.add_argument("--seconds", type=float, required=True, help="measured seconds of work per check")
    own.add_argument("--megabytes", type=float, default=200.0, help="data that a check reads")
    own.add_argument("--workers", default="1,10,100,1000")
    own.add_argument("--checks", type=int, default=10000)
    own.add_argument("--link-gbit", type=float, default=10.0)
    own = commands.add_parser("kills")
    own.add_argument("--kills", type=int, default=100)
    own.add_argument("--seed", type=int, default=0)
    own.add_argument("--commands", action="store_true", help="start `p2o fleet run` each time: slower")
    own = commands.add_parser("bank")
    own.add_argument("--store", type=Path, required=True)
    own.add_argument("--out", type=Path, required=True)
    own.add_argument("--rigs", default="kitti,sim-hdl-64e,sim-os1-64,sim-hdl-32e")
    words = vars(parser.parse_args(argv))
    command = words.pop("command")
    for name in ("workers", "rigs"):
        if name in words:
            words[name] = [int(word) if name == "workers" else word for word in words[name].split(",")]
    failed = False
    if command == "kills":
        lines, failed = kills(words["kills"], words["seed"], commands=words["commands"])
    elif command == "bank":
        lines = write_bank(words["store"], words["out"], words["rigs"])
    else:
        lines = {
            "real": real,
            "detect": detect,
            "types": types,
            "store": store,
            "throughput": throughput,
            "cluster": cluster,
        }[command](**words)
    print("\n".join(lines))
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
