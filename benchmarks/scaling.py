"""Measure rows per minute by workers, and predict the bottleneck at 1,000 workers and a million rows.

    python benchmarks/scaling.py measure [--workers 1 2 4] [--rows 200] [--keep FILE]     # this machine
    python benchmarks/scaling.py plan FILE [--rows 1000000]                               # a simulated scheduler

`measure` runs a study of single synthetic frames from many starts (features kept beforehand, so that rows are
calibrations alone) with N processes, and with N local dask workers where dask is installed, each into a
store of its own. Printed are rows a minute, and what a row costs the process that hands it out: planning, asking the
store, pickling the job, handing it to a backend and taking it back (jobs that do nothing), and writing the row. `plan`
takes these times: one scheduler serves every row twice, before and after a worker is busy with it for one of the
measured times of rows, in the order of arrival. It prints rows a minute and how busy the scheduler is against the
number of workers, and the other needs of a million rows: bytes of plan, of store and of features read.
"""

from __future__ import annotations

import argparse
import heapq
import json
import pickle
import statistics
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from p2o import P2OError, Registry
from p2o.cache import FeatureCache, content_hash
from p2o_study import worker
from p2o_study.ablate import ablate
from p2o_study.parallel import Workers
from p2o_study.store import FILE, Store, StoredRow
from p2o_study.study import find_study

FRAMES, BARE_JOBS = 4, 400
STUDY = """
name = "scaling"
title = "Rows a minute"
perturb = "1deg 0.05m"
seeds = {seeds}

[[dataset]]
name = "streets"
data = "synthetic:"
options = {{ scenes = {frames}, width_px = 621, height_px = 188, right = false }}

[defaults]
extractor = "depth/rings"
matcher = "ogm"
solver = "lm"
init = "search"

[[row]]
label = "ogm"
"""
LINK_BYTES_PER_S = 1.25e9
"""A file server on a link of ten gigabit a second, which `plan` takes for where features and the store lie."""


@dataclass(frozen=True)
class Speed:
    """Rows per minute with N workers of a backend, with and without planning and start of workers."""

    backend: str
    workers: int
    rows_a_minute: float
    rows_a_minute_once_running: float


@dataclass(frozen=True)
class Costs:
    """What `measure` finds: seconds and bytes of a row, and rows a minute as they were.

    `row_s` are times of rows in a worker; `plan_s` to `put_s` are spent in the process that hands rows out, `hand_s` by
    backend. `row_bytes` is what a row adds to the store, `plan_bytes` what a planned one holds in memory, `job_bytes`
    and `done_bytes` what goes to a worker and comes back, `feature_bytes` what a worker reads of a new frame.
    """

    row_s: tuple[float, ...]
    plan_s: float
    plan_bytes: float
    ask_s: float
    put_s: float
    pickle_s: float
    hand_s: dict[str, float]
    job_bytes: int
    done_bytes: int
    row_bytes: float
    feature_bytes: float
    speeds: tuple[Speed, ...]

    def served_s(self, backend: str) -> float:
        """Return for how long the process that hands rows out is busy with each."""
        return self.ask_s + self.put_s + self.pickle_s + self.hand_s[backend]


@dataclass(frozen=True)
class Outcome:
    """What a simulated scheduler comes to: rows a minute, and shares of time that it and its workers are busy."""

    rows_a_minute: float
    scheduler_busy: float
    workers_busy: float


def simulated(rows: int, workers: int, row_s: Sequence[float], served_s: float, seed: int = 0) -> Outcome:
    """Return the simulated throughput of one scheduler with N workers and M rows.

    The scheduler does one thing at a time, first come first served: half of `served_s` before a row goes out, half when
    it is back. Times of rows are drawn from `row_s`.
    """
    times = np.random.default_rng(seed).choice(np.asarray(row_s, float), rows)
    half, free, out, back = served_s / 2, 0.0, 0, 0
    asks: list[tuple[float, int]] = [(0.0, 0)] * min(workers, rows)
    """(when, 1 if a row comes back): a worker without a row asks for one."""
    heapq.heapify(asks)
    while back < rows:
        when, returned = heapq.heappop(asks)
        free = max(free, when)
        if returned:
            free += half
            back += 1
        if out < rows:
            free += half
            heapq.heappush(asks, (free + times[out], 1))
            out += 1
    return Outcome(60 * rows / free, rows * served_s / free, float(times.sum()) / (workers * free))


