"""Kill studies and fleet runs at random moments: is a finished row or check lost, or a bit of a result changed?

    python benchmarks/kills.py study --kills 100 --seed 1
    python benchmarks/kills.py fleet --kills 100      # local runs of `p2o fleet`, in every third folder two at a time
    python benchmarks/kills.py cluster --kills 100    # scheduler, workers and runs of `p2o fleet` on a dask cluster

Each of them is started, killed at a random moment and started again until it is complete, one folder after the other:
by SIGKILL, SIGTERM and SIGINT, one process or its whole group, with one job and with two; in a cluster by SIGKILL. A
third of the kills of a study occur while it starts, reads and plans, all others while rows are computed. After every
kill the store is intact, everything that it contained before is present, and no process is left; what SIGTERM and
SIGINT end has status 130, unless Python has not reached p2o yet. Every row of a study is the same to the last bit as
that of an undisturbed study, except for its run time; a fleet has the expected number of checks of every vehicle.
Exit status 1 if one of these conditions is violated. A seed gives the same moments on machines of the same speed.
"""

from __future__ import annotations

import argparse
import contextlib
import multiprocessing
import os
import random
import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from limits_and_tables import STUDY
from p2o_fleet.drive import drives_of
from p2o_fleet.evidence import Verdict
from p2o_fleet.run import run_fleet
from p2o_fleet.store import Store
from p2o_fleet.worker import CheckSettings
from p2o_study.parallel import Workers
from p2o_study.rows import Rows
from p2o_study.worker import Plugins

_LEAVE_S = 30.0
"""Time that processes may need to end on a busy machine; workers look for their parent every half second."""
_STUCK_S = 300.0


Process = Any
"""A process that leads a group of its own: with `pid`, `poll` and `wait` as of `subprocess.Popen`."""


@dataclass
class Tally:
    """The outcome: `kills` by signal or process, how many of them occurred among the rows, and violated conditions."""

    kills: Counter[str] = field(default_factory=Counter)
    among_rows: int = 0
    folders: int = 0
    count: int = 0
    broken: list[str] = field(default_factory=list)

    def __str__(self) -> str:
        kinds = ", ".join(f"{count} {name}" for name, count in sorted(self.kills.items()))
        head = (
            f"{self.kills.total()} kills ({kinds}), {self.among_rows} of them among the rows; "
            f"{self.folders} folders of {self.count} rows; {len(self.broken)} conditions violated"
        )
        return "\n".join([head, *(f"  {line}" for line in self.broken)])


class Subject:
    """What is killed: `count` rows or checks, the first after `start_s`, each in `row_s`, compared with `expected`."""

    SIGNALS: ClassVar[tuple[signal.Signals, ...]] = (signal.SIGKILL, signal.SIGTERM, signal.SIGINT)
    expected: Mapping[str, object] | None = None
    start_s, row_s = 0.0, 0.12
    is_command, count = False, 0

    def victims(self, processes: list[Process], rng: random.Random) -> dict[str, Process]:
        """Return the processes to kill by name."""
        return {f"run {n}": process for n, process in enumerate(processes) if process.poll() is None}


def campaign(subject: StudyOfStreets | Fleet, kills: int, seed: int, home: Path) -> Tally:
    """Kill a subject at random moments until `kills` kills, in folders of `home`."""
    rng, tally = random.Random(seed), Tally(count=subject.count)
    while tally.kills.total() < kills:
        tally.folders += 1
        folder = home / f"run-{tally.folders}"
        while disturbed(subject, folder, rng, tally, kills):
            print(f"{tally.kills.total()} kills, {len(tally.broken)} conditions violated", file=sys.stderr, flush=True)
        tally.broken += [f"{folder.name}: {fault}" for fault in subject.faults(folder)]
    return tally


