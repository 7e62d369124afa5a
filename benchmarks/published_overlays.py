"""Draw the edges of a frame at the published extrinsic and at the one that `p2o check` estimates from them.

    python benchmarks/published_overlays.py --data folder:build/data/rigs/pjlab --frames 0 --out docs/gallery/FILE.webp

The estimate is that of all frames of `--frames`, the first of them is drawn. `--crop` keeps a part of the image (left,
top, width and height in pixels of the downsampled image). Frames may be shown where their card permits it
(benchmarks/cards).
"""

from __future__ import annotations

import argparse

import numpy as np
import p2o
from limits_and_tables import write_webp
from p2o.draw.overlay import before_after, draw
from p2o.frames.scale import image_at_scale
from p2o.run.pipeline import Pipeline
from p2o.run.recipe import Recipe


def main() -> None:
    """Estimate the extrinsic and write the figure."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", required=True, help="dataset of the frames")
    parser.add_argument("--frames", required=True, help="which frames, as of p2o check")
    parser.add_argument("--estimate", choices=("check", "calibrate"), default="check", help="what estimates the pose")
    parser.add_argument("--crop", type=int, nargs=4, metavar=("LEFT", "TOP", "WIDTH", "HEIGHT"))
    parser.add_argument("--out", required=True)
    options = parser.parse_args()
    check = p2o.check(options.data, "truth", frames=options.frames)
    print(check.holding.value, check.reason)
    published, estimate = check.camera_from_lidar, check.estimate
    if options.estimate == "calibrate":
        result = p2o.calibrate(options.data, frames=options.frames, joint=True).result
        estimate = None if result is None else result.camera_from_lidar
    if estimate is None:
        raise SystemExit(check.reason)
    print(p2o.pose_error(published, estimate))
    plan = Recipe.of(data=options.data).resolve(p2o.Registry.load())
    dataset, pipeline = plan.dataset(), plan.calibrator()
    assert isinstance(pipeline, Pipeline)
    frame = dataset[list(dataset.names).index(check.frames[0])]
    view, image = pipeline.prepare(frame.without_truth()), image_at_scale(frame.image)
    left, top, width, height = options.crop or (0, 0, view.camera.width, view.camera.height)
    overlays = []
    for pose in (published, estimate):
        visible = view.as_seen_from(pose).without_hidden(pose)
        canvas = draw(image.rgb, visible.image_edges, visible.cloud_edges, view.camera, pose, legend=False)
        overlays.append(np.ascontiguousarray(canvas[top : top + height, left : left + width]))
    titles = ("published extrinsic", "extrinsic estimated from the edges")
    write_webp(options.out, [before_after(*overlays, titles=titles)], quality=70)


if __name__ == "__main__":
    main()
