"""Draw the animated figure of the README: a crossing with its sweep at a wrong initial guess and at the result of p2o.

    python benchmarks/front_page.py

The frame is no part of the repository: docs/gallery/NOTICE states its source and its licence. The initial guess has an
error of 2 deg and 15 cm; between initial guess and result the pose is only blended.
"""

from __future__ import annotations

import cv2
import numpy as np
import p2o
from limits_and_tables import write_webp
from p2o.arrays import Float, UInt8
from p2o.draw.sweep_image import draw_sweep
from p2o.run.recipe import open_dataset
from p2o.solving import image_at_scale

DATA, FRAME = "folder:build/data/rigs/pjlab", "2"
ROWS = (0.19, 0.70)
"""The displayed crop of the image: there are no returns above it, and the road below is empty."""
SHOWN_MS = 1600, 3200
BLENDED = 7
BLENDED_MS = 70


def drawn(frame: p2o.Frame, camera_from_lidar: Float, caption: str) -> UInt8:
    """Return the sweep drawn on the cropped image, with a caption in the upper left corner."""
    image = image_at_scale(frame.image)
    sweep = draw_sweep(image.rgb, frame.cloud, image.camera, camera_from_lidar)
    top, bottom = (round(share * len(sweep)) for share in ROWS)
    small = cv2.addWeighted(sweep, 0.85, image.rgb, 0.15, 0)[top:bottom]
    small[6:32, 6 : 16 + 9 * len(caption)] //= 4
    cv2.putText(small, caption, (12, 24), cv2.FONT_HERSHEY_SIMPLEX, 0.5, (245, 245, 245), 1, cv2.LINE_AA)
    return np.asarray(small)


def main() -> None:
    """Calibrate the frame and write the figure."""
    run = p2o.calibrate(DATA, frames=FRAME, perturb="2deg 0.15m")
    result, error = run.result, run.rows[0].error
    assert result is not None
    print(result.verdict.trust, error)
    [frame] = [f for f in open_dataset(DATA, p2o.Registry.load()) if f.name == result.frames[0]]
    step = p2o.se3.log(result.camera_from_lidar @ p2o.se3.inverse(result.start))
    shares = [0.0, *((1 - np.cos(np.pi * np.arange(1, BLENDED + 1) / (BLENDED + 1))) / 2), 1.0]
    captions = ["start: 2 deg and 15 cm off", *[""] * BLENDED, "result"]
    images = [
        drawn(frame, p2o.se3.exp(share * step) @ result.start, caption)
        for share, caption in zip(shares, captions, strict=True)
    ]
    durations = [SHOWN_MS[0], *[BLENDED_MS] * BLENDED, SHOWN_MS[1]]
    write_webp("docs/gallery/crossing.webp", images, duration=durations, loop=0, quality=62)


if __name__ == "__main__":
    main()
