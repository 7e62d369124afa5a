"""A study on a dask cluster that breaks: at most one line of an error, all finished rows kept, the next step stated."""

from __future__ import annotations

import contextlib
import importlib.util
import os
import socket
import subprocess
import sys
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.study_bench import QUICK, Bench

pytestmark = [
    pytest.mark.system,
    pytest.mark.skipif(importlib.util.find_spec("distributed") is None, reason='needs pip install ".[dask]"'),
    pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="looks for processes in /proc"),
]
SEEDS = 50
ABSENT_S = 8.0
"""For how long the started study lets a cluster be without workers or an answer: less than for users."""


def _started(bench: Bench, *words: str) -> subprocess.Popen[str]:
    """Start a study on dask and return when some of its rows are stored."""
    text = QUICK.replace("seeds = 2", f"seeds = {SEEDS}") + "options.calibrator.sleep_s = 0.05\n"
    code = f"from p2o_study import parallel; parallel._ABSENT_S = {ABSENT_S}; from p2o.cli import main; exit(main())"
    return bench.started(text, 5, "--backend", "dask", "--jobs", "2", *words, python=["-c", code])


def _workers_of(process: subprocess.Popen[str]) -> list[int]:
    """Return the ids of the dask workers that a process has started."""
    found = []
    for stat in Path("/proc").glob("[0-9]*/stat"):
        with contextlib.suppress(OSError):
            parent = int(stat.read_text().rpartition(")")[2].split()[1])
            if parent == process.pid and b"multiprocessing-fork" in (stat.parent / "cmdline").read_bytes():
                found.append(int(stat.parent.name))
    return found


def test_killed_workers_cost_no_row_and_no_line(bench: Bench) -> None:
    """Of one worker that is killed, the other does its jobs: test_ablate.py."""
    process = _started(bench)
    workers = _workers_of(process)
    assert len(workers) == 2
    for pid in workers:
        os.kill(pid, 9)
    _, error = process.communicate(timeout=300)
    assert (process.returncode, error) == (0, "")
    assert len(bench.keys()) == 3 * SEEDS


def test_a_plugin_that_crashes_its_dask_worker_is_a_row(bench: Bench) -> None:
    done = bench.cli(QUICK + 'options.calibrator.die_on = "tiny/001"\n', "--backend", "dask", "--jobs", "2", "--quiet")
    assert (done.returncode, done.stderr) == (1, "")
    assert "2 (2 crashed)" in done.stdout


class _Cluster:
    """A scheduler with two workers, and a relay in front of the scheduler that can be cut."""

    def __init__(self, folder: Path) -> None:
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.address = f"tcp://127.0.0.1:{self._listener.getsockname()[1]}"
        with socket.create_server(("127.0.0.1", 0)) as probe:
            self._port = probe.getsockname()[1]
        command = [sys.executable, "-m", "distributed.cli.dask_scheduler", "--host", "127.0.0.1", "--no-dashboard"]
        self.scheduler = self._process(*command, "--port", str(self._port))
        command = [sys.executable, "-m", "distributed.cli.dask_worker", f"tcp://127.0.0.1:{self._port}", "--no-nanny"]
        command += ["--nthreads", "1", "--no-dashboard", "--local-directory", str(folder)]
        self.workers = [self._process(*command) for _ in range(2)]
        self._ends: list[socket.socket] = []
        threading.Thread(target=self._relay, daemon=True).start()

    @staticmethod
    def _process(*command: str) -> subprocess.Popen[bytes]:
        return subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)

    def _relay(self) -> None:
        with contextlib.suppress(OSError):
            while True:
                near, _ = self._listener.accept()
                try:
                    far = socket.create_connection(("127.0.0.1", self._port))
                except OSError:  # the scheduler has not started yet, or has ended
                    near.close()
                    continue
                self._ends += [near, far]
                for source, sink in ((near, far), (far, near)):
                    threading.Thread(target=self._copy, args=(source, sink), daemon=True).start()

    @staticmethod
    def _copy(source: socket.socket, sink: socket.socket) -> None:
        with contextlib.suppress(OSError):
            while data := source.recv(1 << 16):
                sink.sendall(data)
        for end in (source, sink):
            with contextlib.suppress(OSError):
                end.shutdown(socket.SHUT_RDWR)

    def cut(self) -> None:
        """Close all connections and accept no more."""
        with contextlib.suppress(OSError):
            self._listener.shutdown(socket.SHUT_RDWR)
        for end in (self._listener, *self._ends):
            with contextlib.suppress(OSError):
                end.shutdown(socket.SHUT_RDWR)
            end.close()


@pytest.fixture
def cluster(tmp_path: Path) -> Iterator[_Cluster]:
    made = _Cluster(tmp_path)
    yield made
    made.cut()
    for process in (*made.workers, made.scheduler):
        process.kill()
        process.wait()


@pytest.mark.parametrize("case", ["the scheduler is killed", "the connection is cut", "all workers are killed"])
def test_a_lost_cluster_is_one_line_that_states_the_next_step(bench: Bench, cluster: _Cluster, case: str) -> None:
    process = _started(bench, "--address", cluster.address)
    before = len(bench.keys())
    if case == "the scheduler is killed":
        cluster.scheduler.kill()
    elif case == "the connection is cut":
        cluster.cut()
    else:
        for worker in cluster.workers:
            worker.kill()
    _, error = process.communicate(timeout=200)
    assert process.returncode == 2, error
    [line] = error.splitlines()
    assert len(bench.keys()) >= before
    assert line.startswith(f"p2o: error: {cluster.address}: the workers of --backend dask were lost; ")
    assert line.endswith("start scheduler and workers again, then run the same command")