def disturbed(subject: StudyOfStreets | Fleet, folder: Path, rng: random.Random, tally: Tally, kills: int) -> bool:
    """Start the subject, kill it, and check the conditions; return whether it is incomplete."""
    before, number, group = subject.finished(folder), rng.choice(subject.SIGNALS), rng.random() < 0.5
    processes = subject.start(folder, tally.folders)
    if tally.kills.total() >= kills:
        for process in processes:
            process.wait(600)
    elif rng.random() < 1 / 3 and subject.start_s:
        _until(rng.uniform(0.0, subject.start_s), lambda: _ended(processes))
    else:
        _until(_STUCK_S, lambda: _ended(processes) or len(subject.finished(folder)) > len(before))
        _until(rng.uniform(0.0, 4 * subject.row_s), lambda: _ended(processes))
    where = f"{folder.name}, kill {tally.kills.total() + 1} ({number.name} to {'all' if group else 'one'})"
    known, victims = subject.finished(folder), subject.victims(processes, rng)
    for name, process in victims.items():
        # Shells also report 130 for SIGINT: Python ends with it if it is interrupted while it compiles a text.
        expected = {0, 130, -signal.SIGINT}
        if number is signal.SIGKILL or not _handles_signals(process.pid):
            expected.add(-number)
        kill(process, number, group=group)
        tally.kills[f"{name.split()[0]} by {number.name}"] += 1
        tally.among_rows += 0 < len(known) < subject.count
        if subject.is_command and process.wait() not in expected:
            tally.broken.append(f"{where}: exit status {process.wait()}")
    for process in (process for process in processes if process.poll() is not None):
        if subject.is_command and process not in victims.values() and process.poll():
            tally.broken.append(f"{where}: ended without a kill with status {process.poll()}")
        if left := _left(process.pid):
            tally.broken.append(f"{where}: {len(left)} processes are left")
            os.killpg(process.pid, signal.SIGKILL)
    now = subject.finished(folder)
    lost = [key for key in before.keys() | known.keys() if key not in now]
    changed = [key for key in now if subject.expected is not None and now[key] != subject.expected.get(key)]
    for keys, problem in ((lost, "lost"), (changed, "changed")):
        if keys:
            tally.broken.append(f"{where}: {len(keys)} rows {problem}, such as {keys[0]}")
    return len(now) < subject.count and bool(victims)


def kill(process: Process, number: signal.Signals = signal.SIGKILL, *, group: bool = True) -> None:
    """Send a signal to a process or to its group, and wait for its end."""
    try:
        (os.killpg if group else os.kill)(process.pid, number)
    except ProcessLookupError:  # it has ended, or does not lead its group yet
        with contextlib.suppress(ProcessLookupError):
            os.kill(process.pid, number)
    process.wait(600)


def _ended(processes: list[Process]) -> bool:
    return all(process.poll() is not None for process in processes)


def _until(limit_s: float, condition: Callable[[], bool]) -> None:
    """Wait until a condition is true, at most `limit_s`."""
    end = time.monotonic() + limit_s
    while not condition() and time.monotonic() < end:
        time.sleep(0.02)


def _handles_signals(process: int) -> bool:
    """Return whether a process handles SIGTERM; False if that cannot be determined."""
    try:
        status = Path(f"/proc/{process}/status").read_text()
    except OSError:
        return False
    caught = next(line for line in status.splitlines() if line.startswith("SigCgt:"))
    return bool(int(caught.split()[1], 16) >> (signal.SIGTERM - 1) & 1)


def _left(session: int) -> list[str]:
    """Return the processes of a session that do not end; none if they cannot be listed."""
    _until(_LEAVE_S, lambda: not _alive(session))
    return _alive(session)


def _alive(session: int) -> list[str]:
    alive = []
    for file in Path("/proc").glob("[0-9]*/stat"):
        with contextlib.suppress(OSError, ValueError):  # it has ended meanwhile
            state, _, _, own, *_ = file.read_text().rpartition(")")[2].split()
            if own == str(session) and state not in "ZX":
                alive.append(file.parent.name)
    return alive


