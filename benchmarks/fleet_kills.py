"""Runs of `p2o fleet` that are killed at random moments: is a finished check lost, or one counted twice?

`python benchmarks/fleet.py kills` kills local runs, `kills --cluster` the scheduler and the workers of a dask cluster
of local processes and the run that uses it. After each kill, the checks that were stored before have to be there; at
the end, a run that is left alone has to complete every store.
"""

from __future__ import annotations

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
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from p2o_fleet.drive import drives_of
from p2o_fleet.evidence import Verdict
from p2o_fleet.run import run_fleet
from p2o_fleet.store import Store
from p2o_fleet.worker import CheckSettings
from p2o_study.parallel import Workers
from p2o_study.worker import Plugins

_STUCK_S = 300.0
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
    Runs are forks of a process that has imported p2o, or with `commands` they are started as `p2o fleet run`.
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
                        tally[number.name] += 1
                        _kill(process, number)
                now = _stored(folder)
                broken += [f"round {round_number}: {len(before - now)} checks lost"] if before - now else []
                before = now
                if ended or len(now) == drives:
                    break
            start(table, folder, jobs=1).wait(600)
            broken += _judge(folder, drives, round_number)
            print(f"{tally.total()} kills, {len(broken)} faults", file=sys.stderr, flush=True)
    return _outcome(tally, round_number, drives, broken)


def _start(table: Path, folder: Path, jobs: int) -> subprocess.Popen[bytes]:
    words = ["fleet", "run", str(table), "--store", str(folder), "--jobs", str(jobs), "--quiet"]
    words += ["--frames", "1", "--candidates", "1", "--extractor", "depth/rings"]
    nowhere = subprocess.DEVNULL
    return subprocess.Popen(
        [sys.executable, "-m", "p2o", *words], stdout=nowhere, stderr=nowhere, start_new_session=True
    )


_FORKS = multiprocessing.get_context("forkserver")
_FORKS.set_forkserver_preload(["p2o_fleet.run", "p2o.run.pipeline", "distributed"])
"""Processes are forked from a server that has imported most modules, which saves their time in each."""


@dataclass
class _Forked:
    """A process with the methods of Popen that are used here."""

    process: Any

    @classmethod
    def start(cls, work: Callable[..., object], *arguments: object) -> _Forked:
        """Start a function in a process of its own group."""
        process = _FORKS.Process(target=_grouped, args=(work, *arguments))
        process.start()
        return cls(process)

    @property
    def pid(self) -> int:
        return int(self.process.pid)

    def poll(self) -> int | None:
        status: int | None = self.process.exitcode
        return status

    def wait(self, timeout: float) -> None:
        self.process.join(timeout)


def _grouped(work: Callable[..., object], *arguments: object) -> None:
    os.setsid()
    silence = os.open(os.devnull, os.O_WRONLY)
    for output in (1, 2):
        os.dup2(silence, output)
    work(*arguments)


def _fork(table: Path, folder: Path, jobs: int, workers: Workers | None = None) -> _Forked:
    """Start a run in a fork, by default of one process; `jobs` are for commands."""
    return _Forked.start(_run, table, folder, workers or Workers())


def _run(table: Path, folder: Path, workers: Workers) -> None:
    settings = CheckSettings(1, 1, "depth/rings")
    run_fleet(drives_of(str(table)), Store(folder), settings=settings, plugins=Plugins(), workers=workers)


_Run = _Forked | subprocess.Popen[bytes]


def _wait(running: Sequence[_Run], folder: Path, before: int, rng: random.Random) -> bool:
    """Wait until some checks are added, then a random moment; return whether the runs ended before.

    Raises TimeoutError if no check is added for five minutes.
    """
    until = time.monotonic() + _STUCK_S
    while len(_stored(folder)) <= before + rng.randrange(3):
        if all(process.poll() is not None for process in running):
            return True
        if time.monotonic() > until:
            raise TimeoutError(f"no check was added to {folder} for {_STUCK_S:.0f} s")
        time.sleep(0.05)
    time.sleep(rng.random() * 0.5)
    return all(process.poll() is not None for process in running)


def _stored(folder: Path) -> set[str]:
    if not (folder / "checks").exists():
        return set()
    return {str(key) for checks in Store(folder).checks() for key in checks.texts["key"]}