def bare(job: int) -> int:
    """Return the job: what a backend costs that has nothing to do."""
    return job


def hand_s(workers: Workers) -> float:
    """Return the seconds that an empty job costs its scheduler, once workers run."""

    def lost(job: Any, problem: P2OError) -> Any:
        raise problem

    with workers.start() as run:
        list(run(bare, range(20), lost))
        began = time.perf_counter()
        list(run(bare, range(BARE_JOBS), lost))
        return (time.perf_counter() - began) / BARE_JOBS


def speed(name: str, workers: Workers, rows: int, cache: FeatureCache) -> tuple[Speed, list[StoredRow], int]:
    """Return how fast a study runs, its rows, and the size of its store in bytes."""
    arrived: list[float] = []
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "scaling.toml"
        file.write_text(STUDY.format(frames=FRAMES, seeds=rows // FRAMES))
        study = find_study(str(file), Registry.load())
        began = time.perf_counter()
        done = ablate(
            study,
            folder,
            workers=workers,
            cache=cache,
            on_progress=lambda p: arrived.append(time.perf_counter()) if p.phase == "calibrate" else None,
        )
        whole = time.perf_counter() - began
        size = sum(path.stat().st_size for path in Path(folder).glob(FILE + "*"))
    running = arrived[-1] - arrived[len(arrived) // 4]
    share = len(arrived) - 1 - len(arrived) // 4
    return (
        Speed(name, workers.jobs, 60 * len(done.rows) / whole, 60 * share / running),
        list(done.rows),
        size,
    )


def per_call(work: Callable[[], Any], times: int) -> float:
    """Return the median seconds of a call."""
    took = []
    for _ in range(times):
        began = time.perf_counter()
        work()
        took.append(time.perf_counter() - began)
    return statistics.median(took)


def backends() -> Iterator[str]:
    """Yield the backends that are installed, but for ray."""
    yield "loky"
    try:
        Workers(1, "dask")
    except P2OError:
        return
    yield "dask"


def measure(counts: Sequence[int], rows: int) -> Costs:
    """Return what rows cost on this machine; each number of workers on every backend."""
    with tempfile.TemporaryDirectory() as kept:
        cache = FeatureCache(Path(kept))
        first, done, size = speed("in this process", Workers(1), rows, cache)
        # Extraction is in a row's seconds by what it once took; the rows here find it done.
        row_s = [sum(v for k, v in row.seconds.items() if k != "extract") for row in done]
        features = sum(path.stat().st_size for path in Path(kept).rglob("*") if path.is_file()) / FRAMES
        speeds = [first]
        for backend in backends():
            for count in counts:
                if backend == "loky" and count == 1:
                    continue
                speeds.append(speed(backend, Workers(count, backend), rows, cache)[0])  # type: ignore[arg-type]
        row = done[0]
        with tempfile.TemporaryDirectory() as folder, Store.open(folder) as store:
            keys = iter(str(number) for number in range(10**9))
            put_s = per_call(lambda: store.put(replace(row, key=next(keys))), 200)
            ask_s = per_call(lambda: store.finished([next(keys)]), 200)
        facts = worker.FrameRecord(
            worker.Source(worker.Plugins(), "synthetic:", "{}", 0, row.place), row.inputs[row.frames[0]]
        )
        job = worker.CalibrateJob(row, json.dumps(row.recipe), (facts,), Path(kept), ({"image": "0" * 64},))
        sent, back = pickle.dumps(job), pickle.dumps(row)
        pickle_s = per_call(lambda: pickle.dumps(job), 200) + per_call(lambda: pickle.loads(back), 200)  # noqa: S301 (our own)
        plan_s = per_call(lambda: content_hash({"method": row.key, "start": row.start, "truth": row.truth}), 200)
    return Costs(
        tuple(row_s),
        plan_s,
        float(len(pickle.dumps(facts)) + len(pickle.dumps(_planned(row)))),
        ask_s,
        put_s,
        pickle_s,
        {name: hand_s(Workers(max(counts), name)) for name in backends()},  # type: ignore[arg-type]
        len(sent),
        len(back),
        size / len(done),
        features,
        tuple(speeds),
    )


def _planned(row: StoredRow) -> tuple[str, ...]:
    return (row.key, row.study, row.row, row.section, row.dataset, row.place)


def print_measured(costs: Costs) -> None:
    """Print the measurements, and the prediction of the simulated scheduler for the same workers."""
    print("| backend | workers | rows a minute, all in | once running | simulated |")
    print("|---|---|---|---|---|")
    for one in costs.speeds:
        backend = one.backend if one.backend in costs.hand_s else "loky"
        served = costs.served_s(backend) if one.backend in costs.hand_s else costs.ask_s + costs.put_s
        told = simulated(20_000, one.workers, costs.row_s, served).rows_a_minute
        print(
            f"| {one.backend} | {one.workers} | {one.rows_a_minute:.0f} | {one.rows_a_minute_once_running:.0f} "
            f"| {told:.0f} |"
        )
    handed = ", ".join(f"{name} {1e3 * value:.2f}" for name, value in costs.hand_s.items())
    print(
        f"\na row: {statistics.median(costs.row_s):.3f} s in a worker (median); ms of the process that hands rows out: "
        f"planning {1e3 * costs.plan_s:.3f}, asking the store {1e3 * costs.ask_s:.3f}, pickling "
        f"{1e3 * costs.pickle_s:.3f}, handing out and taking back {handed}, writing {1e3 * costs.put_s:.3f}; bytes: "
        f"{costs.job_bytes} sent, {costs.done_bytes} back, {costs.row_bytes:.0f} in the store, "
        f"{costs.feature_bytes:.0f} of features of a frame"
    )


def print_plan(costs: Costs, rows: int) -> None:
    """Print the prediction of the simulated scheduler for N rows, and their other needs."""
    tried = min(rows, 200_000)  # as good as more: it settles within a few thousand rows
    for backend in costs.hand_s:
        print(f"\n{backend}: {1e3 * costs.served_s(backend):.2f} ms of the scheduler for each row\n")
        print(
            "| workers | rows a minute | scheduler busy | workers busy | the rows take | bytes of features a second |"
        )
        print("|---|---|---|---|---|---|")
        for workers in (1, 2, 10, 100, 300, 1000, 3000):
            found = simulated(tried, workers, costs.row_s, costs.served_s(backend))
            hours = rows / found.rows_a_minute / 60
            read = found.rows_a_minute / 60 * costs.feature_bytes
            print(
                f"| {workers} | {found.rows_a_minute:.0f} | {found.scheduler_busy:.0%} | {found.workers_busy:.0%} "
                f"| {hours:.1f} h | {read:.1e} ({read / LINK_BYTES_PER_S:.1%} of ten gigabit) |"
            )
    print(
        f"\n{rows} rows: planning {rows * costs.plan_s / 60:.1f} min in one process, a plan of at least "
        f"{rows * costs.plan_bytes / 1e9:.1f} GB in its memory, a store of {rows * costs.row_bytes / 1e9:.1f} GB"
    )


def main() -> None:
    """Measure, or plan."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    commands = parser.add_subparsers(dest="command", required=True)
    measuring = commands.add_parser("measure")
    measuring.add_argument("--workers", type=int, nargs="+", default=[1, 2, 4])
    measuring.add_argument("--rows", type=int, default=200)
    measuring.add_argument("--keep", type=Path)
    planning = commands.add_parser("plan")
    planning.add_argument("file", type=Path)
    planning.add_argument("--rows", type=int, default=1_000_000)
    said = parser.parse_args()
    if said.command == "measure":
        costs = measure(said.workers, said.rows)
        if said.keep is not None:
            said.keep.write_text(json.dumps(asdict(costs)))
        print_measured(costs)
        return
    kept = json.loads(said.file.read_text())
    costs = Costs(**{**kept, "speeds": tuple(Speed(**one) for one in kept["speeds"])})
    print_plan(costs, said.rows)


if __name__ == "__main__":
    main()
