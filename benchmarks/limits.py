"""Where the network's edges are good and where they are not, on synthetic images like and unlike what it has seen.

    python benchmarks/limits.py [--weights kitti] [--gallery docs/gallery]

For each kind of image: precision and recall of the edges surer than 0.5 within 2 px of an exact one of their own side
(leaves are neither right nor wrong), their best F over all thresholds, and how many edges there are. With --gallery,
an image of each with these edges drawn, as JPEG.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from edge_scores import edge_truth, judge_sides, precision_recall, score, together
from p2o import ImageEdges
from p2o.draw.overlay import COLOURS
from p2o.features.side import SIDES
from p2o_plugins.image.p2ornet import METHOD, P2ORNetOptions
from p2o_sim.synthetic import SyntheticOptions, build

SURE = 0.5
CASES: dict[str, dict[str, Any]] = {
    "street, as in training": {},
    "among trees": {"place": "trees"},
    "overexposed by 3 stops": {"exposure_ev": 3.0},
    "underexposed by 4 stops": {"exposure_ev": -4.0, "grain": 6.0},
    "blurred, 3 px": {"blur_px": 3.0},
    "heavy grain": {"grain": 20.0},
    "JPEG of quality 20": {"jpeg_quality": 20},
    "half the size": {"width_px": 621, "height_px": 188},
    "wide-angle with distortion": {"camera": "opencv-distorted"},
    "fisheye": {"camera": "fisheye"},
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--weights", default="kitti", help="kitti, synthetic or a file")
    parser.add_argument("--frames", type=int, default=3, help="places of each kind")
    parser.add_argument("--seed", type=int, default=301, help="seed of the places")
    parser.add_argument("--gallery", type=Path, help="draw the first of each kind into this folder")
    arguments = parser.parse_args()
    extract = METHOD.build(P2ORNetOptions(weights=arguments.weights))
    print("| image | edges per image with a confidence over 0.5 | precision | recall | best F |")
    print("|---|---|---|---|---|")
    for name, words in CASES.items():
        options = {"place": "street", "seed": arguments.seed, "right": False, "mask_foliage": True, **words}
        frames = build(SyntheticOptions(scenes=arguments.frames, **options))
        judged, count = [], 0
        for number in range(arguments.frames):
            image = frames[number].image
            truth = edge_truth(image.depth_m, image.camera, masked=image.masked)
            found = extract(type(image)(image.rgb, image.camera)).edges
            judged += judge_sides(found, truth).values()
            count += int((found.weight >= SURE).sum())
            if number == 0 and arguments.gallery is not None:
                arguments.gallery.mkdir(parents=True, exist_ok=True)
                file = arguments.gallery / f"p2ornet-{name.split(',')[0].replace(' ', '-').lower()}.jpg"
                cv2.imwrite(str(file), drawn(image.rgb, found)[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, 70])
        all_four = together(judged)
        precision, recall = precision_recall(all_four, SURE)
        best = score([all_four]).ods
        print(f"| {name} | {count // arguments.frames} | {precision:.2f} | {recall:.2f} | {best:.2f} |", flush=True)


def drawn(rgb: np.ndarray, edges: ImageEdges) -> np.ndarray:
    """Return the image above the same with its surer edges: L green, R red, U yellow, B blue."""
    canvas = (0.45 * rgb).astype(np.uint8)
    sure = edges.select(edges.weight >= SURE)
    colours = np.array([COLOURS[side.letter] for side in SIDES], np.uint8)
    place = np.clip(np.rint(sure.uv), 0, np.array(rgb.shape[1::-1]) - 1).astype(int)
    canvas[place[:, 1], place[:, 0]] = colours[sure.side]
    return np.concatenate([rgb, canvas])


if __name__ == "__main__":
    main()
