"""Draw what each pair of extractors sees of a synthetic street: `python benchmarks/features.py --gallery docs/gallery`.

For each family an image features-FAMILY.jpg; in each row the features of the image, and those of the sweep at the
true pose on the image. Coloured by direction (L green, R red, U yellow, B blue) where they have one, by intensity, by
segment, or magenta.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import cv2
import numpy as np
import p2o
from p2o import CloudFeatures, Frame, ImageFeatures, Recipe, Registry
from p2o.arrays import Float, UInt8
from p2o.draw.overlay import dimmed, draw, stamp

STREET = "synthetic:?seed=4&scenes=1&place=street&lidar=os1-128&right=false"
FAMILIES = {
    "edges": {
        "ours": ("p2ornet/rings", "ogm"),
        "Canny": ("canny/rings", "nearest"),
        "Levinson 2013": ("idt/ring-discontinuity", "idt"),
        "Castorena 2016": ("smoothness/returns", "tv-fusion"),
    },
    "lines": {
        "Zhang 2021": ("line-idt/line-points", "line-idt"),
        "Moghadam 2013": ("lsd/plane-lines", "lines"),
        "Yuan 2021": ("canny-long/voxel-planes", "knn-line"),
    },
    "points": {"Pandey 2012, Koide 2023": ("grey/reflectance", "mi")},
    "segments": {
        "CalibAnything 2023": ("masks/attributes", "mask-consistency"),
        "Ma 2021": ("lane-pole/lane-pole", "crlf"),
    },
}
SOLVERS = dict.fromkeys(("mi", "idt", "line-idt", "tv-fusion", "mask-consistency", "crlf"), "nelder-mead")
_DOT = np.array([[0, 0], [1, 0], [0, 1], [1, 1]])
_MAGENTA = (255, 0, 255)


def of_image(frame: Frame, found: ImageFeatures) -> UInt8:
    """Return the features of the image as an image (H, W, 3)."""
    canvas = dimmed(frame.image.rgb, frame.camera)
    if found.edges is not None:
        # Edges alone: a sweep without points.
        return draw(frame.image.rgb, found.edges, p2o.CloudEdges.empty(), frame.camera, np.eye(4), legend=False)
    for feature in found.features:
        if feature.word == "image-lines":
            for first, last in np.rint(feature.ends).astype(int):
                cv2.line(canvas, tuple(first.tolist()), tuple(last.tolist()), _MAGENTA, 2)
        elif feature.word == "image-masks":
            labels = feature.labels[..., 0]
            canvas[labels >= 0] = colours(labels[labels >= 0])
        elif feature.word == "image-lane-pole":
            near = np.atleast_3d(feature.values) <= 1
            canvas[near[..., 0]], canvas[near[..., 1]] = (255, 220, 0), (255, 60, 60)
        else:
            values = np.asarray(feature.values, np.float64)
            low, high = np.percentile(values, [1, 99])
            grey = 255 * np.clip((values - low) / max(high - low, 1e-9), 0, 1)
            canvas = np.repeat(grey[..., None], 3, axis=2).astype(np.uint8)
    return canvas


def of_sweep(frame: Frame, found: CloudFeatures) -> UInt8:
    """Return the features of the sweep at the true pose on the image (H, W, 3)."""
    pose = frame.camera_from_lidar
    assert pose is not None
    if found.edges is not None:
        return draw(frame.image.rgb, p2o.ImageEdges.empty(), found.edges, frame.camera, pose, legend=False)
    canvas = dimmed(frame.image.rgb, frame.camera)
    for feature in found.features:
        if feature.word == "cloud-points":
            canvas = points(frame, canvas, feature.xyz, shade(feature.intensity, len(feature)))
        elif feature.word == "cloud-lines":
            ends = frame.camera.project(p2o.se3.apply(pose, feature.ends.reshape(-1, 3))).reshape(-1, 2, 2)
            seen = frame.camera.in_image(ends.reshape(-1, 2)).reshape(-1, 2).all(axis=1)
            for first, last in np.rint(ends[seen]).astype(int):
                cv2.line(canvas, tuple(first.tolist()), tuple(last.tolist()), _MAGENTA, 2)
        elif feature.word == "cloud-segments":
            canvas = points(frame, canvas, feature.xyz, colours(feature.segment))
        elif feature.word == "cloud-lane-pole":
            kinds = np.where(feature.kind[:, None] == 0, (255, 220, 0), (255, 60, 60)).astype(np.uint8)
            canvas = points(frame, canvas, feature.xyz, kinds)
    return canvas


def points(frame: Frame, canvas: UInt8, xyz: Float, rgb: UInt8) -> UInt8:
    """Return the canvas with points (K, 3) of the sweep stamped on it in their colours (K, 3)."""
    assert frame.camera_from_lidar is not None
    uv = frame.camera.project(p2o.se3.apply(frame.camera_from_lidar, xyz))
    seen = frame.camera.in_image(uv)
    stamp(canvas, np.rint(uv[seen]).astype(np.int64), _DOT, rgb[seen])
    return canvas


def shade(intensity: Float | None, count: int) -> UInt8:
    """Return colours (K, 3) by the rank of the intensity, magenta where there is none."""
    if intensity is None:
        return np.tile(np.array(_MAGENTA, np.uint8), (count, 1))
    rank = np.argsort(np.argsort(intensity)) * 255 // max(count - 1, 1)
    return np.asarray(cv2.applyColorMap(rank.astype(np.uint8)[:, None], cv2.COLORMAP_VIRIDIS)[:, 0, ::-1])


def colours(number: np.ndarray) -> UInt8:
    """Return a colour (K, 3) for each number (K,), those of neighbouring numbers far apart."""
    hue = (np.asarray(number, np.int64) * 67 % 180).astype(np.uint8)
    hsv = np.stack([hue, np.full_like(hue, 200), np.full_like(hue, 255)], axis=-1)
    return np.asarray(cv2.cvtColor(hsv[None], cv2.COLOR_HSV2RGB)[0])


def titled(picture: UInt8, text: str) -> UInt8:
    """Return an image under a bar with its title."""
    bar = np.full((34, picture.shape[1], 3), 24, np.uint8)
    cv2.putText(bar, text, (10, 24), cv2.FONT_HERSHEY_SIMPLEX, 0.75, (235, 235, 235), 1, cv2.LINE_AA)
    return np.concatenate([bar, picture])


def main() -> None:
    """Write the images."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--gallery", type=Path, default=Path("docs/gallery"))
    parser.add_argument("families", nargs="*", metavar="FAMILY", help=f"of {', '.join(FAMILIES)} (default: all)")
    arguments = parser.parse_args()
    registry = Registry.load()
    frame = Recipe.of(data=STREET).resolve(registry).dataset()[0]
    for family in arguments.families or FAMILIES:
        rows = []
        for title, (pair, matcher) in FAMILIES[family].items():
            plan = Recipe.of(extractor=pair, matcher=matcher, init="given", solver=SOLVERS.get(matcher, "lm")).resolve(
                registry
            )
            image = plan.parts["extractor"].offer.method.build(plan.parts["extractor"].options)(frame.image)
            sweep = plan.parts["cloud"].offer.method.build(plan.parts["cloud"].options)(frame.cloud)
            pictures = [of_image(frame, image), of_sweep(frame, sweep)]
            names = (f"{title}: image", f"{title}: sweep")
            rows.append(np.hstack([titled(p, n) for p, n in zip(pictures, names, strict=True)]))
        whole = np.concatenate(rows)
        small = cv2.resize(whole, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)
        cv2.imwrite(str(arguments.gallery / f"features-{family}.jpg"), small[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, 70])


if __name__ == "__main__":
    main()
