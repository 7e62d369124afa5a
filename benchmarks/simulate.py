"""Time the simulator: `python benchmarks/simulate.py [--frames 6]`.

Frames a second at 1242x375 with a sweep of the HDL-64E, by kind of place: on a drive (the place is built once), and
with a new place for each frame; both with and without the right picture. Wall time on the cores this process may use,
and the CPU time in brackets, which does not depend on what else the machine does.
"""

from __future__ import annotations

import argparse
import os
import time

from p2o_plugins.data.synthetic import SyntheticOptions, _drive, build, view

PLACES = ("street", "suburb", "highway", "trees")


def timed(options: SyntheticOptions, frames: list[tuple[int, int]]) -> tuple[float, float]:
    """Return seconds of wall and CPU time a frame."""
    wall, busy = time.perf_counter(), time.process_time()
    for scene, number in frames:
        view(options, scene, number)
    return (time.perf_counter() - wall) / len(frames), (time.process_time() - busy) / len(frames)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--frames", type=int, default=6, help="frames of each figure")
    frames = parser.parse_args().frames
    build(SyntheticOptions())[0]  # imports and tables
    print(f"{len(os.sched_getaffinity(0))} cores; frames a second, wall (CPU seconds a frame)\n")
    print("| place | drive | drive, with right picture | new places | new places, with right picture |\n|---|---|---|---|---|")
    for place in PLACES:
        cells = []
        for new in (False, True):
            for right in (False, True):
                shape = {"scenes": frames} if new else {"frames_per_scene": frames}
                options = SyntheticOptions(place=place, right=right, seed=1, **shape)
                _drive.cache_clear()
                if not new:
                    view(options, 0, 0)  # builds the place
                wall, busy = timed(options, [(i, 0) if new else (0, i) for i in range(frames)])
                cells.append(f"{1 / wall:.1f} ({busy:.2f} s)")
        print(f"| {place} | " + " | ".join(cells) + " |", flush=True)


if __name__ == "__main__":
    main()