class StudyOfStreets(Subject):
    """A small study of synthetic streets, with the rows of an undisturbed run in `home`."""

    ROWS: ClassVar[str] = """[defaults]
extractor = "depth/rings"
init = "given"
solver = "lm"
[[product]]
matcher = ["ogm", "nearest"]
[[row]]
label = "pairs of frames"
matcher = "ogm"
joint = 2
"""
    """Columns that differ between runs."""
    is_command = True

    def __init__(self, home: Path, scenes: int = 3, seeds: int = 4) -> None:
        self.file, folder = home / "kills.toml", home / "undisturbed"
        data = f"synthetic:?scenes={scenes}&width_px=320&height_px=96&lidar=vlp-16&right=false"
        self.file.write_text(STUDY.format(name="kills", seeds=seeds, data=data) + self.ROWS, encoding="utf-8")
        began = time.monotonic()
        [process] = self.start(folder, 0)
        while process.poll() is None and not self.finished(folder):
            time.sleep(0.02)
        self.start_s = time.monotonic() - began
        if process.wait():
            raise SystemExit("the undisturbed study did not succeed")
        self.expected = self.finished(folder)
        self.count = len(self.expected)
        self.row_s = (time.monotonic() - began - self.start_s) / self.count

    def start(self, folder: Path, number: int) -> list[Process]:
        """Start the study in a session of its own, whose cache is in the folder."""
        words = ["ablate", str(self.file), "--out", str(folder), "--jobs", str(1 + number % 2), "--quiet"]
        environment = {**os.environ, "P2O_CACHE": str(folder / "cache"), "OMP_NUM_THREADS": "1"}
        nowhere = subprocess.DEVNULL
        command = [sys.executable, "-m", "p2o", *words]
        return [subprocess.Popen(command, stdout=nowhere, stderr=nowhere, env=environment, start_new_session=True)]

    def finished(self, folder: Path) -> dict[str, object]:
        """Return the finished rows by key, without their run time."""
        rows = Rows(folder)
        finished = (row for study in rows.studies for row in rows.each(study) if not row.crashed)
        return {
            row.key: (row.status, row.reason, None if row.estimate is None else row.estimate.tolist(), repr(row.rounds))
            for row in finished
        }

    def faults(self, folder: Path) -> list[str]:
        """Return the differences of a complete study from the undisturbed one."""
        rows = self.finished(folder)
        different = [key for key in self.expected.keys() | rows.keys() if rows.get(key) != self.expected.get(key)]
        return [f"{len(different)} rows differ in the end, such as {different[0]}"] if different else []


_FORKS = multiprocessing.get_context("forkserver")
_FORKS.set_forkserver_preload(["p2o_fleet.run", "p2o.run.pipeline", "distributed"])  # saves imports in each run


@dataclass
class Fork:
    """A function in a process of its own group."""

    process: Any

    @classmethod
    def start(cls, work: Callable[..., object], *arguments: object) -> Fork:
        """Start a function."""
        process = _FORKS.Process(target=_grouped, args=(work, *arguments))
        process.start()
        return cls(process)

    @property
    def pid(self) -> int:
        return int(self.process.pid)

    def poll(self) -> int | None:
        status: int | None = self.process.exitcode
        return status

    def wait(self, timeout: float | None = None) -> int:
        self.process.join(timeout)
        return int(self.process.exitcode)


def _grouped(work: Callable[..., object], *arguments: object) -> None:
    os.setsid()
    silence = os.open(os.devnull, os.O_WRONLY)
    for output in (1, 2):
        os.dup2(silence, output)
    work(*arguments)


def _run_fleet(table: Path, folder: Path, workers: Workers) -> None:
    settings = CheckSettings(1, 1, "depth/rings")
    run_fleet(drives_of(str(table)), Store(folder), settings=settings, plugins=Plugins(), workers=workers)


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


