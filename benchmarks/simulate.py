"""Time the simulator, or draw the gallery of docs/simulator.md: `python benchmarks/simulate.py [--gallery FOLDER]`.

Frames a second at 1242x375 with a sweep of the HDL-64E, by kind of place: on a drive (the place is built once), and
with a new place for each frame; both with and without the right image. Wall time on the cores this process may use,
and the CPU time in brackets, which does not depend on what else the machine does.
"""

from __future__ import annotations

import argparse
import os
import time
from pathlib import Path
from typing import Any

import numpy as np
from p2o import SIDES, occlusion
from p2o.draw.overlay import COLOURS, draw_cloud
from p2o_sim import labels
from p2o_sim.synthetic import SyntheticOptions, _drive, build, view

GALLERY = {"street": 0, "suburb": 2, "highway": 3, "trees": 1}
"""Seeds of the images."""
BOARDS: dict[str, dict[str, Any]] = {
    "checkerboard": {"seed": 4},
    "holes": {"seed": 2, "boards": 2, "board": "a1", "holder": "stand"},
}
"""Options of the images of boards."""
BUILDINGS = {"hall": 2, "room": 0}
"""Seeds of the images of places inside of buildings."""
PLACES = ("street", "suburb", "highway", "trees", "hall", "room")


def timed(options: SyntheticOptions, frames: list[tuple[int, int]]) -> tuple[float, float]:
    """Return seconds of wall and CPU time a frame."""
    wall, busy = time.perf_counter(), time.process_time()
    for scene, number in frames:
        view(options, scene, number)
    return (time.perf_counter() - wall) / len(frames), (time.process_time() - busy) / len(frames)


def gallery(folder: Path) -> None:
    """Write an image of each kind of place and board, and of one place depth, sweep and labels, as JPEG."""
    folder.mkdir(parents=True, exist_ok=True)
    for place, seed in GALLERY.items():
        options = SyntheticOptions(place=place, seed=seed, right=False)
        seen = view(options, 0)
        save(folder / f"{place}.jpg", seen.frame.image.rgb)
        if place == "street":
            frame, picture = seen.frame, seen.rendered
            sweep = draw_cloud(frame.image.rgb, frame.cloud, frame.camera, frame.camera_from_lidar)
            save(folder / "sweep.jpg", sweep)
            orders = labels(picture, frame.camera, mask_foliage=True)
            uv, side = occlusion.edges_from_orders(orders)
            canvas = (0.35 * frame.image.rgb).astype(np.uint8)
            colours = np.array([COLOURS[s.letter] for s in SIDES], np.uint8)
            canvas[uv[:, 1].astype(int), uv[:, 0].astype(int)] = colours[side]
            save(folder / "labels.jpg", canvas)
            close = np.clip(3.0 / picture.depth_m, 0, 1) ** 0.5
            save(folder / "depth.jpg", np.repeat((255 * close).astype(np.uint8)[..., None], 3, axis=2))
            save(folder / "normals.jpg", (127.5 * (1 - picture.normals)).astype(np.uint8))
    for place, seed in BUILDINGS.items():
        wide = {"width_px": 960, "height_px": 540, "focal_px": 520.0, "exposure_ev": 0.0, "right": False}
        save(folder / f"{place}.jpg", view(SyntheticOptions(place=place, seed=seed, **wide), 0).frame.image.rgb)
    for targets, options in BOARDS.items():
        options = SyntheticOptions(targets=targets, place="yard", exposure_ev=-0.5, right=False, **options)
        save(folder / f"{targets}.jpg", view(options, 0).frame.image.rgb)


def save(path: Path, rgb: np.ndarray) -> None:
    import cv2

    cv2.imwrite(str(path), rgb[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, 70])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--frames", type=int, default=6, help="frames of each figure")
    parser.add_argument("--gallery", type=Path, help="write pictures to this folder instead")
    arguments = parser.parse_args()
    frames = arguments.frames
    if arguments.gallery is not None:
        gallery(arguments.gallery)
        return
    build(SyntheticOptions())[0]  # imports and tables
    print(f"{len(os.sched_getaffinity(0))} cores; frames a second, wall (CPU seconds a frame)\n")
    print(
        "| place | drive | drive, right picture too | new places | new places, right picture too |\n"
        "|---|---|---|---|---|"
    )
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
