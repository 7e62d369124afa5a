"""Time the LiDAR side on whole sweeps: `python benchmarks/rings.py PATH_TO_KITTI_RAW`.

Prints milliseconds a sweep and their ratio to one numpy argsort of the same number of random values, which makes
figures of different machines comparable. Time is that of one core (set OMP_NUM_THREADS=1), without what other
programs use of it.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from p2o import Cloud
from p2o_plugins.cloud.rings import METHOD

TEST_FRAMES = {
    "0005": (10, 59),
    "0011": (111, 127, 147, 157, 167),
    "0019": (30, 87, 97),
    "0027": (53, 103),
    "0036": (54, 402),
    "0046": (52, 62),
    "0070": (69, 224),
    "0084": (84, 179, 238),
    "0096": (20, 278, 381),
}
REPEATS = 9


def best_ms(call: Callable[[], object]) -> float:
    """Return the shortest of several runs."""
    times = []
    for _ in range(REPEATS):
        begin = time.process_time()
        call()
        times.append(time.process_time() - begin)
    return 1e3 * min(times)


def main() -> None:
    if len(sys.argv) < 2:
        raise SystemExit(__doc__)
    files = [
        Path(sys.argv[1]) / f"2011_09_26/2011_09_26_drive_{drive}_sync/velodyne_points/data/{frame:010}.bin"
        for drive, frames in TEST_FRAMES.items()
        for frame in frames
    ]
    missing = [path for path in files if not path.is_file()]
    if missing:
        raise SystemExit(f"{missing[0]}: no such sweep ({len(missing)} of {len(files)} missing)")
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