class Fleet(Subject):
    """A fleet of five vehicles with `count` small drives in `home`."""

    def __init__(self, home: Path, count: int = 40) -> None:
        self.count, self.table = count, write_drives(home, count)

    def start(self, folder: Path, number: int) -> list[Process]:
        """Start one run, in every third folder two."""
        return [self.run(folder, Workers()) for _ in range(1 + (number % 3 == 0))]

    def run(self, folder: Path, workers: Workers) -> Fork:
        """Start a run."""
        return Fork.start(_run_fleet, self.table, folder, workers)

    def finished(self, folder: Path) -> dict[str, object]:
        """Return the keys of the stored checks."""
        checks = Store(folder).checks() if (folder / "checks").exists() else ()
        return {str(key): None for each in checks for key in each.texts["key"]}

    def faults(self, folder: Path) -> list[str]:
        """Return what is wrong with a folder after a last run that is not disturbed."""
        self.run(folder, Workers()).wait(600)
        checks = list(Store(folder).checks())
        counts = {each.vehicle: len(each) for each in checks}
        expected = {f"van-{vehicle}": self.count // 5 for vehicle in range(5)}
        unreadable = sum(int((each.texts["verdict"] == Verdict.UNREADABLE.value).sum()) for each in checks)
        journals = list((folder / "journal").glob("*.jsonl"))
        faults = {
            f"checks by vehicle are {counts}": counts != expected,
            f"{unreadable} drives are unreadable": unreadable,
            f"{len(journals)} journals are left": journals,
        }
        return [fault for fault, exists in faults.items() if exists]


class FleetOnCluster(Fleet):
    """A fleet that is checked on a dask cluster: a scheduler and two workers are killed, and the run."""

    SIGNALS: ClassVar = (signal.SIGKILL,)

    def __init__(self, home: Path, count: int = 40) -> None:
        super().__init__(home, count)
        self.address, self.processes = "", dict[str, Fork]()

    def start(self, folder: Path, number: int) -> list[Process]:
        """Start the missing processes; without a scheduler all of them."""
        running = {name: process for name, process in self.processes.items() if process.poll() is None}
        if "scheduler" not in running:
            for process in running.values():
                kill(process)
            with socket.socket() as free:
                free.bind(("127.0.0.1", 0))
                port = free.getsockname()[1]
            self.address = f"tcp://127.0.0.1:{port}"
            words = ["--host", "127.0.0.1", "--port", str(port), "--no-dashboard"]
            running = {"scheduler": Fork.start(_dask, "scheduler", words)}
        for name in ("worker 1", "worker 2"):
            if name not in running:
                words = [self.address, "--nthreads", "1", "--no-nanny", "--no-dashboard"]
                running[name] = Fork.start(_dask, "worker", words)
        if "run" not in running:
            running["run"] = self.run(folder, Workers(1, "dask", self.address))
        self.processes = running
        return [running["run"]]

    def victims(self, processes: list[Process], rng: random.Random) -> dict[str, Process]:
        """Return one process; a run whose scheduler is killed ends with an error, or is killed by the next start."""
        name = rng.choice(("worker 1", "worker 2", "scheduler", "run"))
        return {} if _ended(processes) else {name: self.processes[name]}

    def faults(self, folder: Path) -> list[str]:
        """Return what is wrong with a folder after a last run that is not disturbed."""
        self.close()
        return super().faults(folder)

    def close(self) -> None:
        """Kill all processes."""
        for process in self.processes.values():
            kill(process)
        self.processes = {}


def _dask(kind: str, words: list[str]) -> None:
    """Run `dask scheduler` or `dask worker` in this process."""
    from distributed.cli import dask_scheduler, dask_worker

    {"scheduler": dask_scheduler, "worker": dask_worker}[kind].main(words, standalone_mode=False)


SUBJECTS = {"study": StudyOfStreets, "fleet": Fleet, "cluster": FleetOnCluster}


def main() -> int:
    """Kill, and print the outcome."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("subject", choices=SUBJECTS)
    parser.add_argument("--kills", type=int, default=100)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as home:
        tally = campaign(SUBJECTS[options.subject](Path(home)), options.kills, options.seed, Path(home))
    print(tally)
    return 1 if tally.broken else 0


if __name__ == "__main__":
    sys.exit(main())
