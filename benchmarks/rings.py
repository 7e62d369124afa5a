"""Time the LiDAR side on whole sweeps: `python benchmarks/rings.py PATH_TO_KITTI_RAW [FRAMES.json]`.

Prints milliseconds a sweep and their ratio to one numpy argsort of the same points in random order, which makes
figures of different machines comparable. One core: set OMP_NUM_THREADS=1.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from p2o import Cloud
from p2o_plugins.cloud.rings import METHOD

TEST_DRIVES = ("0005", "0011", "0019", "0027", "0036", "0046", "0070", "0084", "0096")
REPEATS = 9


def best_ms(call: Callable[[], object]) -> float:
    """Return the shortest of several runs: what the code needs when nothing else uses the core."""
    times = []
    for _ in range(REPEATS):
        begin = time.perf_counter()
        call()
        times.append(time.perf_counter() - begin)
    return 1e3 * min(times)


def main() -> None:
    if len(sys.argv) < 2:
        raise SystemExit(__doc__)
    files = sorted(
        path
        for drive in TEST_DRIVES
        for path in Path(sys.argv[1]).glob(f"*/*_drive_{drive}_sync/velodyne_points/data/*.bin")
    )
    if not files:
        raise SystemExit(f"{sys.argv[1]}: no velodyne_points/data/*.bin of drives {', '.join(TEST_DRIVES)}")
    extract = METHOD.build(METHOD.options())
    rng = np.random.default_rng(0)
    rows = []
    for path in files:
        cloud = Cloud(np.fromfile(path, np.float32).reshape(-1, 4)[:, :3])
        key = rng.random(len(cloud))
        edges = extract(cloud).edges
        rows.append((len(cloud), len(edges), best_ms(lambda c=cloud: extract(c)), best_ms(lambda k=key: np.argsort(k))))
    points, edges, ours, sort = np.array(rows).T
    print(f"{len(rows)} sweeps, {np.median(points):.0f} points, {np.median(edges):.0f} edges (medians)")
    print(f"rings: median {np.median(ours):.1f} ms, slowest {ours.max():.1f} ms")
    print(f"argsort of as many numbers: {np.median(sort):.1f} ms; ratio {np.median(ours / sort):.1f}")


if __name__ == "__main__":
    main()