def _judge(folder: Path, drives: int, number: int) -> list[str]:
    every = list(Store(folder).checks())
    counts = {checks.vehicle: len(checks) for checks in every}
    expected = {f"van-{vehicle}": drives // 5 for vehicle in range(5)}
    faults = [] if counts == expected else [f"round {number}: checks by vehicle are {counts}"]
    if unreadable := sum(int((checks.texts["verdict"] == Verdict.UNREADABLE.value).sum()) for checks in every):
        faults.append(f"round {number}: {unreadable} drives are unreadable")
    left = list((folder / "journal").glob("*.jsonl"))
    return faults + ([f"round {number}: {len(left)} journals are left"] if left else [])


@dataclass
class _Cluster:
    """A dask scheduler and two workers."""

    address: str = ""
    processes: dict[str, _Forked] = field(default_factory=dict)

    def __enter__(self) -> _Cluster:
        return self

    def __exit__(self, *error: object) -> None:
        self.end()

    def complete(self) -> None:
        """Start what is missing; without a scheduler, everything."""
        if "scheduler" not in self.processes:
            self.end()
            with socket.socket() as free:
                free.bind(("127.0.0.1", 0))
                port = free.getsockname()[1]
            self.address = f"tcp://127.0.0.1:{port}"
            words = ["--host", "127.0.0.1", "--port", str(port), "--no-dashboard"]
            self.processes["scheduler"] = _Forked.start(_dask, "scheduler", words)
        for name in ("worker 1", "worker 2"):
            if name not in self.processes:
                words = [self.address, "--nthreads", "1", "--no-nanny", "--no-dashboard"]
                self.processes[name] = _Forked.start(_dask, "worker", words)

    def kill(self, name: str) -> None:
        """Kill a process."""
        _kill(self.processes.pop(name))

    def end(self) -> None:
        """Kill everything."""
        for name in list(self.processes):
            self.kill(name)


def _dask(kind: str, words: Sequence[str]) -> None:
    """Run `dask scheduler` or `dask worker` in this process."""
    from distributed.cli import dask_scheduler, dask_worker

    {"scheduler": dask_scheduler, "worker": dask_worker}[kind].main(words, standalone_mode=False)


def _kill(process: _Run, number: int = signal.SIGKILL) -> None:
    """Send a signal to a process and its children, and wait for its end."""
    try:
        os.killpg(process.pid, number)
    except ProcessLookupError:  # it has ended, or not yet its own group
        with contextlib.suppress(ProcessLookupError):
            os.kill(process.pid, number)
    process.wait(60)


def kills_of_cluster(count: int, seed: int, drives: int = 40) -> tuple[list[str], bool]:
    """Kill scheduler, workers and runs by SIGKILL at random moments until `count` kills; return as `kills`.

    A run whose scheduler was killed ends with an error; after 20 s it is killed, too.
    """
    rng, tally, broken = random.Random(seed), Counter[str](), list[str]()
    with tempfile.TemporaryDirectory() as home, _Cluster() as cluster:
        table, number = write_drives(Path(home), drives), 0
        while tally.total() < count:
            number += 1
            folder, before = Path(home) / f"store-{number}", set[str]()
            run: _Forked | None = None
            while tally.total() < count and len(before) < drives:
                cluster.complete()
                if run is None or run.poll() is not None:
                    run = _fork(table, folder, 1, Workers(1, "dask", cluster.address))
                if not _wait([run], folder, len(before), rng):
                    victim = rng.choice(("worker", "scheduler", "run"))
                    tally[victim] += 1
                    if victim == "run":
                        _kill(run)
                    else:
                        cluster.kill("scheduler" if victim == "scheduler" else rng.choice(("worker 1", "worker 2")))
                    if victim == "scheduler":
                        run.wait(20)
                        tally["run"] += run.poll() is None
                        _kill(run)
                now = _stored(folder)
                broken += [f"store {number}: {len(before - now)} checks lost"] if before - now else []
                before = now
            if run is not None:
                _kill(run)
            cluster.complete()
            _fork(table, folder, 1, Workers(1, "dask", cluster.address)).wait(600)
            broken += _judge(folder, drives, number)
            print(f"{tally.total()} kills, {len(broken)} faults", file=sys.stderr, flush=True)
    return _outcome(tally, number, drives, broken)


def _outcome(tally: Counter[str], stores: int, drives: int, broken: Sequence[str]) -> tuple[list[str], bool]:
    line = f"{tally.total()} kills ({', '.join(f'{n} {name}' for name, n in sorted(tally.items()))}), "
    return [f"{line}{stores} stores of {drives} drives: {len(broken)} faults", *broken], bool(broken)
