"""Draw the animated figure of the README: a crossing with its sweep at a wrong initial guess and at the result of p2o.

    python benchmarks/front_page.py --data folder:build/data/rigs/pjlab --frames 2

The frame is no part of the repository: docs/gallery/NOTICE states its source and its licence. The
start is 2 deg and 15 cm off the published extrinsic; between start and result the pose is only blended.
"""

from __future__ import annotations

import argparse
import io
from pathlib import Path

import cv2
import numpy as np
import p2o
from p2o.arrays import Float, UInt8
from p2o.draw.sweep_image import draw_sweep
from p2o.files.whole_file import write_whole
from p2o.run.recipe import open_dataset
from p2o.solving import image_at_scale

ROWS = (0.19, 0.70)
"""The displayed crop of the image: there are no returns above it, and the road below is empty."""
HELD_MS = 1600, 3200
BLENDED = 7
BLENDED_MS = 70


def drawn(frame: p2o.Frame, camera_from_lidar: Float, said: str) -> UInt8:
    """Return the sweep drawn on the cropped image, with a caption in the upper left corner."""
    image = image_at_scale(frame.image)
    swept = draw_sweep(image.rgb, frame.cloud, image.camera, camera_from_lidar)
    top, bottom = (round(share * len(swept)) for share in ROWS)
    small = cv2.addWeighted(swept, 0.85, image.rgb, 0.15, 0)[top:bottom]
    small[6:32, 6 : 16 + 9 * len(said)] //= 4
    cv2.putText(small, said, (12, 24), cv2.FONT_HERSHEY_SIMPLEX, 0.5, (245, 245, 245), 1, cv2.LINE_AA)
    return np.asarray(small)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", default="folder:build/data/rigs/pjlab", help="dataset of the frame")
    parser.add_argument("--frames", default="2", help="which frame")
    parser.add_argument("--perturb", default="2deg 0.15m", help="how wrong the start is")
    parser.add_argument("--out", type=Path, default=Path("docs/gallery/crossing.webp"))
    arguments = parser.parse_args()
    from PIL import Image

    run = p2o.calibrate(arguments.data, frames=arguments.frames, perturb=arguments.perturb)
    result, error = run.result, run.rows[0].error
    assert result is not None
    print(result.verdict.trust, error)
    [frame] = [f for f in open_dataset(arguments.data, p2o.Registry.load()) if f.name == result.frames[0]]
    step = p2o.se3.log(result.camera_from_lidar @ p2o.se3.inverse(result.start))
    shares = [0.0, *((1 - np.cos(np.pi * np.arange(1, BLENDED + 1) / (BLENDED + 1))) / 2), 1.0]
    said = [
        f"start: {arguments.perturb} off".replace("0.15m", "15 cm").replace("2deg", "2 deg and"),
        *[""] * BLENDED,
        "result",
    ]
    pictures = [
        Image.fromarray(drawn(frame, p2o.se3.exp(share * step) @ result.start, text))
        for share, text in zip(shares, said, strict=True)
    ]
    held = [HELD_MS[0], *[BLENDED_MS] * BLENDED, HELD_MS[1]]
    file = io.BytesIO()
    pictures[0].save(
        file, "webp", save_all=True, append_images=pictures[1:], duration=held, loop=0, quality=62, method=6
    )
    write_whole(arguments.out, file.getvalue())


if __name__ == "__main__":
    main()
