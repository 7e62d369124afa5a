"""Measure rows per minute by workers.

    python benchmarks/scaling.py [--workers 1 2 4] [--rows 200]

A study of single synthetic frames from many initial guesses (features are extracted before, so that rows are
calibrations alone) is run with N processes, and with N local dask workers where dask is installed, each into a folder
of its own. Printed are rows a minute, and the processor time of the process that distributes the rows for each of them:
planning, sending it to a worker, receiving and writing it, and polling.
"""

from __future__ import annotations

import argparse
import statistics
import tempfile
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from limits_and_tables import STUDY, table
from p2o import P2OError, Registry
from p2o.cache import FeatureCache
from p2o_study.ablate import ablate
from p2o_study.parallel import Workers
from p2o_study.study import find_study

FRAMES = 4
DATA = f"synthetic:?scenes={FRAMES}&width_px=621&height_px=188&right=false"
ROW = """[[row]]
label = "ogm"
extractor = "depth/rings"
matcher = "ogm"
solver = "lm"
init = "search"
"""


@dataclass(frozen=True)
class Speed:
    """Rows per minute with N workers of a backend, with and without planning and start of workers.

    `served_s` are processor seconds of the distributing process per row, after the first quarter of the rows.
    """

    backend: str
    workers: int
    rows_a_minute: float
    rows_a_minute_once_running: float
    served_s: float


def speed(name: str, workers: Workers, rows: int, cache: FeatureCache) -> tuple[Speed, list[float], float]:
    """Return the speed of a study, the seconds of its rows without extraction, and their size in bytes."""
    arrived: list[tuple[float, float]] = []
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "scaling.toml"
        file.write_text(STUDY.format(name="scaling", seeds=rows // FRAMES, data=DATA) + ROW)

        def on_progress(progress: object) -> None:
            if getattr(progress, "phase", "") == "calibrate":
                arrived.append((time.perf_counter(), time.process_time()))

        began = time.perf_counter()
        done = ablate(
            find_study(str(file), Registry.load()), folder, workers=workers, cache=cache, on_progress=on_progress
        ).rows
        total = time.perf_counter() - began
        size = sum(path.stat().st_size for path in Path(folder).iterdir()) / len(done)
        row_s = [sum(seconds for stage, seconds in row.seconds.items() if stage != "extract") for row in done]
    first = len(arrived) // 4
    count = len(arrived) - 1 - first
    wall_s, cpu_s = np.subtract(arrived[-1], arrived[first])
    return Speed(name, workers.jobs, 60 * len(done) / total, 60 * count / wall_s, cpu_s / count), row_s, size


def backends() -> Iterator[str]:
    """Yield the backends that are installed, without ray."""
    yield "loky"
    try:
        Workers(1, "dask")
    except P2OError:
        return
    yield "dask"


def measured(counts: Sequence[int], rows: int) -> str:
    """Return what rows cost on this machine, as text: each number of workers on every backend."""
    with tempfile.TemporaryDirectory() as folder:
        cache = FeatureCache(Path(folder))
        first, row_s, size = speed("in this process", Workers(1), rows, cache)
        features = sum(path.stat().st_size for path in Path(folder).rglob("*") if path.is_file()) / FRAMES
        speeds = [first]
        for backend in backends():
            for count in counts:
                if backend != "loky" or count > 1:
                    workers = Workers(count, backend)  # type: ignore[arg-type]
                    speeds.append(speed(backend, workers, rows, cache)[0])
    lines = [(s.backend, s.workers, f"{s.rows_a_minute:.0f}", f"{s.rows_a_minute_once_running:.0f}") for s in speeds]
    by_backend = {each.backend: each.served_s for each in speeds[1:]}
    served = ", ".join(f"{name} {1e3 * value:.2f}" for name, value in by_backend.items())
    return (
        f"{table(('backend', 'workers', 'rows a minute, all in', 'once running'), lines)}\n\n"
        f"a row: {statistics.median(row_s):.3f} s in a worker (median); ms of the distributing process: "
        f"{served}; {size:.0f} bytes on disk; {features:.0f} bytes of features of a frame"
    )


def main() -> None:
    """Measure."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--workers", type=int, nargs="+", default=[1, 2, 4])
    parser.add_argument("--rows", type=int, default=200)
    options = parser.parse_args()
    print(measured(options.workers, options.rows))


if __name__ == "__main__":
    main()
