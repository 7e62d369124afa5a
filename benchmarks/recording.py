"""Calibrate good and bad simulated scenes for docs/how-to/record-good-data.md, print its tables, draw its figures.

    python benchmarks/recording.py                          # the table of scenes, single frames
    python benchmarks/recording.py --gallery docs/gallery   # and the figures
    python benchmarks/recording.py --groups                 # the table of groups of frames, jointly

Each figure shows an image, and below it the overlay `after.png` of `p2o run --out`: edges of the image as lines, edges
of the sweep at the result as rings. The initial guesses have an error of 2 deg and 15 cm.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import json
import shutil
import tempfile
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import p2o
from p2o.arrays import UInt8
from p2o.cli import main as p2o_main
from p2o.files.whole_file import write_whole
from p2o.run.recipe import open_dataset

SCENES = {
    "street": "place=street&exposure_ev=0",
    "trees": "place=trees&exposure_ev=0",
    "overexposed": "place=street&exposure_ev=4&scenes=5",
    "blurred": "place=street&exposure_ev=0&blur_px=6",
    "few-rings": "place=street&exposure_ev=0&lidar=vlp-16",
    "small-overlap": "place=street&exposure_ev=0&lidar=mid-40",
}
"""Options of the scenes; the last frame is calibrated."""
LATE = "place=street&exposure_ev=0&speed_m_s=8&frames_per_scene=2"
"""A drive, 0.1 s from frame to frame: the image of the second frame with the sweep of the first is late by this."""
GROUPS = {
    "1 frame": "place=street&exposure_ev=0&scenes=1",
    "10 frames of one place, static": "place=street&exposure_ev=0&speed_m_s=0&frames_per_scene=10",
    "10 frames of one drive, 0.1 s apart": "place=street&exposure_ev=0&speed_m_s=8&frames_per_scene=10",
    "10 frames of one drive, 1 s apart": "place=street&exposure_ev=0&speed_m_s=8&frames_per_scene=10&period_s=1",
    "3 frames of different places": "place=street&exposure_ev=0&scenes=3",
    "10 frames of different places": "place=street&exposure_ev=0&scenes=10",
}
"""Options of the scenes of joint calibrations."""
PERTURB = "2deg 0.15m"
WIDTH_PX = 900
QUALITY = 60


def synthetic(options: str) -> str:
    return f"synthetic:?{options}&right=false"


def calibrated(data: str, out: Path, *words: str) -> dict[str, Any]:
    """Return the first result of `p2o run --out` as in run.json."""
    with contextlib.redirect_stdout(io.StringIO()):
        p2o_main(["run", "--data", data, "--perturb", PERTURB, "--out", str(out), *words])
    result: dict[str, Any] = json.loads((out / "run.json").read_text(encoding="utf-8"))["results"][0]
    return result


def row(name: str, result: dict[str, Any]) -> str:
    """Return a row of the table: verdict, predicted error (67 %) and error."""
    accuracy, error = result["accuracy"], result["error"]
    predicted = f"{accuracy['rotation_deg']:.2f} deg, {100 * accuracy['translation_m']:.1f} cm" if accuracy else "-"
    true = f"{error['rotation_deg']:.2f} deg, {100 * error['translation_m']:.1f} cm"
    return f"| {name} | `{result['verdict']['trust']}` | {predicted} | {true} |"


def late_image(folder: Path) -> str:
    """Write a frame whose image is late, and return its name as a dataset."""
    words = [word for option in LATE.split("&") for word in ("--set", option)]
    with contextlib.redirect_stdout(io.StringIO()):
        p2o_main(["simulate", str(folder), "--layout", "folder", "--set", "right=false", *words])
    first, second = sorted(folder.iterdir())
    shutil.copy(second / "image.png", first / "image.png")
    return f"folder:{first}"


def figure(image: UInt8, overlay: Path) -> UInt8:
    """Return an image and the overlay below it, at the width of the figures."""
    edges = cv2.imread(str(overlay))[..., ::-1]
    parts = [cv2.resize(part, (WIDTH_PX, round(WIDTH_PX * part.shape[0] / part.shape[1])), interpolation=cv2.INTER_AREA)
             for part in (image, edges)]  # fmt: skip
    return np.concatenate(parts)


def save(path: Path, rgb: UInt8) -> None:
    from PIL import Image

    file = io.BytesIO()
    Image.fromarray(rgb).save(file, "webp", quality=QUALITY, method=6)
    write_whole(path, file.getvalue())


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--gallery", type=Path, help="also write the figures to this folder")
    parser.add_argument("--groups", action="store_true", help="calibrate groups of frames jointly instead")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        home = Path(name)
        if arguments.groups:
            print("| frames | verdict | predicted error (67 %) | error |\n|---|---|---|---|")
            for group, options in GROUPS.items():
                print(row(group, calibrated(synthetic(options), home / group, "--joint")), flush=True)
            return
        print("| scene | verdict | predicted error (67 %) | error |\n|---|---|---|---|")
        data = {scene: synthetic(options) for scene, options in SCENES.items()}
        data["late-image"] = late_image(home / "late")
        for scene, source in data.items():
            result = calibrated(source, home / scene, "--frames", "-1")
            print(row(scene, result), flush=True)
            if arguments.gallery is not None:
                *_, frame = open_dataset(source, p2o.Registry.load())
                [overlay] = (home / scene).glob("*/after.png")
                save(arguments.gallery / f"record-{scene}.webp", figure(frame.image.rgb, overlay))


if __name__ == "__main__":
    main()
