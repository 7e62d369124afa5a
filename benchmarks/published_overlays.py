"""Draw the edges of a frame at the published extrinsic and at the one that `p2o check` estimates from them.

    python benchmarks/published_overlays.py --data folder:build/data/rigs/pjlab --frames 0 --out docs/gallery/FILE.webp

The estimate is that of all frames of `--frames`, the first of them is drawn. `--crop` keeps a part of the image (left,
top, width and height in pixels of the downsampled image). Frames may be shown where their card permits it
(benchmarks/cards).
"""

from __future__ import annotations

import argparse
import io
from pathlib import Path

import numpy as np
import p2o
from p2o.arrays import Float, UInt8
from p2o.draw.overlay import before_after, draw
from p2o.files.whole_file import write_whole
from p2o.frames.scale import image_at_scale
from p2o.run.pipeline import Pipeline
from p2o.run.recipe import Recipe


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", required=True, help="dataset of the frames")
    parser.add_argument("--frames", required=True, help="which frames, as of p2o check")
    parser.add_argument("--estimate", choices=("check", "calibrate"), default="check", help="what estimates the pose")
    parser.add_argument("--crop", type=int, nargs=4, metavar=("LEFT", "TOP", "WIDTH", "HEIGHT"))
    parser.add_argument("--out", type=Path, required=True)
    arguments = parser.parse_args()
    published, estimate, name = poses(arguments.data, arguments.frames, arguments.estimate)
    images = overlays(arguments.data, name, (published, estimate), arguments.crop)
    titles = ("published extrinsic", "extrinsic estimated from the edges")
    from PIL import Image

    file = io.BytesIO()
    Image.fromarray(before_after(*images, titles=titles)).save(file, "webp", quality=70, method=6)
    write_whole(arguments.out, file.getvalue())


def poses(data: str, frames: str, by: str) -> tuple[Float, Float, str]:
    """Return the published extrinsic (4, 4), the estimated one, and the name of the first frame."""
    check = p2o.check(data, "truth", frames=frames)
    print(check.holding.value, check.reason)
    estimate, name = check.estimate, check.frames[0]
    if by == "calibrate":
        result = p2o.calibrate(data, frames=frames, joint=True).result
        assert result is not None
        estimate = result.camera_from_lidar
    if estimate is None:
        raise SystemExit(check.reason)
    print(p2o.pose_error(check.camera_from_lidar, estimate))
    return check.camera_from_lidar, estimate, name


def overlays(data: str, name: str, each: tuple[Float, Float], crop: list[int] | None) -> tuple[UInt8, UInt8]:
    """Return the edges of a frame at two poses (4, 4), drawn on its image."""
    plan = Recipe.of(data=data).resolve(p2o.Registry.load())
    dataset, pipeline = plan.dataset(), plan.calibrator()
    assert isinstance(pipeline, Pipeline)
    frame = dataset[list(dataset.names).index(name)]
    view, image = pipeline.prepare(frame.without_truth()), image_at_scale(frame.image)
    drawn = []
    for pose in each:
        seen = view.as_seen_from(pose).without_hidden(pose)
        canvas = draw(image.rgb, seen.image_edges, seen.cloud_edges, view.camera, pose, legend=False)
        left, top, width, height = crop or (0, 0, canvas.shape[1], canvas.shape[0])
        drawn.append(np.ascontiguousarray(canvas[top : top + height, left : left + width]))
    return drawn[0], drawn[1]


if __name__ == "__main__":
    main()
